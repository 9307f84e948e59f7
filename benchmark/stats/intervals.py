"""Confidence intervals for proportions, pooled proportions and quantiles.

All intervals are two-sided with equal tails. They need no random numbers. The quantile intervals are based on the binomial
distribution of ranks and so hold for any distribution of errors, including one with an atom at infinity (refusals), for which
a bootstrap of the median has no guarantee.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

CONFIDENCE = 0.95


@dataclass(frozen=True)
class Estimate:
    """A number with its interval.

    Attributes
    ----------
    value, low, high : float
        NaN where undefined (nothing to count); +inf where an error quantile lies among the refusals.
    n : int
        Number of independent units (frames) on which it is based.
    """

    value: float
    low: float
    high: float
    n: int


def wilson(successes: float, trials: float, confidence: float = CONFIDENCE) -> tuple[float, float]:
    """Wilson's score interval for a binomial proportion, without continuity correction.

    Parameters
    ----------
    successes, trials : float
        Counts; fractions are allowed, for effective sample sizes.
    confidence : float
        Nominal coverage, 0 to 1.

    Returns
    -------
    tuple of float
        Low and high; (nan, nan) without trials.

    Raises
    ------
    ValueError
        Unless 0 <= successes <= trials.

    References
    ----------
    E. B. Wilson, JASA 22, 209-212, 1927. R. G. Newcombe, Statistics in Medicine 17, 857-872, 1998, method 3.
    """
    if not 0.0 <= successes <= trials:
        raise ValueError(f"need 0 <= successes <= trials, found {successes} of {trials}")
    if trials == 0.0:
        return math.nan, math.nan
    z2 = float(stats.norm.ppf(0.5 + confidence / 2.0)) ** 2
    p = successes / trials
    centre = (p + z2 / (2.0 * trials)) / (1.0 + z2 / trials)
    half = math.sqrt(z2 * (p * (1.0 - p) + z2 / (4.0 * trials)) / trials) / (1.0 + z2 / trials)
    # At 0 successes and at all successes, rounding would put the end slightly off the value that it must equal.
    low = 0.0 if successes == 0.0 else max(0.0, centre - half)
    high = 1.0 if successes == trials else min(1.0, centre + half)
    return low, high


def proportion(flags: Sequence[bool] | NDArray[np.bool_], confidence: float = CONFIDENCE) -> Estimate:
    """Share of true flags among independent frames, with Wilson's interval."""
    n = len(flags)
    successes = int(np.count_nonzero(np.asarray(flags, dtype=bool)))
    low, high = wilson(successes, n, confidence)
    return Estimate(successes / n if n else math.nan, low, high, n)


def pooled_proportion(successes: ArrayLike, trials: ArrayLike, confidence: float = CONFIDENCE) -> Estimate:
    """Proportion pooled over frames whose stars succeed or fail together.

    The stars of one frame are not independent: a wrong fix mislabels all of them. The variance is therefore computed between
    frames (ratio estimator, linearised), converted to an effective number of independent stars and used in Wilson's interval.
    The effective number never exceeds the number of stars, and is scaled by the t quantile for the frames' degrees of
    freedom. Where all frames agree on 0 or 1 the variance is no guide; each frame then counts as one trial.

    Parameters
    ----------
    successes, trials : array_like, shape (n_frames,)
        Counts per frame; frames without trials are ignored.
    confidence : float
        Nominal coverage.

    Returns
    -------
    Estimate
        NaN throughout without any trial; the interval is 0 to 1 when there is only one frame.

    References
    ----------
    W. G. Cochran, Sampling Techniques, 3rd ed., 1977, eq. 6.13 (variance of a ratio).
    E. L. Korn and B. I. Graubard, Survey Methodology 24, 193-201, 1998 (effective sample size).
    C. Franco, R. J. A. Little, T. A. Louis, E. V. Slud, J. Survey Statistics and Methodology 7, 334-364, 2019
    (Wilson's interval with it).
    """
    k, m = np.asarray(successes, dtype=np.float64), np.asarray(trials, dtype=np.float64)
    k, m = k[m > 0], m[m > 0]
    n = len(m)
    if n == 0:
        return Estimate(math.nan, math.nan, math.nan, 0)
    total = float(m.sum())
    p = float(k.sum()) / total
    if n == 1:
        return Estimate(p, 0.0, 1.0, 1)
    variance = n / (n - 1.0) * float(np.sum((k - p * m) ** 2)) / total**2
    effective = float(n)
    if 0.0 < p < 1.0:
        effective = min(total, p * (1.0 - p) / variance) if variance > 0.0 else total
        tail = 0.5 + confidence / 2.0
        effective *= float(stats.norm.ppf(tail) / stats.t.ppf(tail, n - 1)) ** 2
    low, high = wilson(p * effective, effective, confidence)
    return Estimate(p, low, high, n)


def quantile_ranks(n: int, q: float, confidence: float = CONFIDENCE) -> tuple[int, int]:
    """Ranks (1-based) of the order statistics that enclose quantile `q` with at least the given confidence.

    Parameters
    ----------
    n : int
        Sample size, at least 1.
    q : float
        Quantile, strictly between 0 and 1.
    confidence : float
        Coverage, guaranteed for every distribution.

    Returns
    -------
    tuple of int
        Low rank, 0 when even the smallest value is too high; high rank, n + 1 when even the largest is too low.

    References
    ----------
    G. J. Hahn, W. Q. Meeker, Statistical Intervals, 1991, section 5.2 and table A.16; H. A. David, H. N. Nagaraja,
    Order Statistics, 3rd ed., 2003, section 7.1.
    """
    if n < 1 or not 0.0 < q < 1.0:
        raise ValueError(f"need n >= 1 and 0 < q < 1, found n = {n}, q = {q}")
    alpha = (1.0 - confidence) / 2.0
    ranks = np.arange(0, n + 2)
    # B counts the values below the quantile: P(quantile < X_(l)) = P(B <= l - 1), P(quantile > X_(u)) = P(B >= u).
    below = stats.binom.cdf(ranks - 1, n, q)
    above = stats.binom.sf(ranks - 1, n, q)
    low = int(ranks[below <= alpha].max())
    high = int(ranks[above <= alpha].min())
    return low, high


def quantile(values: ArrayLike, q: float) -> float:
    """Sample quantile that remains meaningful with infinite values.

    It is the inverse of the empirical distribution, averaged at jumps (Hyndman and Fan's definition 2): the median of an even
    number of values is the mean of the middle two, and infinite when either of them is.

    Parameters
    ----------
    values : array_like, shape (n,)
        Finite or +inf, n >= 1.
    q : float
        Strictly between 0 and 1.

    References
    ----------
    R. J. Hyndman, Y. Fan, The American Statistician 50, 361-365, 1996.
    """
    x = np.sort(np.asarray(values, dtype=np.float64))
    if len(x) == 0 or np.isnan(x).any():
        raise ValueError("a quantile needs at least one value and no NaN")
    position = len(x) * q
    nearest = round(position)
    if abs(position - nearest) < 1e-9 and 1 <= nearest < len(x):
        return float((x[nearest - 1] + x[nearest]) / 2.0)
    return float(x[min(math.ceil(position), len(x)) - 1])


def quantile_estimate(values: ArrayLike, q: float, confidence: float = CONFIDENCE) -> Estimate:
    """Sample quantile of non-negative values with its order-statistic interval.

    The interval is exact in the sense that its coverage is at least `confidence` for any distribution of the values,
    including atoms at infinity. A small sample may have no finite interval: with fewer than 6 values, the 95 % interval of
    the median runs from 0 to infinity.

    Parameters
    ----------
    values : array_like, shape (n,)
        Non-negative, +inf allowed.
    q : float
        Strictly between 0 and 1.
    """
    x = np.sort(np.asarray(values, dtype=np.float64))
    n = len(x)
    if n == 0:
        return Estimate(math.nan, math.nan, math.nan, 0)
    low, high = quantile_ranks(n, q, confidence)
    return Estimate(
        quantile(x, q),
        float(x[low - 1]) if low >= 1 else 0.0,
        float(x[high - 1]) if high <= n else math.inf,
        n,
    )
