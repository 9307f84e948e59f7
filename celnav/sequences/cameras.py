"""Several cameras at one instant: one position from the stars of all, and from what is known of each attitude.

Cameras on one body share its orientation, within the uncertainties of their mountings; each may have its own inclinometer. A
camera that shows too few stars is searched in the direction in which it should look according to the others.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime

import numpy as np
from numpy.typing import ArrayLike, NDArray

from celnav.attitude import ROTATION_TOLERANCE, Attitude, as_attitude
from celnav.camera import Camera
from celnav.checking import finite_number, real_array
from celnav.detections import Detections
from celnav.errors import AttitudeError, ConfigError
from celnav.fix import Fix, Reason
from celnav.position import Weather
from celnav.problem import LastKnown, Solver
from celnav.sequences.known_orientation import (
    UNFOUND,
    Orientation,
    solve_oriented,
    terrestrial_orientation,
    without_place,
)
from celnav.sequences.shared_body import Body, Seen, adjust_body
from celnav.sky.astrometry import enu_rotation
from celnav.sky.utc import Utc, parse_utc
from celnav.sky.wgs84 import MEAN_RADIUS_KM
from celnav.solver import solve
from celnav.uncertainty.contradicted import vertical_doubt_deg

F8 = NDArray[np.float64]

# If the others contradict a camera by more than this and five standard deviations, it is misidentified or not mounted as
# stated.
_LARGEST_CONTRADICTION_DEG = 1.0
# Standard deviation of a zenith from stars whose refraction has not been removed.
_REFRACTION_DEG = 0.1
# A disagreement whose probability by chance is below this widens the covariance.
_LEAST_CHANCE = 1e-3


@dataclass(frozen=True, eq=False)
class CameraView:
    """The view of one of the cameras.

    Attributes
    ----------
    detections : Detections or array_like, shape (n, 2)
        From `celnav.detect`, or bare pixel positions.
    camera : Camera
        The camera.
    attitude : Attitude, 3x3 array_like or None
        Orientation relative to the horizon from this camera's own sensor, whose errors are independent of the others; None
        without such a sensor.
    mounting : array_like, shape (3, 3), or None
        Rotation that takes directions from the body frame to the camera frame; None if unknown.
    mounting_sigma_deg : float
        Standard deviation of the mounting about each axis, degrees.
    flux : array_like, shape (n,), optional
        Brightness of bare positions.
    """

    detections: Detections | ArrayLike
    camera: Camera
    attitude: Attitude | ArrayLike | None = None
    mounting: ArrayLike | None = None
    mounting_sigma_deg: float = 0.0
    flux: ArrayLike | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "attitude", as_attitude(self.attitude))
        if self.mounting is not None:
            object.__setattr__(self, "mounting", _rotation(self.mounting))
        sigma = finite_number(self.mounting_sigma_deg, "mounting_sigma_deg", ConfigError, 0.0, 180.0)
        object.__setattr__(self, "mounting_sigma_deg", sigma)


@dataclass(frozen=True, eq=False)
class CamerasFix:
    """Joint solution of several cameras.

    Attributes
    ----------
    ok : bool
        Whether there is a position.
    reason : Reason
        ``ok``; ``too_few_detections`` if no camera was identified; ``vertical_required`` if no attitude gives the
        vertical; ``inconsistent`` if the cameras contradict each other or a heading.
    message : str
        The reason in words; empty if there is a position.
    lat_deg, lon_deg, cov_km2
        As in `Fix`.
    fixes : tuple of Fix
        The individual fixes and refusals of the cameras.
    helped : tuple of int
        Cameras that were identified only by searching near the direction expected from the others.
    apart_deg : float
        Largest angle by which a camera's stars contradict the others and its mounting; NaN if there is nothing to compare.
    chance : float
        Probability of as large a contradiction from errors of the stated sizes; NaN if there is nothing to compare.
    R_terrestrial_to_body : ndarray, shape (3, 3), or None
        Orientation of the body relative to the Earth (ITRS), if a mounting is known. If no vertical is known, it contains
        the refraction.
    """

    ok: bool
    reason: Reason
    message: str = ""
    lat_deg: float = math.nan
    lon_deg: float = math.nan
    cov_km2: F8 | None = None
    fixes: tuple[Fix, ...] = ()
    helped: tuple[int, ...] = ()
    apart_deg: float = math.nan
    chance: float = math.nan
    R_terrestrial_to_body: F8 | None = None


@dataclass(frozen=True, eq=False)
class _Question:
    """Inputs common to all cameras."""

    views: tuple[CameraView, ...]
    utc: Utc
    weather: Weather
    near: LastKnown | None
    solver: str | Solver
    attitude: Attitude | None
    dut1_s: float | None


def solve_cameras(
    views: Sequence[CameraView],
    utc: str | datetime | Utc,
    attitude: Attitude | ArrayLike | None = None,
    *,
    pressure_hpa: float = 1010.0,
    temperature_c: float = 10.0,
    dut1_s: float | None = None,
    near: LastKnown | None = None,
    solver: str | Solver = "skybench",
) -> CamerasFix:
    """Determine the position of cameras that look at the sky at one instant.

    Each camera is first solved alone. One that cannot be identified is searched again within four standard deviations of the
    orientation that the others and the mountings imply; its own stars must still confirm the identification. A mounted camera
    without a vertical is solved again with the one that the others imply, which removes the refraction. Then stars, mountings
    and attitudes are adjusted together.

    Parameters
    ----------
    views : sequence of CameraView
        One view for each camera; cameras with a mounting are all on the same body.
    utc : str, datetime or Utc
        Middle of the exposures; the same for all.
    attitude : Attitude, 3x3 array_like or None
        Orientation of the body relative to the horizon, from a sensor that the cameras share; needs a mounting.
    pressure_hpa, temperature_c, dut1_s, near, solver
        As in `celnav.solve`; the solver must provide `Fix.R_icrs_to_camera` and `Fix.rotation_cov_rad2`.

    Raises
    ------
    CelnavError
        For malformed input.
    """
    views = tuple(views)
    if not views or not all(isinstance(view, CameraView) for view in views):
        raise ConfigError("views must be one CameraView or more")
    shared = as_attitude(attitude)
    if shared is not None and all(view.mounting is None for view in views):
        raise ConfigError("attitude is the body's: give the mounting of a camera, or the attitude in its CameraView")
    question = _Question(views, parse_utc(utc), Weather(pressure_hpa, temperature_c), near, solver, shared, dut1_s)
    fixes = [_alone(question, view, _supposed(question, view)) for view in views]
    found = _together(question, fixes)
    if found is not None and found.cov_km2 is not None and question.weather.pressure_hpa > 0:
        upright = [_upright(question, view, fix, found) for view, fix in zip(views, fixes, strict=True)]
        if any(again is not fix for again, fix in zip(upright, fixes, strict=True)):
            fixes, found = upright, _together(question, upright)
    helped = []
    if found is not None:
        for number, view in enumerate(views):
            known = _expected(view, found)
            if fixes[number].reason not in UNFOUND or known is None:
                continue
            fix = solve_oriented(
                view.detections, view.camera, question.utc, _own(view), known, solver, question.weather, view.flux,
                dut1_s=dut1_s,
            )  # fmt: skip
            if terrestrial_orientation(fix, question.utc, dut1_s) is not None:
                fixes[number] = fix
                helped.append(number)
        if helped:
            found = _together(question, fixes)
    return replace(_answer(question, fixes, found), fixes=tuple(fixes), helped=tuple(helped))


def _alone(question: _Question, view: CameraView, attitude: Attitude | None) -> Fix:
    return solve(
        view.detections, view.camera, question.utc, attitude, question.solver, flux=view.flux,
        pressure_hpa=question.weather.pressure_hpa, temperature_c=question.weather.temperature_c, dut1_s=question.dut1_s,
        near=question.near,
    )  # fmt: skip


def _upright(question: _Question, view: CameraView, fix: Fix, found: Body) -> Fix:
    """Return the fix of a camera without a vertical, solved again with that of the position, which removes the refraction.

    The zenith follows from the camera's own stars and the position that the others gave; any other fix is unchanged. The new
    one has no position either, since that would depend on the others.
    """
    rotation = terrestrial_orientation(fix, question.utc, question.dut1_s)
    if rotation is None or view.mounting is None or _supposed(question, view) is not None:
        return fix
    assert found.cov_km2 is not None
    sigma_deg = math.degrees(math.sqrt(float(np.linalg.eigvalsh(found.cov_km2)[-1])) / MEAN_RADIUS_KM)
    zenith = enu_rotation(found.lat_deg, found.lon_deg)[2]
    attitude = Attitude.up(rotation @ zenith, math.hypot(sigma_deg, _REFRACTION_DEG))
    again = _alone(question, view, attitude)
    return without_place(again) if again.ok else fix


def _supposed(question: _Question, view: CameraView) -> Attitude | None:
    """Return a camera's own attitude, else that of the body with the camera's mounting."""
    attitude = _own(view)
    if attitude is None and question.attitude is not None and view.mounting is not None:
        attitude = _of_camera(question.attitude, view)
    return attitude


def _own(view: CameraView) -> Attitude | None:
    assert view.attitude is None or isinstance(view.attitude, Attitude)
    return view.attitude


def _of_camera(body: Attitude, view: CameraView) -> Attitude:
    """Convert the attitude of the body to that of a camera, including the uncertainty of the mounting."""
    mounting = np.asarray(view.mounting)
    tilt = math.hypot(body.tilt_deg, view.mounting_sigma_deg)
    if body.kind == "up":
        return Attitude.up(mounting @ np.array(body.rows[0]), tilt)
    heading = math.hypot(body.heading_deg, view.mounting_sigma_deg)
    return Attitude.with_sigma(mounting @ body.R_cam, tilt_deg=tilt, heading_deg=heading)


def _together(question: _Question, fixes: Sequence[Fix]) -> Body | None:
    """Adjust all cameras together; None if none is identified."""
    seen = []
    for view, fix in zip(question.views, fixes, strict=True):
        rotation = terrestrial_orientation(fix, question.utc, question.dut1_s)
        mounting = None if view.mounting is None else np.asarray(view.mounting)
        if rotation is None and mounting is None:
            continue
        # The mounting was measured with the same lens as the attitude.
        doubt = vertical_doubt_deg(fix)
        sigma = math.radians(math.hypot(view.mounting_sigma_deg, doubt))
        seen.append(Seen(rotation, fix.rotation_cov_rad2, mounting, sigma, _own(view), doubt))
    return adjust_body(seen, question.attitude)


def _expected(view: CameraView, found: Body) -> Orientation | None:
    """Return the orientation of a camera expected from the others; None if its mounting or theirs is unknown."""
    if view.mounting is None or found.rotation is None or found.cov_rad2 is None:
        return None
    own = float(np.linalg.eigvalsh(found.cov_rad2)[-1])
    sigma = math.sqrt(own + math.radians(view.mounting_sigma_deg) ** 2)
    return Orientation(np.asarray(view.mounting) @ found.rotation, sigma, found.lat_deg, found.lon_deg)


def _answer(question: _Question, fixes: Sequence[Fix], found: Body | None) -> CamerasFix:
    if found is None:
        message = f"none of {len(fixes)} cameras was identified: {'; '.join(fix.message for fix in fixes)}"
        return CamerasFix(False, Reason.TOO_FEW_DETECTIONS, message)
    apart = math.degrees(found.apart_rad)
    answer = CamerasFix(
        False, Reason.OK, apart_deg=apart, chance=found.chance, R_terrestrial_to_body=found.rotation
    )  # fmt: skip
    if found.chance < _LEAST_CHANCE and apart > _LARGEST_CONTRADICTION_DEG:
        message = f"cameras contradict each other by {apart:.2f} deg: check their mountings, attitudes and clocks"
        return replace(answer, reason=Reason.INCONSISTENT, message=message)
    for number, fix in enumerate(fixes):
        if fix.reason is Reason.INCONSISTENT:
            return replace(answer, reason=Reason.INCONSISTENT, message=f"camera {number}: {fix.message}")
    if found.cov_km2 is None:
        message = (
            "the stars give orientations; a position needs the vertical of the body or of a camera: give Attitude.up"
        )
        return replace(answer, reason=Reason.VERTICAL_REQUIRED, message=message)
    # Birge 1932, Phys. Rev. 40, 207: values that disagree are less certain than stated.
    widened = max(1.0, found.chi2 / found.freedom) if found.chance < _LEAST_CHANCE else 1.0
    return replace(
        answer, ok=True, lat_deg=found.lat_deg, lon_deg=found.lon_deg, cov_km2=found.cov_km2 * widened
    )  # fmt: skip


def _rotation(matrix: ArrayLike) -> F8:
    rotation = real_array(matrix, "mounting", AttitudeError)
    if rotation.shape != (3, 3) or not np.isfinite(rotation).all():
        raise AttitudeError("mounting must be 3x3 finite numbers (body to camera)")
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > ROTATION_TOLERANCE or np.linalg.det(rotation) < 0:
        raise AttitudeError("mounting must be a rotation (body to camera): orthonormal rows, determinant 1")
    return rotation
