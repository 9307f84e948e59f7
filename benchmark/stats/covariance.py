"""Calibration of a solver's covariance: normalised estimation error squared and coverage of error ellipses.

All functions take a table of frames.
"""

from __future__ import annotations

import math

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy import stats

from benchmark.stats.clustered import Resamples, proportion_estimate
from benchmark.stats.frame_metrics import UNDEFINED, Metric, column, fixed, identified
from benchmark.stats.intervals import Estimate
from benchmark.stats.metrics import SUCCESS_KM
from benchmark.stats.skewed_means import skewed_mean_estimate

F8 = NDArray[np.float64]

ELLIPSE_LEVELS = (0.50, 0.95, 0.99)
NEES_DIMENSIONS = 2


def nees_values(frames: pd.DataFrame) -> F8:
    """Squared error in units of the claimed covariance, shape (n,); NaN without a fix or a covariance.

    The value is +inf for a covariance that is not positive definite, which claims certainty in some direction.
    """
    east, north = column(frames, "error_east_km"), column(frames, "error_north_km")
    ee, en, nn = (column(frames, f"cov_{name}_km2") for name in ("ee", "en", "nn"))
    determinant = ee * nn - en**2
    known = fixed(frames) & ~np.isnan(determinant) & ~np.isnan(east) & ~np.isnan(north)
    proper = known & (ee > 0) & (nn > 0) & (determinant > 0)
    square = (nn * east**2 - 2.0 * en * east * north + ee * north**2) / np.where(proper, determinant, 1.0)
    return np.where(proper, square, np.where(known, math.inf, math.nan))


def nees_of_identified(frames: pd.DataFrame, resamples: Resamples, limit_km: float = SUCCESS_KM) -> Estimate:
    """Mean of `nees_values` over the fixes that are `identified`; undefined unless every one of them has a covariance.

    If the others were left out, a solver could choose its value by stating covariances for only some fixes. A correct
    covariance gives 2, one that is too small gives more. The interval is that of `skewed_mean_estimate`, because a few fixes
    may contribute most of the sum.

    References
    ----------
    Y. Bar-Shalom, X. R. Li, T. Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001, section 5.4.2.
    """
    chosen = identified(frames, limit_km)
    values = np.where(chosen, nees_values(frames), math.nan)
    if not chosen.any() or np.isnan(values[chosen]).any():
        return UNDEFINED
    if np.isinf(values).any():
        return Estimate(math.inf, math.nan, math.nan, int(np.count_nonzero(chosen)))
    return skewed_mean_estimate(values, resamples)


def ellipse_coverage(frames: pd.DataFrame, resamples: Resamples, level: float = 0.95) -> Estimate:
    """Share of the fixes whose error ellipse of a level contains the truth; ideally equal to the level.

    A fix without a covariance counts as missed, or a solver could choose its value by stating covariances for only some
    fixes. Undefined if no fix has one.
    """
    values = nees_values(frames)
    if np.isnan(values).all():
        return UNDEFINED
    inside = values <= stats.chi2.ppf(level, NEES_DIMENSIONS)
    return proportion_estimate(inside, fixed(frames), resamples)


def _ellipse_at(level: float) -> Metric:
    name = f"{100 * level:.0f}"
    return Metric(
        f"ellipse_{name}", f"{name} % ellipse holds", "", 0, lambda f, r: ellipse_coverage(f, r, level)
    )  # fmt: skip


def covariance_metrics_within(limit_km: float) -> tuple[Metric, ...]:
    """Metrics of the stated covariances; fixes count as right within the given limit, that of their task."""
    return (
        Metric("nees", "NEES of identified fixes", "", 0, lambda f, r: nees_of_identified(f, r, limit_km)),
        *(_ellipse_at(level) for level in ELLIPSE_LEVELS),
    )
