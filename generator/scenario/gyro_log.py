"""Gyro logs, and the check that a motion can be sampled as the scenario specifies."""

from __future__ import annotations

import functools
import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from generator.csv_table import CsvError, read_csv
from generator.scenario.motion_spec import LARGEST_RATE_DEG_S, MotionSpec
from generator.scenario.strict import InputFile

Floats = NDArray[np.float64]

LOG_COLUMNS = ("t", "wx", "wy", "wz")
"""Time from the start of the exposure, s, and body rates, deg/s."""
LARGEST_LOG_ROWS = 2_000_000
"""Enough for one hour, the longest exposure, at 555 Hz."""

MOST_READINGS = 50_000
"""Largest number of readings of a gyroscope in a frame: 5 MB of its record, of which readers take 8."""
MOST_TURN_DEG = LARGEST_RATE_DEG_S * 1800.0
"""Largest turn by a term of a polynomial: that of the largest rate within half of the longest exposure."""


class MotionError(ValueError):
    """The motion cannot be computed as specified; the message starts with the key."""


def check_motion(motion: MotionSpec, duration_s: float) -> None:
    """Refuse a motion that cannot be sampled as specified. Raises MotionError."""
    _check_polynomial(motion, duration_s)
    if motion.imu is not None and motion.imu.rate_hz * duration_s > MOST_READINGS:
        raise MotionError(
            f"motion.imu.rate_hz: {motion.imu.rate_hz:g} Hz over {duration_s:g} s are {motion.imu.rate_hz * duration_s:.3g} "
            f"readings, and a frame record holds {MOST_READINGS}; lower the rate or the exposure, or use imu of a sequence"
        )
    fastest = max((point[0] for part in motion.vibration for point in part.psd_deg2_hz if point[1] > 0), default=0.0)
    needed = math.ceil(2 * fastest * duration_s) + 1
    if needed > motion.samples:
        raise MotionError(
            f"motion.samples: found {motion.samples}, but vibration up to {fastest:g} Hz over {duration_s:g} s needs {needed}"
        )
    if motion.gyro_log is not None:
        log = read_gyro_log(motion.gyro_log)
        if log[0, 0] > 1e-9 or log[-1, 0] < duration_s - 1e-9:
            raise MotionError(
                f"motion.gyro_log: '{motion.gyro_log.path}' covers {log[0, 0]:g} to {log[-1, 0]:g} s, "
                f"but the shutter is open from 0 to {duration_s:g} s"
            )


def _check_polynomial(motion: MotionSpec, duration_s: float) -> None:
    for axis, coefficients in enumerate(motion.polynomial_deg):
        for number, coefficient in enumerate(coefficients):
            if not abs(coefficient) * (duration_s / 2) ** (number + 1) <= MOST_TURN_DEG:
                raise MotionError(
                    f"motion.polynomial_deg.{axis}.{number}: {coefficient:g} deg/s^{number + 1} turns the camera by more "
                    f"than {MOST_TURN_DEG:g} deg in {duration_s / 2:g} s, half the time of the shutter; lower it"
                )


@functools.lru_cache(maxsize=8)
def read_gyro_log(file: InputFile) -> Floats:
    """Read a gyro log: CSV with a header t, wx, wy, wz (s, deg/s); returns (n, 4).

    Raises
    ------
    MotionError
        The file is not a valid table, or its times do not increase.
    """
    try:
        table = read_csv(
            Path(file.location), file.path, LOG_COLUMNS, least_rows=2, most_rows=LARGEST_LOG_ROWS, increasing=True
        )
    except CsvError as error:
        raise MotionError(f"motion.gyro_log: {error}") from error
    return table.values
