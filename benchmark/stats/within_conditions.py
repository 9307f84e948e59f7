"""Shares of frames whose conditions a task fixes: their variance is that within conditions.

A task has as many frames at each condition whatever is drawn, so that what the conditions differ by is no part of the
share's variance. Clusters of frames may lie in one condition or run through several.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from benchmark.stats.clustered import Resamples, proportion_estimate
from benchmark.stats.intervals import CONFIDENCE, Estimate, wilson

F8 = NDArray[np.float64]

FEWEST_CLUSTERS = 2
"""At each condition; fewer say nothing of the variance within it."""


def share_within_conditions(flags: ArrayLike, condition: ArrayLike, resamples: Resamples) -> Estimate:
    """Share of true flags, Wilson's interval with the effective number of frames that the variance within conditions gives.

    Where all frames of a condition agree, they show no variance: the condition then has that of a share with half a frame
    that differs. The share as a whole is treated as by `clustered.proportion_estimate` where all frames agree, where there is
    one condition, where a frame has none, and where one has fewer than `FEWEST_CLUSTERS` clusters.

    Parameters
    ----------
    flags : array_like of bool, shape (n_frames,)
    condition : array_like, shape (n_frames,)
        NaN where a frame has none.
    resamples : Resamples
        Of the frames' clusters.

    References
    ----------
    W. G. Cochran, Sampling Techniques, 3rd ed., 1977, section 5.3 (variance of a stratified mean).
    C. Franco, R. J. A. Little, T. A. Louis, E. V. Slud, J. Survey Statistics and Methodology 7, 334-364, 2019
    (Wilson's interval with an effective sample size).
    """
    right, at = np.asarray(flags, dtype=np.float64), np.asarray(condition, dtype=np.float64)
    whole = proportion_estimate(right, np.ones(len(right)), resamples)
    if len(at) == 0 or np.isnan(at).any() or not 0.0 < whole.value < 1.0:
        return whole
    _, stratum = np.unique(at, return_inverse=True)
    n_strata = int(stratum.max()) + 1
    clusters = np.unique(np.column_stack((stratum, resamples.cluster)), axis=0)[:, 0]
    n_clusters = np.bincount(clusters, minlength=n_strata)
    if n_strata < 2 or n_clusters.min() < FEWEST_CLUSTERS:
        return whole
    variance = _variance(right, stratum, n_clusters, resamples)
    tail = 0.5 + CONFIDENCE / 2.0
    freedom = max(1, resamples.n_clusters - n_strata)
    effective = whole.value * (1.0 - whole.value) / variance
    effective *= float(stats.norm.ppf(tail) / stats.t.ppf(tail, freedom)) ** 2
    low, high = wilson(whole.value * effective, effective)
    return Estimate(whole.value, low, high, whole.n)


def _variance(right: F8, stratum: NDArray[np.intp], n_clusters: NDArray[np.intp], resamples: Resamples) -> float:
    """Variance of the share over all frames, with the number of frames at each condition fixed."""
    frames = np.bincount(stratum).astype(np.float64)
    share = np.bincount(stratum, weights=right) / frames
    residual = (right - share[stratum]) * np.sqrt(n_clusters / (n_clusters - 1.0))[stratum]
    between = float(np.square(np.bincount(resamples.cluster, weights=residual)).sum())
    agree = (share == 0.0) | (share == 1.0)
    p = 0.5 / (n_clusters[agree] + 1.0)
    unseen = float((np.square(frames[agree]) * p * (1.0 - p) / n_clusters[agree]).sum())
    return (between + unseen) / math.pow(len(right), 2)
