"""Detections on photographs that are stars: python tools/photograph_detections.py FRAMES --camera FILE --site LAT LON HEIGHT.

Frames and the camera's file are those of `celnav calibrate`. A detection is a star if the catalogue has one of at most
`--to-mag` within 1.5 px, through the camera and the attitude that the frame's own stars give. With `--learn-mask`, the second
pair of columns is that of the detections outside the mask that `celnav.sky_mask` learns from all the frames.
"""

from __future__ import annotations

import argparse

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

import celnav
from celnav.calibrating.frames import Site, sky_over
from celnav.position import Weather
from celnav.reading.fits_file import read_fits
from celnav.sky.utc import parse_utc

F8 = NDArray[np.float64]

_RADIUS_PX = 1.5


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("frames", nargs="+")
    parser.add_argument("--camera", required=True)
    parser.add_argument("--site", type=float, nargs=3, required=True, metavar=("LAT", "LON", "HEIGHT"))
    parser.add_argument("--to-mag", type=float, default=7.5)
    parser.add_argument("--learn-mask", action="store_true")
    arguments = parser.parse_args()
    camera = celnav.read_camera_file(arguments.camera).camera
    attitude = celnav.Attitude.from_json(arguments.camera)
    lat, lon, height_m = arguments.site
    air = celnav.usual_weather(height_m)
    site = Site(lat, lon, Weather(air.pressure_hpa, air.temperature_c))
    photographs = [read_fits(path) for path in arguments.frames]
    mask = celnav.sky_mask([each.pixels for each in photographs]) if arguments.learn_mask else None
    print("| frame | detections | not stars | with the mask | not stars |\n|-|-|-|-|-|")
    for path, photograph in zip(arguments.frames, photographs, strict=True):
        if photograph.exposure.middle is None:
            parser.error(f"{path} does not say when it was taken")
        found = celnav.detect(photograph.pixels)
        fix = celnav.solve(
            found,
            camera,
            photograph.exposure.middle,
            attitude,
            pressure_hpa=air.pressure_hpa,
            temperature_c=air.temperature_c,
        )
        cells = [str(len(found)), "-", "-", "-"]
        if fix.ok:
            sky = sky_over(site, parse_utc(photograph.exposure.middle), arguments.to_mag)
            index = {int(star): row for row, star in enumerate(sky.star_id)}
            pairs = [(detection, index[int(star)]) for detection, star in fix.matches if int(star) in index]
            rows = np.array(pairs)
            turn, _ = Rotation.align_vectors(camera.to_rays(found.uv[rows[:, 0]]), sky.dirs[rows[:, 1]])
            stars = camera.project(turn.apply(sky.dirs))
            stars = stars[np.isfinite(stars).all(axis=1)]
            cells[1] = _share(found.uv, stars)
            if mask is not None:
                masked = celnav.detect(photograph.pixels, mask)
                cells[2:] = [str(len(masked)), _share(masked.uv, stars)]
        print(f"| {path} | {' | '.join(cells)} |")


def _share(uv: F8, stars: F8) -> str:
    """Return the percentage of positions without a star within the radius."""
    apart, _ = cKDTree(stars).query(uv)
    return f"{100 * np.mean(apart > _RADIUS_PX):.0f} %"


if __name__ == "__main__":
    main()
