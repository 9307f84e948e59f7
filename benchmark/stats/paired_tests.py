"""Tests for two solvers on the same frames, and for many such comparisons at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

_CHUNK_ELEMENTS = 4_000_000


@dataclass(frozen=True)
class PairedTest:
    """McNemar's exact test.

    Attributes
    ----------
    n : int
        Frames.
    only_first, only_second : int
        Frames on which one solver succeeds and the other fails; the others carry no information about a difference.
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


def mcnemar_clustered(
    first: Sequence[bool] | NDArray[np.bool_],
    second: Sequence[bool] | NDArray[np.bool_],
    clusters: ArrayLike,
) -> PairedTest:
    """McNemar's exact test for frames that come in clusters.

    Frames of one site tend to favour the same solver, so they are no independent evidence. Under the null hypothesis
    the two solvers can change places at a whole site: the difference of successes at each site keeps its size and
    takes either sign with probability one half. The distribution of the sum is worked out exactly. With one frame a
    site this is `mcnemar_exact`.

    Parameters
    ----------
    first, second : sequence of bool, shape (n,)
        Successes, frame by frame.
    clusters : array_like, shape (n,)
        Each frame's site.

    References
    ----------
    V. L. Durkalski, Y. Y. Palesch, S. R. Lipsitz, P. F. Rust, Statistics in Medicine 22, 2417-2428, 2003 (McNemar's
    test with clusters, of which this is the exact permutation form); R. A. Fisher, The Design of Experiments, 1935,
    section 21 (the sign flips).
    """
    a, b = np.asarray(first, dtype=bool), np.asarray(second, dtype=bool)
    cluster = np.unique(np.asarray(clusters), return_inverse=True)[1]
    if a.shape != b.shape or a.ndim != 1 or cluster.shape != a.shape:
        raise ValueError(f"a paired test needs lists of one length, found {a.shape}, {b.shape} and {cluster.shape}")
    only_first, only_second = int(np.count_nonzero(a & ~b)), int(np.count_nonzero(b & ~a))
    differences = np.bincount(cluster, weights=a.astype(np.float64) - b) if len(a) else np.empty(0)
    sizes = np.abs(differences).astype(np.int64)
    distribution = np.ones(1)  # of the sum, from minus to plus the sum of sizes, in steps of one
    for size, count in zip(*np.unique(sizes[sizes > 0], return_counts=True), strict=True):
        # `count` sites of one size: a binomial number of them favours the first, each change moves the sum by 2 sizes.
        spread = np.zeros(2 * size * count + 1)
        spread[:: 2 * size] = stats.binom.pmf(np.arange(count + 1), count, 0.5)
        distribution = np.convolve(distribution, spread)
    total = int(sizes.sum())
    extreme = abs(int(differences.sum()))
    sums = np.arange(-total, total + 1)
    p = min(1.0, float(distribution[np.abs(sums) >= extreme].sum()))
    return PairedTest(len(a), only_first, only_second, p)


def sign_flip(values: ArrayLike, clusters: ArrayLike, n_flips: int = 4999, seed: int = 20260302) -> float:
    """Two-sided p-value of the hypothesis that clusters of values are symmetric about zero.

    The sums of whole clusters change their signs at random; the sum over all of them, in absolute value, is compared
    with that observed. The observed one counts among them, so that the level holds for any number of flips.

    Parameters
    ----------
    values : array_like, shape (n,)
    clusters : array_like, shape (n,)
    n_flips, seed : int

    References
    ----------
    B. Phipson, G. K. Smyth, Statistical Applications in Genetics and Molecular Biology 9, 39, 2010 (the count).
    """
    x = np.asarray(values, dtype=np.float64)
    if len(x) == 0:
        return 1.0
    cluster = np.unique(np.asarray(clusters), return_inverse=True)[1]
    sums = np.bincount(cluster, weights=x)
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(len(sums),)))
    # Rounding must not tell a flip of all signs from the observed sum.
    total = float(sums.sum())
    observed = abs(total) - 1e-12 * float(np.abs(sums).sum())
    extreme = 0
    step = max(1, _CHUNK_ELEMENTS // len(sums))
    for start in range(0, n_flips, step):
        flipped = rng.integers(0, 2, (min(step, n_flips - start), len(sums)), dtype=np.int8)
        extreme += int(np.count_nonzero(np.abs(total - 2.0 * (flipped.astype(np.float64) @ sums)) >= observed))
    return (1 + extreme) / (n_flips + 1)


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
