"""Tests for two solvers on the same frames, and for many such comparisons at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats


@dataclass(frozen=True)
class PairedTest:
    """McNemar's exact test.

    Attributes
    ----------
    n : int
        Frames.
    only_first, only_second : int
        Frames on which one solver succeeds and the other fails; the others say nothing about a difference.
    p : float
        Two-sided.
    """

    n: int
    only_first: int
    only_second: int
    p: float


def mcnemar_exact(first: Sequence[bool] | NDArray[np.bool_], second: Sequence[bool] | NDArray[np.bool_]) -> PairedTest:
    """Test whether two solvers succeed equally often on the same frames.

    Under the null hypothesis a frame that only one of them solves is as likely the one's as the other's, so that the
    smaller count is binomial with probability one half.

    Parameters
    ----------
    first, second : sequence of bool, shape (n,)
        Successes, frame by frame.

    Raises
    ------
    ValueError
        The two differ in length.

    References
    ----------
    Q. McNemar, Psychometrika 12, 153-157, 1947. A. Agresti, Categorical Data Analysis, 3rd ed., 2013, section 11.1.
    """
    a, b = np.asarray(first, dtype=bool), np.asarray(second, dtype=bool)
    if a.shape != b.shape or a.ndim != 1:
        raise ValueError(f"a paired test needs two lists of one length, found {a.shape} and {b.shape}")
    only_first, only_second = int(np.count_nonzero(a & ~b)), int(np.count_nonzero(b & ~a))
    discordant = only_first + only_second
    p = min(1.0, 2.0 * float(stats.binom.cdf(min(only_first, only_second), discordant, 0.5))) if discordant else 1.0
    return PairedTest(len(a), only_first, only_second, p)


def holm(p_values: Sequence[float]) -> tuple[float, ...]:
    """Adjust p-values so that the probability of any false rejection among them keeps its level.

    The smallest is multiplied by their number, the next by one less, and so on; none is smaller than one before it.

    References
    ----------
    S. Holm, Scandinavian Journal of Statistics 6, 65-70, 1979.
    """
    if any(not 0.0 <= p <= 1.0 for p in p_values):
        raise ValueError("p-values lie between 0 and 1")
    adjusted = [1.0] * len(p_values)
    largest = 0.0
    for rank, place in enumerate(sorted(range(len(p_values)), key=lambda i: p_values[i])):
        largest = max(largest, min(1.0, (len(p_values) - rank) * p_values[place]))
        adjusted[place] = largest
    return tuple(adjusted)
