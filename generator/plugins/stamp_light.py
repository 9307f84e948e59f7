"""The stamp size of each star, given that the wings of faint stars are below the noise."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

Floats = NDArray[np.float64]

FAINTEST_PIXEL_E = 0.05
"""Largest number of electrons that a pixel beyond a star's stamp would have received from the star."""
SIZES_PX = (3, 4, 6, 9, 13, 19, 28, 40)
LARGEST_MOVED_SHARE = 0.025
"""Largest fraction of a star's light that is taken from beyond its stamp and spread over the stamp instead."""


@dataclass(frozen=True)
class StampLight:
    """Light of a point spread function within and beyond stamps of radius 0, 1, … px.

    Attributes
    ----------
    inside : (radius + 1, bands, rows, columns) array
        Mean fraction of the light on a stamp, by wavelength band and field node.
    beyond : (radius + 1,) array
        Largest fraction in a pixel beyond it.
    """

    inside: Floats
    beyond: Floats

    @property
    def radius_px(self) -> int:
        """Radius of the largest stamp, which is the point spread function's support."""
        return len(self.beyond) - 1

    @property
    def gain(self) -> Floats:
        """Factor that brings the light on each stamp to that on the largest one; shape of `inside`."""
        return self.inside[-1] / self.inside

    def radii(self, electrons: Floats) -> NDArray[np.int64]:
        """Radii, px, of the stamps of stars, for their electrons (n,) in the brightest channel.

        Each is the smallest of a few sizes that satisfies FAINTEST_PIXEL_E and LARGEST_MOVED_SHARE, or else the largest.
        The sizes are few because every size costs a pass over the stars.
        """
        moved = 1 - 1 / self.gain.max(axis=(1, 2, 3))
        # Electrons above which each radius is too small.
        brightest = np.full(self.radius_px, np.inf)
        np.divide(FAINTEST_PIXEL_E, self.beyond[:-1], out=brightest, where=self.beyond[:-1] > 0)
        brightest[moved[:-1] > LARGEST_MOVED_SHARE] = -np.inf
        too_small = np.searchsorted(np.sort(brightest), electrons)
        sizes = np.array([*(size for size in SIZES_PX if size < self.radius_px), self.radius_px])
        return sizes[np.searchsorted(sizes, too_small)]


def gaussian_light(sigma_px: float, radius_px: int) -> StampLight:
    """Stamp light of a Gaussian point spread function that is integrated over pixels."""
    radius = np.arange(radius_px + 1)
    scale = math.sqrt(2) * sigma_px
    inside = erf((radius + 0.5) / scale) ** 2
    # The star may be anywhere in the central pixel.
    beyond = 0.5 * (erf((radius + 1) / scale) - erf(radius / scale)) * erf(0.5 / scale)
    beyond[-1] = 0
    return StampLight(inside[:, None, None, None], beyond)
