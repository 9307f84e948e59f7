"""Calibration of a solver's confidence: reliability diagram, expected calibration error, risk-coverage curve.

All functions take a table of frames.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy import stats

from benchmark.stats.clustered import Resamples, expanded_levels, percentile_interval, proportion_estimate
from benchmark.stats.frame_metrics import UNDEFINED, Metric, column, fixed, resamples_of, succeeded
from benchmark.stats.intervals import CONFIDENCE, Estimate
from benchmark.stats.metrics import SUCCESS_KM

F8 = NDArray[np.float64]
Bools = NDArray[np.bool_]

RELIABILITY_BINS = 10
_GAP_FACTORS = np.linspace(0.0, 1.0, 41)


@dataclass(frozen=True)
class ReliabilityBin:
    """Fixes with similar confidence.

    Attributes
    ----------
    low, high : float
        Edges of the bin; it holds low < confidence <= high, and the first bin also holds 0.
    n : int
        Number of fixes in the bin.
    confidence : float
        Their mean confidence.
    success : Estimate
        Share of them with an error below the limit of success.
    """

    low: float
    high: float
    n: int
    confidence: float
    success: Estimate


@dataclass(frozen=True, eq=False)
class RiskCoverage:
    """Risk as more and more frames are accepted, in order of decreasing confidence.

    Attributes
    ----------
    coverage : ndarray, shape (n,)
        Share of all frames accepted, ascending to 1.
    risk : ndarray, shape (n,)
        Share of the accepted frames that are wrong. Refused frames are accepted last and count as wrong.
    n_fixes : int
        Number of frames with a fix: the part of the curve that the solver itself would answer.
    n_confidences : int
        Number of different confidences among them; with fewer than two, they do not distinguish frames.
    area : Estimate
        Area under the curve, which is the mean risk over all coverages; 0 is perfect.
    """

    coverage: F8
    risk: F8
    n_fixes: int
    n_confidences: int
    area: Estimate


def _confident(frames: pd.DataFrame) -> tuple[F8, Bools]:
    confidence = column(frames, "confidence")
    return confidence, fixed(frames) & ~np.isnan(confidence)


def _bins(confidence: F8, n_bins: int) -> NDArray[np.intp]:
    return np.clip(np.ceil(confidence * n_bins).astype(np.intp) - 1, 0, n_bins - 1)


def reliability(
    frames: pd.DataFrame, n_bins: int = RELIABILITY_BINS, limit_km: float = SUCCESS_KM
) -> tuple[ReliabilityBin, ...]:
    """Success against confidence, in bins of equal width; empty bins are omitted.

    References
    ----------
    C. Guo, G. Pleiss, Y. Sun, K. Q. Weinberger, "On Calibration of Modern Neural Networks", ICML 2017, section 2;
    A. H. Murphy and R. L. Winkler, Applied Statistics 26, 41-47, 1977 (the diagram).
    """
    confidence, known = _confident(frames)
    part = frames[known]
    confidence, right = confidence[known], succeeded(part, limit_km)
    place = _bins(confidence, n_bins)
    found = []
    for i in np.unique(place):
        inside = place == i
        share = proportion_estimate(right[inside], np.ones(inside.sum()), resamples_of(part[inside]))
        found.append(
            ReliabilityBin(i / n_bins, (i + 1) / n_bins, int(inside.sum()), float(confidence[inside].mean()), share)
        )
    return tuple(found)


def expected_calibration_error(confidence: F8, success: Bools, n_bins: int = RELIABILITY_BINS) -> float:
    """Mean distance between confidence and success over the bins of `reliability`, weighted by the number of fixes.

    Parameters
    ----------
    confidence : ndarray, shape (n,)
        0 to 1.
    success : ndarray of bool, shape (n,)

    Returns
    -------
    float
        NaN without fixes.

    References
    ----------
    M. P. Naeini, G. F. Cooper, M. Hauskrecht, AAAI 2015, 2901-2907; Guo et al. 2017, equation 3.
    """
    if len(confidence) == 0:
        return math.nan
    gaps = np.bincount(_bins(confidence, n_bins), weights=success - confidence, minlength=n_bins)
    return float(np.abs(gaps).sum()) / len(confidence)


def calibration_error(
    frames: pd.DataFrame, resamples: Resamples, n_bins: int = RELIABILITY_BINS, limit_km: float = SUCCESS_KM
) -> Estimate:
    """Expected calibration error over the fixes (`expected_calibration_error`) with its interval.

    The value is that of the sample, as is customary. Because it averages absolute gaps, it exceeds that of the solver, and
    the more so the fewer fixes a bin has. Its lower end is therefore found by test inversion: it is the smallest error, among
    solvers whose gaps are those of the sample times a factor, under which the sample's error would not be too improbable; the
    noise of the gaps is taken from the resamples. The upper end is not affected by the bias; it is as many standard
    deviations above the value as the t distribution gives.

    References
    ----------
    Guo et al. 2017, equation 3. J. Bröcker, Climate Dynamics 39, 655-667, 2012 (the bias). J. Carpenter, J. R.
    Statist. Soc. B 61, 159-172, 1999 (test inversion with the bootstrap).
    """
    confidence, known = _confident(frames)
    n = int(known.sum())
    if n == 0:
        return UNDEFINED
    right = succeeded(frames, limit_km)
    gap = np.where(known, right - np.nan_to_num(confidence), 0.0)
    place = _bins(np.nan_to_num(confidence), n_bins)
    sample = expected_calibration_error(confidence[known], right[known], n_bins)
    if resamples.n_clusters < 2:
        return Estimate(sample, 0.0, 1.0, n)
    by_bin = gap[:, None] * (place[:, None] == np.arange(n_bins))
    gaps = by_bin.sum(axis=0) / n
    sums = resamples.sums(np.column_stack((by_bin, known)))
    sums = sums[sums[:, -1] > 0]
    noise = sums[:, :-1] / sums[:, -1:] - gaps
    errors = np.abs(_GAP_FACTORS[:, None, None] * gaps + noise).sum(axis=2)
    at_least = (errors >= sample).mean(axis=1)
    low = _GAP_FACTORS[np.argmax(at_least >= expanded_levels(resamples.n_clusters)[0])]
    if not noise.any():
        return Estimate(sample, *percentile_interval([sample], resamples.n_clusters, (0.0, 1.0)), n=n)
    spread = float(stats.t.ppf(0.5 + CONFIDENCE / 2.0, resamples.n_clusters - 1)) * float(errors[-1].std(ddof=1))
    return Estimate(sample, sample * float(low), min(1.0, sample + spread), n)


def overconfidence(frames: pd.DataFrame, resamples: Resamples, limit_km: float = SUCCESS_KM) -> Estimate:
    """Mean confidence minus success over the fixes; positive for an overconfident solver.

    Independent of bins and unbiased.
    """
    confidence, known = _confident(frames)
    n = int(known.sum())
    if n == 0:
        return UNDEFINED
    gap = np.where(known, np.nan_to_num(confidence) - succeeded(frames, limit_km), 0.0)
    sums = resamples.sums(np.column_stack((gap, known)))
    replicates = sums[:, 0] / np.where(sums[:, 1] > 0, sums[:, 1], np.nan)
    low, high = percentile_interval(replicates, resamples.n_clusters, (-1.0, 1.0))
    return Estimate(float(gap.sum() / n), low, high, n)


def risk_coverage(frames: pd.DataFrame, limit_km: float = SUCCESS_KM) -> RiskCoverage:
    """Risk-coverage curve and its area; frames with equal confidence are accepted in random order, averaged over all orders.

    Fixes without a confidence come after all fixes that have one. Refused frames come last and count as wrong, so that the
    curve of every solver ends at coverage 1 and areas can be compared.

    References
    ----------
    R. El-Yaniv and Y. Wiener, JMLR 11, 1605-1641, 2010; Y. Geifman and R. El-Yaniv, "Selective Classification for
    Deep Neural Networks", NeurIPS 2017; Y. Geifman, G. Uziel, R. El-Yaniv, "Bias-Reduced Uncertainty Estimation for
    Deep Neural Classifiers", ICLR 2019 (the area).
    """
    wrong, order, block = _ranked(frames, limit_km)
    n = len(frames)
    if n == 0:
        return RiskCoverage(np.empty(0), np.empty(0), 0, 0, UNDEFINED)
    resamples = resamples_of(frames)

    wrong = wrong[order]

    def areas(weights: NDArray[np.uint8]) -> F8:
        return _curve(weights, wrong, block)[1]

    risk, area = _curve(np.ones((1, n), dtype=np.uint8), wrong, block)
    low, high = percentile_interval(resamples.frame_weights(order, areas), resamples.n_clusters, (0.0, 1.0))
    coverage = np.arange(1, n + 1) / n
    confidence, known = _confident(frames)
    return RiskCoverage(
        coverage,
        risk[0],
        int(fixed(frames).sum()),
        len(np.unique(confidence[known])),
        Estimate(float(area[0]), low, high, n),
    )


def _ranked(frames: pd.DataFrame, limit_km: float) -> tuple[NDArray[np.bool_], NDArray[np.intp], NDArray[np.intp]]:
    """Which frames are wrong; their order by decreasing confidence; where each block of equal ones starts in that order."""
    confidence, known = _confident(frames)
    rank = np.where(known, confidence, np.where(fixed(frames), -1.0, -2.0))
    order = np.argsort(-rank, kind="stable")
    block = np.flatnonzero(np.diff(rank[order], prepend=math.inf))
    return ~succeeded(frames, limit_km), order, block


def _curve(weights: NDArray[np.uint8], wrong: Bools, block: NDArray[np.intp]) -> tuple[F8, F8]:
    """Risk after each frame, shape (k, n), and its weighted mean, shape (k,), for k weightings of the ordered frames."""
    if len(block) == 0:
        return np.empty(weights.shape), np.full(len(weights), math.nan)
    accepted, bad = _cumulated(weights), _cumulated(weights * wrong)
    risk = bad[:, 1:] / np.maximum(accepted[:, 1:], 1)
    size = np.diff(np.append(block, len(wrong)))
    # Where all frames of a block of equals are right, or all are wrong, their order is irrelevant; elsewhere all orders are
    # averaged.
    share = np.add.reduceat(wrong, block, dtype=np.intp) / size
    mixed = (share > 0) & (share < 1)
    if mixed.any():
        size, start = size[mixed], block[mixed]
        inside, inside_bad = (sums[:, start + size] - sums[:, start] for sums in (accepted, bad))
        slope = np.repeat(inside_bad / np.maximum(inside, 1), size, axis=1)
        before, before_bad = (np.repeat(sums[:, start], size, axis=1) for sums in (accepted, bad))
        tied = np.flatnonzero(np.repeat(mixed, np.diff(np.append(block, len(wrong)))))
        after = accepted[:, tied + 1]
        risk[:, tied] = (before_bad + slope * (after - before)) / np.maximum(after, 1)
    return risk, (risk * weights).sum(axis=1) / accepted[:, -1]


def _cumulated(counts: NDArray[np.uint8]) -> NDArray[np.int32]:
    """Cumulative sums along rows, starting from zero, shape (k, n + 1)."""
    sums = np.zeros((len(counts), counts.shape[1] + 1), dtype=np.int32)
    np.cumsum(counts, axis=1, out=sums[:, 1:])
    return sums


def confidence_metrics_within(limit_km: float) -> tuple[Metric, ...]:
    """Metrics of the stated confidences; fixes count as right within the given limit, that of their task."""
    return (
        Metric("ece", "calibration error", "", -1, lambda f, r: calibration_error(f, r, limit_km=limit_km)),
        Metric("overconfidence", "overconfidence", "", 0, lambda f, r: overconfidence(f, r, limit_km)),
        Metric("risk_coverage_area", "risk-coverage area", "", -1, lambda f, r: risk_coverage(f, limit_km).area),
    )
