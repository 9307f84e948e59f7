"""Places from photographs with a wrong lens: python tools/wrong_lenses.py FRAMES --camera FILE --lat DEG --lon DEG.

Frames and the camera's file are those of `celnav calibrate`. The principal point is moved in six directions, the focal length
is changed, the lens replaced by an equidistant one, and its axis put into the middle of the picture; the vertical stays. A
place is wrong if its error is larger than 15 km and than 5.5 standard deviations, which chance exceeds once in three million.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

import celnav
from benchmark.judge.geodesy import east_north_km
from celnav.reading.fits_file import read_fits

SHIFTS_PX = (3, 6, 10, 14, 20, 30, 40, 60, 100)
DIRECTIONS_DEG = (0, 35, 100, 180, 215, 280)
FACTORS = (0.98, 0.99, 1.005, 1.01, 1.02, 1.04)
WRONG_KM, WRONG_SQUARE = 15.0, 30.0


def lenses(lens: celnav.Camera) -> Iterator[tuple[str, celnav.Camera]]:
    """The lens, and wrong ones, with their names."""
    yield "as it is", lens
    for shift_px in SHIFTS_PX:
        for turn in map(math.radians, DIRECTIONS_DEG):
            du, dv = shift_px * math.cos(turn), shift_px * math.sin(turn)
            yield f"axis {du:+.0f} {dv:+.0f} px", replace(lens, cx_px=lens.cx_px + du, cy_px=lens.cy_px + dv)
    for factor in FACTORS:
        fy_px = None if lens.fy_px is None else factor * lens.fy_px
        yield f"focal length x {factor}", replace(lens, f_px=factor * lens.f_px, fy_px=fy_px)
    yield "equidistant", celnav.Camera("equidistant", lens.width, lens.height, lens.f_px)
    yield "axis in the middle", replace(lens, cx_px=(lens.width - 1) / 2, cy_px=(lens.height - 1) / 2)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("frames", nargs="+")
    parser.add_argument("--camera", required=True)
    parser.add_argument("--lat", type=float, required=True)
    parser.add_argument("--lon", type=float, required=True)
    parser.add_argument("--tilt-deg", type=float, default=0.05, help="standard deviation of the vertical")
    arguments = parser.parse_args()
    lens = replace(celnav.read_camera_file(arguments.camera).camera, uncertainty=None)
    attitude = celnav.Attitude.from_json(arguments.camera)
    vertical = celnav.Attitude.up(attitude.R_cam[:, 2], tilt_deg=arguments.tilt_deg)
    wrong = refused = solved = 0
    for path in arguments.frames:
        frame = read_fits(path)
        if frame.exposure.middle is None:
            parser.error(f"{path} does not say when it was taken")
        detections = celnav.detect(frame.pixels)
        for name, camera in lenses(lens):
            fix = celnav.solve(detections, camera, frame.exposure.middle, vertical)
            solved, refused = solved + fix.ok, refused + (not fix.ok)
            if not fix.ok or fix.cov_km2 is None:
                continue
            error = np.array(east_north_km(arguments.lat, arguments.lon, fix.lat_deg, fix.lon_deg))
            square, error_km = float(error @ np.linalg.solve(fix.cov_km2, error)), math.hypot(*error)
            if error_km > WRONG_KM and square > WRONG_SQUARE:
                wrong += 1
                print(f"{Path(path).name}, {name}: {error_km:.0f} km off, {math.sqrt(square):.0f} standard deviations")
    print(
        f"{solved + refused} cases: {wrong} wrong, {refused} refused, {solved - wrong} right or as uncertain as they are off"
    )


if __name__ == "__main__":
    main()
