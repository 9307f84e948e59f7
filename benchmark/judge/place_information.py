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
from scipy.interpolate import RectBivariateSpline
from scipy.special import spence
from scipy.stats import norm

from benchmark.protocol import CameraRecord

F8 = NDArray[np.float64]

PIXEL_VARIANCE_PX2 = 1.0 / 12.0
# A streak shorter than this fraction of the width of the point spread function costs less than 0.1 % of the information.
_SHORTEST_STREAK = 0.1
_REACH_SIGMAS = 6.0
_NODE, _WEIGHT = leggauss(24)
"""Quadrature of a streak in each of two directions: exact to 2e-5 for streaks up to 60 standard deviations."""
_LIGHTS = np.linspace(math.log(1e-8), math.log(1e12), 121)
"""Logarithms of a star's electrons over the background's variance in one square of the image's width."""
_LENGTHS = np.linspace(math.log(0.05), math.log(2e4), 105)
"""Logarithms of a streak's length over that width."""


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

    The light of a star that moves uniformly by `length_px` is the Gaussian smeared over that length. As a share of that of
    photons alone in an image that stands still, E / s^2, its information depends on two ratios only, and is interpolated
    between the integrals of `streak_share` to 1e-5.

    Parameters
    ----------
    electrons_e, background_e2, length_px : ndarray, shape (n,)
    sigma_px : float
        Without the pixel's own width.
    """
    variance = sigma_px**2 + PIXEL_VARIANCE_PX2
    with np.errstate(divide="ignore"):
        light = np.log(electrons_e) - np.log(variance * background_e2)
        length = np.log(length_px) - 0.5 * math.log(variance)
    # Beyond the table's ends there is hardly any information, or photons are all there is.
    at = light.clip(_LIGHTS[0], _LIGHTS[-1]), length.clip(_LENGTHS[0], _LENGTHS[-1])
    share = np.exp(np.column_stack([table.ev(*at) for table in _logarithms()]))
    return np.asarray(electrons_e[:, None] / variance * share)


@functools.cache
def _logarithms() -> tuple[RectBivariateSpline, RectBivariateSpline]:
    """Logarithms of `streak_share` along and across, by the logarithms of its arguments."""
    share = np.log([streak_share(np.exp(_LIGHTS), math.exp(length)) for length in _LENGTHS])
    along, across = (RectBivariateSpline(_LIGHTS, _LENGTHS, share[:, :, axis].T, s=0) for axis in (0, 1))
    return along, across


def streak_share(light: F8, length: float) -> F8:
    r"""Information along and across a streak over E / s^2, shape (n, 2).

    For the light along the streak, :math:`A(x) = [\Phi(x + l / 2) - \Phi(x - l / 2)] / l`, and
    :math:`g(y) = e^{-y^2 / 2} / \sqrt{2 \pi}` across it, both are

    .. math:: 4 q \int_0^\infty \int_0^\infty D^2 / (1 + q A g) \, dy \, dx, \quad D = A' g, \; A y g,

    by Gauss-Legendre quadrature, separately over the end, where A varies, and over the middle, where it does not.

    Parameters
    ----------
    light : ndarray, shape (n,)
        q, electrons over the background's variance in a square of one standard deviation of the image.
    length : float
        l, length of the streak in standard deviations.
    """
    half, y, wy = length / 2.0, *_between(0.0, _REACH_SIGMAS)
    g = norm.pdf(y)
    found = np.zeros((len(light), 2))
    split = max(half - _REACH_SIGMAS, 0.0)
    for low, high in ((0.0, split), (split, half + _REACH_SIGMAS)):
        x, wx = _between(low, high)
        A = (norm.cdf(half - x) - norm.cdf(-half - x)) / length
        slope = (norm.pdf(x + half) - norm.pdf(x - half)) / length
        share = 4.0 * wx[:, None] * wy * g**2 / (1.0 + light[:, None, None] * A[:, None] * g)
        found[:, 0] += np.einsum("nxy,x->n", share, slope**2)
        found[:, 1] += np.einsum("nxy,x,y->n", share, A**2, y**2)
    return np.asarray(light[:, None] * found)


def _between(low: float, high: float) -> tuple[F8, F8]:
    """Nodes and weights of the quadrature from `low` to `high`."""
    return low + 0.5 * (high - low) * (_NODE + 1.0), 0.5 * (high - low) * _WEIGHT


def place_information(light: StarLight) -> F8:
    """Fisher information on each star's place, shape (n, 2, 2), 1/px^2."""
    length = np.hypot(*light.streak_px.T)
    moving = length > _SHORTEST_STREAK * light.psf_sigma_px
    still = centroid_information(light.electrons_e, light.background_e2, light.psf_sigma_px)
    found = np.asarray(still[:, None, None] * np.eye(2))
    if moving.any():
        along, across = streak_information(
            light.electrons_e[moving], light.background_e2[moving], light.psf_sigma_px, length[moving]
        ).T
        t = light.streak_px[moving] / length[moving, None]
        n = np.column_stack((-t[:, 1], t[:, 0]))
        found[moving] = (
            along[:, None, None] * t[:, :, None] * t[:, None, :] + across[:, None, None] * n[:, :, None] * n[:, None, :]
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
