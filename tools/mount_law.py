"""Compare laws for the wander of a mount within nights: python tools/mount_law.py NIGHT.json … --site LAT LON.

Each file is the output of `celnav calibrate --mount frame` over many frames of a night. One frame at a time serves as the
calibration; the attitude that a law predicts from it for the time of every other frame is converted to a position, as
`celnav.solve` does, with the uncertainty of the heading (`celnav.horizon.honest_place`) and without. For each night, over all
pairs of frames, it prints the median error, squared error over the stated covariance (2 is correct) by class of lag and in
the mean, the share within the 95 % ellipse, and the mean negative logarithm of the density stated for the error, with equal
weight for classes of lag; lower is better.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmark.judge.geodesy import east_north_km
from celnav.attitude import Attitude
from celnav.calibrating.mount import USUAL_WANDER_DEG, mean_rotation, turns_deg
from celnav.calibrating.mount_times import MEMORY_H, read_measured
from celnav.horizon import honest_place, place_from_rotation
from celnav.sky.astrometry import enu_rotation

F8 = NDArray[np.float64]

LAWS = (  # wander (deg), memory (h)
    (USUAL_WANDER_DEG, MEMORY_H), (0.006, 4.0), (0.009, 4.0), (0.016, 4.0), (0.02, 4.0), (0.03, 4.0), (0.012, 24.0),
    (0.016, 24.0), (0.02, 24.0), (0.03, 24.0), (0.009, 1.0),
)  # fmt: skip
LAGS_H = (0.02, 0.4, 1.0, 2.5, 3.5, 12.0)
"""Ends of the classes of lag; pairs closer than the first determine the noise of an attitude."""
WITHIN_95 = 5.991  # chi-squared of two degrees of freedom
SHRUNK = 0.08
"""Factor on the variances with which the five photographs of meteor-real@2 of one night would have a NEES of 1."""


@dataclass(frozen=True, eq=False)
class Pairs:
    """Calibrated and other frames of a night: lags (n,), rotations (n, 3, 3) of both, noise of an attitude per axis (deg).

    `axis` is the one about which the mount turned most (east, north, up); `turned_deg` is the scatter about it.
    """

    name: str
    axis: F8
    turned_deg: float
    lag_h: F8
    told: F8
    true: F8
    noise_deg: float

    @classmethod
    def of(cls, path: Path) -> Pairs:
        """Read the file of a night."""
        frames = [(one.R_cam, mjd * 24) for one in read_measured(path) for mjd in one.mjd]
        rotations, hours = np.stack([rotation for rotation, _ in frames]), np.array([hour for _, hour in frames])
        told, true = np.nonzero(~np.eye(len(hours), dtype=bool))
        lag = np.abs(hours[true] - hours[told])
        near = lag < LAGS_H[0]
        apart = [
            turns_deg(rotations[j][None], rotations[i])[0] for i, j in zip(told[near], true[near], strict=True) if i < j
        ]
        noise = math.sqrt(float(np.mean(np.square(apart))) / 2)
        squares, axes = np.linalg.eigh(np.cov(turns_deg(rotations, mean_rotation(rotations)).T))
        return cls(
            path.stem,
            axes[:, -1],
            math.sqrt(squares[-1]),
            lag[~near],
            rotations[told[~near]],
            rotations[true[~near]],
            noise,
        )


def judged(pairs: Pairs, variance_deg2: F8, site: tuple[float, float], *, doubt: bool) -> tuple[F8, F8, F8]:
    """Return error (km), squared error over covariance and negative log density of every pair, for stated variances (n,)."""
    to_enu = enu_rotation(*site)
    own = np.eye(3) * math.radians(pairs.noise_deg) ** 2
    rows = []
    for told, true, variance in zip(pairs.told, pairs.true, variance_deg2, strict=True):
        sigma = math.sqrt(variance + pairs.noise_deg**2)
        attitude = Attitude.with_sigma(told, tilt_deg=sigma, heading_deg=sigma)
        place = (honest_place if doubt else place_from_rotation)(true @ to_enu, own, attitude)
        error = np.array(east_north_km(*site, place.lat_deg, place.lon_deg))
        square = float(error @ np.linalg.solve(place.cov_km2, error))
        density = square / 2 + math.log(2 * math.pi) + math.log(np.linalg.det(place.cov_km2)) / 2
        rows.append((float(np.hypot(*error)), square, density))
    columns = np.array(rows).T
    return columns[0], columns[1], columns[2]


def unfelt_axis(lat_deg: float) -> F8:
    """Axis (east, north, up), shape (3,), about which an attitude may err without moving the position.

    No change of latitude (about east) or longitude (about the pole) resembles it, so all of it acts as a wrong heading.
    """
    return np.array([0.0, -math.sin(math.radians(lat_deg)), math.cos(math.radians(lat_deg))])


def by_lag(pairs: Pairs, values: F8) -> list[float]:
    """Mean over each class of lag; NaN for an empty one."""
    classes = np.digitize(pairs.lag_h, LAGS_H)
    return [float(values[classes == k].mean()) if (classes == k).any() else math.nan for k in range(1, len(LAGS_H))]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("nights", nargs="+", type=Path)
    parser.add_argument("--site", type=float, nargs=2, required=True, metavar=("LAT", "LON"))
    arguments = parser.parse_args()
    site = (arguments.site[0], arguments.site[1])
    nights = [Pairs.of(path) for path in arguments.nights]
    for one in nights:
        east, north, up = one.axis
        unfelt = abs(float(one.axis @ unfelt_axis(site[0])))
        print(
            f"{one.name}: {len(one.lag_h)} pairs, noise of an attitude {one.noise_deg:.4f} deg an axis; turned by "
            f"{one.turned_deg:.4f} deg about east {east:.2f}, north {north:.2f}, up {up:.2f}, "
            f"{math.degrees(math.acos(min(unfelt, 1.0))):.0f} deg from the axis that no position feels"
        )
    print(f"classes of lag end at {LAGS_H} h")
    laws = [(f"{wander} deg, {memory:g} h", wander, memory, 1.0) for wander, memory in LAWS]
    laws.append((f"the first, variance x {SHRUNK}", *LAWS[0], SHRUNK))
    for words, wander, memory, part in laws:
        for doubt in (False, True):
            line, total = f"{words:28s} {'doubted' if doubt else 'as told':8s}", 0.0
            for pairs in nights:
                variance = part * 2 * wander**2 * (1 - np.exp(-pairs.lag_h / memory))
                error, square, density = judged(pairs, variance, site, doubt=doubt)
                score = float(np.nanmean(by_lag(pairs, density)))
                total += score
                classes = " ".join(f"{value:6.2f}" for value in by_lag(pairs, square))
                inside = float(np.mean(square < WITHIN_95))
                line += f" | {np.median(error):.2f} km  {classes}  mean {np.mean(square):6.2f}"
                line += f"  95 %: {100 * inside:3.0f}  {score:6.2f}"
            print(f"{line} | {total:6.2f}")


if __name__ == "__main__":
    main()
