"""Fisher information that a star's pixels give on its place in the image, for point images and for streaks.

A star of E electrons in a Gaussian of width s, on a background with variance b per pixel, gives Fisher information on its
place. For Poisson and read noise it has the closed form of `centroid_information`. The stars are taken as separate and
unsaturated, and the background as known.

References
----------
I. R. King, PASP 95, 163-168, 1983 (noise-equivalent area). K. A. Winick, J. Opt. Soc. Am. A 3, 1809-1815, 1986
(Cramér-Rao bounds of a spot's place on a pixel detector). S. Thomas et al., MNRAS 371, 323-336, 2006 (photon and read
noise of centroids).
"""

from __future__ import annotations

import dataclasses
import functools
import math
from dataclasses import dataclass

import numpy as np
from numpy.polynomial.legendre import leggauss
from numpy.typing import NDArray
from scipy.special import erf, spence

from benchmark.protocol import CameraRecord

F8 = NDArray[np.float64]

PIXEL_VARIANCE_PX2 = 1.0 / 12.0
# A streak shorter than this fraction of the width of the point spread function costs less than 0.1 % of the information.
_SHORTEST_STREAK = 0.1
_REACH_SIGMAS = 6.0
_NODE, _WEIGHT = leggauss(24)
"""Quadrature of a streak in each of two directions: exact to 2e-5 for streaks up to 60 standard deviations."""
_LEAST_PEAK, _LARGEST_PEAK, _KNOTS = 1e-9, 1e12, 40001
"""Range of a streak's light over the background in which integrals across it are looked up, and the number of knots."""
_LEAST_BACKGROUND = 1e-11
"""Least background, as a fraction of a streak's light in one square pixel, so that its ratio stays in this range."""
_STARS_AT_ONCE = 500
"""Streaks that are integrated in one step, so that their numbers fit into the processor's cache."""


@dataclass(frozen=True, eq=False)
class StarLight:
    """True light of a frame, and the camera that recorded it.

    Attributes
    ----------
    uv : ndarray, shape (n, 2)
        Places of the stars at mid-exposure, px.
    electrons_e : ndarray, shape (n,)
        Expected electrons of each star.
    background_e2 : ndarray, shape (n,)
        Variance per pixel at each star of everything but its own light (sky, dark current, read-out), e^2.
    streak_px : ndarray, shape (n, 2)
        Vector from the start to the end of the star's light; 0 where nothing moves.
    psf_sigma_px : float
        Width of the point spread function, without that of the pixel.
    camera : CameraRecord
    R_cam : ndarray, shape (3, 3)
        ENU to camera.
    latitude_deg : float
    """

    uv: F8
    electrons_e: F8
    background_e2: F8
    streak_px: F8
    psf_sigma_px: float
    camera: CameraRecord
    R_cam: F8
    latitude_deg: float

    def take(self, rows: NDArray[np.bool_]) -> StarLight:
        """Select stars by a mask of shape (n,)."""
        names = ("uv", "electrons_e", "background_e2", "streak_px")
        return dataclasses.replace(self, **{name: getattr(self, name)[rows] for name in names})


def centroid_information(electrons_e: F8, background_e2: F8, sigma_px: float) -> F8:
    r"""Fisher information on a star's place along each axis, 1/px^2, shape (n,).

    For the mean mu = E / (2 pi s^2) exp(-r^2 / (2 s^2)) per pixel and the variance mu + b,

    .. math:: F = \int (d\mu/dx)^2 / (\mu + b) = (E / s^2) [1 + \beta Li_2(-1/\beta)],  \beta = 2 \pi s^2 b / E,

    with the dilogarithm Li_2; s^2 includes the 1/12 px^2 of the pixel's own width. The limits are the known ones: the
    variance is s^2 / E for photons alone (King 1983; Thomas et al. 2006, equation 8) and 8 pi s^4 b / E^2 for background
    alone (King 1983).

    Parameters
    ----------
    electrons_e, background_e2 : ndarray, shape (n,)
    sigma_px : float
        Without the pixel's own width.
    """
    variance = sigma_px**2 + PIXEL_VARIANCE_PX2
    bright = np.maximum(electrons_e, 1e-12)
    beta = 2.0 * math.pi * variance * background_e2 / bright
    return np.asarray(bright / variance * _photon_share(beta))


def _photon_share(beta: F8) -> F8:
    """Evaluate 1 + beta Li_2(-1/beta): 1 without background, 1/(4 beta) for a strong one."""
    safe = np.maximum(beta, 1e-12)
    # Where the two terms nearly cancel, use the series of the dilogarithm: 1/(4 b) - 1/(9 b^2) + 1/(16 b^3) - …
    x = 1.0 / np.maximum(safe, 50.0)
    series = sum((-1.0) ** k * x ** (k - 1) / k**2 for k in range(2, 9))
    return np.where(safe < 50.0, 1.0 + safe * spence(1.0 + 1.0 / np.minimum(safe, 50.0)), series)


def streak_information(electrons_e: F8, background_e2: F8, sigma_px: float, length_px: F8) -> F8:
    """Fisher information along and across a streak, shape (n, 2), 1/px^2.

    The light of a star that moves uniformly by `length_px` is the Gaussian smeared over that length. It is integrated over
    one half of the streak by Gauss-Legendre quadrature, separately over the end, where the derivative along the streak is
    not zero, and over the middle, where it is. The integrals across the streak depend on the star's light over the
    background alone, and are looked up (`_integrals_across`).

    Parameters
    ----------
    electrons_e, background_e2, length_px : ndarray, shape (n,)
    sigma_px : float
        Without the pixel's own width.
    """
    sigma = math.sqrt(sigma_px**2 + PIXEL_VARIANCE_PX2)
    half = length_px / 2.0
    split = np.maximum(half - _REACH_SIGMAS * sigma, 0.0)
    # The last term is for stars without light, whose ratio would otherwise be 0 / 0.
    background = np.maximum(background_e2, _LEAST_BACKGROUND * electrons_e / (sigma * length_px) + 1e-300)
    found = np.zeros((len(electrons_e), 2))
    for low, high in ((np.zeros_like(half), split), (split, half + _REACH_SIGMAS * sigma)):
        x = low[:, None] + 0.5 * (high - low)[:, None] * (_NODE + 1.0)
        wx = 0.5 * (high - low)[:, None] * _WEIGHT
        ends = [(x + sign * half[:, None]) / sigma for sign in (1.0, -1.0)]
        along = (erf(ends[0] / math.sqrt(2.0)) - erf(ends[1] / math.sqrt(2.0))) / (2.0 * length_px[:, None])
        slope = (np.exp(-0.5 * ends[0] ** 2) - np.exp(-0.5 * ends[1] ** 2)) / (
            math.sqrt(2.0 * math.pi) * sigma * length_px[:, None]
        )
        e, b = electrons_e[:, None], background[:, None]
        peak = e * along / (math.sqrt(2.0 * math.pi) * sigma * b)
        light, gradient = _integrals_across(peak)
        # The four quarters of the plane are equal.
        area = 4.0 * wx * e**2 / (2.0 * math.pi * sigma * b)
        found[:, 0] += np.sum(area * slope**2 * light, axis=1)
        found[:, 1] += np.sum(area * (along / sigma) ** 2 * gradient, axis=1)
    return found


def _integrals_across(peak: F8) -> tuple[F8, F8]:
    r"""Two integrals across a streak, by p, the ratio of its light in the middle to the background; interpolated to 1e-7.

    .. math:: \int_0^\infty g^2 / (1 + p g) dt, \quad \int_0^\infty t^2 g^2 / (1 + p g) dt, \quad g = exp(-t^2 / 2)
    """
    table = _logarithms_across()
    low, high = math.log(_LEAST_PEAK), math.log(_LARGEST_PEAK)
    place = (np.log(np.fmax(np.fmin(peak, _LARGEST_PEAK), _LEAST_PEAK)) - low) * ((_KNOTS - 1) / (high - low))
    below = np.minimum(place.astype(np.intp), _KNOTS - 2)
    share = place - below
    light, gradient = (np.exp((1.0 - share) * row[below] + share * row[below + 1]) for row in table)
    return light, gradient


@functools.cache
def _logarithms_across() -> F8:
    """Logarithms of both integrals, shape (2, _KNOTS), at ratios whose logarithms are equidistant."""
    t = 0.5 * _REACH_SIGMAS * (_NODE + 1.0)
    weight, g = 0.5 * _REACH_SIGMAS * _WEIGHT, np.exp(-0.5 * t**2)
    share = weight * g**2 / (1.0 + np.geomspace(_LEAST_PEAK, _LARGEST_PEAK, _KNOTS)[:, None] * g)
    return np.asarray(np.log([share.sum(axis=1), (t**2 * share).sum(axis=1)]))


def place_information(light: StarLight) -> F8:
    """Fisher information on each star's place, shape (n, 2, 2), 1/px^2."""
    length = np.hypot(*light.streak_px.T)
    moving = length > _SHORTEST_STREAK * light.psf_sigma_px
    still = centroid_information(light.electrons_e, light.background_e2, light.psf_sigma_px)
    found = np.asarray(still[:, None, None] * np.eye(2))
    if moving.any():
        rows = np.flatnonzero(moving)
        for part in np.array_split(rows, math.ceil(len(rows) / _STARS_AT_ONCE)):
            along, across = streak_information(
                light.electrons_e[part], light.background_e2[part], light.psf_sigma_px, length[part]
            ).T
            t = light.streak_px[part] / length[part, None]
            n = np.column_stack((-t[:, 1], t[:, 0]))
            found[part] = (
                along[:, None, None] * t[:, :, None] * t[:, None, :]
                + across[:, None, None] * n[:, :, None] * n[:, None, :]
            )
    return found


def background_variance(electrons_e: F8, snr: F8, sigma_px: float) -> F8:
    """Variance per pixel of all but the star's own light, e^2, derived from a matched-filter signal-to-noise ratio.

    The ratio in the truth table is E / sqrt(E + 4 pi (s^2 + 1/12) b); NaN for a star without light.
    """
    area = 4.0 * math.pi * (sigma_px**2 + PIXEL_VARIANCE_PX2)
    with np.errstate(divide="ignore", invalid="ignore"):
        total = np.where(snr > 0, (electrons_e / snr) ** 2, math.nan)
    return np.asarray(np.maximum(total - electrons_e, 0.0) / area)
