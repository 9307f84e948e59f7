"""Pairs of positions that are close to each other."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

F8 = NDArray[np.float64]

# If a position has fewer others than this in the columns within the radius, measuring them is faster than building a tree.
_FEW = 12


def close_pairs(uv: F8, radius_px: float) -> NDArray[np.intp]:
    """Return the pairs of positions, shape (n, 2), within a radius of each other: rows in ascending order, shape (p, 2)."""
    order = uv[:, 0].argsort()
    u = uv[:, 0].take(order)
    after = np.arange(1, len(u) + 1)
    count = u.searchsorted(u + radius_px, side="right") - after
    end = count.cumsum()
    if not len(u) or end[-1] > _FEW * len(u):
        from scipy.spatial import cKDTree

        return np.asarray(cKDTree(uv).query_pairs(radius_px, output_type="ndarray"))
    v = uv[:, 1].take(order)
    one = np.arange(len(u)).repeat(count)
    other = np.arange(end[-1]) + (after - end + count).repeat(count)
    square, down = u.take(other) - u.take(one), v.take(other) - v.take(one)
    square *= square
    down *= down
    square += down
    near = (square <= radius_px**2).nonzero()[0]
    one, other = order.take(one.take(near)), order.take(other.take(near))
    return np.column_stack((np.minimum(one, other), np.maximum(one, other)))
