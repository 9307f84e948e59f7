"""Shares of frames, and their differences, with the variance within the conditions that a task fixes.

A task has the same number of frames at each condition whatever is drawn, so differences between conditions are no part of the
variance of a share. A cluster of frames may belong to one condition or extend over several.
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
"""Fewest clusters at each condition; fewer say nothing about the variance within it."""
MOST_UNSEEN = 1 / 3
"""Largest variance of conditions whose frames agree, over that of the others, for which the sum tells that of the share."""
_TAIL = 0.5 + CONFIDENCE / 2.0


def share_within_conditions(flags: ArrayLike, condition: ArrayLike, resamples: Resamples) -> Estimate:
    """Share of true flags, with Wilson's interval for the effective number of frames given by the variance within conditions.

    Where all frames of a condition agree, they show no variance; the condition then gets that of a share with half a frame
    that differs. The share as a whole is treated as by `clustered.proportion_estimate` where all frames agree, where there is
    only one condition, where a frame has no condition, where a condition has fewer than `FEWEST_CLUSTERS` clusters, and for
    rare events, where half frames would add more than `MOST_UNSEEN` of the variance seen, if that interval is the narrower
    one: fixed conditions lessen the variance.

    Parameters
    ----------
    flags : array_like of bool, shape (n_frames,)
    condition : array_like, shape (n_frames,)
        NaN where a frame has none.
    resamples : Resamples
        Resamples of the frames' clusters.

    References
    ----------
    W. G. Cochran, Sampling Techniques, 3rd ed., 1977, section 5.3 (variance of a stratified mean).
    C. Franco, R. J. A. Little, T. A. Louis, E. V. Slud, J. Survey Statistics and Methodology 7, 334-364, 2019
    (Wilson's interval with an effective sample size).
    """
    right = np.asarray(flags, dtype=np.float64)
    whole = proportion_estimate(right, np.ones(len(right)), resamples)
    strata = _strata(condition, resamples)
    if strata is None or not 0.0 < whole.value < 1.0:
        return whole
    seen, unseen = _variances(right, *strata, resamples)
    variance = seen + unseen
    if variance == 0.0:  # the residuals of every cluster cancel
        return whole
    effective = whole.value * (1.0 - whole.value) / variance
    effective *= float(stats.norm.ppf(_TAIL) / _quantile(strata[1], resamples)) ** 2
    low, high = wilson(whole.value * effective, effective)
    if unseen > MOST_UNSEEN * seen and high - low > whole.high - whole.low:
        return whole
    return Estimate(whole.value, low, high, whole.n)


def difference_within_conditions(gap: ArrayLike, condition: ArrayLike, resamples: Resamples) -> Estimate | None:
    """Mean of paired differences -1, 0 or 1 of two solvers on the same frames, with the variance within conditions.

    Two frames are added, one on which only the first solver succeeds and one on which only the second does: without them, few
    differences would make the interval too short, and no difference would shrink it to a point. The interval is Wald's about
    the mean with these frames, extended to include the mean without them.

    Parameters
    ----------
    gap : array_like, shape (n_frames,)
    condition : array_like, shape (n_frames,)
        NaN where a frame has none.
    resamples : Resamples
        Resamples of the frames' clusters.

    Returns
    -------
    Estimate or None
        None where the conditions give no variance: there is only one, a frame has none, or one has fewer than
        `FEWEST_CLUSTERS` clusters.

    References
    ----------
    D. G. Bonett, R. M. Price, J. Educational and Behavioral Statistics 37, 479-488, 2012 (the adjustment).
    W. G. Cochran, Sampling Techniques, 3rd ed., 1977, section 5.3 (variance of a stratified mean).
    """
    gaps, strata = np.asarray(gap, dtype=np.float64), _strata(condition, resamples)
    if strata is None:
        return None
    n, total = len(gaps), float(gaps.sum())
    squares = _sum_of_squares(gaps, *strata, resamples) + 2.0
    middle, half = total / (n + 2), _quantile(strata[1], resamples) * math.sqrt(squares) / (n + 2)
    value = total / n
    return Estimate(value, max(-1.0, min(middle - half, value)), min(1.0, max(middle + half, value)), n)


def _strata(condition: ArrayLike, resamples: Resamples) -> tuple[NDArray[np.intp], NDArray[np.intp]] | None:
    """Condition of each frame, from 0, and the number of clusters at each; None where they give no variance."""
    at = np.asarray(condition, dtype=np.float64)
    if len(at) == 0 or np.isnan(at).any():
        return None
    _, stratum = np.unique(at, return_inverse=True)
    n_strata = int(stratum.max()) + 1
    clusters = np.unique(np.column_stack((stratum, resamples.cluster)), axis=0)[:, 0]
    n_clusters = np.bincount(clusters, minlength=n_strata)
    return None if n_strata < 2 or n_clusters.min() < FEWEST_CLUSTERS else (stratum, n_clusters)


def _quantile(n_clusters: NDArray[np.intp], resamples: Resamples) -> float:
    """Quantile of Student's t for a variance with as many degrees of freedom as clusters minus conditions."""
    return float(stats.t.ppf(_TAIL, max(1, resamples.n_clusters - len(n_clusters))))


def _sum_of_squares(values: F8, stratum: NDArray[np.intp], n_clusters: NDArray[np.intp], resamples: Resamples) -> float:
    """Variance of the sum of the values over all frames, with the number of frames at each condition fixed."""
    means = np.bincount(stratum, weights=values) / np.bincount(stratum)
    residual = (values - means[stratum]) * np.sqrt(n_clusters / (n_clusters - 1.0))[stratum]
    return float(np.square(np.bincount(resamples.cluster, weights=residual)).sum())


def _variances(
    right: F8, stratum: NDArray[np.intp], n_clusters: NDArray[np.intp], resamples: Resamples
) -> tuple[float, float]:
    """Variance of the share over all frames: that between clusters, and that of conditions whose frames agree."""
    frames = np.bincount(stratum).astype(np.float64)
    share = np.bincount(stratum, weights=right) / frames
    between = _sum_of_squares(right, stratum, n_clusters, resamples)
    agree = (share == 0.0) | (share == 1.0)
    p = 0.5 / (n_clusters[agree] + 1.0)
    unseen = float((np.square(frames[agree]) * p * (1.0 - p) / n_clusters[agree]).sum())
    squared = math.pow(len(right), 2)
    return between / squared, unseen / squared
