"""Direction and length of streaks from camera motion, from the autocorrelation of the image, before any star is found.

Equal streaks add up at shifts along them by less than their length. For a straight line of length l, the correlation at the
shift t is 1 - t / l. Stars that are individually too faint to be found as streaks thus determine direction and length
together. Uneven skies and clouds correlate as much next to the line as on it, and cancel.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from celnav.detecting.correlation.self_correlation import SHIFTS
from celnav.detecting.star_shape import StarShape

F8 = NDArray[np.float64]

# px. A line whose correlation does not fall off within the largest shift is a trail or a sensor defect.
_LONGEST, _SHORTEST, _FIRST_SHIFT = 78.0, 8.0, 4
# px. Lines are compared with parallel ones at this distance.
_BESIDE = 6.0
# The line of a streak exceeds the scatter of all other directions by this factor; directions this close to it, deg, do not
# count.
_CLEAR, _OWN_DEG = 8.0, 25.0
# Its correlation falls off like that of a line, measured by the cosine between the two, and is at least this fraction of the
# correlation of light at this many pixels.
_STRAIGHT, _PART, _NEAR = 0.97, 0.15, 2.0
# Compared with lines at this smaller distance, px, it keeps at least this fraction of its excess; smooth clouds, which fall
# off quadratically, keep a quarter.
_NEARER, _NARROW = 3.0, 0.5
# Each half of the image has at least this fraction of it; a signal in one half alone is a trail, or stars in a row.
_SHARED = 0.15
# The best-fitting Gaussian of a line of length l has a variance of l^2 / 8 (that of its light is l^2 / 12).
GAUSSIAN_OF_LINE = 8.0
_ACROSS_VARIANCE = 1.0


def streak_of_image(halves: tuple[F8, F8], size: tuple[int, int]) -> StarShape | None:
    """Measure the common streak of the stars in an image; None if there is none.

    Parameters
    ----------
    halves : tuple of two ndarrays
        Result of `celnav.detecting.correlation.self_correlation.correlations_of_halves`.
    size : tuple of int
        Height and width of the image.
    """
    correlation = (halves[0] + halves[1]) / 2
    turn = np.radians(np.arange(0.0, 180.0, 1.0))
    along = np.column_stack((np.cos(turn), np.sin(turn)))
    shifts = np.arange(_FIRST_SHIFT, SHIFTS - _BESIDE - 1.0)
    ridge = _ridge(correlation, along, shifts)
    lengths = np.arange(_SHORTEST, SHIFTS, 1.0)
    falls = np.maximum(1 - shifts / lengths[:, None], 0)
    strength = ridge @ (falls / np.sqrt((falls**2).sum(axis=1, keepdims=True))).T
    direction, length = np.unravel_index(np.argmax(strength), strength.shape)
    highest, fall = strength[direction, length], falls[length]
    apart = np.abs((np.arange(len(turn)) - direction + 90) % 180 - 90)
    others = strength[apart > _OWN_DEG, length]
    scatter = 1.4826 * float(np.median(np.abs(others - np.median(others))))
    clear = highest - np.median(others) > _CLEAR * scatter
    straight = highest > _STRAIGHT * np.linalg.norm(ridge[direction])
    most = float(_lines(correlation, along, np.array([_NEAR]), 0.0).max() - np.median(correlation))
    large = highest > _PART * most * np.linalg.norm(fall)
    least = min(float((_ridge(half, along[direction : direction + 1], shifts) @ fall)[0]) for half in halves)
    shared = least > _SHARED * highest * np.linalg.norm(fall)
    nearer = float((_ridge(correlation, along[direction : direction + 1], shifts, _NEARER) @ fall)[0])
    narrow = nearer > _NARROW * highest * np.linalg.norm(fall)
    if not (clear and straight and large and shared and narrow) or lengths[length] >= _LONGEST:
        return None
    line = np.outer(along[direction], along[direction]) * lengths[length] ** 2 / GAUSSIAN_OF_LINE
    return StarShape.constant(
        float(line[0, 0]) + _ACROSS_VARIANCE, float(line[0, 1]), float(line[1, 1]) + _ACROSS_VARIANCE, size
    )


def _ridge(correlation: F8, along: F8, shifts: F8, apart: float = _BESIDE) -> F8:
    """Read the correlation on lines minus that on parallel lines `apart` from them; shape (directions, shifts)."""
    beside = _lines(correlation, along, shifts, -apart) + _lines(correlation, along, shifts, apart)
    return np.asarray(_lines(correlation, along, shifts, 0.0) - beside / 2)


def _lines(correlation: F8, along: F8, shifts: F8, beside: float) -> F8:
    """Read the correlation on lines that pass its centre at the distance `beside`; shape (directions, shifts)."""
    from scipy import ndimage

    columns = SHIFTS + along[:, :1] * shifts - along[:, 1:] * beside
    rows = SHIFTS + along[:, 1:] * shifts + along[:, :1] * beside
    return np.asarray(ndimage.map_coordinates(correlation, [rows, columns], order=1, mode="nearest"))
