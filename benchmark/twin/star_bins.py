"""Stars of a photograph over those of its twin, in bins: SNR by magnitude, width by the angle from the lens' axis."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

MAGNITUDE_EDGES = (-2.0, 2.0, 3.0, 4.0, 5.0, 6.0)
ANGLE_EDGES_DEG = (0.0, 15.0, 30.0, 45.0, 60.0, 75.0, 90.0)
LEAST_STARS = 5
"""Bins with fewer stars are left out."""
LEAST_SNR = 20.0
"""Least SNR, on both pictures, of a star whose width counts: noise widens fainter ones."""
RESAMPLES = 400
STREAM = 15


@dataclass(frozen=True)
class StarBin:
    """A quantity of the stars in one bin.

    Attributes
    ----------
    low, high : float
        Edges of the bin.
    stars : int
    real, twin : float
        Medians on the photograph and on the twin.
    ratio : float
        The first over the second.
    sigma : float
        Standard deviation of the ratio, of a bootstrap over the stars.
    """

    low: float
    high: float
    stars: int
    real: float
    twin: float
    ratio: float
    sigma: float


def binned(real: Floats, twin: Floats, by: Floats, edges: Sequence[float]) -> tuple[StarBin, ...]:
    """Compare a quantity of the same stars in two pictures, bin by bin.

    The ratio is that of the medians, because the ratio of a single faint star has no mean.

    Parameters
    ----------
    real, twin : (n,) arrays
        NaN where a star was not measured; such stars do not count.
    by : (n,) array
        What the bins divide.
    edges : sequence of float
        Edges of the bins, rising.
    """
    found = []
    for number, (low, high) in enumerate(itertools.pairwise(edges)):
        inside = np.isfinite(real) & np.isfinite(twin) & (by >= low) & (by < high)
        n = int(inside.sum())
        if n < LEAST_STARS:
            continue
        one, other = real[inside], twin[inside]
        middle = float(np.median(one)), float(np.median(other))
        if middle[1] <= 0.0:
            continue
        # A bin's resamples depend on nothing but its number, so that the same pictures give the same digits.
        rows = np.random.default_rng([STREAM, number]).integers(0, n, (RESAMPLES, n))
        below = np.median(other[rows], axis=1)
        again = np.median(one[rows], axis=1) / np.where(below > 0.0, below, np.nan)
        found.append(StarBin(low, high, n, *middle, middle[0] / middle[1], float(np.nanstd(again))))
    return tuple(found)


def snr_by_magnitude(real_snr: Floats, twin_snr: Floats, v_mag: Floats) -> tuple[StarBin, ...]:
    """SNR of the stars, (n,) each, in bins of their magnitude."""
    return binned(real_snr, twin_snr, v_mag, MAGNITUDE_EDGES)


def width_by_angle(
    widths_px: tuple[Floats, Floats], snrs: tuple[Floats, Floats], axis_deg: Floats
) -> tuple[StarBin, ...]:
    """Widths of the stars (photograph, twin), px, in bins of their angle from the axis; faint stars do not count."""
    clear = (np.nan_to_num(snrs[0]) >= LEAST_SNR) & (np.nan_to_num(snrs[1]) >= LEAST_SNR)
    real, twin = (np.where(clear, width, np.nan) for width in widths_px)
    return binned(real, twin, axis_deg, ANGLE_EDGES_DEG)
