"""Bootstrap of whole clusters: frames of one site and night share weather and sky, so they are drawn together.

Intervals are percentile intervals whose levels are widened for few clusters (Hesterberg's expanded percentiles). Statistics
must be functions of weighted frames; sums and quantiles are computed for all resamples at once.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from benchmark.stats.intervals import CONFIDENCE, Estimate, pooled_proportion, quantile, wilson

F8 = NDArray[np.float64]

N_RESAMPLES = 2000
SEED = 20260301
FEWEST_CLUSTERS = 6
"""With fewer clusters, all are on one side of a median with a probability above 5 %: quantiles then get no interval."""
_CHUNK_ELEMENTS = 4_000_000
_CACHED_ELEMENTS = 250_000
"""Size of the pieces of arrays that are processed element by element: they fit into a core's cache."""
_BLOCK_FRAMES = 1024


@dataclass(frozen=True, eq=False)
class Resamples:
    """Resamples of clusters, drawn with replacement.

    Attributes
    ----------
    cluster : ndarray of int, shape (n_frames,)
        Cluster of each frame, 0 to n_clusters - 1.
    n_clusters : int
    n_resamples : int
    seed : int
        The same clusters and seed give the same resamples, so that paired statistics share them.
    """

    cluster: NDArray[np.intp]
    n_clusters: int
    n_resamples: int = N_RESAMPLES
    seed: int = SEED

    @classmethod
    def of(cls, clusters: ArrayLike, n_resamples: int = N_RESAMPLES, seed: int = SEED) -> Resamples:
        """Make resamples of the clusters to which frames belong.

        Parameters
        ----------
        clusters : array_like, shape (n_frames,)
            Name of each frame's cluster, of any sortable type.
        n_resamples, seed : int
        """
        names, cluster = np.unique(np.asarray(clusters), return_inverse=True)
        return cls(cluster.astype(np.intp), len(names), n_resamples, seed)

    @property
    def weights(self) -> NDArray[np.uint8]:
        """Number of times that each resample contains each cluster, shape (n_resamples, n_clusters)."""
        return _weights(self.n_clusters, self.n_resamples, self.seed)

    def sums(self, values: ArrayLike) -> F8:
        """Sum of per-frame values, shape (n_frames,) or (n_frames, k), in each resample."""
        x = np.asarray(values, dtype=np.float64)
        columns = x.reshape(len(x), -1).T
        by_cluster = np.stack([np.bincount(self.cluster, weights=one, minlength=self.n_clusters) for one in columns])
        return self.cluster_sums(np.asarray(by_cluster.T, dtype=np.float64)).reshape(self.n_resamples, *x.shape[1:])

    def cluster_sums(self, by_cluster: F8) -> F8:
        """Sum of per-cluster values, shape (n_clusters, k), in each resample, shape (n_resamples, k)."""
        parts = self._chunks(self.n_clusters, _CHUNK_ELEMENTS)
        return np.concatenate([part.astype(np.float64) @ by_cluster for part in parts])

    def frame_weights(self, order: NDArray[np.intp], function: Callable[[NDArray[np.uint8]], F8]) -> F8:
        """Apply `function` to the weights of frames in `order`, shape (chunk, n), in chunks that bound the memory."""
        cluster = self.cluster[order]
        parts = self._chunks(len(order), _CACHED_ELEMENTS)
        return np.concatenate([function(np.take(part, cluster, axis=1)) for part in parts])

    def _chunks(self, width: int, most: int) -> Iterator[NDArray[np.uint8]]:
        step = max(1, most // max(width, 1))
        for start in range(0, self.n_resamples, step):
            yield self.weights[start : start + step]

    def quantiles(self, values: ArrayLike, q: float) -> F8:
        """Quantile of per-frame values (+inf allowed) in each resample, as defined by `intervals.quantile`."""
        x = np.asarray(values, dtype=np.float64)
        order = np.argsort(x, kind="stable")
        ordered, cluster = x[order], self.cluster[order]
        reached = self._weight_after_blocks(cluster)
        target = q * reached[:, -1]
        # Where the weight equals the target exactly, the value is the mean of this frame's and the next one's.
        least = np.ceil(target - 1e-9).astype(np.int64)
        most = np.floor(target + 1e-9).astype(np.int64) + 1
        everywhere, apart = np.arange(self.n_resamples), np.flatnonzero(most > least)
        lower = self._first_reaching(cluster, reached, everywhere, least)
        upper = lower.copy()
        upper[apart] = self._first_reaching(cluster, reached, apart, most[apart])
        return np.asarray((ordered[lower] + ordered[upper]) / 2.0)

    def _weight_after_blocks(self, cluster: NDArray[np.intp]) -> NDArray[np.int64]:
        """Frames in each resample up to the end of each block of the ordered frames, shape (n_resamples, n_blocks)."""
        n_blocks = -(-len(cluster) // _BLOCK_FRAMES)
        place = cluster * n_blocks + np.arange(len(cluster)) // _BLOCK_FRAMES
        counts = np.bincount(place, minlength=self.n_clusters * n_blocks).reshape(self.n_clusters, n_blocks)
        return np.cumsum(self.cluster_sums(counts.astype(np.float64)), axis=1).astype(np.int64)

    def _first_reaching(
        self,
        cluster: NDArray[np.intp],
        reached: NDArray[np.int64],
        rows: NDArray[np.intp],
        count: NDArray[np.int64],
    ) -> NDArray[np.intp]:
        """First of the ordered frames at which each of some resamples (`rows`) has `count` frames."""
        block = (reached[rows] < count[:, None]).sum(axis=1)
        left = count - np.where(block > 0, reached[rows, block - 1], 0)
        found = np.empty(len(rows), dtype=np.intp)
        for one in np.unique(block):
            here, start = np.flatnonzero(block == one), one * _BLOCK_FRAMES
            weights = self.weights[np.ix_(rows[here], cluster[start : start + _BLOCK_FRAMES])]
            cumulated = np.cumsum(weights, axis=1, dtype=np.int32)
            found[here] = start + (cumulated < left[here, None]).sum(axis=1)
        return found


@lru_cache(maxsize=4)
def _weights(n_clusters: int, n_resamples: int, seed: int) -> NDArray[np.uint8]:
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(n_clusters,)))
    found = np.empty((n_resamples, n_clusters), dtype=np.uint8)
    step = max(1, _CHUNK_ELEMENTS // max(n_clusters, 1))
    for start in range(0, n_resamples, step):
        rows = min(step, n_resamples - start)
        # A cluster is drawn about once (Poisson distribution), and practically never 255 times.
        drawn = rng.integers(0, max(n_clusters, 1), (rows, n_clusters))
        drawn += n_clusters * np.arange(rows)[:, None]
        counts = np.bincount(drawn.ravel(), minlength=rows * n_clusters)
        found[start : start + rows] = counts.reshape(rows, n_clusters)
    found.flags.writeable = False
    return found


@lru_cache(maxsize=64)
def expanded_levels(n_clusters: int, confidence: float = CONFIDENCE) -> tuple[float, float]:
    """Percentile levels that give the interval the width of a t interval instead of a normal one without n/(n - 1).

    References
    ----------
    T. C. Hesterberg, The American Statistician 69, 371-386, 2015, section 4.4 (expanded percentile interval).
    """
    t = float(stats.t.ppf(0.5 + confidence / 2.0, n_clusters - 1))
    low = float(stats.norm.cdf(-math.sqrt(n_clusters / (n_clusters - 1.0)) * t))
    return low, 1.0 - low


def percentile_interval(
    replicates: ArrayLike,
    n_clusters: int,
    bounds: tuple[float, float] = (-math.inf, math.inf),
    confidence: float = CONFIDENCE,
) -> tuple[float, float]:
    """Interval of a statistic from its bootstrap replicates.

    Parameters
    ----------
    replicates : array_like, shape (n_resamples,)
        Infinite values are allowed; NaN (a resample in which the statistic is undefined) is left out.
    n_clusters : int
        With fewer than 2 nothing is known, and the interval is `bounds`.
    bounds : tuple of float
        Range of the statistic. Where all clusters agree, resamples carry no information about clusters that were not drawn: a
        share of z^2 / (n + z^2) of them (Wilson's bound for 0 of n) may be at either end of a finite range.
    """
    x = np.asarray(replicates, dtype=np.float64)
    x = x[~np.isnan(x)]
    if n_clusters < 2 or len(x) == 0:
        return bounds
    if (x == x[0]).all() and all(math.isfinite(end) for end in bounds):
        unseen = wilson(0.0, n_clusters, confidence)[1]
        return float(x[0] + unseen * (bounds[0] - x[0])), float(x[0] + unseen * (bounds[1] - x[0]))
    low, high = expanded_levels(n_clusters, confidence)
    return (
        max(bounds[0], float(np.quantile(x, low, method="lower"))),
        min(bounds[1], float(np.quantile(x, high, method="higher"))),
    )


def mean_estimate(
    values: ArrayLike, resamples: Resamples, bounds: tuple[float, float] = (-math.inf, math.inf)
) -> Estimate:
    """Mean of per-frame values; NaN values are ignored."""
    return mean_estimates(np.asarray(values, dtype=np.float64)[:, None], resamples, bounds)[0]


def mean_estimates(
    values: F8, resamples: Resamples, bounds: tuple[float, float] = (-math.inf, math.inf)
) -> list[Estimate]:
    """Means of per-frame values, shape (n_frames, k), each as in `mean_estimate`, all on the same resamples."""
    known = ~np.isnan(values)
    if known.all():
        return _ratio_estimates(values, np.ones((len(values), 1)), resamples, bounds)
    return _ratio_estimates(np.where(known, values, 0.0), known.astype(np.float64), resamples, bounds)


def _ratio_estimates(top: F8, bottom: F8, resamples: Resamples, bounds: tuple[float, float]) -> list[Estimate]:
    """Ratios of sums over frames, shapes (n_frames, k) and (n_frames, k or 1); NaN where a denominator is empty."""
    k = top.shape[1]
    sums = resamples.sums(np.column_stack((top, bottom)))
    over, under = sums[:, :k], sums[:, k:]
    with np.errstate(invalid="ignore", divide="ignore"):
        replicates = np.where(under > 0, over / under, np.nan)
        # Summed over rows of the transpose, so that rounding equals that of a sum over one column alone.
        values = np.ascontiguousarray(top.T).sum(axis=1) / np.ascontiguousarray(bottom.T).sum(axis=1)
    counts = np.broadcast_to(np.count_nonzero(bottom, axis=0), k)
    return [
        Estimate(value, *percentile_interval(column, resamples.n_clusters, bounds), n=n)
        if n
        else Estimate(math.nan, math.nan, math.nan, 0)
        for value, column, n in zip(values.tolist(), replicates.T, counts.tolist(), strict=True)
    ]


def proportion_estimate(successes: ArrayLike, trials: ArrayLike, resamples: Resamples) -> Estimate:
    """Proportion of successes among trials, with Wilson's interval for the effective size of clustered trials.

    A percentile bootstrap of a proportion is too short near 0 and 1, where resamples agree with each other. The effective
    sample size of `intervals.pooled_proportion`, with the cluster as the unit, avoids this.

    Parameters
    ----------
    successes, trials : array_like, shape (n_frames,)
        Counts per frame (0 or 1 for a property of frames).

    Returns
    -------
    Estimate
        `n` is the number of frames that have a trial.
    """
    k, m = np.asarray(successes, dtype=np.float64), np.asarray(trials, dtype=np.float64)
    successes_of, trials_of = (
        np.bincount(resamples.cluster, weights=x, minlength=resamples.n_clusters) for x in (k, m)
    )
    found = pooled_proportion(successes_of, trials_of)
    return Estimate(found.value, found.low, found.high, int(np.count_nonzero(m)))


def quantile_estimate(values: ArrayLike, q: float, resamples: Resamples) -> Estimate:
    """Quantile of non-negative values (+inf allowed) with its clustered bootstrap interval; NaN values are ignored."""
    x = np.asarray(values, dtype=np.float64)
    known = ~np.isnan(x)
    if not known.any():
        return Estimate(math.nan, math.nan, math.nan, 0)
    part = resamples
    if not known.all():
        part = Resamples.of(resamples.cluster[known], resamples.n_resamples, resamples.seed)
    n, tail = int(known.sum()), (1.0 - CONFIDENCE) / 2.0
    low, high = percentile_interval(part.quantiles(x[known], q), part.n_clusters, (0.0, math.inf))
    few = part.n_clusters < FEWEST_CLUSTERS
    # Even with independent frames, all may be on one side of the quantile.
    low, high = 0.0 if few or (1.0 - q) ** n > tail else low, math.inf if few or q**n > tail else high
    return Estimate(quantile(x[known], q), low, high, n)
