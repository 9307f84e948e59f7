"""Stars of a photograph and of its twin in bins: SNR by magnitude, width by the angle from the axis."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmark.stats.intervals import Estimate
from benchmark.twin.comparison import Measured
from generator.seeds import random_stream

Floats = NDArray[np.float64]

MAGNITUDES = (-2.0, 2.0, 3.0, 4.0, 5.0, 6.0)
"""Edges of the bins of V."""
ANGLES_DEG = (0.0, 15.0, 30.0, 45.0, 60.0, 75.0, 90.0, 110.0)
"""Edges of the bins of the angle from the optical axis."""
LEAST_STARS = 8
"""Number of stars below which a bin is left out: the 95 % interval of a median of fewer is nearly their whole range."""
LEAST_TWIN_SNR = 2.0
"""Median SNR of a twin's stars below which there is no ratio: noise divided by noise."""
WIDTH_SNR = 10.0
"""Least SNR, in both images, of a star whose width counts."""
RESAMPLES = 1000
LEVELS = (2.5, 97.5)
DIGITS = 4


@dataclass(frozen=True)
class StarBin:
    """Stars of one bin, the same ones in both images.

    The estimates are medians over the stars, and the quotient of the two medians (robust where some stars are not seen; NaN
    where the twin shows none). Intervals of 95 % are percentiles of a bootstrap over stars, drawn with both of their values;
    `n` is the number of stars. The interval holds what differs by star: noise, gaps in cloud, errors of the catalogue. It
    does not hold what all stars share, such as the fitted air.

    Attributes
    ----------
    low, high : float
        Edges: V, or the angle from the axis, deg.
    middle : float
        Median of the stars' V or angle.
    real, twin : Estimate
        SNR, or width in px.
    ratio : Estimate
        Photograph over twin.
    """

    low: float
    high: float
    middle: float
    real: Estimate
    twin: Estimate
    ratio: Estimate


def snr_by_magnitude(real: Measured, twin: Measured) -> tuple[StarBin, ...]:
    """SNR of the stars to V 6 without a neighbour that are above 20 deg and saturated in neither image, by V."""
    return binned(real.stars.v_mag, MAGNITUDES, real.snr, twin.snr, LEAST_TWIN_SNR)


def width_by_angle(real: Measured, twin: Measured) -> tuple[StarBin, ...]:
    """Width, px, of such stars above 10 deg with an SNR of 10 in both images, by the angle from the optical axis.

    A lens with a field of less than 15 deg from the axis has one bin.
    """
    # NaN is not bright.
    bright = (real.width_snr >= WIDTH_SNR) & (twin.width_snr >= WIDTH_SNR)
    return binned(
        real.stars.off_axis_deg,
        ANGLES_DEG,
        np.where(bright, real.width_px, np.nan),
        np.where(bright, twin.width_px, np.nan),
    )


def binned(
    by: Floats, edges: Sequence[float], real: Floats, twin: Floats, least_twin: float = 0.0
) -> tuple[StarBin, ...]:
    """Compare the values of stars in bins.

    Parameters
    ----------
    by : (n,) array
        What the bins are of.
    edges : sequence of float
        Ascending; a bin contains its lower edge.
    real, twin : (n,) arrays
        Values; a star with NaN in one of them is left out of both.
    least_twin : float
        Median of the twin's values at or below which the ratio is undefined.

    Returns
    -------
    tuple of StarBin
        Those with `LEAST_STARS` or more; empty without any.
    """
    known = np.isfinite(real) & np.isfinite(twin) & np.isfinite(by)
    found = []
    for number, (low, high) in enumerate(itertools.pairwise(edges)):
        chosen = known & (by >= low) & (by < high)
        n = int(chosen.sum())
        if n < LEAST_STARS:
            continue
        pair = np.stack((real[chosen], twin[chosen]))
        drawn = random_stream(0, "twin:star-bins", number).integers(0, n, (RESAMPLES, n))
        medians, resampled = np.median(pair, axis=1), np.median(pair[:, drawn], axis=2)
        intervals = np.percentile(resampled, LEVELS, axis=1)
        ends = [Estimate(float(medians[k]), float(intervals[0, k]), float(intervals[1, k]), n) for k in (0, 1)]
        ratio = _ratio(medians, resampled, least_twin, n)
        found.append(StarBin(low, high, float(np.median(by[chosen])), ends[0], ends[1], ratio))
    return tuple(found)


def _ratio(medians: Floats, resampled: Floats, least_twin: float, n: int) -> Estimate:
    """Quotient of two medians (2,) with its interval from resampled ones (2, m)."""
    if not medians[1] > least_twin:
        return Estimate(math.nan, math.nan, math.nan, n)
    # A resampled twin whose stars vanish says that the ratio has no upper limit.
    quotients = np.where(resampled[1] > 0.0, resampled[0] / np.where(resampled[1] > 0.0, resampled[1], 1.0), np.inf)
    low, high = np.quantile(quotients, np.array(LEVELS) / 100, method="nearest")
    return Estimate(float(medians[0] / medians[1]), float(low), float(high), n)


def plain_bins(bins: Sequence[StarBin]) -> list[dict[str, Any]]:
    """Bins as JSON holds them: rounded, and None for what is not finite."""
    return [_plain(dataclasses.asdict(one)) for one in bins]


def bins_of(rows: Sequence[Mapping[str, Any]]) -> tuple[StarBin, ...]:
    """Bins from what `plain_bins` made."""
    return tuple(
        StarBin(row["low"], row["high"], row["middle"], *(_estimate(row[name]) for name in ("real", "twin", "ratio")))
        for row in rows
    )


def _plain(tree: dict[str, Any]) -> dict[str, Any]:
    return {name: _plain(part) if isinstance(part, dict) else _rounded(part) for name, part in tree.items()}


def _rounded(value: float) -> float | None:
    if isinstance(value, int):
        return value
    return round(value, DIGITS) if math.isfinite(value) else None


def _estimate(row: Mapping[str, Any]) -> Estimate:
    value, low, high = (math.nan if row[name] is None else float(row[name]) for name in ("value", "low", "high"))
    # Of an estimate with a value only an end without limit is not finite.
    return Estimate(value, low, math.inf if math.isfinite(value) and math.isnan(high) else high, int(row["n"]))
