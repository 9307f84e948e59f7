"""Pairing of detections with nearby predicted stars."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

F8 = NDArray[np.float64]
Rows = NDArray[np.intp]

# Number of pairs measured together, which bounds the memory if both lists are long.
_PAIRS_AT_ONCE = 2_000_000


def candidate_pairs(seen: F8, predicted: F8, radius_px: float) -> tuple[Rows, Rows, F8]:
    """Return all pairs of `seen` (n, 2) and `predicted` (k, 2) within a radius, and their distances, shapes (m,).

    The pairs are sorted by row of `seen`. Pairs within the radius along u are looked up in sorted order, then measured.
    """
    order = predicted[:, 0].argsort()
    u, v = predicted[:, 0].take(order), predicted[:, 1].take(order)
    seen_u, seen_v = seen[:, 0].copy(), seen[:, 1].copy()
    # Look up in sorted order: at random places, the processor mispredicts the branches of the binary search.
    by_u = seen_u.argsort()
    ordered = seen_u.take(by_u)
    first, count = np.empty((2, len(seen)), dtype=np.intp)
    first[by_u] = u.searchsorted(ordered - radius_px)
    count[by_u] = u.searchsorted(ordered + radius_px, side="right")
    count -= first
    end = count.cumsum()
    found = []
    start = 0
    while start < len(seen):
        before = end[start] - count[start]
        stop = max(start + 1, int(end.searchsorted(before + _PAIRS_AT_ONCE, side="right")))
        block = slice(start, stop)
        rows = np.arange(start, stop).repeat(count[block])
        columns = np.arange(len(rows)) + (first[block] - (end[block] - count[block] - before)).repeat(count[block])
        square, down = seen_u.take(rows), seen_v.take(rows)
        square -= u.take(columns)
        down -= v.take(columns)
        square *= square
        down *= down
        square += down
        near = (square <= radius_px**2).nonzero()[0]
        found.append((rows.take(near), order.take(columns.take(near)), np.sqrt(square.take(near))))
        start = stop
    if not found:
        return np.empty(0, dtype=np.intp), np.empty(0, dtype=np.intp), np.empty(0)
    if len(found) == 1:
        return found[0]
    detection, star, distances = (np.concatenate(parts) for parts in zip(*found, strict=True))
    return detection, star, distances


def first_of_each(numbers: NDArray[np.integer]) -> Rows:
    """Return the places where each of some small non-negative numbers occurs first, in ascending order."""
    return _is_first(numbers).nonzero()[0]


def _is_first(numbers: NDArray[np.integer]) -> NDArray[np.bool_]:
    """Return which entries of an array of small non-negative numbers are the first of their value."""
    if not len(numbers):
        return np.zeros(0, dtype=bool)
    place = np.arange(len(numbers))
    first = np.empty(int(numbers.max()) + 1, dtype=np.intp)
    first[numbers[::-1]] = place[::-1]  # of several values assigned to one place, the last stays
    return np.asarray(first.take(numbers) == place)


def nowhere_far_off(predicted: F8) -> F8:
    """Return positions, shape (n, 2), with missing ones (NaN) moved beyond any frame."""
    return np.where(np.isnan(predicted), -1e6, predicted)


def mutual_nearest(seen: F8, predicted: F8, radius_px: float) -> tuple[Rows, Rows]:
    """Return the rows of `seen` (n, 2) and `predicted` (k, 2) that are each other's nearest within a radius."""
    detection, star, distance = candidate_pairs(seen, predicted, radius_px)
    by_distance = distance.argsort(kind="stable")
    detection, star = detection.take(by_distance), star.take(by_distance)
    # The first pair of each in this order is the nearest one.
    mutual = (_is_first(detection) & _is_first(star)).nonzero()[0]
    mutual = mutual.take(detection.take(mutual).argsort())
    return detection.take(mutual), star.take(mutual)
