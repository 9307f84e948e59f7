"""Robust statistics of many rows of samples at once, some of which are not used.

Rows are sorted rather than partitioned, and unused samples are multiplied by zero rather than selected by a mask, because
processors do both for many numbers at a time.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

F4 = NDArray[np.float32]
Mask = NDArray[np.bool_]

# Standard deviation of a normal distribution after clipping at three standard deviations, as a fraction of its own.
CLIP, CLIPPED_NORMAL = np.float32(3.0), np.float32(0.98658)
# Slightly more than one step, to allow for rounding.
_OVER_STEP = np.float32(1.01)


class Scatter(NamedTuple):
    """Scatter of pixels from the differences of neighbours, and the step of rounded values; shapes (n,)."""

    variance: F4
    number: NDArray[np.int_]
    step: F4


def scatter_of_steps(samples: F4, counted: Mask) -> Scatter:
    """Measure the variance of pixels from the differences of every second one to the next, along the first axis of blocks.

    The step is the lower quartile of the nonzero differences: for rounded values, that between neighbouring values; for
    others, less than a standard deviation. Differences of one step are never clipped.

    Parameters
    ----------
    samples, counted : ndarray, shape (n, k, k)
        Blocks of pixels, and which of them to use.
    """
    steps = ((samples[:, 1::2] - samples[:, ::2]) * np.float32(np.sqrt(0.5))).reshape(len(samples), -1)
    both = (counted[:, 1::2] & counted[:, ::2]).reshape(len(samples), -1)
    number, last = count_true(both), steps.shape[1] - 1
    size = np.abs(steps)
    if not both.all():
        size[~both] = np.inf
    size.sort(axis=1)
    row, same = np.arange(len(size)), count_true(size == 0)
    usual = size[row, np.minimum(number // 2, last)]
    step = _OVER_STEP * size[row, np.minimum(same + (number - same) // 4, last)]
    step[same >= number] = 0
    limit = np.maximum(CLIP * np.float32(1.4826) * usual, step)
    limit[number == 0] = 0
    mean, square = moments_within(steps, limit, both)
    variance = np.maximum(square - mean * mean, np.float32(0)) / CLIPPED_NORMAL**2
    return Scatter(np.asarray(variance, dtype=np.float32), number, step)


def all_true(mask: Mask) -> bool:
    """Return whether a mask is true everywhere; a single broadcast value (`np.broadcast_to`) is checked only once."""
    return bool(mask.all() if any(mask.strides) or not mask.size else mask.flat[0])


def count_true(mask: Mask) -> NDArray[np.int_]:
    """Count the true entries of each row, shape (n,)."""
    return np.asarray(mask.astype(np.float32) @ np.ones(mask.shape[1], dtype=np.float32), dtype=np.int_)


def medians(samples: F4, counted: Mask | None) -> F4:
    """Return the upper medians of the counted samples of each row (None: all), shape (n,); NaN for rows without any."""
    size = samples.shape[1]
    if counted is None or counted.all():
        return np.asarray(np.sort(samples, axis=1)[:, size // 2])
    number = count_true(counted)
    ordered = np.sort(np.where(counted, samples, np.float32(np.inf)), axis=1)
    middles = ordered[np.arange(len(samples)), np.minimum(number // 2, size - 1)]
    return np.where(number > 0, middles, np.float32(np.nan))


def moments_within(deviation: F4, limit: F4, counted: Mask | None) -> tuple[F4, F4]:
    """Return the mean and the mean square, shapes (n,), of each row's counted values (None: all) up to the row's limit.

    Medians alone are too coarse for integers if the noise is less than a step or two.
    """
    kept = np.abs(deviation) <= limit[:, None]
    if counted is not None:
        kept &= counted
    weight = kept.astype(np.float32)
    number = np.maximum(weight @ np.ones(weight.shape[1], dtype=np.float32), np.float32(1))
    inside = deviation * weight
    return inside.sum(axis=1) / number, np.asarray(np.einsum("ij,ij->i", inside, inside) / number, dtype=np.float32)
