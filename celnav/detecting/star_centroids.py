"""Centroids, brightness, and shape of stars under a window that follows them, neighbours subtracted.

The iteration x += 2 sum(w I (x_i - x)) / sum(w I) of the windowed positions of SExtractor (Bertin & Arnouts 1996, A&AS
117, 393, and its manual) is nearly as good as a fit where the window has the shape of the star. Negative light counts:
leaving it out would bias towards the window's middle.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from celnav.detecting.star_shape import inverse, patches, unlikeness

F4 = NDArray[np.float32]
F8 = NDArray[np.float64]

# What pixels and a point spread function that is no Gaussian leave in the centroid of the brightest star.
CENTROID_FLOOR_PX = 0.03
# Part of a neighbour's light that stays when its model has been taken off.
_LEFT_OF_NEIGHBOUR = 0.05
_ROUNDS = 5
_PATCH_PIXELS = 400_000  # at a time: a few megabytes


@dataclass(frozen=True, eq=False)
class Measured:
    """Stars as measured.

    Attributes
    ----------
    uv : ndarray, shape (n, 2)
        Centroids.
    flux : ndarray, shape (n,)
        Twice the light under the window: for a star of the window's shape all of its light.
    sigma_px : ndarray, shape (n,)
        Standard deviation of the centroid, root mean square of the two axes.
    narrow, wide : ndarray, shape (n,)
        Second moments of the light under the window along its axes over those expected: 1 for a star, less for a
        sharper source, 2 for a flat one.
    snr : ndarray, shape (n,)
        Light under the window over its noise.
    unlike, significance : ndarray, shape (n,)
        Light that is not that of a star, as of `celnav.detecting.star_shape.unlikeness`.
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
    light: F4, noise: F4, uv: F8, covariance: F8, gain_e_per_unit: float, white: F4 | None = None
) -> Measured:
    """Measure stars at places, shape (n, 2), that are good to a pixel or two.

    Parameters
    ----------
    light : ndarray, shape (height, width)
        Image less background.
    noise : ndarray, shape (height, width)
        Standard deviation of its pixels without stars.
    uv : ndarray, shape (n, 2)
        Where they are.
    covariance : ndarray, shape (n, 3)
        Of the star's image: uu, uv, vv, px^2.
    gain_e_per_unit : float
        Electrons that make one unit of the image; infinity leaves the photon noise of the stars out.
    white : ndarray, shape (height, width), optional
        Noise by the differences of neighbouring pixels, where `noise` is that of white pixels that scatter as much under a
        filter; the same unless given.
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
    """Ordered pairs (star, neighbour), shape (p, 2), whose light overlaps, sorted by star."""
    from scipy.spatial import cKDTree

    reach = 5.0 * float(np.sqrt(np.median(np.maximum(covariance[:, 0], covariance[:, 2]))))
    pairs = cKDTree(uv).query_pairs(reach, output_type="ndarray")
    both = np.concatenate((pairs, pairs[:, ::-1]))
    return both[np.argsort(both[:, 0], kind="stable")]


def _measure(
    light: F4,
    noise: F4,
    white: F4,
    uv: F8,
    covariance: F8,
    gain: float,
    reach: tuple[int, int],
    neighbours: NDArray[np.intp],
    start: int,
    stop: int,
) -> Measured:
    """Measure the stars of rows `start` to `stop`; the others stay where they were found."""
    first = uv[start:stop]
    shape = covariance[start:stop]
    cut, rows, columns = patches(light, first, reach)
    p, q, r = inverse(shape).T
    area = 2 * np.pi * np.sqrt(shape[:, 0] * shape[:, 2] - shape[:, 1] ** 2)
    low, high = np.searchsorted(neighbours[:, 0], [start, start + len(first)])
    pairs = neighbours[low:high]
    crowd: F8 = np.zeros(len(first))
    if len(pairs):
        own, other = pairs[:, 0] - start, pairs[:, 1]
        peaks = np.maximum(_values_at(light, uv[other]), 0)
        _take_off(cut, own, _gaussians(uv[other], covariance[other], rows[own], columns[own]) * peaks[:, None, None])
        apart = uv[other] - first[own]
        square = p[own] * apart[:, 0] ** 2 + 2 * q[own] * apart[:, 0] * apart[:, 1] + r[own] * apart[:, 1] ** 2
        crowding = peaks * np.sqrt(square) * np.exp(-0.25 * square)
        crowd = np.bincount(own, weights=crowding, minlength=len(first)).astype(np.float64)
    at = first.copy()
    limit = 2 * np.sqrt(np.maximum(shape[:, [0, 2]], 1.0))
    window = cut
    for _ in range(_ROUNDS):
        du, dv = (columns - at[:, :1])[:, None, :], (rows - at[:, 1:])[:, :, None]
        window = cut * _window(p, q, r, du, dv)
        total = _positive(window.sum(axis=(1, 2)))
        at[:, 0] += 2 * np.sum(window.sum(axis=1) * du[:, 0], axis=1) / total
        at[:, 1] += 2 * np.sum(window.sum(axis=2) * dv[:, :, 0], axis=1) / total
        np.clip(at, first - limit, first + limit, out=at)
    # What wanders off follows a neighbour's light: it stays where it was found.
    wandered = np.any(np.abs(at - first) > 0.75 * limit, axis=1)
    at = np.where(wandered[:, None], first, at)
    light_under = window.sum(axis=(1, 2))
    du, dv = columns - at[:, :1], rows - at[:, 1:]
    narrow, wide = _relative_axes(window, du, dv, p, q, r)
    flux = np.maximum(2 * light_under, 0.0)
    pixel = _values_at(noise, at)
    spread = np.sqrt((shape[:, 0] + shape[:, 2]) / 2)
    sigma = _sigma_px(flux, pixel, shape, area, gain)
    sigma = np.hypot(sigma, _LEFT_OF_NEIGHBOUR * spread * crowd / np.maximum(flux / area, 1e-30))
    sigma = np.hypot(np.minimum(sigma, 1.0 + np.sqrt(shape[:, [0, 2]].max(axis=1))), CENTROID_FLOOR_PX)
    # The variance of sum(w I): sum(w^2) is half of the star's area.
    snr = light_under / np.maximum(np.sqrt(pixel**2 * area / 2 + flux / (3 * gain)), 1e-30)
    star = _window(p, q, r, du[:, None, :], dv[:, :, None])
    photons = star * (flux / area / gain)[:, None, None]
    # Of correlated noise a single pixel has less than the window has: half of it in logarithm.
    single = pixel * np.maximum(_values_at(white, at), 1e-30)
    unlike, significance = unlikeness(cut, star, single[:, None, None] + photons)
    return Measured(at, flux, sigma, narrow, wide, snr, unlike, significance)


def _values_at(image: F4, uv: F8) -> F8:
    """Values of the pixels that hold positions, shape (n,)."""
    height, width = image.shape
    nearest = np.rint(uv).astype(np.intp)
    return image[nearest[:, 1].clip(0, height - 1), nearest[:, 0].clip(0, width - 1)].astype(np.float64)


def _positive(total: F8) -> F8:
    return np.where(total > 0, total, np.inf)


def _take_off(cut: F8, own: NDArray[np.intp], models: F8) -> None:
    """Subtract models, shape (p, rows, columns), from the windows that they belong to (rows of `cut`, ascending)."""
    starts = np.flatnonzero(np.diff(own, prepend=-1))
    cut[own[starts]] -= np.add.reduceat(models, starts, axis=0)


def _relative_axes(window: F8, du: F8, dv: F8, p: F8, q: F8, r: F8) -> tuple[F8, F8]:
    """Moments of the light under the window along its short and long axis over those expected, shapes (n,).

    Light and window of the same Gaussian S: the covariance of their product is S / 2, and these are eigenvalues of twice
    it over S.
    """
    by_column, by_row = window.sum(axis=1), window.sum(axis=2)
    total = _positive(by_row.sum(axis=1))
    uu, vv = np.sum(by_column * du * du, axis=1) / total, np.sum(by_row * dv * dv, axis=1) / total
    mixed = np.sum(np.einsum("nrc,nc->nr", window, du) * dv, axis=1) / total
    trace = p * uu + 2 * q * mixed + r * vv
    root = np.sqrt(np.maximum(trace**2 - 4 * (uu * vv - mixed**2) * (p * r - q * q), 0))
    return trace - root, trace + root


def _sigma_px(flux: F8, noise: F8, shape: F8, area: F8, gain: float) -> F8:
    """Standard deviation of windowed centroids of Gaussian stars from the noise of sky and star, shape (n,).

    The estimate 2 sum(w I x) / sum(w I) has the variance 4 sum(w^2 x^2 N^2) / sum(w I)^2. With S the star's covariance,
    w^2 is a Gaussian of S / 2, and w^2 times the star one of S / 3.
    """
    axis = (shape[:, 0] + shape[:, 2]) / 2
    sky = noise**2 * (area / 2) * axis / 2
    star = flux / gain / 3 * axis / 3
    return np.asarray(2 * np.sqrt(sky + star) / np.maximum(flux / 2, 1e-30))


def _window(p: F8, q: F8, r: F8, du: F8, dv: F8) -> F8:
    """Gaussian windows, shape (n, rows, columns); as a product where none is inclined."""
    if not np.abs(q).max() > 1e-3 * min(p.min(), r.min()):
        return np.asarray(np.exp(-0.5 * p[:, None, None] * du * du) * np.exp(-0.5 * r[:, None, None] * dv * dv))
    p, q, r = p[:, None, None], q[:, None, None], r[:, None, None]
    return np.asarray(np.exp(-0.5 * (p * du * du + 2 * q * du * dv + r * dv * dv)))


def _gaussians(uv: F8, covariance: F8, rows: NDArray[np.int64], columns: NDArray[np.int64]) -> F8:
    """Gaussians of unit peak on windows of pixels, shape (n, rows, columns)."""
    p, q, r = inverse(covariance).T
    return _window(p, q, r, (columns - uv[:, :1])[:, None, :], (rows - uv[:, 1:])[:, :, None])
