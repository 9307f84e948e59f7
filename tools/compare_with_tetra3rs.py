"""Compare celnav with sep, tetra3rs and the vertical on rendered frames: python tools/compare_with_tetra3rs.py FOLDER.

Neither receives the heading. Needs the extra `peers` of pyproject.toml.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
import sep
import tetra3rs

import celnav
from benchmark.judge.geodesy import geodesic_km
from celnav.sky.astrometry import celestial_to_terrestrial
from celnav.sky.earth_rotation import earth_orientation
from celnav.sky.utc import parse_utc


def peer_error_km(database, image, record, camera) -> float:
    pixels = image.astype(np.float32)
    background = sep.Background(pixels)
    found = sep.extract(pixels - background, 3.0, err=background.globalrms)
    found = found[np.argsort(-found["flux"])]
    centred = np.column_stack((found["x"], found["y"])) - [(camera.width - 1) / 2, (camera.height - 1) / 2]
    answer = database.solve_from_centroids(
        centred, fov_estimate_deg=120.0, fov_max_error_deg=5.0, image_width=camera.width, image_height=camera.height,
        camera_model=tetra3rs.CameraModel(camera.f_px, camera.width, camera.height),
    )  # fmt: skip
    if answer is None or isinstance(answer, tetra3rs.SolveFailure):
        return np.inf
    utc = parse_utc(record["time"]["utc_mid"])
    up = np.array(record["attitude"]["R_cam"])[:, 2]
    zenith = (
        celestial_to_terrestrial(utc, earth_orientation(utc)) @ np.array(answer.rotation_matrix_icrs_to_camera).T @ up
    )
    lat, lon = np.degrees(np.arcsin(zenith[2])), np.degrees(np.arctan2(zenith[1], zenith[0]))
    return geodesic_km(record["site"]["latitude_deg"], record["site"]["longitude_deg"], float(lat), float(lon))


def our_error_km(image, record, camera) -> float:
    fix = celnav.solve(
        celnav.detect(image), camera, record["time"]["utc_mid"],
        celnav.Attitude.up(np.array(record["attitude"]["R_cam"])[:, 2]),
        pressure_hpa=record["atmosphere"]["pressure_hpa"], temperature_c=record["atmosphere"]["temperature_c"],
    )  # fmt: skip
    if not fix.ok:
        return np.inf
    return geodesic_km(record["site"]["latitude_deg"], record["site"]["longitude_deg"], fix.lat_deg, fix.lon_deg)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="frames written by `skybench render`")
    folder = parser.parse_args().folder
    database = tetra3rs.SolverDatabase.generate_from_gaia(max_fov_deg=130.0)
    rows = []
    for path in sorted(folder.glob("frame-*.json")):
        record = json.loads(path.read_text())
        image, camera = celnav.read_image(path.with_suffix(".png")), celnav.Camera.from_json(path)
        rows.append(
            (
                record["sky"]["bortle"],
                peer_error_km(database, image, record, camera),
                our_error_km(image, record, camera),
            )
        )
    table = np.array(rows, dtype=float)
    print("| Bortle | sep + tetra3rs, within 10 km | median km | celnav, within 10 km | median km |\n|-|-|-|-|-|")
    for bortle in np.unique(table[:, 0]):
        _, peer, ours = table[table[:, 0] == bortle].T
        print(
            f"| {bortle:.0f} | {np.sum(peer <= 10)} of {len(peer)} | {np.median(peer):.2f} "
            f"| {np.sum(ours <= 10)} of {len(ours)} | {np.median(ours):.3f} |"
        )
    print(f"median of all: {np.median(table[:, 1]):.3f} km against {np.median(table[:, 2]):.3f} km")


if __name__ == "__main__":
    main()
