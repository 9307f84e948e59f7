"""Pixel-phase error: the pixel grid draws the centroids of sharp stars towards the centres of pixels.

Pixels undersample a star whose image is narrower than 0.8 pixel (standard deviation), so the centroid depends on its position
within the pixel, by an S-curve with the period of a pixel (Anderson & King 2000, PASP 112, 1360). Pixels and stars are
symmetric, so the curve is odd, and its first harmonic makes up nine tenths of it: a sine along each axis. Windowed centroids
of noise-free Gaussians of 0.8, 0.7 and 0.6 px have amplitudes of -0.007, -0.024 and -0.070 px.

The curve is a function of the measured position, since noise shifts a star before the pixel grid draws it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

F8 = NDArray[np.float64]

MOST_CHANCE = 1e-3
"""Fraction of calibrations without pixel-phase error in which one is found."""
FEWEST_PIXELS = 100
"""Least number of pixels with stars; with fewer, the sums that judge the curve are not normally distributed."""

# Least mean square of the sine, which is 1/2 for evenly distributed phases. Positions rounded to pixels or half pixels carry
# no information.
_LEAST_SPREAD = 0.1


@dataclass(frozen=True)
class PixelPhase:
    """Error of a centroid along each axis: amplitude times sin(2 pi u) and sin(2 pi v).

    Attributes
    ----------
    amplitude_px : tuple of float
        Along u and v; negative where centroids are drawn towards the middles of pixels, 0 where no error was found.
    sigma_px : tuple of float
        Their standard deviations.
    """

    amplitude_px: tuple[float, float] = (0.0, 0.0)
    sigma_px: tuple[float, float] = (0.0, 0.0)

    def __bool__(self) -> bool:
        """Whether an error was found."""
        return any(self.amplitude_px)

    def error_px(self, uv: F8) -> F8:
        """Return the errors of centroids measured at `uv`, shape (n, 2)."""
        return np.asarray(np.array(self.amplitude_px) * np.sin(2 * np.pi * uv))


def measure_pixel_phase(uv: F8, residual: F8, sigma_px: F8) -> PixelPhase:
    """Fit the curve to residuals, unless chance explains it.

    This is a score test of both amplitudes: weighted sums of residual times sine, over the scatter of such sums of single
    pixels. Stars that cross the same pixel in several frames share the error of the lens there, so they count as one (White
    1980, Econometrica 48, 817; Liang & Zeger 1986, Biometrika 73, 13). Chi-squared with two degrees of freedom exceeds t with
    probability exp(-t / 2).

    Parameters
    ----------
    uv : ndarray, shape (n, 2)
        Measured positions.
    residual : ndarray, shape (n, 2)
        Measured minus predicted, px.
    sigma_px : ndarray, shape (n,)
        Standard deviation of a position along an axis.
    """
    column, row = np.rint(uv).astype(np.int64).T
    pixels, pixel = np.unique((column << 32) + row, return_inverse=True)
    if len(pixels) < FEWEST_PIXELS:
        return PixelPhase()
    sine, weight = np.sin(2 * np.pi * uv), sigma_px[:, None] ** -2
    information = (weight * sine**2).sum(axis=0)
    if (information < _LEAST_SPREAD * weight.sum()).any():
        return PixelPhase()
    score = weight * sine * residual
    by_chance = score.sum(axis=0) / np.maximum(_of_pixels(score, pixel), 1e-300)
    if math.exp(-0.5 * float(by_chance @ by_chance)) > MOST_CHANCE:
        return PixelPhase()
    amplitude = score.sum(axis=0) / information
    sigma = _of_pixels(weight * sine * (residual - amplitude * sine), pixel) / information
    return PixelPhase((float(amplitude[0]), float(amplitude[1])), (float(sigma[0]), float(sigma[1])))


def _of_pixels(score: F8, pixel: NDArray[np.intp]) -> F8:
    """Return the standard deviation, shape (2,), of the sum of scores, shape (n, 2), from their sums over each pixel."""
    sums = np.column_stack([np.bincount(pixel, weights=column) for column in score.T])
    return np.asarray(np.sqrt((sums**2).sum(axis=0)))
