"""Tests of two solvers on the same frames, and adjustment for many such comparisons."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

F8 = NDArray[np.float64]

N_FLIPS = 4999
FLIP_SEED = 20260302
_DRAWN_ELEMENTS = 4_000_000
_FLIPPED_ELEMENTS = 100_000
"""Number of values that are converted and summed at a time, so that they fit into a core's cache."""


@dataclass(frozen=True)
class PairedTest:
    """McNemar's exact test.

    Attributes
    ----------
    n : int
        Number of frames.
    only_first, only_second : int
        Frames on which one solver succeeds and the other fails; the others carry no information about a difference.
    p : float
        Two-sided p-value.
    """

    n: int
    only_first: int
    only_second: int
    p: float


def mcnemar_exact(first: Sequence[bool] | NDArray[np.bool_], second: Sequence[bool] | NDArray[np.bool_]) -> PairedTest:
    """Test whether two solvers succeed equally often on the same frames.

    Under the null hypothesis, a frame that only one of them solves is equally likely to be solved by either, so the smaller
    count is binomial with probability one half.

    Parameters
    ----------
    first, second : sequence of bool, shape (n,)
        Success on each frame.

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

    Frames of one site tend to favour the same solver, so they are not independent evidence. Under the null hypothesis the two
    solvers can be exchanged at a whole site: the difference of successes at each site keeps its size and takes either sign
    with probability one half. The distribution of the sum is computed exactly. With one frame per site this is
    `mcnemar_exact`.

    Parameters
    ----------
    first, second : sequence of bool, shape (n,)
        Successes, frame by frame.
    clusters : array_like, shape (n,)
        Site of each frame.

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
        # Of `count` sites of one size a binomial number favours the first solver; each of them moves the sum by 2 sizes.
        spread = np.zeros(2 * size * count + 1)
        spread[:: 2 * size] = stats.binom.pmf(np.arange(count + 1), count, 0.5)
        distribution = np.convolve(distribution, spread)
    total = int(sizes.sum())
    extreme = abs(int(differences.sum()))
    sums = np.arange(-total, total + 1)
    p = min(1.0, float(distribution[np.abs(sums) >= extreme].sum()))
    return PairedTest(len(a), only_first, only_second, p)


def sign_flip(values: ArrayLike, clusters: ArrayLike, n_flips: int = N_FLIPS, seed: int = FLIP_SEED) -> float:
    """Two-sided p-value of the hypothesis that clusters of values are symmetric about zero.

    The sums of whole clusters change their signs at random; the absolute sum over all of them is compared with the observed
    one. The observed one counts as one of the flips, so that the level holds for any number of flips.

    Parameters
    ----------
    values : array_like, shape (n,)
    clusters : array_like, shape (n,)
    n_flips, seed : int

    References
    ----------
    B. Phipson, G. K. Smyth, Statistical Applications in Genetics and Molecular Biology 9, 39, 2010 (the count).
    """
    return sign_flips([sums_by_cluster(values, clusters)], n_flips, seed)[0]


def sums_by_cluster(values: ArrayLike, clusters: ArrayLike) -> F8:
    """Sum of the values of each cluster that has any, shape (n_clusters,), in the order of their names."""
    names, cluster = np.unique(np.asarray(clusters), return_inverse=True)
    return np.bincount(cluster, weights=np.asarray(values, dtype=np.float64), minlength=len(names)).astype(np.float64)


def sign_flips(sums: Sequence[F8], n_flips: int = N_FLIPS, seed: int = FLIP_SEED) -> list[float]:
    """P-values, as by `sign_flip`, of many sets of clusters given by their sums; sets of equal size share the flips."""
    alike: defaultdict[int, list[int]] = defaultdict(list)
    for place, one in enumerate(sums):
        alike[len(one)].append(place)
    found = np.ones(len(sums))
    for n_clusters, places in alike.items():
        if n_clusters:
            found[places] = _flipped_alike(np.stack([sums[place] for place in places]), n_flips, seed)
    return [float(p) for p in found]


def _flipped_alike(sums: F8, n_flips: int, seed: int) -> F8:
    """P-values of sets with equal numbers of clusters, shape (n_sets, n_clusters)."""
    # Rounding must not make a flip of all signs differ from the observed sum.
    total = sums.sum(axis=1)
    observed = np.abs(total) - 1e-12 * np.abs(sums).sum(axis=1)
    extreme = np.zeros(len(sums), dtype=np.int64)
    for flipped in _flips(sums.shape[1], n_flips, seed):
        extreme += np.count_nonzero(np.abs(total - 2.0 * (flipped @ sums.T)) >= observed, axis=0)
    return np.asarray((1 + extreme) / (n_flips + 1))


def _flips(n_clusters: int, n_flips: int, seed: int) -> Iterator[F8]:
    """Yield which clusters change their sign in each flip, 0 or 1, shape (n, n_clusters), in pieces that bound the memory."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(n_clusters,)))
    drawn, step = max(1, _DRAWN_ELEMENTS // n_clusters), max(1, _FLIPPED_ELEMENTS // n_clusters)
    for start in range(0, n_flips, drawn):
        count = min(drawn, n_flips - start) * n_clusters
        # The first bit of each byte of whole words: what `integers(0, 2, dtype=int8)` draws, but several times as fast.
        words = rng.integers(0, 2**32, -(-count // 4), dtype=np.uint32)
        flips = (words.astype("<u4", copy=False).view(np.uint8)[:count] >> 7).reshape(-1, n_clusters)
        for first in range(0, len(flips), step):
            yield flips[first : first + step].astype(np.float64)


def holm(p_values: Sequence[float]) -> tuple[float, ...]:
    """Adjust p-values so that the probability of any false rejection among them keeps its level.

    The smallest is multiplied by their number, the next by one less, and so on; no adjusted value is below the one before it.

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
