"""Centroids, brightness and shape of stars under a window that follows them, with neighbours subtracted.

The iteration x += 2 sum(w I (x_i - x)) / sum(w I) of SExtractor's windowed positions (Bertin & Arnouts 1996, A&AS 117, 393,
and its manual) is nearly as good as a fit if the window has the shape of the star. Negative light counts, because leaving it
out would bias the position towards the centre of the window.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from celnav.detecting.close_pairs import close_pairs
from celnav.detecting.noise_map import NoiseMap
from celnav.detecting.star_shape import gaussians, inverse, offsets, windows

F4 = NDArray[np.float32]
F8 = NDArray[np.float64]

# Centroid error of even the brightest star, due to pixels and to a point spread function that is not Gaussian.
CENTROID_FLOOR_PX = 0.03
# Fraction of a neighbour's light that remains after its model has been subtracted.
_LEFT_OF_NEIGHBOUR = 0.05
_ROUNDS = 5
_PATCH_PIXELS = 65_000  # at a time, which stay in the processor's cache


@dataclass(frozen=True, eq=False)
class Measured:
    """Measurements of stars.

    Attributes
    ----------
    uv : ndarray, shape (n, 2)
        Centroids.
    flux : ndarray, shape (n,)
        Twice the light under the window, which is all the light of a star with the window's shape.
    sigma_px : ndarray, shape (n,)
        Standard deviation of the centroid, root mean square of the two axes.
    narrow, wide : ndarray, shape (n,)
        Second moments of the light under the window along its axes, relative to those expected: 1 for a star, less for a
        sharper source, 2 for a flat one.
    snr : ndarray, shape (n,)
        Signal-to-noise ratio of the light under the window.
    unlike, significance : ndarray, shape (n,)
        Light that does not have the form of a star, from `unlikeness`.
    """

    uv: F8
    flux: F8
    sigma_px: F8
    narrow: F8
    wide: F8
    snr: F8
    unlike: F8
    significance: F8


def measure_stars(
    light: F4, noise: NoiseMap, uv: F8, covariance: F8, gain_e_per_unit: float, white: NoiseMap | None = None
) -> Measured:
    """Measure stars at positions, shape (n, 2), that are known to a pixel or two.

    Parameters
    ----------
    light : ndarray, shape (height, width)
        Image minus background.
    noise : NoiseMap
        Standard deviation of its pixels without stars.
    uv : ndarray, shape (n, 2)
        Approximate positions.
    covariance : ndarray, shape (n, 3)
        Covariance of the star image: uu, uv, vv, px^2.
    gain_e_per_unit : float
        Electrons per unit of the image; infinity neglects the photon noise of the stars.
    white : NoiseMap, optional
        Noise from the differences of neighbouring pixels, for use if `noise` is that of white pixels with the same scatter
        under a filter; equal to `noise` unless given.
    """
    white = noise if white is None else white
    if not len(uv):
        empty = np.empty(0)
        return Measured(np.empty((0, 2)), empty, empty, empty, empty, empty, empty, empty)
    reach = tuple(int(np.ceil(3 * np.sqrt(covariance[:, k].max()))) for k in (2, 0))
    at_once = max(1, _PATCH_PIXELS // ((2 * reach[0] + 1) * (2 * reach[1] + 1)))
    neighbours = _neighbours(uv, covariance)
    parts = [
        _measure(
            light,
            noise,
            white,
            uv,
            covariance,
            gain_e_per_unit,
            (reach[0], reach[1]),
            neighbours,
            start,
            start + at_once,
        )
        for start in range(0, len(uv), at_once)
    ]
    return Measured(*(np.concatenate([getattr(part, name) for part in parts]) for name in Measured.__annotations__))


def _neighbours(uv: F8, covariance: F8) -> NDArray[np.intp]:
    """Return ordered pairs (star, neighbour), shape (p, 2), whose light overlaps, sorted by star."""
    reach = 5.0 * float(np.sqrt(np.median(np.maximum(covariance[:, 0], covariance[:, 2]))))
    pairs = close_pairs(uv, reach)
    both = np.concatenate((pairs, pairs[:, ::-1]))
    return both[np.argsort(both[:, 0], kind="stable")]


def _measure(
    light: F4,
    noise: NoiseMap,
    white: NoiseMap,
    uv: F8,
    covariance: F8,
    gain: float,
    reach: tuple[int, int],
    neighbours: NDArray[np.intp],
    start: int,
    stop: int,
) -> Measured:
    """Measure the stars of rows `start` to `stop`; the others stay at their approximate positions."""
    first, shape = uv[start:stop], covariance[start:stop]
    # The index of the window is the last axis, so that every step passes over all windows in memory order.
    cut, rows, columns = windows(light, first, reach)
    inverses = inverse(shape)
    p, q, r = inverses.T
    area = 2 * np.pi * np.sqrt(shape[:, 0] * shape[:, 2] - shape[:, 1] ** 2)
    low, high = np.searchsorted(neighbours[:, 0], [start, start + len(first)])
    pairs = neighbours[low:high]
    crowd: F8 = np.zeros(len(first))
    if len(pairs):
        own, other = pairs[:, 0] - start, pairs[:, 1]
        peaks = np.maximum(light[_nearest(light, uv[other])], 0)
        models = gaussians(inverse(covariance[other]), *offsets(rows[:, own], columns[:, own], uv[other]))
        models *= peaks
        _take_off(cut, own, models)
        apart = uv[other] - first[own]
        square = p[own] * apart[:, 0] ** 2 + 2 * q[own] * apart[:, 0] * apart[:, 1] + r[own] * apart[:, 1] ** 2
        crowding = peaks * np.sqrt(square) * np.exp(-0.25 * square)
        crowd = np.bincount(own, weights=crowding, minlength=len(first)).astype(np.float64)
    at = first.copy()
    limit = 2 * np.sqrt(np.maximum(shape[:, [0, 2]], 1.0))
    lowest, highest = first - limit, first + limit
    window = cut
    for _ in range(_ROUNDS):
        du, dv = offsets(rows, columns, at)
        window = gaussians(inverses, du, dv)
        window *= cut
        by_column, by_row = window.sum(axis=0), window.sum(axis=1)
        total = _positive(by_row.sum(axis=0))
        at[:, 0] += 2 * (by_column * du).sum(axis=0) / total
        at[:, 1] += 2 * (by_row * dv).sum(axis=0) / total
        np.minimum(np.maximum(at, lowest, out=at), highest, out=at)
    # A centroid that wanders off follows a neighbour's light; it is reset to its approximate position.
    wandered = np.any(np.abs(at - first) > 0.75 * limit, axis=1)
    at = np.where(wandered[:, None], first, at)
    light_under = window.sum(axis=(0, 1)).astype(np.float64)
    du, dv = offsets(rows, columns, at)
    narrow, wide = _relative_axes(window, du, dv, p, q, r)
    flux = np.maximum(2 * light_under, 0.0)
    rows_at, columns_at = _nearest(light, at)
    pixel = noise.at(rows_at, columns_at).astype(np.float64)
    spread = np.sqrt((shape[:, 0] + shape[:, 2]) / 2)
    sigma = _sigma_px(flux, pixel, shape, area, gain)
    sigma = np.hypot(sigma, _LEFT_OF_NEIGHBOUR * spread * crowd / np.maximum(flux / area, 1e-30))
    sigma = np.hypot(np.minimum(sigma, 1.0 + np.sqrt(shape[:, [0, 2]].max(axis=1))), CENTROID_FLOOR_PX)
    # Variance of sum(w I): sum(w^2) is half of the star's area.
    snr = light_under / np.maximum(np.sqrt(pixel**2 * area / 2 + flux / (3 * gain)), 1e-30)
    star = gaussians(inverses, du, dv)
    # If noise is correlated, that of a single pixel is smaller than that of the window; use their geometric mean.
    single = pixel * np.maximum(white.at(rows_at, columns_at), 1e-30)
    unlike, significance = unlikeness(cut, star, single, flux / area / gain)
    return Measured(at, flux, sigma, narrow, wide, snr, unlike, significance)


def _nearest(image: F4, uv: F8) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return rows and columns of the pixels that contain positions, shapes (n,)."""
    height, width = image.shape
    nearest = np.rint(uv).astype(np.intp)
    return nearest[:, 1].clip(0, height - 1), nearest[:, 0].clip(0, width - 1)


def unlikeness(cut: F4, star: F4, sky_power: F8, photons: F8) -> tuple[F8, F8]:
    """Measure how much of the light in windows does not have the form of a star.

    Parameters
    ----------
    cut : ndarray, shape (rows, columns, n)
        Light; it does not count beyond 2.5 standard deviations of the star.
    star : ndarray, shape (rows, columns, n)
        The star image, with a peak of 1.
    sky_power, photons : ndarray, shape (n,)
        Variance of a pixel without stars, and the variance that the star's light adds at its peak.

    Returns
    -------
    unlike : ndarray, shape (n,)
        Square root of the residual power of the best-fitting star beyond noise, over that of the star's own power: 0 for a
        star, 0.5 and more for the track of a particle, infinity if the star has no light.
    significance : ndarray, shape (n,)
        The residual power in standard deviations of the noise power.
    """
    inner = (star > np.float32(np.exp(-0.5 * 2.5**2))).astype(np.float32)
    star = star * inner
    squares = star * star
    total, own = _summed(star), _summed(squares)
    number, left = _summed(inner), cut * inner
    peak = np.maximum(_summed(left * star) / np.maximum(own, 1e-30), 0.0)
    left -= star * peak.astype(np.float32)
    power = _summed(left * left)
    by_noise = number * sky_power + total * photons
    spread = np.sqrt(2 * (number * sky_power**2 + 2 * total * sky_power * photons + own * photons**2))
    excess = np.maximum(power - by_noise, 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.sqrt(np.where(peak > 0, excess / (peak**2 * own), np.inf))), np.asarray(
            excess / np.maximum(spread, 1e-30)
        )


def _summed(values: F4) -> F8:
    """Return the sums over windows, shape (n,)."""
    return values.sum(axis=(0, 1)).astype(np.float64)


def _positive(total: F4) -> F4:
    return np.where(total > 0, total, np.float32(np.inf))


def _take_off(cut: F4, own: NDArray[np.intp], models: F4) -> None:
    """Subtract models, shape (rows, columns, p), from the windows numbered `own`, in ascending order."""
    starts = np.flatnonzero(np.diff(own, prepend=-1))
    cut[:, :, own[starts]] -= np.add.reduceat(models, starts, axis=2)


def _relative_axes(window: F4, du: F4, dv: F4, p: F8, q: F8, r: F8) -> tuple[F8, F8]:
    """Return the moments of the light under the window along its short and long axis over those expected, shapes (n,).

    If light and window are the same Gaussian of covariance S, the covariance of their product is S / 2; the results are the
    eigenvalues of twice that covariance over S.
    """
    by_column, by_row = window.sum(axis=0), window.sum(axis=1)
    total = _positive(by_row.sum(axis=0))
    uu, vv = (by_column * du * du).sum(axis=0) / total, (by_row * dv * dv).sum(axis=0) / total
    mixed = ((window * du[None]).sum(axis=1) * dv).sum(axis=0) / total
    uu, vv, mixed = (each.astype(np.float64) for each in (uu, vv, mixed))
    trace = p * uu + 2 * q * mixed + r * vv
    root = np.sqrt(np.maximum(trace**2 - 4 * (uu * vv - mixed**2) * (p * r - q * q), 0))
    return trace - root, trace + root


def _sigma_px(flux: F8, noise: F8, shape: F8, area: F8, gain: float) -> F8:
    """Return the standard deviation of windowed centroids of Gaussian stars from the noise of sky and star, shape (n,).

    The estimate 2 sum(w I x) / sum(w I) has the variance 4 sum(w^2 x^2 N^2) / sum(w I)^2. With S the star's covariance,
    w^2 is a Gaussian of covariance S / 2, and w^2 times the star is one of S / 3.
    """
    axis = (shape[:, 0] + shape[:, 2]) / 2
    sky = noise**2 * (area / 2) * axis / 2
    star = flux / gain / 3 * axis / 3
    return np.asarray(2 * np.sqrt(sky + star) / np.maximum(flux / 2, 1e-30))
