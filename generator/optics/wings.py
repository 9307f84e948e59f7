"""Wings of the point spread function of a lens: light scattered by its surfaces, dust and bulk.

The irradiance at r from a point is (1 + (r / core)^2)^(-slope / 2) minus its value at the wings' end, the form of Harvey
and Shack for scatter by polished surfaces (Harvey 1976, "Light-scattering characteristics of optical surfaces", thesis,
University of Arizona; Pfisterer 2011, "Approximated scatter models for stray light analysis", Optics & Photonics News
22(10), 16). Far from the core it falls as r^-slope: as r^-2 around stars in telescopes (King 1971, PASP 83, 199), as
r^-1.6 to r^-3 in others (compiled by Bernstein 2007, ApJ 666, 663; Sandin 2014, A&A 567, A97), as r^-2.4 in an all-sky
fisheye.

Such a profile is a mixture of Gaussians, (1 + x^2)^-p = integral over t of t^(p-1) exp(-t) exp(-t x^2) dt / Gamma(p). The
narrow ones are convolved on cells of half their width; the rest is smooth on :data:`COARSE_PX` and is convolved there by
one transform.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from generator.scenario.lens.stray_light_spec import BloomSpec

Floats = NDArray[np.float64]

COARSE_PX = 8
"""Side of the largest cells, px."""
NARROWEST = 1.65
"""Value of t of the narrowest Gaussian in the mixture. Narrower ones contain less than 1 % of the light of wings of slope
2.4."""
STEP = 4.0
"""Ratio of t between neighbours, whose widths differ by a factor of two."""
TRUNCATE = 4.0
"""Standard deviations at which a Gaussian ends."""
WIDEST_PX = 64.0
"""Standard deviation of Gaussians for which the cells' own blur does not matter."""
LEAST_SIGMA_CELLS = 1.1
"""Least standard deviation, in cells, of a Gaussian that cells sample to 1 %."""
SAMPLES = 5
"""Samples per axis of the profile in a coarse cell, whose core may be narrower than a cell."""


@dataclass(frozen=True)
class Gaussian:
    """A Gaussian of the mixture.

    Attributes
    ----------
    sigma_px : float
    share : float
        Fraction of the wings' light.
    """

    sigma_px: float
    share: float

    @property
    def cell_px(self) -> int:
        """Side of the largest cells, px, a power of two, that sample the Gaussian well."""
        widest = math.floor(math.log2(max(self.sigma_px, 1.0) / LEAST_SIGMA_CELLS))
        return int(2 ** min(max(widest, 0), round(math.log2(COARSE_PX))))

    def left_px2(self, fine_px: int) -> float:
        """Variance per axis, px^2, left for the convolution: the path from fine cells to these and back makes the rest."""
        return max(self.sigma_px**2 - blur_px2(max(self.cell_px, fine_px), fine_px), 0.0)

    def on_pixels(self, r2: Floats, variance_px2: float) -> Floats:
        """Light on a pixel at squared distances, for wings with a total light of 1, with another width."""
        return np.asarray(self.share / (2 * math.pi * variance_px2) * np.exp(-r2 / (2 * variance_px2)))


def blur_px2(cell_px: int, fine_px: int) -> float:
    """Variance per axis, px^2, of the blur due to the path over cells.

    Points are distributed over the nearest fine cells (fine^2 / 6 on average); each doubling of the cells, and each
    halving back to single pixels, adds 3/16 of the squared side of the larger cells.
    """
    return fine_px**2 / 6 + (cell_px**2 - fine_px**2) / 4 + (cell_px**2 - 1) / 4


def end_height(bloom: BloomSpec) -> float:
    """The profile's height at its reach, which is subtracted so that wings end without an edge."""
    return float((1 + (bloom.reach_px / bloom.core_px) ** 2) ** (-bloom.slope / 2))


def area_px2(bloom: BloomSpec, radius_px: float | Floats) -> Floats:
    """Integral of the profile within a radius, at most its reach, px^2."""
    radius = np.minimum(np.asarray(radius_px, dtype=np.float64), bloom.reach_px)
    x2 = np.square(radius / bloom.core_px)
    scale = math.pi * bloom.core_px**2
    taken = math.pi * np.square(radius) * end_height(bloom)
    if abs(bloom.slope - 2) < 1e-9:
        return np.asarray(scale * np.log1p(x2) - taken)
    power = 1 - bloom.slope / 2
    return np.asarray(scale / power * np.expm1(power * np.log1p(x2)) - taken)


def encircled(bloom: BloomSpec, radius_px: float | Floats) -> Floats:
    """Fraction of the wings' light within a radius, 0-1."""
    return area_px2(bloom, radius_px) / area_px2(bloom, bloom.reach_px)


def profile(bloom: BloomSpec, radius_px: Floats) -> Floats:
    """Light on a pixel at a distance, for wings with a total light of 1; 0 beyond their reach."""
    light = (1 + np.square(radius_px / bloom.core_px)) ** (-bloom.slope / 2) - end_height(bloom)
    return np.maximum(light, 0.0) / area_px2(bloom, bloom.reach_px)


@functools.lru_cache(maxsize=8)
def mixture(bloom: BloomSpec) -> tuple[Gaussian, ...]:
    """Gaussians that make up the wings to a few percent of the profile at each radius, narrowest first.

    The rest, a ripple and the wings' end, is in :func:`wide_kernel`.
    """
    order = bloom.slope / 2
    found: list[Gaussian] = []
    t = NARROWEST
    while True:
        sigma = bloom.core_px / math.sqrt(2 * t)
        if sigma > WIDEST_PX or TRUNCATE * sigma > bloom.reach_px:
            return tuple(found)
        height = math.log(STEP) * t**order * math.exp(-t) / math.gamma(order)
        share = height * 2 * math.pi * sigma**2 / float(area_px2(bloom, bloom.reach_px))
        found.append(Gaussian(sigma, share))
        t /= STEP


@functools.lru_cache(maxsize=8)
def wide_kernel(bloom: BloomSpec, margin: int, fine_px: int) -> Floats:
    """Remainder of the wings without the Gaussians on cells below COARSE_PX, on cells of COARSE_PX: fractions of the light.

    `fine_px` is the side of the finest cells. Values may be negative by the small difference between the profile and its
    mixture.

    Returns
    -------
    (2 margin + 1, 2 margin + 1) array
    """
    axis = np.arange(-margin, margin + 1) * float(COARSE_PX)
    parts = mixture(bloom)
    samples = (np.arange(SAMPLES) - (SAMPLES - 1) / 2) * (COARSE_PX / SAMPLES)
    kernel = np.zeros((len(axis), len(axis)))
    for dx in samples:
        for dy in samples:
            r2 = np.square(axis + dx) + np.square(axis + dy)[:, None]
            kernel += profile(bloom, np.sqrt(r2))
            for part in parts:
                kernel -= part.on_pixels(r2, part.sigma_px**2)
    kernel /= SAMPLES**2
    for part in parts:
        if part.cell_px == COARSE_PX:
            kernel += part.on_pixels(np.square(axis) + np.square(axis)[:, None], part.left_px2(fine_px))
    kernel *= COARSE_PX**2
    share = 1 - sum(part.share for part in parts if part.cell_px < COARSE_PX)
    # The narrowest part of the core, which the mixture lacks, is put into the central cell.
    kernel[margin, margin] += share - kernel.sum()
    return kernel
