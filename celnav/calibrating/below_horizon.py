"""A wrong place or time shows where stars stand that should be below the horizon.

A calibration knows only the stars above the horizon of the place it is told. With a wrong one the attitude turns so that they
fit all the same, and a wide frame goes on to show stars on the other side of that horizon.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from celnav.calibrating.bundle import Bundle
from celnav.calibrating.frames import CalibrationFrame, Sky
from celnav.identification.pairing import mutual_nearest
from celnav.identification.verification import log10_chance

F8 = NDArray[np.float64]

# From an aeroplane the horizon is 3 deg lower, and refraction lifts stars by half a degree.
HIGHEST_DEG = -5.0
_RADIUS_PX = 3.0
# Places beside the predicted ones, which say how many lights agree by chance where trees and lamps crowd.
_BESIDE_PX = 12.0
_BESIDE = _BESIDE_PX * np.array([[1, 1], [1, -1], [-1, 1], [-1, -1], [1.5, 0], [-1.5, 0], [0, 1.5], [0, -1.5]])


def stars_below(frame: CalibrationFrame, sky: Sky, bundle: Bundle, faintest_mag: float) -> tuple[int, float]:
    """Count the stars that are seen below the horizon.

    Parameters
    ----------
    frame : CalibrationFrame
        The frame.
    sky : Sky
        Of `sky_over` without a horizon.
    bundle : Bundle
        Lens and attitude, fitted to the stars of the whole sky.
    faintest_mag : float
        Of the stars that the frame shows.

    Returns
    -------
    How many of them have a detection, and the probability, decimal logarithm, that chance gives as many.
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
