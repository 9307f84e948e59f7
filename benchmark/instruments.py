"""What a solver is told about a frame: the truth as instruments of a stated precision report it, in tasks and in rounds.

Each quantity gets a Gaussian error of the stated standard deviation and is then rounded to a step of at most half of that
deviation. No digit beyond the instrument's precision carries information, so the supplied quantities cannot be inverted to
recover the random numbers that produced the truth. Stated standard deviations include the variance of the rounding, step^2 /
12. A quantity whose standard deviation is 0 is supplied exactly.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import celnav
from benchmark.protocol import CameraRecord, Observation
from generator.places.times import Instant

HEADING_UNKNOWN_DEG = 180.0
MATRIX_DIGITS = 9
"""Decimal digits of R_cam: far below the rounding step of its angles, and the same on every machine."""
PLAIN_MODELS = {"brown_conrady": "pinhole", "kannala_brandt": "equidistant"}
"""The distortion-free model that corresponds to each model with distortion."""


@dataclass(frozen=True)
class Precision:
    """Precision with which the circumstances of a frame are supplied to solvers.

    Attributes
    ----------
    tilt_sigma_deg, heading_sigma_deg, utc_sigma_s, focal_sigma, principal_point_sigma_px, pressure_sigma_hpa, \
    temperature_sigma_c : float
        Standard deviations: of the vertical, about each horizontal axis; of the heading (180 or more: unknown); of the focal
        length, relative to it; of the others, in the units of their names. In a round all are above 0.
    focal_range : float
        Half-width of an additional, uniformly distributed error of the focal length, relative.
    distortion_sigma : float
        If above 0, the lens is supplied without its distortion, and this is the standard deviation of k1.
    tilt_bias_sigma_deg : float
        Standard deviation of an additional error of the vertical, about each of the camera's axes across its line of sight.
    """

    tilt_sigma_deg: float
    heading_sigma_deg: float
    utc_sigma_s: float
    focal_sigma: float
    principal_point_sigma_px: float
    pressure_sigma_hpa: float
    temperature_sigma_c: float
    focal_range: float = 0.0
    distortion_sigma: float = 0.0
    tilt_bias_sigma_deg: float = 0.0


def told(
    seen: Observation, precision: Precision, rng: np.random.Generator, alike: np.random.Generator | None = None
) -> Observation:
    """Simulate what a solver is told about a frame.

    Parameters
    ----------
    seen : Observation
        The truth.
    precision : Precision
    rng : Generator
        Random numbers of this frame.
    alike : Generator, optional
        Random numbers of the errors that are common to all frames of a sequence, in the same state for each frame: lens, air,
        clock, and the part of the error of the vertical that is constant in the camera. By default `rng`.
    """
    east, north = rng.normal(0.0, precision.tilt_sigma_deg, 2)
    unknown = precision.heading_sigma_deg >= HEADING_UNKNOWN_DEG
    turn = rng.uniform(-180.0, 180.0) if unknown else rng.normal(0.0, precision.heading_sigma_deg)
    alike = rng if alike is None else alike
    late_s, focal, shift = alike.normal(), alike.normal(), alike.normal(size=2)
    hpa, celsius = alike.normal(), alike.normal()
    wide = alike.uniform(-precision.focal_range, precision.focal_range) if precision.focal_range else 0.0
    bias = alike.normal(0.0, precision.tilt_bias_sigma_deg, 2) if precision.tilt_bias_sigma_deg else np.zeros(2)
    R_cam = Rotation.from_rotvec([*bias, 0.0], degrees=True).as_matrix() @ seen.R_cam if bias.any() else seen.R_cam
    wrong = Rotation.from_rotvec([east, north, 0.0], degrees=True) * Rotation.from_rotvec(
        [0.0, 0.0, turn], degrees=True
    )
    # Azimuth, altitude and roll are all rounded to the finest step, that of the better-known direction.
    angle_step = step_of(min(precision.tilt_sigma_deg, precision.heading_sigma_deg))
    pressure_step, temperature_step = step_of(precision.pressure_sigma_hpa), step_of(precision.temperature_sigma_c)
    time_step = step_of(precision.utc_sigma_s)
    camera, sigmas = _told_camera(seen.camera, precision, focal, wide, shift)
    return dataclasses.replace(
        seen,
        camera=camera,
        utc=rounded_utc(seen.utc, precision.utc_sigma_s * late_s, time_step) if time_step else seen.utc,
        R_cam=_rounded_attitude(R_cam @ wrong.as_matrix(), angle_step),
        tilt_sigma_deg=stated(math.hypot(precision.tilt_sigma_deg, precision.tilt_bias_sigma_deg), angle_step),
        heading_sigma_deg=math.inf if unknown else stated(precision.heading_sigma_deg, angle_step),
        pressure_hpa=round_to(seen.pressure_hpa + precision.pressure_sigma_hpa * hpa, pressure_step)
        if seen.pressure_hpa
        else 0.0,
        temperature_c=round_to(seen.temperature_c + precision.temperature_sigma_c * celsius, temperature_step),
        utc_sigma_s=stated(precision.utc_sigma_s, time_step),
        pressure_sigma_hpa=stated(precision.pressure_sigma_hpa, pressure_step),
        temperature_sigma_c=stated(precision.temperature_sigma_c, temperature_step),
        **sigmas,
    )


def _told_camera(
    camera: CameraRecord, precision: Precision, focal: float, wide: float, shift: NDArray[np.float64]
) -> tuple[CameraRecord, dict[str, Any]]:
    """The lens as supplied, and its standard deviations."""
    focal_px = precision.focal_sigma * camera.f_px
    f_step, place_step = step_of(focal_px), step_of(precision.principal_point_sigma_px)
    f_px = round_to(camera.f_px * (1.0 + wide) + focal_px * focal, f_step)
    shift = precision.principal_point_sigma_px * shift
    told_lens = dataclasses.replace(
        camera,
        f_px=f_px,
        # The ratio of the two focal lengths is the aspect ratio of the pixels, which is known.
        fy_px=significant(f_px * camera.fy_px / camera.f_px) if f_step or wide else camera.fy_px,
        cx_px=round_to(camera.cx_px + float(shift[0]), place_step),
        cy_px=round_to(camera.cy_px + float(shift[1]), place_step),
    )
    if precision.distortion_sigma:
        plain = PLAIN_MODELS.get(camera.model, camera.model)
        told_lens = dataclasses.replace(told_lens, model=plain, k=(), p=(), s=(), tilt_rad=())
    spread = precision.focal_range / math.sqrt(3.0)
    focal_sigma = stated(focal_px, f_step) / f_px
    return told_lens, {
        "focal_sigma": significant(math.hypot(focal_sigma, spread), 3),
        "principal_point_sigma_px": stated(precision.principal_point_sigma_px, place_step),
        "distortion_sigma": precision.distortion_sigma,
    }


def _rounded_attitude(R_cam: NDArray[np.float64], step_deg: float) -> NDArray[np.float64]:
    """Round an attitude so that its azimuth, altitude and roll are multiples of a step."""
    if not step_deg:
        return R_cam
    pointing = celnav.Pointing.of(R_cam)
    rounded = celnav.Pointing(
        *(round_to(angle, step_deg) for angle in (pointing.azimuth_deg, pointing.altitude_deg, pointing.roll_deg))
    )
    return np.asarray(np.round(rounded.R_cam, MATRIX_DIGITS) + 0.0)


def step_of(sigma: float) -> float:
    """Rounding step of a quantity: the power of ten that is at most half its standard deviation; 0 if it is exact."""
    if not sigma:
        return 0.0
    return float(10.0 ** math.floor(math.log10(sigma / 2.0)))


def round_to(value: float, step: float) -> float:
    """Round to the nearest multiple of a step (a power of ten), without further decimal digits; a step of 0 does nothing."""
    if not step:
        return value
    return round(round(value / step) * step, max(0, -round(math.log10(step)))) + 0.0


def significant(value: float, digits: int = 7) -> float:
    """Round a value to a number of significant digits."""
    return float(f"{value:.{digits}g}")


def stated(sigma: float, step: float) -> float:
    """Standard deviation of a quantity with an error of `sigma` that was rounded to a step, to three significant digits."""
    return significant(math.hypot(sigma, step / math.sqrt(12.0)), 3)


def rounded_utc(utc: str, late_s: float, step_s: float) -> str:
    """Round a time with an error to a multiple of a step (s, a power of ten) after the full minute; ISO 8601."""
    found = Instant.parse(utc).plus(late_s)
    seconds = float(found.isoformat().removesuffix("Z").rpartition(":")[2])
    return found.plus(round_to(seconds, step_s) - seconds).isoformat()
