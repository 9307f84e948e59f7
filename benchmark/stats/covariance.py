"""Calibration of a solver's covariance: normalised estimation error squared and coverage of error ellipses.

All take a table of frames.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy import stats

from benchmark.stats.clustered import Resamples, proportion_estimate
from benchmark.stats.frame_metrics import Metric, column, fixed, succeeded
from benchmark.stats.intervals import Estimate

F8 = NDArray[np.float64]

ELLIPSE_LEVELS = (0.50, 0.95, 0.99)
NEES_DIMENSIONS = 2


@dataclass(frozen=True)
class Nees:
    """Normalised estimation error squared of the fixes that come with a covariance.

    Attributes
    ----------
    n : int
        Fixes.
    mean : float
        2 where the covariance is right; more where it is too small, less where it is too large.
    low, high : float
        Where the mean lies with 95 % probability if all errors are Gaussian with the covariance claimed.
    median : float
        1.386 where it is right; robust against a few gross errors.
    """

    n: int
    mean: float
    low: float
    high: float
    median: float


def nees_values(frames: pd.DataFrame) -> F8:
    """Squared error in units of the covariance claimed, shape (n,); NaN without a fix or a covariance.

    +inf for a covariance that is not positive definite, which claims certainty in some direction.
    """
    east, north = column(frames, "error_east_km"), column(frames, "error_north_km")
    ee, en, nn = (column(frames, f"cov_{name}_km2") for name in ("ee", "en", "nn"))
    determinant = ee * nn - en**2
    known = fixed(frames) & ~np.isnan(determinant) & ~np.isnan(east) & ~np.isnan(north)
    proper = known & (ee > 0) & (nn > 0) & (determinant > 0)
    square = (nn * east**2 - 2.0 * en * east * north + ee * north**2) / np.where(proper, determinant, 1.0)
    return np.where(proper, square, np.where(known, math.inf, math.nan))


def nees(frames: pd.DataFrame, right_only: bool = False, confidence: float = 0.95) -> Nees:
    """Normalised estimation error squared with the bounds that a correct covariance keeps.

    Parameters
    ----------
    frames : DataFrame
    right_only : bool
        Over the fixes within the limit of success only: the covariance by itself, once the stars are identified correctly.
    confidence : float

    References
    ----------
    Y. Bar-Shalom, X. R. Li, T. Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001,
    section 5.4.2: n times the mean of n values of dimension d is chi-squared with n d degrees of freedom.
    """
    values = nees_values(frames)
    values = values[~np.isnan(values) & (succeeded(frames) if right_only else True)]
    n = len(values)
    if n == 0:
        return Nees(0, math.nan, math.nan, math.nan, math.nan)
    tail = (1.0 - confidence) / 2.0
    low, high = (float(stats.chi2.ppf(level, NEES_DIMENSIONS * n)) / n for level in (tail, 1.0 - tail))
    return Nees(n, float(values.mean()), low, high, float(np.median(values)))


def ellipse_coverage(frames: pd.DataFrame, resamples: Resamples, level: float = 0.95) -> Estimate:
    """Share of the fixes with a covariance whose error ellipse of a level holds the truth; the level if it is correct."""
    values = nees_values(frames)
    inside = values <= stats.chi2.ppf(level, NEES_DIMENSIONS)
    return proportion_estimate(inside & ~np.isnan(values), ~np.isnan(values), resamples)


def _ellipse_at(level: float) -> Metric:
    name = f"{100 * level:.0f}"
    return Metric(
        f"ellipse_{name}", f"{name} % ellipse holds", "", 0, lambda f, r: ellipse_coverage(f, r, level)
    )  # fmt: skip


COVARIANCE_METRICS: tuple[Metric, ...] = tuple(_ellipse_at(level) for level in ELLIPSE_LEVELS)
