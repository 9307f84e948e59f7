"""The network's view of a star: the distances of the other detections from it, and whether they are brighter.

Rijlaarsdam et al. (Sensors 20, 3684, 2020, doi 10.3390/s20133684) describe a star by a histogram of the angular distances to
its neighbours, which no rotation of the camera changes. Here the bins widen with the distance, because the effect of an error
of the focal length grows with it. Each distance is shared between its two nearest bins. Brighter, similar and fainter
neighbours have separate histograms, because wide fields contain many stars.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

NEAREST_DEG = 0.4
FARTHEST_DEG = 36.0
NARROWEST_BIN_DEG = 0.1
BINS_PER_E_FOLD = 100
"""Bins per factor of e far beyond 10 deg; at 10 deg a bin is 0.2 deg wide, and at 36 deg 0.46 deg."""
BINS = int(BINS_PER_E_FOLD * np.log1p(FARTHEST_DEG / (BINS_PER_E_FOLD * NARROWEST_BIN_DEG))) + 2
KINDS = 3
KIND_STEP_MAG = 1.2
"""Difference in magnitude between the centres of the kinds brighter, similar and fainter."""
PATTERN_SIZE = BINS * KINDS
MOST_DETECTIONS = 60
"""Number of the brightest detections of a frame that take part in its patterns."""


def patterns_of(rays: NDArray[np.float64], magnitudes: NDArray[np.float64]) -> NDArray[np.float32]:
    """Patterns of all detections of a frame.

    Parameters
    ----------
    rays : ndarray, shape (n, 3)
        Unit vectors to the detections, in any frame.
    magnitudes : ndarray, shape (n,)
        Magnitudes with any zero point.

    Returns
    -------
    ndarray of float32, shape (n, PATTERN_SIZE)
    """
    n = len(rays)
    away = np.degrees(np.arccos(np.clip(rays @ rays.T, -1.0, 1.0)))
    star, other = np.nonzero((away > NEAREST_DEG) & (away < FARTHEST_DEG))
    place = BINS_PER_E_FOLD * np.log1p(away[star, other] / (BINS_PER_E_FOLD * NARROWEST_BIN_DEG))
    kind = np.clip(1.0 + (magnitudes[other] - magnitudes[star]) / KIND_STEP_MAG, 0.0, KINDS - 1.001)
    bin_, part = np.divmod(place, 1.0)
    row, share = np.divmod(kind, 1.0)
    first = ((star * KINDS + row) * BINS + bin_).astype(np.intp)
    content = np.bincount(
        np.concatenate((first, first + 1, first + BINS, first + BINS + 1)),
        np.concatenate(((1 - share) * (1 - part), (1 - share) * part, share * (1 - part), share * part)),
        n * PATTERN_SIZE,
    )
    return content.reshape(n, PATTERN_SIZE).astype(np.float32)
