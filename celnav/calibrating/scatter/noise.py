"""Scatter of measured positions: the centroids' own standard deviations times a factor, and a floor."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

F8 = NDArray[np.float64]

CLIP_SIGMAS = 4.0
_LEAST_FLOOR_PX = 0.002
_ROUNDS = 12


@dataclass(frozen=True)
class Noise:
    """Variance along an axis: floor_px^2 + (factor x own standard deviation)^2 + (blending x pull of neighbours)^2.

    Attributes
    ----------
    floor_px : float
        Scatter due to the shape of the stars, the air and the fine structure of the lens.
    factor : float
        Factor on the centroids' standard deviations; above 1 if the pixel noise is correlated (video).
    blending : float
        Factor on the pull of fainter neighbours (`star_matching`).
    """

    floor_px: float
    factor: float
    blending: float = 0.0

    def sigma_px(self, own: F8, pull: F8) -> F8:
        """Return the standard deviations, shape (n,), of positions from their own ones and the pull of their neighbours."""
        return np.sqrt(self.floor_px**2 + (self.factor * own) ** 2 + (self.blending * pull) ** 2)


def measure_noise(square: F8, own: F8, pull: F8) -> Noise:
    """Fit the three components to squared distances.

    The fit is non-negative least squares of half the squared distances, weighted by the inverse square of the variance (the
    likelihood equations of variance components; Searle, Casella & McCulloch 1992, chapter 6). Distances beyond 4 standard
    deviations are left out.

    Parameters
    ----------
    square : ndarray, shape (n,)
        Squared distances between measured and predicted positions, px^2; infinite where there is no prediction.
    own : ndarray, shape (n,)
        Standard deviations along an axis from detection; 0 where it gave none.
    pull : ndarray, shape (n,)
        Pull of neighbours, px.
    """
    from scipy.optimize import nnls

    finite = np.isfinite(square)
    square, own, pull = square[finite], own[finite], pull[finite]
    if not len(square):
        return Noise(1.0, 1.0)
    # The median of two squared normal numbers is 2 ln 2.
    noise = Noise(max(math.sqrt(float(np.median(square)) / (2 * math.log(2))), _LEAST_FLOOR_PX), 0.0)
    for _ in range(_ROUNDS):
        variance = noise.sigma_px(own, pull) ** 2
        good = square <= CLIP_SIGMAS**2 * variance
        design = np.column_stack((np.ones(len(own)), own**2, pull**2))[good]
        weighted = design / variance[good, None]
        # The lengths of the columns differ by orders of magnitude.
        lengths = np.maximum(np.sqrt((weighted**2).sum(axis=0)), 1e-300)
        parts = nnls(weighted / lengths, square[good] / 2 / variance[good])[0] / lengths
        noise = Noise(max(math.sqrt(parts[0]), _LEAST_FLOOR_PX), math.sqrt(parts[1]), math.sqrt(parts[2]))
    return noise
