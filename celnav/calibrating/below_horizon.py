"""Detection of a wrong place or time from stars that should be below the horizon.

A calibration uses only the stars above the horizon of the supplied place. If the place is wrong, the attitude is rotated so
that they fit all the same, but a wide frame also shows stars on the other side of that horizon.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from celnav.calibrating.bundle import Bundle
from celnav.calibrating.frames import CalibrationFrame, Sky
from celnav.identification.pairing import mutual_nearest
from celnav.identification.verification import log10_chance

F8 = NDArray[np.float64]

# Seen from an aeroplane, the horizon is 3 deg lower, and refraction lifts stars by half a degree.
HIGHEST_DEG = -5.0
_RADIUS_PX = 3.0
# Distance of test positions from the predicted ones. They show how many lights match by chance where trees and lamps crowd.
_BESIDE_PX = 12.0
_BESIDE = _BESIDE_PX * np.array([[1, 1], [1, -1], [-1, 1], [-1, -1], [1.5, 0], [-1.5, 0], [0, 1.5], [0, -1.5]])


def stars_below(frame: CalibrationFrame, sky: Sky, bundle: Bundle, faintest_mag: float) -> tuple[int, float]:
    """Count the stars seen below the horizon.

    Parameters
    ----------
    frame : CalibrationFrame
        The frame.
    sky : Sky
        Result of `sky_over` without a horizon.
    bundle : Bundle
        Lens and attitude, fitted to the stars of the whole sky.
    faintest_mag : float
        Magnitude of the faintest stars that the frame shows.

    Returns
    -------
    int, float
        Number of these stars that have a detection, and the decimal logarithm of the probability of as many by chance.
    """
    below = np.flatnonzero((sky.dirs[:, 2] < np.sin(np.radians(HIGHEST_DEG))) & (sky.v_mag <= faintest_mag))
    predicted = bundle.predict(sky.dirs[below], np.zeros(len(below), dtype=np.intp))
    width, height = frame.size
    u, v = np.nan_to_num(predicted, nan=-1e6).T
    predicted = predicted[(u > -0.5) & (u < width - 0.5) & (v > -0.5) & (v < height - 0.5)]
    if not len(predicted) or not len(frame.uv):
        return 0, 0.0
    seen = len(mutual_nearest(frame.uv, predicted, _RADIUS_PX)[0])
    beside = np.mean([len(mutual_nearest(frame.uv, predicted + shift, _RADIUS_PX)[0]) for shift in _BESIDE])
    chance = (float(beside) + 1.0) / (len(predicted) + 2.0)
    return seen, log10_chance(seen, len(predicted), chance)
