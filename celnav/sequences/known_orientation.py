"""Frames whose orientation relative to the Earth is known from other frames of the night or from another camera.

The known orientation only guides the search, which then needs fewer stars. Orientation, position and covariance come from the
frame's own stars and its own attitude, so that they stay independent of the source of that knowledge.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from celnav.attitude import Attitude
from celnav.camera import Camera
from celnav.detections import Detections
from celnav.fix import Fix, Reason
from celnav.horizon import honest_place
from celnav.position import Weather
from celnav.problem import LastKnown, Solver, ToldSigmas
from celnav.sky.astrometry import celestial_to_terrestrial, enu_rotation
from celnav.sky.earth_rotation import earth_orientation
from celnav.sky.utc import Utc
from celnav.solver import solve
from celnav.uncertainty.contradicted import vertical_doubt_deg

F8 = NDArray[np.float64]

UNFOUND = (Reason.NO_HYPOTHESIS, Reason.EFFORT_SPENT)
"""Reasons of refusals that a known orientation may resolve."""
# Radius of the search for the place, in addition to that from the standard deviation of the orientation.
_RADIUS_KM = 1.0
# Least standard deviation of the orientation in a search: mounts yield, and lenses are off, by as much.
_LEAST_SIGMA_RAD = math.radians(0.02)


@dataclass(frozen=True, eq=False)
class Orientation:
    """An orientation of a camera relative to the Earth.

    Attributes
    ----------
    terrestrial_to_camera : ndarray, shape (3, 3)
        ITRS to camera.
    sigma_rad : float
        Standard deviation about each axis.
    lat_deg, lon_deg : float
        Position of the camera, for refraction; NaN if no vertical is known.
    """

    terrestrial_to_camera: F8
    sigma_rad: float
    lat_deg: float = math.nan
    lon_deg: float = math.nan


def terrestrial_orientation(fix: Fix, utc: Utc, dut1_s: float | None = None) -> F8 | None:
    """Return the rotation from ITRS to camera, shape (3, 3), if the stars of the frame were identified, else None."""
    if fix.reason not in (Reason.OK, Reason.VERTICAL_REQUIRED) or fix.rotation_cov_rad2 is None:
        return None
    if fix.R_icrs_to_camera is None:
        return None
    return np.asarray(fix.R_icrs_to_camera @ celestial_to_terrestrial(utc, earth_orientation(utc, dut1_s)).T)


def solve_oriented(
    detections: Detections | ArrayLike,
    camera: Camera,
    utc: Utc,
    attitude: Attitude | None,
    known: Orientation,
    solver: str | Solver,
    weather: Weather,
    flux: ArrayLike | None = None,
    sigmas: ToldSigmas | None = None,
    dut1_s: float | None = None,
) -> Fix:
    """Solve a frame near a known orientation; the position comes from its own stars and the supplied attitude.

    Parameters
    ----------
    detections, camera, utc, attitude, solver, flux, sigmas, dut1_s
        As in `celnav.solve`.
    known : Orientation
        Orientation near which to search.
    weather : Weather
        Air for refraction; not used if no vertical is known.
    """
    upright = not math.isnan(known.lat_deg)
    lat, lon = (known.lat_deg, known.lon_deg) if upright else (0.0, 0.0)
    sigma_deg = math.degrees(max(known.sigma_rad, _LEAST_SIGMA_RAD))
    supposed = Attitude.with_sigma(
        known.terrestrial_to_camera @ enu_rotation(lat, lon).T, tilt_deg=sigma_deg, heading_deg=sigma_deg
    )
    fix = solve(
        detections, camera, utc, supposed, solver, flux=flux, temperature_c=weather.temperature_c,
        pressure_hpa=weather.pressure_hpa if upright else 0.0, near=LastKnown(lat, lon, _RADIUS_KM),
        sigmas=sigmas, dut1_s=dut1_s,
    )  # fmt: skip
    rotation = terrestrial_orientation(fix, utc, dut1_s)
    if rotation is None:
        return fix
    if attitude is None:
        return without_place(fix)
    assert fix.rotation_cov_rad2 is not None
    place = honest_place(rotation, fix.rotation_cov_rad2, attitude, doubt_deg=vertical_doubt_deg(fix))
    cov_km2 = place.cov_km2 if sigmas is None else sigmas.with_time(place.cov_km2, place.lat_deg)
    return replace(
        fix, lat_deg=place.lat_deg, lon_deg=place.lon_deg, cov_km2=cov_km2, heading_off_deg=place.heading_off_deg
    )


def without_place(fix: Fix) -> Fix:
    """Return the fix of a camera without a vertical of its own: its orientation, and no position."""
    message = "the stars are identified and give R_icrs_to_camera; a position needs the vertical too: give Attitude.up"
    fix = replace(fix, ok=False, reason=Reason.VERTICAL_REQUIRED, message=message)
    return replace(fix, lat_deg=math.nan, lon_deg=math.nan, cov_km2=None, heading_off_deg=math.nan)
