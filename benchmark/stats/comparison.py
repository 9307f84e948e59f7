"""Comparison of solvers on the same frames: differences, tests over the family of pairs, ranks with intervals."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from benchmark.errors import ResultsError
from benchmark.stats.clustered import Resamples, mean_estimates
from benchmark.stats.frame_metrics import column, errors_km, fixed, sites, succeeded
from benchmark.stats.intervals import Estimate
from benchmark.stats.metrics import SUCCESS_KM
from benchmark.stats.paired_tests import N_FLIPS, PairedTest, holm, mcnemar_clustered, sign_flips, sums_by_cluster
from benchmark.stats.power import design_effect, minimum_detectable_difference
from benchmark.stats.within_conditions import difference_within_conditions

F8 = NDArray[np.float64]

FLIPS_A_PAIR = 200
"""Flips of the test of errors for each pair of a family: adjusted for all of them, its least p-value is 1/200."""
SMALLEST_ERROR_KM = 0.001
"""Errors below a metre count as a metre in a ratio, so that a perfect fix has a ratio."""
LEVEL = 0.05
_MOST_ELEMENTS = 2_000_000


@dataclass(frozen=True)
class Comparison:
    """Comparison of two solvers on the same frames.

    Attributes
    ----------
    first, second : str
    n_frames, n_sites : int
    difference : Estimate
        Success of the first minus that of the second.
    success_test : PairedTest
        McNemar's exact test by site.
    success_p_holm : float
        Its p-value, adjusted for all pairs of the family.
    error_ratio : Estimate
        Geometric mean of the ratio of the first's error to the second's, over the frames on which both have a fix.
    error_p : float
        P-value of a sign-flip test by site of the logarithm of that ratio.
    error_p_holm : float
        The same p-value, adjusted for all pairs of the family.
    closer : Estimate
        Share of all frames on which the first is closer to the truth. A refused frame counts as infinitely far, and a tie
        (both refused) counts one half.
    design_effect : float
        Factor by which sites increase the variance of the difference.
    """

    first: str
    second: str
    n_frames: int
    n_sites: int
    difference: Estimate
    success_test: PairedTest
    success_p_holm: float
    error_ratio: Estimate
    error_p: float
    error_p_holm: float
    closer: Estimate
    design_effect: float


@dataclass(frozen=True)
class Rank:
    """A solver's rank by success (1 is the best), and the interval that contains its true rank.

    The intervals of all solvers hold jointly with 95 % probability.
    """

    solver: str
    rank: int
    low: int
    high: int


@dataclass(frozen=True, eq=False)
class _Answers:
    """Answers of one solver on each frame, in an order of frames that all solvers share; each of shape (n_frames,)."""

    site: NDArray[np.intp]
    right: NDArray[np.bool_]
    fixed: NDArray[np.bool_]
    error_km: F8
    condition: F8


def paired(first: pd.DataFrame, second: pd.DataFrame) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Bring both tables into the order of the first's frames.

    Raises
    ------
    ResultsError
        They are not of the same frames, or a frame occurs twice in one.
    """
    for table in (first, second):
        if not table["frame_id"].is_unique:
            raise ResultsError("a table has a frame twice; run `skybench bench run` again")
    place = pd.Index(second["frame_id"]).get_indexer(pd.Index(first["frame_id"]))
    if len(first) != len(second) or (place < 0).any():
        raise ResultsError(
            "solvers were scored on different frames and cannot be paired; run them on the same task and split"
        )
    return first.reset_index(drop=True), second.iloc[place].reset_index(drop=True)


def compare(
    tables: Mapping[str, pd.DataFrame], limit_km: float = SUCCESS_KM, pairs: Sequence[tuple[str, str]] | None = None
) -> tuple[Comparison, ...]:
    """Compare solvers pair by pair; p-values are adjusted by Holm over all pairs.

    Parameters
    ----------
    tables : mapping of str to DataFrame
        Table of frames of each solver, by name.
    limit_km : float
        Largest error that counts as success.
    pairs : sequence of (str, str), optional
        The family of pairs; by default all pairs.

    Raises
    ------
    ResultsError
        The tables are not of the same frames.
    """
    family = list(itertools.combinations(tables, 2)) if pairs is None else list(pairs)
    if not family:
        return ()
    reference = tables[family[0][0]]
    names = dict.fromkeys(itertools.chain.from_iterable(family))
    answers = {name: _answers(paired(reference, tables[name])[1], limit_km) for name in names}
    most = max(1, _MOST_ELEMENTS // max(len(reference), 1))
    found: list[Comparison] = []
    ratios: list[F8] = []
    for first, group in itertools.groupby(family, key=lambda pair: pair[0]):
        seconds = [second for _, second in group]
        for start in range(0, len(seconds), most):
            compared = _compare(first, seconds[start : start + most], answers)
            found += [comparison for comparison, _ in compared]
            ratios += [by_site for _, by_site in compared]
    success = holm([comparison.success_test.p for comparison in found])
    error_p = sign_flips(ratios, max(N_FLIPS, FLIPS_A_PAIR * len(ratios) - 1))
    return tuple(
        replace(comparison, success_p_holm=p, error_p=q, error_p_holm=adjusted)
        for comparison, p, q, adjusted in zip(found, success, error_p, holm(error_p), strict=True)
    )


def _answers(table: pd.DataFrame, limit_km: float) -> _Answers:
    return _Answers(
        np.unique(sites(table), return_inverse=True)[1],
        succeeded(table, limit_km),
        fixed(table),
        np.maximum(errors_km(table), SMALLEST_ERROR_KM),
        column(table, "condition"),
    )


def _compare(first: str, seconds: Sequence[str], answers: Mapping[str, _Answers]) -> list[tuple[Comparison, F8]]:
    """Compare one solver with others, before errors are tested and p-values adjusted; with log error ratios by site."""
    one, others = answers[first], [answers[name] for name in seconds]
    resamples = Resamples.of(one.site)
    gaps = np.column_stack([one.right.astype(np.float64) - other.right for other in others])
    both = [one.fixed & other.fixed for other in others]
    log_ratios = np.full(gaps.shape, math.nan)
    for k, (known, other) in enumerate(zip(both, others, strict=True)):
        log_ratios[known, k] = np.log(one.error_km[known] / other.error_km[known])
    closer = np.column_stack(
        [np.where(one.error_km == other.error_km, 0.5, one.error_km < other.error_km) for other in others]
    )
    differences = difference_estimates(gaps, one.condition, resamples)
    ratios = mean_estimates(log_ratios, resamples)
    closest = mean_estimates(closer, resamples, (0.0, 1.0))
    return [
        (
            Comparison(
                first,
                second,
                len(one.site),
                resamples.n_clusters,
                differences[k],
                mcnemar_clustered(one.right, others[k].right, one.site),
                math.nan,
                exponential(ratios[k]),
                math.nan,
                math.nan,
                closest[k],
                design_effect(gaps[:, k], one.site),
            ),
            sums_by_cluster(log_ratios[both[k], k], one.site[both[k]]),
        )
        for k, second in enumerate(seconds)
    ]


def difference_estimate(gap: F8, condition: F8, resamples: Resamples) -> Estimate:
    """Mean of paired differences -1, 0 or 1 with its interval (see `difference_estimates`)."""
    return difference_estimates(np.asarray(gap, dtype=np.float64)[:, None], condition, resamples)[0]


def difference_estimates(gaps: F8, condition: F8, resamples: Resamples) -> list[Estimate]:
    """Means of paired differences -1, 0 or 1, shape (n_frames, k), with their intervals.

    Where the conditions, shape (n_frames,), allow it, the variance is that within conditions
    (`difference_within_conditions`); otherwise clusters are resampled. Two frames are added to the resampled ones, one on
    which only the first solver succeeds and one on which only the second does: without them, few differences would make the
    interval too short, and no difference would shrink it to a point.

    References
    ----------
    D. G. Bonett, R. M. Price, J. Educational and Behavioral Statistics 37, 479-488, 2012 (the adjustment).
    """
    n, k = gaps.shape
    if n == 0:
        return [Estimate(math.nan, math.nan, math.nan, 0)] * k
    within = [difference_within_conditions(gap, condition, resamples) for gap in gaps.T]
    known = [estimate for estimate in within if estimate is not None]
    if len(known) == k:
        return known
    padded = np.concatenate((gaps, np.full((1, k), 1.0), np.full((1, k), -1.0)))
    cluster = np.concatenate((resamples.cluster, resamples.n_clusters + np.arange(2)))
    widened = Resamples(cluster, resamples.n_clusters + 2, resamples.n_resamples, resamples.seed)
    means = np.ascontiguousarray(gaps.T).mean(axis=1).tolist()
    return [
        Estimate(mean, min(found.low, mean), max(found.high, mean), n)
        for mean, found in zip(means, mean_estimates(padded, widened, (-1.0, 1.0)), strict=True)
    ]


def exponential(estimate: Estimate) -> Estimate:
    """Estimate of which the given one is the natural logarithm."""
    with np.errstate(over="ignore"):
        value, low, high = np.exp([estimate.value, estimate.low, estimate.high]).tolist()
    return Estimate(value, low, high, estimate.n)


def ranks(
    tables: Mapping[str, pd.DataFrame],
    comparisons: Sequence[Comparison],
    level: float = LEVEL,
    limit_km: float = SUCCESS_KM,
) -> tuple[Rank, ...]:
    """Ranks by success with joint confidence intervals, best first.

    A solver's true rank is one more than the number of better solvers. That number is at least the number of solvers that
    test as better, and at most the number of those that do not test as worse. Holm's adjustment keeps the probability of any
    false verdict below the level; if no verdict is false, all intervals hold.

    Parameters
    ----------
    tables : mapping of str to DataFrame
    comparisons : sequence of Comparison
        All pairs of the tables, from `compare`.
    level : float

    References
    ----------
    M. Mogstad, J. P. Romano, A. M. Shaikh, D. Wilhelm, Review of Economic Studies 91, 476-518, 2024 (confidence sets
    for ranks from tests of all pairs).
    """
    names = list(tables)
    pairs = {frozenset((c.first, c.second)) for c in comparisons}
    if missing := [pair for pair in itertools.combinations(names, 2) if frozenset(pair) not in pairs]:
        raise ValueError(f"ranks need the comparison of all pairs; {missing[0]} is missing")
    rate = {name: float(succeeded(table, limit_km).mean()) for name, table in tables.items()}
    better, worse = dict.fromkeys(names, 0), dict.fromkeys(names, 0)
    for c in comparisons:
        if c.success_p_holm > level or c.difference.value == 0:
            continue
        winner, loser = (c.first, c.second) if c.difference.value > 0 else (c.second, c.first)
        better[loser] += 1
        worse[winner] += 1
    found = [
        Rank(name, 1 + sum(other > rate[name] for other in rate.values()), 1 + better[name], len(names) - worse[name])
        for name in names
    ]
    return tuple(sorted(found, key=lambda rank: (rank.rank, rank.solver)))


def lead_p(best: str, comparisons: Sequence[Comparison]) -> float:
    """P-value of "this solver succeeds more often than every other": its largest against any of them, adjusted by Holm.

    The adjustment for all pairs of the family covers that the solver was chosen for being first. 1 where another one succeeds
    as often, or there is no other.

    Parameters
    ----------
    best : str
    comparisons : sequence of Comparison
        Those of `compare`, of all pairs.
    """
    mine = [c for c in comparisons if best in (c.first, c.second)]
    ahead = [c.difference.value * (1.0 if c.first == best else -1.0) > 0.0 for c in mine]
    return max((c.success_p_holm if first else 1.0 for c, first in zip(mine, ahead, strict=True)), default=1.0)


def detectable(comparisons: Sequence[Comparison], level: float = LEVEL, power: float = 0.8) -> float:
    """Smallest true difference of success that a table of comparisons detects with probability `power`.

    It is computed for a typical pair of the table, with the median share of frames on which the two differ and the median
    design effect, tested at the level of the first step of Holm's procedure. NaN without pairs or where no pair differs.
    """
    if not comparisons:
        return math.nan
    discordant = float(
        np.median([(c.success_test.only_first + c.success_test.only_second) / c.n_frames for c in comparisons])
    )
    effect = float(np.median([c.design_effect for c in comparisons]))
    return minimum_detectable_difference(
        comparisons[0].n_frames / effect, discordant, level / len(comparisons), power
    )  # fmt: skip
