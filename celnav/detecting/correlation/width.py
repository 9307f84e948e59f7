"""The width of stars so blurred by the lens that few stand out individually.

The autocorrelation of a Gaussian of standard deviation s at the shift t is exp(-t^2 / (4 s^2)). All stars of a blurred image
add up to that, and to almost nothing at shifts beyond their width. The correlations of clouds, glare and the texture of the
ground fall slowly from a cusp, so most of their value at one pixel remains where that of stars has vanished (turbulence falls
as t^(5/3); Roddier 1981, Progress in Optics 19, 281).
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from celnav.detecting.correlation.self_correlation import SHIFTS
from celnav.detecting.star_shape import StarShape

F8 = NDArray[np.float64]

# px. Range of shifts used and of widths tried; narrower stars are found with an initial guess and measured individually.
_LARGEST_SHIFT = 20
_WIDTHS = np.arange(0.6, 5.01, 0.1)
_LEAST_PX, _MOST_PX = 1.45, 4.95
# At least the first fraction of the correlation at one pixel falls off like stars, and the residual over all shifts is below
# the second fraction of that part.
_PART, _UNEXPLAINED = 0.8, 0.03
# Each half of the image has at least this fraction of it.
_SHARED = 0.15


def width_of_image(halves: tuple[F8, F8], size: tuple[int, int]) -> StarShape | None:
    """Measure the common width of the stars in an image; None if it is small or if something else causes the correlation.

    Parameters
    ----------
    halves : tuple of two ndarrays
        Result of `celnav.detecting.correlation.self_correlation.correlations_of_halves`.
    size : tuple of int
        Height and width of the image.
    """
    one, other = (_rings(half) for half in halves)
    correlation = (one + other) / 2
    models = _models()
    solutions = np.linalg.pinv(models) @ correlation
    left = ((correlation - np.einsum("wst,wt->ws", models, solutions)) ** 2).mean(axis=1)
    best = int(np.argmin(left))
    width, height = float(_WIDTHS[best]), float(solutions[best, 0])
    of_stars = height > _PART * correlation[0] and np.sqrt(left[best]) < _UNEXPLAINED * height
    solve = np.linalg.pinv(models[best])
    shared = min(float((solve @ half)[0]) for half in (one, other)) > _SHARED * height
    if not (of_stars and shared and _LEAST_PX < width < _MOST_PX):
        return None
    return StarShape.constant(width**2, 0.0, width**2, size)


def _rings(correlation: F8) -> F8:
    """Return the means over shifts of 1, 2, ... px, shape (_LARGEST_SHIFT - 1,)."""
    chosen, ring, number = _shifts()[1:]
    return np.asarray(np.bincount(ring, correlation[chosen])[1:] / number[1:])


@lru_cache(maxsize=1)
def _shifts() -> tuple[F8, NDArray[np.bool_], NDArray[np.intp], NDArray[np.intp]]:
    """Return the lengths of the shifts used, their places, the rings that they belong to, and the counts of the rings."""
    down, across = np.mgrid[-SHIFTS : SHIFTS + 1, -SHIFTS : SHIFTS + 1]
    shift = np.hypot(down, across)
    chosen = (shift > 0) & (shift < _LARGEST_SHIFT - 0.5)
    ring = np.rint(shift[chosen]).astype(np.intp)
    return shift[chosen], chosen, ring, np.bincount(ring)


@lru_cache(maxsize=1)
def _models() -> F8:
    """Return for each width the correlation of stars, a constant, and a slow fall; shape (widths, rings, 3)."""
    shift, _, ring, number = _shifts()
    stars = [np.bincount(ring, np.exp(-(shift**2) / (4 * width**2)))[1:] / number[1:] for width in _WIDTHS]
    slow = np.arange(1, len(number)) / _LARGEST_SHIFT
    return np.stack([np.column_stack((star, np.ones_like(slow), slow**2)) for star in stars])
