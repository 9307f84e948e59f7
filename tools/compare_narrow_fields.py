"""Compare celnav with tetra3rs on random narrow fields: python tools/compare_narrow_fields.py --fields 40.

The comparison is lost in space: neither solver receives an attitude, and both receive the same centroids in order of
brightness and the true focal length. A field counts as solved where the boresight is within 0.05 deg. Needs the extra `peers`
of pyproject.toml.
"""

from __future__ import annotations

import argparse

import numpy as np
import tetra3rs

import celnav
from benchmark.fields.solver_bars import camera_of
from benchmark.fields.solver_fields import HEIGHT, WIDTH, Condition, Field, make_field
from celnav.sky.astrometry import celestial_to_terrestrial, enu_rotation
from celnav.sky.earth_rotation import earth_orientation
from celnav.sky.utc import parse_utc

WIDTHS_DEG = (20.0, 15.0, 12.0, 8.0, 5.0)
V_MAX = 8.0
SPOILT = {"20 % missing, 20 % false": (0.2, 0.2), "50 % missing, 100 % false": (0.5, 1.0)}
SOLVED_DEG = 0.05


def boresight(field: Field) -> np.ndarray:
    utc = parse_utc(field.utc)
    to_terrestrial = celestial_to_terrestrial(utc, earth_orientation(utc))
    return field.R_cam[2] @ enu_rotation(field.lat_deg, field.lon_deg) @ to_terrestrial


def verdict(found: np.ndarray | None, field: Field) -> str:
    if found is None:
        return "refused"
    away_deg = np.degrees(np.arccos(np.clip(found[2] @ boresight(field), -1, 1)))
    return "solved" if away_deg < SOLVED_DEG else "wrong"


def ours(condition: Condition, field: Field) -> np.ndarray | None:
    return celnav.solve(field.uv, camera_of(condition), field.utc, None, flux=field.flux).R_icrs_to_camera


def theirs(database: tetra3rs.SolverDatabase, condition: Condition, field: Field) -> np.ndarray | None:
    centred = field.uv - [(WIDTH - 1) / 2, (HEIGHT - 1) / 2]
    answer = database.solve_from_centroids(
        np.column_stack((centred, field.flux)), fov_estimate_deg=condition.hfov_deg, fov_max_error_deg=0.2,
        image_width=WIDTH, image_height=HEIGHT, camera_model=tetra3rs.CameraModel(condition.f_px, WIDTH, HEIGHT),
    )  # fmt: skip
    if answer is None or isinstance(answer, tetra3rs.SolveFailure):
        return None
    return np.array(answer.rotation_matrix_icrs_to_camera)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--fields", type=int, default=40, help="of each condition")
    parser.add_argument("--seed", type=int, default=31)
    arguments = parser.parse_args()
    print("| field | | stars, median | celnav solved | wrong | tetra3rs solved | wrong |\n|-|-|-|-|-|-|-|")
    for width_deg in WIDTHS_DEG:
        database = tetra3rs.SolverDatabase.generate_from_gaia(
            max_fov_deg=width_deg * 1.3, min_fov_deg=width_deg * 0.8, star_max_magnitude=V_MAX + 0.3
        )
        for spoilt, (missing, false) in SPOILT.items():
            condition = Condition(spoilt, width_deg, V_MAX, 0.5, missing, false, tilt_deg=50)
            fields = [make_field(condition, arguments.seed, number) for number in range(arguments.fields)]
            stars = np.median([np.sum(field.star_id != 0) for field in fields])
            mine = [verdict(ours(condition, field), field) for field in fields]
            peer = [verdict(theirs(database, condition, field), field) for field in fields]
            counts = (mine.count("solved"), mine.count("wrong"), peer.count("solved"), peer.count("wrong"))
            row = " | ".join(str(count) for count in counts)
            print(f"| {width_deg:g} deg | {spoilt} | {stars:.0f} | {row} |", flush=True)


if __name__ == "__main__":
    main()
