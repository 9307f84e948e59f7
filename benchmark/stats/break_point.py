"""Break point of a solver: the value of a task's condition at which half of its frames succeed."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from benchmark.stats.clustered import Resamples, percentile_interval
from benchmark.stats.frame_metrics import column, sites, succeeded
from benchmark.stats.intervals import Estimate
from benchmark.stats.metrics import SUCCESS_KM

F8 = NDArray[np.float64]

HALF = 0.5
INFORMATIVE = (0.05, 0.95)


@dataclass(frozen=True)
class Discrimination:
    """Whether a task's conditions distinguish between solvers.

    Attributes
    ----------
    n_conditions : int
    n_informative : int
        Conditions at which the success of some solver is between 5 % and 95 %.
    best_at_hardest : float
        Success of the best solver at the hardest condition.
    """

    n_conditions: int
    n_informative: int
    best_at_hardest: float

    @property
    def holds(self) -> bool:
        """Whether at least half of the conditions are informative and the hardest is too hard for every solver."""
        return 2 * self.n_informative >= self.n_conditions and self.best_at_hardest < HALF


def discrimination(
    tables: Mapping[str, pd.DataFrame], harder: int = 1, by: str = "condition", limit_km: float = SUCCESS_KM
) -> Discrimination:
    """Judge a task by its solvers' tables; `harder` is 1 where larger conditions are harder, -1 where smaller ones are."""
    rates = []
    for table in tables.values():
        levels, hits, counts, _ = _counts(table, by, limit_km)
        rates.append(pd.Series(hits.sum(axis=0) / counts.sum(axis=0), index=levels))
    if not rates:
        return Discrimination(0, 0, math.nan)
    table = pd.concat(rates, axis=1).sort_index(ascending=harder > 0)
    inside = ((table > INFORMATIVE[0]) & (table < INFORMATIVE[1])).any(axis=1)
    hardest = float(table.iloc[-1].max()) if len(table) else math.nan
    return Discrimination(len(table), int(inside.sum()), hardest)


def break_point(
    frames: pd.DataFrame,
    harder: int = 1,
    by: str = "condition",
    limit_km: float = SUCCESS_KM,
    share: float = HALF,
    seed: int | None = None,
) -> Estimate:
    """Condition at which success falls to one half, with its clustered bootstrap interval.

    Isotonic regression makes success at the tested values fall with difficulty; between two tested values it is taken as
    linear. No other shape of the curve is assumed, so the result depends on the tested values only.

    Parameters
    ----------
    frames : DataFrame
    harder : int
        1 where a larger value of the condition is harder, -1 where a smaller one is.
    by : str
        Column of the condition.
    limit_km : float
        Largest error that counts as success.
    share : float
        The success rate sought.
    seed : int, optional
        Seed of the resamples.

    Returns
    -------
    Estimate
        In the condition's unit. It is infinite towards the harder end where success never falls that low, and towards the
        easier end where success is lower from the start; one end of the interval alone may be infinite. NaN where no frame
        has a value.

    References
    ----------
    M. Ayer, H. D. Brunk, G. M. Ewing, W. T. Reid, E. Silverman, Annals of Mathematical Statistics 26, 641-647, 1955
    (isotonic regression of proportions); B. Efron, R. J. Tibshirani, An Introduction to the Bootstrap, 1993,
    section 13.3 (percentile intervals respect monotone transformations, to infinity here).
    """
    levels, hits, counts, site = _counts(frames, by, limit_km)
    n = int(counts.sum())
    if n == 0:
        return Estimate(math.nan, math.nan, math.nan, 0)
    if harder < 0:
        levels, hits, counts = -levels[::-1], hits[:, ::-1], counts[:, ::-1]
    resamples = Resamples.of(site) if seed is None else Resamples.of(site, seed=seed)
    value = float(crossing(levels, *isotonic(hits.sum(axis=0)[None], counts.sum(axis=0)[None]), share)[0])
    drawn = isotonic(resamples.cluster_sums(hits), resamples.cluster_sums(counts))
    low, high = percentile_interval(crossing(levels, *drawn, share), resamples.n_clusters)
    low, high = min(low, value), max(high, value)
    if harder < 0:
        value, low, high = -value, -high, -low
    return Estimate(value, low, high, n)


def tested_around(value: float, tested: Sequence[float]) -> tuple[float, float] | None:
    """Bracket of a break point: the nearest tested values on both sides, between which it is interpolated.

    None where the break point is at a tested value, beyond all of them, or undefined.
    """
    below, above = [one for one in tested if one <= value], [one for one in tested if one >= value]
    if not below or not above or max(below) == min(above):
        return None
    return max(below), min(above)


def _counts(frames: pd.DataFrame, by: str, limit_km: float) -> tuple[F8, F8, F8, NDArray[np.intp]]:
    """Tested values, ascending; successes and frames by site and value; the indices of the sites."""
    values = column(frames, by)
    known = ~np.isnan(values)
    levels, place = np.unique(values[known], return_inverse=True)
    names, site = np.unique(sites(frames)[known], return_inverse=True)
    hits, counts = np.zeros((len(names), len(levels))), np.zeros((len(names), len(levels)))
    np.add.at(counts, (site, place), 1.0)
    np.add.at(hits, (site, place), succeeded(frames, limit_km)[known].astype(np.float64))
    return levels, hits, counts, np.arange(len(names))


def isotonic(hits: F8, counts: F8) -> tuple[F8, F8]:
    """Least-squares fit of non-increasing proportions, for each row.

    The value at each level is the minimum, over first levels up to it, of the largest share among all blocks of levels that
    start there and reach it (Ayer et al. 1955, see :func:`break_point`).

    Parameters
    ----------
    hits, counts : ndarray, shape (k, n_levels)

    Returns
    -------
    fitted, counts : ndarray, shape (k, n_levels)
        Levels without frames take no part in the fit; they have count 0 and a meaningless fitted value.
    """
    tested = counts > 0
    # Computed from sums of integers, so that a block whose share is one half has exactly that value.
    hits_before, counts_before = (np.pad(np.cumsum(each, axis=1), ((0, 0), (1, 0))) for each in (hits, counts))
    fitted = np.full(hits.shape, math.inf)
    for first in range(hits.shape[1]):
        with np.errstate(invalid="ignore"):
            share = (hits_before[:, first + 1 :] - hits_before[:, first, None]) / (
                counts_before[:, first + 1 :] - counts_before[:, first, None]
            )
        share[np.isnan(share)] = -math.inf
        highest = np.maximum.accumulate(share[:, ::-1], axis=1)[:, ::-1]
        fitted[:, first:] = np.minimum(fitted[:, first:], np.where(tested[:, first, None], highest, math.inf))
    fitted[~tested] = math.nan
    return fitted, counts


def crossing(levels: F8, fitted: F8, counts: F8, share: float = HALF) -> F8:
    """Where a falling curve through the fitted proportions reaches `share`, shape (k,).

    -inf where it is below from the first level on, +inf where it never falls below; the middle of a stretch on which it
    equals `share`.
    """
    found = np.empty(len(fitted))
    above = np.full(len(fitted), -math.inf)  # last level still above the share, and the first one below it
    above_rate = np.full(len(fitted), math.nan)
    below = np.full(len(fitted), math.inf)
    below_rate = np.full(len(fitted), math.nan)
    first_equal, last_equal = np.full(len(fitted), math.nan), np.full(len(fitted), math.nan)
    for i, level in enumerate(levels):
        rate, tested = fitted[:, i], counts[:, i] > 0
        higher = tested & (rate > share)
        above[higher], above_rate[higher] = level, rate[higher]
        equal = tested & (rate == share)
        first_equal = np.where(equal & np.isnan(first_equal), level, first_equal)
        last_equal[equal] = level
        lower = tested & (rate < share) & np.isinf(below)
        below[lower], below_rate[lower] = level, rate[lower]
    with np.errstate(invalid="ignore", divide="ignore"):
        between = above + (above_rate - share) / (above_rate - below_rate) * (below - above)
    found = np.where(np.isinf(above), -math.inf, np.where(np.isinf(below), math.inf, between))
    return np.where(np.isnan(first_equal), found, (first_equal + last_equal) / 2.0)
