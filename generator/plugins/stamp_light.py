"""The size of the stamp of each star: the wings of faint stars are below the noise."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

Floats = NDArray[np.float64]

FAINTEST_PIXEL_E = 0.05
"""Pixels beyond a star's stamp would have received no more electrons than this from the star."""
SIZES_PX = (3, 4, 6, 9, 13, 19, 28, 40)
LARGEST_MOVED_SHARE = 0.025
"""No more than this part of a star's light is taken from beyond its stamp and spread over the stamp instead."""


@dataclass(frozen=True)
class StampLight:
    """Light of a point spread function within and beyond stamps of radius 0, 1, … px.

    Attributes
    ----------
    inside : (radius + 1, bands, rows, columns) array
        Mean share of the light on a stamp, by wavelength band and field node.
    beyond : (radius + 1,) array
        Largest share of a pixel beyond it.
    """

    inside: Floats
    beyond: Floats

    @property
    def radius_px(self) -> int:
        """Of the largest stamp, which is the point spread function's support."""
        return len(self.beyond) - 1

    @property
    def gain(self) -> Floats:
        """Factor that brings the light on each stamp to that on the largest one; shape of `inside`."""
        return self.inside[-1] / self.inside

    def radii(self, electrons: Floats) -> NDArray[np.int64]:
        """Radii, px, of the stamps of stars, by their electrons (n,) in the brightest channel.

        The smallest that keeps to FAINTEST_PIXEL_E and LARGEST_MOVED_SHARE, of a few sizes (every size costs a pass over
        the stars); the largest where no smaller one does.
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
    """The same for a Gaussian point spread function that is integrated over pixels."""
    radius = np.arange(radius_px + 1)
    scale = math.sqrt(2) * sigma_px
    inside = erf((radius + 0.5) / scale) ** 2
    # The star may be anywhere in the middle pixel.
    beyond = 0.5 * (erf((radius + 1) / scale) - erf(radius / scale)) * erf(0.5 / scale)
    beyond[-1] = 0
    return StampLight(inside[:, None, None, None], beyond)
