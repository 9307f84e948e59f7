"""Mean of positive numbers a few of which are far larger than the others, with an interval that accounts for them."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from benchmark.stats.clustered import Resamples
from benchmark.stats.intervals import CONFIDENCE, Estimate

F8 = NDArray[np.float64]

FEWEST_CLUSTERS = 40
"""With fewer clusters, the largest values are too rarely among them for an interval of the mean."""
LARGEST_SHARE = 0.5
"""Where one cluster has more of the sum, the sample says next to nothing about how often such a cluster occurs."""


def skewed_mean_estimate(values: ArrayLike, resamples: Resamples) -> Estimate:
    """Mean of non-negative numbers, with a bootstrap-t interval of its logarithm; NaN values are ignored.

    In a sample without the rare large values, both the mean and its own standard deviation are too small, so a percentile
    interval ends too low. Each resample is therefore measured in units of its own standard deviation, on the scale on which
    the mean is least skewed. There is no interval for values in fewer than `FEWEST_CLUSTERS` clusters, where all agree, or
    where one cluster has more than `LARGEST_SHARE` of the sum.

    Parameters
    ----------
    values : array_like, shape (n_frames,)
        Finite or NaN.
    resamples : Resamples
        Resamples of the frames' clusters.

    References
    ----------
    B. Efron, R. J. Tibshirani, An Introduction to the Bootstrap, 1993, sections 12.5 (bootstrap-t) and 12.6 (the scale).
    """
    x = np.asarray(values, dtype=np.float64)
    known = ~np.isnan(x)
    n = int(np.count_nonzero(known))
    if n == 0:
        return Estimate(math.nan, math.nan, math.nan, 0)
    part = Resamples.of(resamples.cluster[known], resamples.n_resamples, resamples.seed)
    mean = float(x[known].mean())
    if part.n_clusters < FEWEST_CLUSTERS or mean <= 0.0:
        return Estimate(mean, math.nan, math.nan, n)
    total, count = (np.bincount(part.cluster, weights=one) for one in (x[known], np.ones(n)))
    if total.max() > LARGEST_SHARE * total.sum():
        return Estimate(mean, math.nan, math.nan, n)
    sums = np.column_stack((total, count, total**2, total * count, count**2))
    (_, spread), (means, spreads) = _relative(sums.sum(axis=0)[None]), _relative(part.cluster_sums(sums))
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (np.log(means) - math.log(mean)) / spreads
    t = t[np.isfinite(t)]
    if spread[0] <= 0.0 or len(t) < len(means) / 2:
        return Estimate(mean, math.nan, math.nan, n)
    tail = (1.0 - CONFIDENCE) / 2.0
    low, high = np.quantile(t, (tail, 1.0 - tail), method="linear").tolist()
    with np.errstate(over="ignore"):
        ends = mean * np.exp(np.array([-high, -low]) * spread[0])
    return Estimate(mean, float(ends[0]), float(ends[1]), n)


def _relative(sums: F8) -> tuple[F8, F8]:
    """Means and their standard deviations between clusters over the means, shape (k,) each.

    `sums` are those of total, count, total^2, total x count and count^2 over clusters, shape (k, 5).
    """
    total, count, totals, cross, counts = sums.T
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = total / count
        square = totals - 2.0 * mean * cross + mean**2 * counts
        return mean, np.sqrt(np.maximum(square, 0.0)) / total
