"""Effects of a perturbation on a solver: success, error over bound, NEES and ellipses, before and after, frame by frame."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy import stats

from benchmark.stats.clustered import mean_estimate
from benchmark.stats.comparison import compare, difference_estimate, paired
from benchmark.stats.covariance import NEES_DIMENSIONS, ellipse_coverage, nees_of_identified, nees_values
from benchmark.stats.frame_metrics import (
    UNDEFINED,
    bound_ratio_of_identified,
    column,
    identified,
    resamples_of,
    success,
)
from benchmark.stats.intervals import Estimate

F8 = NDArray[np.float64]

LEVEL = 0.05
ELLIPSE = 0.95


@dataclass(frozen=True)
class Change:
    """A number before and after, and the paired difference (for an error over bound: the ratio) with its interval."""

    before: Estimate
    after: Estimate
    change: Estimate


@dataclass(frozen=True)
class Effect:
    """Effect of one perturbation on one solver.

    Attributes
    ----------
    perturbation, solver : str
    success : Change
        Share of frames within 10 km, and the difference.
    bound_ratio : Change
        Median of the error over the bound over identified fixes, and the geometric mean of the ratio of errors on the frames
        on which both have a fix.
    nees, ellipse : Change
        NEES, and share of identified fixes whose 95 % ellipse contains the truth; also the mean difference over frames that
        are identified in both.
    success_p, error_p : float
        P-values of McNemar's test and of a sign-flip test of the errors, adjusted by Holm over all perturbations and solvers.
    """

    perturbation: str
    solver: str
    success: Change
    bound_ratio: Change
    nees: Change
    ellipse: Change
    success_p: float
    error_p: float

    @property
    def words(self) -> str:
        """What is significant at the 5 % level of the whole family."""
        found = []
        if self.success_p <= LEVEL:
            found.append(f"success {'falls' if self.success.change.value < 0 else 'rises'}")
        if self.error_p <= LEVEL:
            found.append(f"error {'grows' if self.bound_ratio.change.value > 1 else 'shrinks'}")
        return ", ".join(found) or "none shown"


Tables = Mapping[str, pd.DataFrame]


def effects_of(before: Tables, after: Mapping[str, Tables]) -> tuple[Effect, ...]:
    """Compute effects of perturbations on solvers.

    Parameters
    ----------
    before : mapping of str to DataFrame
        Tables of frames by solver, without perturbation.
    after : mapping of str to mapping
        The same, by perturbation.

    Raises
    ------
    ResultsError
        The tables are not of the same frames.
    """
    tables = {f"/{solver}": table for solver, table in before.items()}
    tables |= {f"{key}/{solver}": table for key, found in after.items() for solver, table in found.items()}
    pairs = [(f"{key}/{solver}", f"/{solver}") for key, found in after.items() for solver in found]
    effects = []
    for pair in compare(tables, pairs=pairs):
        key, _, solver = pair.first.partition("/")
        unperturbed, perturbed = paired(before[solver], after[key][solver])
        effects.append(
            Effect(
                key,
                solver,
                Change(_of(unperturbed, success), _of(perturbed, success), pair.difference),
                Change(
                    _of(unperturbed, bound_ratio_of_identified),
                    _of(perturbed, bound_ratio_of_identified),
                    pair.error_ratio,
                ),
                _nees_change(unperturbed, perturbed),
                _ellipse_change(unperturbed, perturbed),
                pair.success_p_holm,
                pair.error_p_holm,
            )
        )
    return tuple(effects)


def _of(table: pd.DataFrame, metric: Callable[..., Estimate]) -> Estimate:
    return metric(table, resamples_of(table))


def _nees_change(before: pd.DataFrame, after: pd.DataFrame) -> Change:
    known = _identified_in_both(before, after)
    gap = np.where(known, nees_values(after) - nees_values(before), math.nan)
    finite = known.any() and bool(np.isfinite(gap[known]).all())
    change = mean_estimate(gap, resamples_of(before)) if finite else UNDEFINED
    return Change(_of(before, nees_of_identified), _of(after, nees_of_identified), change)


def _ellipse_change(before: pd.DataFrame, after: pd.DataFrame) -> Change:
    known = _identified_in_both(before, after)
    change = UNDEFINED
    values, values_before = (nees_values(table)[known] for table in (after, before))
    if not np.isnan(values).all() and not np.isnan(values_before).all():
        limit = float(stats.chi2.ppf(ELLIPSE, NEES_DIMENSIONS))
        inside, inside_before = values <= limit, values_before <= limit
        gap = inside.astype(np.float64) - inside_before.astype(np.float64)
        change = difference_estimate(gap, column(before[known], "condition"), resamples_of(before[known]))
    return Change(_ellipse(before[identified(before)]), _ellipse(after[identified(after)]), change)


def _ellipse(right: pd.DataFrame) -> Estimate:
    return _of(right, ellipse_coverage) if len(right) else UNDEFINED


def _identified_in_both(before: pd.DataFrame, after: pd.DataFrame) -> NDArray[np.bool_]:
    """Frames whose stars are identified in both."""
    return np.asarray(identified(before) & identified(after))
