"""Robust statistics of many rows of samples at once, of which some do not count.

Rows are sorted rather than partitioned, and what does not count is multiplied by zero rather than chosen by a mask:
processors do both for many numbers at a time.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

F4 = NDArray[np.float32]
Mask = NDArray[np.bool_]


def count_true(mask: Mask) -> NDArray[np.int_]:
    """Count what is true in each row, shape (n,)."""
    return np.asarray(mask.astype(np.float32) @ np.ones(mask.shape[1], dtype=np.float32), dtype=np.int_)


def medians(samples: F4, counted: Mask) -> F4:
    """Upper medians of the counted samples of each row, shape (n,); NaN for rows without any."""
    size = samples.shape[1]
    if counted.all():
        return np.asarray(np.sort(samples, axis=1)[:, size // 2])
    number = count_true(counted)
    ordered = np.sort(np.where(counted, samples, np.float32(np.inf)), axis=1)
    middles = ordered[np.arange(len(samples)), np.minimum(number // 2, size - 1)]
    return np.where(number > 0, middles, np.float32(np.nan))


def moments_within(deviation: F4, limit: F4, counted: Mask) -> tuple[F4, F4]:
    """Means of each row, shape (n,), and of its squares, of the values no larger than the row's limit.

    Medians alone are too coarse for integers where the noise is less than a step or two.
    """
    kept = counted & (np.abs(deviation) <= limit[:, None])
    number = np.maximum(count_true(kept), 1).astype(np.float32)
    inside = deviation * kept
    return inside.sum(axis=1) / number, np.asarray(np.einsum("ij,ij->i", inside, inside) / number, dtype=np.float32)
