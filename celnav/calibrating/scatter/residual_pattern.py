"""Residuals that neighbouring stars share beyond their noise because the form of the lens cannot describe them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from celnav.calibrating.bundle import Observations

F8 = NDArray[np.float64]

CELLS = 10
"""Number of cells along the longer side of the frame."""
FEWEST = 5


@dataclass(frozen=True, eq=False)
class Pattern:
    """Means of residuals over cells of the frame.

    Attributes
    ----------
    centre_px, mean_px : ndarray, shape (c, 2)
        Centre of each cell with `FEWEST` stars or more, and weighted mean of its residuals.
    sigma_px : ndarray, shape (c,)
        Standard deviation of that mean along an axis, from the noise of the stars.
    stars : ndarray, shape (c,)
        Number of stars in the cell.
    rms_px : float
        Root mean square of the means along an axis, with their noise subtracted: what the form of the lens cannot describe.
    inflation : float
        Mean square of the means over their noise, at least 1: the factor on covariances that treat neighbours as independent.
    """

    centre_px: F8
    mean_px: F8
    sigma_px: F8
    stars: NDArray[np.intp]
    rms_px: float
    inflation: float


def residual_pattern(seen: Observations, residual: F8, size: tuple[int, int]) -> Pattern:
    """Average residuals, shape (n, 2), over cells of a frame of `size`."""
    side = max(size) / CELLS
    at = np.floor((seen.uv + 0.5) / side).astype(np.intp)
    cells, cell = np.unique(at, axis=0, return_inverse=True)
    cell = cell.reshape(-1)
    weight = 1 / seen.sigma_px**2
    total = np.bincount(cell, weights=weight)
    sums = [np.bincount(cell, weights=weight * residual[:, axis]) for axis in (0, 1)]
    mean = np.asarray(np.column_stack(sums) / total[:, None], dtype=np.float64)
    stars = np.bincount(cell)
    full = stars >= FEWEST
    sigma = np.asarray(1 / np.sqrt(total), dtype=np.float64)
    if not full.any():
        return Pattern(np.empty((0, 2)), np.empty((0, 2)), np.empty(0), np.empty(0, np.intp), 0.0, 1.0)
    square = np.asarray((mean[full] ** 2).mean(axis=1), dtype=np.float64)
    excess = float(np.average(square - sigma[full] ** 2, weights=stars[full]))
    ratio = float(np.mean(square / sigma[full] ** 2))
    # As many cells of pure noise exceed this limit in one calibration of a hundred.
    limit = 1 + 2.33 * math.sqrt(1 / full.sum())
    centre = np.asarray((cells[full] + 0.5) * side - 0.5, dtype=np.float64)
    return Pattern(
        centre, mean[full], sigma[full], stars[full], math.sqrt(max(excess, 0.0)), ratio if ratio > limit else 1.0
    )


def star_cells(seen: Observations, size: tuple[int, int]) -> F8:
    """Return the mean u and v of the stars in each cell of a frame, and the sum of their information, px^-2; shape (c, 3)."""
    side = max(size) / CELLS
    _, cell = np.unique(np.floor((seen.uv + 0.5) / side).astype(np.intp), axis=0, return_inverse=True)
    cell = cell.reshape(-1)
    weight = 1 / seen.sigma_px**2
    total = np.bincount(cell, weights=weight)
    middle = [np.bincount(cell, weights=weight * seen.uv[:, axis]) / total for axis in (0, 1)]
    return np.asarray(np.column_stack((*middle, total)), dtype=np.float64)
