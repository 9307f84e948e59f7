"""Polynomials in several coordinates, as sums of products of Chebyshev polynomials."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Axis:
    """One coordinate of a map.

    Attributes
    ----------
    low, high : float
        Coordinates at which the polynomials' variable is -1 and 1.
    degree : int
    """

    low: float
    high: float
    degree: int

    def basis(self, at: Floats) -> Floats:
        """Chebyshev polynomials of the coordinate, (n, degree + 1) array."""
        x = (2 * np.asarray(at, float) - self.low - self.high) / (self.high - self.low)
        return np.asarray(np.polynomial.chebyshev.chebvander(x, self.degree), dtype=np.float64)


def evaluated(coefficients: Floats, bases: Sequence[Floats]) -> Floats:
    """Sum of the products of all axes' basis functions, on the product grid of the bases."""
    values = coefficients
    for basis in bases:
        # The first axis is summed and its points become the last axis: after all axes the order is restored.
        values = np.tensordot(values, basis, axes=(0, 1))
    return values
