"""Gyro logs, and the check that a motion can be sampled as the scenario specifies."""

from __future__ import annotations

import functools
import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from generator.csv_table import CsvError, read_csv
from generator.scenario.motion_spec import MotionSpec
from generator.scenario.strict import InputFile

Floats = NDArray[np.float64]

LOG_COLUMNS = ("t", "wx", "wy", "wz")
"""Time from the start of the exposure, s, and body rates, deg/s."""
LARGEST_LOG_ROWS = 2_000_000
"""Enough for one hour, the longest exposure, at 555 Hz."""


class MotionError(ValueError):
    """The motion cannot be computed as specified; the message starts with the key."""


def check_motion(motion: MotionSpec, duration_s: float) -> None:
    """Refuse a motion that cannot be sampled as specified. Raises MotionError."""
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
