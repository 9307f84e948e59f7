"""How well twins predict photographs: rankings of solvers, outcomes frame by frame, ratios of errors.

The statistics are Kendall's tau-b (Kendall, Biometrika 33, 239-251, 1945), which allows ties, and Cohen's kappa (Educational
and Psychological Measurement 20, 37-46, 1960). Intervals are percentiles of a bootstrap over frames, each drawn with all
solvers and with its twin. With few frames they are wide, and still too narrow by some tenths.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import kendalltau

from benchmark.stats.intervals import Estimate
from benchmark.stats.metrics import SUCCESS_KM
from generator.seeds import random_stream

Floats = NDArray[np.float64]

RESAMPLES = 2000
LEVELS = (2.5, 97.5)
LEAST_DEFINED = 0.5
"""Fraction of the resamples in which a statistic must be defined for an interval to be stated."""


@dataclass(frozen=True, eq=False)
class Outcomes:
    """Errors of solvers on photographs and on their twins.

    Attributes
    ----------
    solvers : tuple of str
        The m solvers.
    real_km, twin_km : (m, n) arrays
        Errors on n frames; infinite without a fix.
    """

    solvers: tuple[str, ...]
    real_km: Floats
    twin_km: Floats

    def frames(self, chosen: NDArray[np.intp]) -> Outcomes:
        """Select the outcomes on some of the frames, which may repeat."""
        return Outcomes(self.solvers, self.real_km[:, chosen], self.twin_km[:, chosen])


@dataclass(frozen=True)
class Agreement:
    """What the twins predict.

    Attributes
    ----------
    tau_success : Estimate
        Kendall's tau-b between the solvers' shares of success.
    tau_error : Estimate
        The same between their median errors over all frames, with a refusal as infinite. Solvers whose medians are infinite
        on both are tied on both, which counts as agreement with all others.
    tau_error_finite : Estimate
        The same among the solvers whose medians are finite on both.
    n_finite : int
        Number of these solvers.
    same_outcome : Estimate
        Share of pairs of solver and frame with success on both or on neither.
    kappa : Estimate
        The same agreement beyond chance.
    error_ratio : Estimate
        Median ratio of the error on a photograph to that on its twin, for successes on both.
    swapped : int
        Pairs of solvers of which one succeeds more often on photographs, and the other on twins.
    """

    tau_success: Estimate
    tau_error: Estimate
    tau_error_finite: Estimate
    n_finite: int
    same_outcome: Estimate
    kappa: Estimate
    error_ratio: Estimate
    swapped: int


def agreement_of(outcomes: Outcomes) -> Agreement:
    """Compare the outcomes on photographs and on twins."""
    return Agreement(
        tau_success=_estimate(outcomes, tau_success),
        tau_error=_estimate(outcomes, tau_error),
        tau_error_finite=_estimate(outcomes, tau_error_finite),
        n_finite=int(_finite(*_median_errors(outcomes)).sum()),
        same_outcome=_estimate(outcomes, same_outcome),
        kappa=_estimate(outcomes, kappa),
        error_ratio=_estimate(outcomes, error_ratio),
        swapped=swapped_pairs(outcomes),
    )


def successes(errors_km: Floats) -> NDArray[np.bool_]:
    """Which errors count as success."""
    return np.asarray(errors_km < SUCCESS_KM)


def tau_success(outcomes: Outcomes) -> float:
    """Kendall's tau-b between shares of success; NaN where all solvers of one set are equal."""
    return _tau(successes(outcomes.real_km).mean(axis=1), successes(outcomes.twin_km).mean(axis=1))


def tau_error(outcomes: Outcomes) -> float:
    """Kendall's tau-b between median errors over all frames."""
    return _tau(*_median_errors(outcomes))


def tau_error_finite(outcomes: Outcomes) -> float:
    """Kendall's tau-b between median errors, among the solvers with a finite one on both; NaN for fewer than two."""
    real, twin = _median_errors(outcomes)
    finite = _finite(real, twin)
    return _tau(real[finite], twin[finite])


def _median_errors(outcomes: Outcomes) -> tuple[Floats, Floats]:
    """Lower of the two middle values, shape (m,) each, because their mean would be infinite if one of them is."""
    middle = (outcomes.real_km.shape[1] - 1) // 2
    return np.sort(outcomes.real_km, axis=1)[:, middle], np.sort(outcomes.twin_km, axis=1)[:, middle]


def _finite(real: Floats, twin: Floats) -> NDArray[np.bool_]:
    return np.asarray(np.isfinite(real) & np.isfinite(twin))


def same_outcome(outcomes: Outcomes) -> float:
    """Share of pairs of solver and frame with the same outcome."""
    return float(np.mean(successes(outcomes.real_km) == successes(outcomes.twin_km)))


def kappa(outcomes: Outcomes) -> float:
    """Cohen's kappa of success; NaN where chance alone makes all outcomes equal."""
    real, twin = successes(outcomes.real_km), successes(outcomes.twin_km)
    chance = float(real.mean() * twin.mean() + (1 - real.mean()) * (1 - twin.mean()))
    return math.nan if chance >= 1.0 else (same_outcome(outcomes) - chance) / (1.0 - chance)


def error_ratio(outcomes: Outcomes) -> float:
    """Median ratio of errors, photograph over twin, for successes on both; NaN where there are none."""
    both = successes(outcomes.real_km) & successes(outcomes.twin_km)
    if not both.any():
        return math.nan
    return float(np.exp(np.median(np.log(outcomes.real_km[both] / outcomes.twin_km[both]))))


def swapped_pairs(outcomes: Outcomes) -> int:
    """Number of pairs of solvers whose order by success is reversed on twins."""
    real, twin = (successes(errors).sum(axis=1) for errors in (outcomes.real_km, outcomes.twin_km))
    ahead_real = np.sign(real[:, None] - real[None, :])
    ahead_twin = np.sign(twin[:, None] - twin[None, :])
    return int(np.count_nonzero(ahead_real * ahead_twin < 0) // 2)


def _tau(one: Floats, other: Floats) -> float:
    # Ranks instead of infinite values, whose differences are undefined.
    ranks = [np.unique(values, return_inverse=True)[1] for values in (one, other)]
    if any(rank.max(initial=0) == 0 for rank in ranks):
        return math.nan
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        return float(kendalltau(*ranks).statistic)


def _estimate(outcomes: Outcomes, statistic: Callable[[Outcomes], float]) -> Estimate:
    """A statistic with its bootstrap interval over frames; an undefined one gets the widest interval."""
    n = outcomes.real_km.shape[1]
    rng = random_stream(0, "study:realism", 0)
    drawn = np.array([statistic(outcomes.frames(np.asarray(rng.integers(0, n, n), np.intp))) for _ in range(RESAMPLES)])
    defined = drawn[np.isfinite(drawn)]
    low, high = np.percentile(defined, LEVELS) if len(defined) >= LEAST_DEFINED * RESAMPLES else (math.nan, math.nan)
    return Estimate(statistic(outcomes), float(low), float(high), n)
