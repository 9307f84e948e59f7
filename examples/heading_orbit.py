"""The full-heading orbit: one turn of the vehicle averages the tilt of its camera's mount away.

A camera that looks 0.06 deg beside where its mount is said to look puts every fix 7 km away, in a direction that turns
with the vehicle. Over a whole turn the errors cancel: in the mean of the fixes, and better in `celnav.Track`, which
knows what the bias does and estimates it (Teague & Chahl 2024, Drones 8(11) 652).

    python examples/heading_orbit.py
"""

from __future__ import annotations

import math
from datetime import UTC, datetime, timedelta

import numpy as np

import celnav
from celnav.sky.astrometry import apparent_enu
from celnav.sky.catalog import load_catalog

LAT_DEG, LON_DEG = 52.0, 4.4
START = datetime(2024, 3, 1, 22, 0, tzinfo=UTC)
FRAMES, SECONDS_APART = 36, 10.0
TILT_DEG = (0.05, -0.03)  # the mount's error: about the image's u axis, about its v axis
NOISE_PX = 0.3


def turned(axis: int, angle_deg: float) -> np.ndarray:
    """Rotation matrix about a coordinate axis."""
    c, s = math.cos(math.radians(angle_deg)), math.sin(math.radians(angle_deg))
    matrix = np.eye(3)
    others = [k for k in range(3) if k != axis]
    matrix[np.ix_(others, others)] = [[c, -s], [s, c]]
    return matrix


def error_km(lat_deg: float, lon_deg: float) -> float:
    """Distance from the truth on a sphere, good enough for a few kilometres."""
    north = math.radians(lat_deg - LAT_DEG)
    east = math.radians(lon_deg - LON_DEG) * math.cos(math.radians(LAT_DEG))
    return 6371.0 * math.hypot(north, east)


def fly() -> tuple[list[celnav.Fix], celnav.Track]:
    """Hover through one turn: a fix at every ten degrees of heading."""
    rng = np.random.default_rng(1)
    camera = celnav.Camera.pinhole(width=1080, height=720, hfov_deg=60)
    stars = load_catalog()
    stars = stars.take(stars.v_mag < 5.5)
    zenith_north_up = celnav.Attitude.zenith_north_up().R_cam
    mount = turned(0, TILT_DEG[0]) @ turned(1, TILT_DEG[1])
    hovering = celnav.TrackConfig(speed_sigma_km_s=1e-3, acceleration_km_s2=1e-6)
    fixes, track = [], celnav.Track(hovering)
    for k in range(FRAMES):
        heading_deg = 360.0 * k / FRAMES
        utc = START + timedelta(seconds=SECONDS_APART * k)
        believed = turned(2, heading_deg) @ zenith_north_up
        dirs = apparent_enu(stars, utc.isoformat(), LAT_DEG, LON_DEG)
        uv = camera.project(dirs @ (mount @ believed).T)
        seen = np.isfinite(uv[:, 0]) & camera.in_frame(np.nan_to_num(uv, nan=-1e6))
        uv = uv[seen] + NOISE_PX * rng.normal(size=(int(seen.sum()), 2))
        flux = 10.0 ** (-0.4 * stars.v_mag[seen])
        # The vertical alone: a tilt also turns the heading that the stars imply, which would pull an exact heading's fix.
        fix = celnav.solve(uv, camera, utc.isoformat(), celnav.Attitude.up(believed[:, 2]), flux=flux)
        fixes.append(fix)
        track.update(fix, utc.isoformat(), heading_deg)
    return fixes, track


def main() -> dict[str, float]:
    """Fly, print the errors in kilometres, and return them."""
    fixes, track = fly()
    last, smooth = track.points[-1], track.smoothed()
    errors = {
        "single fixes, median": float(np.median([error_km(fix.lat_deg, fix.lon_deg) for fix in fixes])),
        "mean of the turn": error_km(
            float(np.mean([fix.lat_deg for fix in fixes])), float(np.mean([fix.lon_deg for fix in fixes]))
        ),
        "filter at the end": error_km(last.lat_deg, last.lon_deg),
        "smoother, median": float(np.median([error_km(point.lat_deg, point.lon_deg) for point in smooth])),
    }
    for what, value in errors.items():
        print(f"{what:22} {value:7.3f} km")
    return errors


if __name__ == "__main__":
    main()
