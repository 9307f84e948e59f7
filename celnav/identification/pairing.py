"""Which detections lie near which predicted stars."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

F8 = NDArray[np.float64]
Rows = NDArray[np.intp]

# Pairs measured together: bounds the memory where both lists are long.
_PAIRS_AT_ONCE = 2_000_000


def candidate_pairs(seen: F8, predicted: F8, radius_px: float) -> tuple[Rows, Rows, F8]:
    """Return all pairs of `seen` (n, 2) and `predicted` (k, 2) within a radius, and their distances, shapes (m,).

    Sorted by row of `seen`. The pairs within the radius along u are looked up in sorted order, then measured.
    """
    order = np.argsort(predicted[:, 0])
    u, v = predicted[order].T.copy()
    first = np.searchsorted(u, seen[:, 0] - radius_px)
    count = np.searchsorted(u, seen[:, 0] + radius_px, side="right") - first
    end = np.cumsum(count)
    found = []
    start = 0
    while start < len(seen):
        before = end[start] - count[start]
        stop = max(start + 1, int(np.searchsorted(end, before + _PAIRS_AT_ONCE, side="right")))
        block = slice(start, stop)
        rows = np.repeat(np.arange(start, stop), count[block])
        columns = np.arange(len(rows)) + np.repeat(first[block] - (end[block] - count[block] - before), count[block])
        distance = np.hypot(seen[:, 0].take(rows) - u.take(columns), seen[:, 1].take(rows) - v.take(columns))
        near = np.flatnonzero(distance <= radius_px)
        found.append((rows[near], order[columns[near]], distance[near]))
        start = stop
    if not found:
        return np.empty(0, dtype=np.intp), np.empty(0, dtype=np.intp), np.empty(0)
    detection, star, distances = (np.concatenate(parts) for parts in zip(*found, strict=True))
    return detection, star, distances


def first_of_each(numbers: NDArray[np.integer]) -> Rows:
    """Where each of some numbers, not negative and small, occurs first, in the order of these places."""
    if not len(numbers):
        return np.empty(0, dtype=np.intp)
    first = np.full(int(numbers.max()) + 1, -1, dtype=np.intp)
    first[numbers[::-1]] = np.arange(len(numbers) - 1, -1, -1)  # of values for one place the last stays
    return np.flatnonzero(first[numbers] == np.arange(len(numbers)))


def nowhere_far_off(predicted: F8) -> F8:
    """Return positions, shape (n, 2), with those that do not exist (NaN) beyond any frame."""
    return np.where(np.isnan(predicted), -1e6, predicted)


def mutual_nearest(seen: F8, predicted: F8, radius_px: float) -> tuple[Rows, Rows]:
    """Return the rows of `seen` (n, 2) and `predicted` (k, 2) that are each other's nearest within a radius."""
    detection, star, distance = candidate_pairs(seen, predicted, radius_px)
    by_distance = np.argsort(distance, kind="stable")
    detection, star = detection[by_distance], star[by_distance]
    # The first pair of each in this order is the nearest one.
    nearest_to_detection = np.zeros(len(detection), dtype=bool)
    nearest_to_detection[first_of_each(detection)] = True
    nearest_to_star = np.zeros(len(detection), dtype=bool)
    nearest_to_star[first_of_each(star)] = True
    mutual = np.flatnonzero(nearest_to_detection & nearest_to_star)
    mutual = mutual[np.argsort(detection[mutual])]
    return detection[mutual], star[mutual]
