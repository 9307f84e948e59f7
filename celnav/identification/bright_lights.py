"""Recognise frames in which bright detections are too many to be stars, as among lamps, satellites and hot pixels."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

BRIGHTER_MAG = 2.0
"""Detections that are brighter than most by this count as bright."""
FEWER_STARS = 0.1
"""Number of stars above a brightness over that above one fainter by `BRIGHTER_MAG`: the catalogue has 515 stars to V 4 and
5,080 to V 6."""
_MOST = (0.5, 0.75)
_LEAST_RATIO, _LEAST_SIGMAS = 2.0, 3.0


def bright_lights(mag: NDArray[np.float64] | None) -> bool:
    """Whether at least twice as many detections are bright as of stars, beyond three standard deviations of chance.

    Bright ones are compared with the brightest half of all and with the brightest three quarters, because bright lights may
    be more than half of all detections.

    Parameters
    ----------
    mag : ndarray, shape (n,), or None
        Magnitudes up to a zero point; NaN where the flux is not positive. None where no flux is known.
    """
    known = np.empty(0) if mag is None else mag[np.isfinite(mag)]
    if not len(known):
        return False
    expected = FEWER_STARS * np.array(_MOST) * len(known)
    bright = np.quantile(known, _MOST) - BRIGHTER_MAG
    count = (known < bright[:, None]).sum(axis=1)
    return bool((count > np.maximum(_LEAST_RATIO * expected, expected + _LEAST_SIGMAS * np.sqrt(expected))).any())
