"""What a solver is told of a frame: the truth as instruments of a stated precision give it.

Each quantity has a Gaussian error of the stated standard deviation and is then rounded, to a step of at most half of it, so
that no digit beyond the instrument's tells anything: told quantities cannot be inverted for the random numbers that made
the truth. Sigmas that are stated include the rounding's own variance, step^2 / 12.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from scipy.spatial.transform import Rotation

import celnav
from benchmark.protocol import Observation
from benchmark.rounds.drawing import Precision
from benchmark.rounds.secret import RoundKey
from generator.places.times import Instant

HEADING_UNKNOWN_DEG = 180.0
MATRIX_DIGITS = 9
"""Of R_cam: far below the step of its angles, and the same on every machine."""


def told(seen: Observation, precision: Precision, key: RoundKey, index: int) -> Observation:
    """What a solver is told of a frame.

    Parameters
    ----------
    seen : Observation
        The truth.
    precision : Precision
    key : RoundKey
    index : int
        Of the frame.
    """
    rng = key.stream("told", index)
    east, north = rng.normal(0.0, precision.tilt_sigma_deg, 2)
    unknown = precision.heading_sigma_deg >= HEADING_UNKNOWN_DEG
    turn = rng.uniform(-180.0, 180.0) if unknown else rng.normal(0.0, precision.heading_sigma_deg)
    late_s, focal, shift, hpa, celsius = rng.normal(), rng.normal(), rng.normal(size=2), rng.normal(), rng.normal()
    wrong = Rotation.from_rotvec([east, north, 0.0], degrees=True) * Rotation.from_rotvec(
        [0.0, 0.0, turn], degrees=True
    )
    # Azimuth, altitude and roll are all rounded to the finest step, that of the better known direction.
    angle_step = step_of(min(precision.tilt_sigma_deg, precision.heading_sigma_deg))
    pointing = celnav.Pointing.of(seen.R_cam @ wrong.as_matrix())
    rounded = celnav.Pointing(
        *(round_to(angle, angle_step) for angle in (pointing.azimuth_deg, pointing.altitude_deg, pointing.roll_deg))
    )
    camera, focal_px = seen.camera, precision.focal_sigma * seen.camera.f_px
    time_step, f_step, place_step = map(step_of, (precision.utc_sigma_s, focal_px, precision.principal_point_sigma_px))
    # The ratio of the two focal lengths is the pixels' shape, which is known.
    f_px = round_to(camera.f_px + focal_px * focal, f_step)
    shift = precision.principal_point_sigma_px * shift
    pressure_step, temperature_step = step_of(precision.pressure_sigma_hpa), step_of(precision.temperature_sigma_c)
    return dataclasses.replace(
        seen,
        camera=dataclasses.replace(
            camera,
            f_px=f_px,
            fy_px=significant(f_px * camera.fy_px / camera.f_px),
            cx_px=round_to(camera.cx_px + float(shift[0]), place_step),
            cy_px=round_to(camera.cy_px + float(shift[1]), place_step),
        ),
        utc=rounded_utc(seen.utc, precision.utc_sigma_s * late_s, time_step),
        R_cam=np.round(rounded.R_cam, MATRIX_DIGITS) + 0.0,
        tilt_sigma_deg=stated(precision.tilt_sigma_deg, angle_step),
        heading_sigma_deg=math.inf if unknown else stated(precision.heading_sigma_deg, angle_step),
        pressure_hpa=round_to(seen.pressure_hpa + precision.pressure_sigma_hpa * hpa, pressure_step)
        if seen.pressure_hpa
        else 0.0,
        temperature_c=round_to(seen.temperature_c + precision.temperature_sigma_c * celsius, temperature_step),
        utc_sigma_s=stated(precision.utc_sigma_s, time_step),
        focal_sigma=significant(stated(focal_px, f_step) / f_px, 3),
        principal_point_sigma_px=stated(precision.principal_point_sigma_px, place_step),
        pressure_sigma_hpa=stated(precision.pressure_sigma_hpa, pressure_step),
        temperature_sigma_c=stated(precision.temperature_sigma_c, temperature_step),
    )


def step_of(sigma: float) -> float:
    """Step of rounding of a quantity: the power of ten that is at most half of its standard deviation."""
    return float(10.0 ** math.floor(math.log10(sigma / 2.0)))


def round_to(value: float, step: float) -> float:
    """The multiple of a step (a power of ten) that is nearest to a value, as a decimal number of no more digits."""
    return round(round(value / step) * step, max(0, -round(math.log10(step)))) + 0.0


def significant(value: float, digits: int = 7) -> float:
    """A value to a number of significant digits."""
    return float(f"{value:.{digits}g}")


def stated(sigma: float, step: float) -> float:
    """Standard deviation of a quantity with an error of `sigma` that was rounded to a step; three significant digits."""
    return significant(math.hypot(sigma, step / math.sqrt(12.0)), 3)


def rounded_utc(utc: str, late_s: float, step_s: float) -> str:
    """A time with an error, rounded to a multiple of a step (s, a power of ten) after the full minute; ISO 8601."""
    found = Instant.parse(utc).plus(late_s)
    seconds = float(found.isoformat().removesuffix("Z").rpartition(":")[2])
    return found.plus(round_to(seconds, step_s) - seconds).isoformat()
