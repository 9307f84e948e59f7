"""Candidates for stars in an image: saturated cores and peaks of the filtered image; and trails, which are not stars."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from celnav.detecting.close_pairs import close_pairs
from celnav.detecting.connected import connected
from celnav.detecting.matched_filter import Filtered
from celnav.detecting.star_shape import StarShape, inverse
from celnav.detecting.tiles import PixelMap

F4 = NDArray[np.float32]
F8 = NDArray[np.float64]
Mask = NDArray[np.bool_]
Labels = NDArray[np.int32]

# Pixels this near to the highest value belong to a flat top.
_FLAT = 0.97
_LEAST_PLATEAU_PX = 4
# Light that lenses scatter around bright stars, as a fraction of their peak; fainter peaks there are not accepted.
_HALO = 0.01


@dataclass(frozen=True, eq=False)
class Components:
    """Connected pixels above a threshold that contain a peak above a higher threshold.

    Attributes
    ----------
    pixel, pixel_label : ndarray of int, shape (m,)
        Flat indices of the pixels above the threshold, in ascending order; and their components, numbered from 1.
    width : int
        Width of the image.
    uv : ndarray, shape (n, 2)
        Centroids, weighted by light.
    covariance : ndarray, shape (n, 3)
        Second moments uu, uv, vv of the light, px^2.
    flux : ndarray, shape (n,)
        Total light of each component.
    area : ndarray, shape (n,)
        Number of pixels of each component.
    label : ndarray, shape (n,)
        Numbers of the components in `pixel_label`.
    """

    pixel: NDArray[np.intp]
    pixel_label: Labels
    width: int
    uv: F8
    covariance: F8
    flux: F8
    area: NDArray[np.int64]
    label: NDArray[np.int64]

    def only(self, labels: Labels) -> Components:
        """Return the components with given labels; the list of pixels stays whole."""
        kept = np.isin(self.label, labels)
        return replace(
            self, uv=self.uv[kept], covariance=self.covariance[kept], flux=self.flux[kept], area=self.area[kept],
            label=self.label[kept],
        )  # fmt: skip

    def holding(self, uv: F8) -> Labels:
        """Return the components of the pixels nearest to positions inside the image, shape (n,); 0 for none."""
        if not len(self.pixel):
            return np.zeros(len(uv), dtype=np.int32)
        nearest = np.rint(uv).astype(np.intp)
        at = nearest[:, 1] * self.width + nearest[:, 0]
        place = np.minimum(np.searchsorted(self.pixel, at), len(self.pixel) - 1)
        return np.where(self.pixel[place] == at, self.pixel_label[place], np.int32(0))


@dataclass(frozen=True, eq=False)
class Cores:
    """Flat tops of saturated stars.

    Attributes
    ----------
    uv : ndarray, shape (n, 2)
        Centres of the flat tops.
    radius_px : ndarray, shape (n,)
        Radius of a circle with the same area.
    level : float
        Light at which they are flat; infinity if nothing is saturated.
    """

    uv: F8
    radius_px: F8
    level: float


def components(light: F4, above: NDArray[np.intp], seeded: Mask) -> Components:
    """Find connected pixels that contain a seed.

    Parameters
    ----------
    light : ndarray, shape (height, width)
        Image minus background.
    above : ndarray of int, shape (n,)
        Flat indices of the pixels above the lower threshold, in ascending order.
    seeded : ndarray of bool, shape (n,)
        Which of these are above the higher threshold.
    """
    width = light.shape[1]
    label, n = connected(above, width)
    rows = above // width
    columns = above - rows * width
    number = label.astype(np.intp)
    value = np.maximum(light.ravel().take(above).astype(np.float64), 0.0)
    area = np.bincount(number, minlength=n + 1)
    good = np.zeros(n + 1, dtype=bool)
    good[number[seeded]] = True
    flux: F8 = np.bincount(number, weights=value, minlength=n + 1).astype(np.float64, copy=False)
    good &= flux > 0
    good[0] = False

    def mean(quantity: F8) -> F8:
        return np.asarray(np.bincount(number, weights=value * quantity, minlength=n + 1) / np.maximum(flux, 1e-30))

    middle_u, middle_v = mean(columns.astype(np.float64)), mean(rows.astype(np.float64))
    du, dv = columns - middle_u.take(number), rows - middle_v.take(number)
    covariance = np.column_stack((mean(du * du), mean(du * dv), mean(dv * dv)))
    return Components(
        above, label, width, np.column_stack((middle_u, middle_v))[good], covariance[good], flux[good],
        area[good], np.flatnonzero(good),
    )  # fmt: skip


def saturated_pixels(pixels: F4, level: float | None) -> NDArray[np.intp]:
    """Return flat indices of the pixels within 3 % of the image's highest value, or above a given level.

    A bright sky that is entirely saturated, or an image of noise, has none.
    """
    of_rows = pixels.max(axis=1)
    highest = float(of_rows.max())
    least = float(np.median(pixels[::16, ::16]))
    threshold = highest - (1 - _FLAT) * (highest - least) if level is None else level
    rows = (of_rows >= threshold).nonzero()[0]
    row, column = (pixels.take(rows, axis=0) >= threshold).nonzero()
    at = rows.take(row) * pixels.shape[1] + column
    if highest <= least or len(at) > 0.01 * pixels.size:
        return at[:0]
    return at


def saturated_cores(at: NDArray[np.intp], light: F4) -> Cores:
    """Find flat tops among saturated pixels: four or more that are connected."""
    none = Cores(np.empty((0, 2)), np.empty(0), np.inf)
    if len(at) < _LEAST_PLATEAU_PX:
        return none
    label, n = connected(at, light.shape[1])
    area = np.bincount(label, minlength=n + 1)
    flat = np.flatnonzero(area >= _LEAST_PLATEAU_PX)
    if not len(flat):
        return none
    rows, columns = np.divmod(at, light.shape[1])
    middle = np.column_stack([np.bincount(label, weights=x, minlength=n + 1) for x in (columns, rows)])[flat]
    return Cores(middle / area[flat, None], np.sqrt(area[flat] / np.pi), float(np.median(light.ravel()[at])))


def trails(
    found: Components, filtered: F4, shape: StarShape, cores: Cores, least_length_px: float
) -> NDArray[np.int64]:
    """Return the labels of components that are trails: long, narrow, and bright over their whole length.

    Stars in a row are also long and narrow, but dark in between. Saturated stars, which may bloom along their column, are
    excluded.
    """
    own = shape.at(found.uv)
    rest = found.covariance - own
    root = np.hypot((rest[:, 0] - rest[:, 2]) / 2, rest[:, 1])
    large, small = (rest[:, 0] + rest[:, 2]) / 2 + root, (rest[:, 0] + rest[:, 2]) / 2 - root
    width = np.minimum(own[:, 0], own[:, 2]) + np.maximum(small, 0)
    # A line of length l has a variance of l^2 / 12.
    long = np.flatnonzero((12 * np.maximum(large, 0) > least_length_px**2) & (large > 9 * width))
    height, columns = filtered.shape
    saturated = set()
    if len(cores.uv):
        saturated = set(found.holding(np.clip(cores.uv, 0, [columns - 1, height - 1])).tolist())
    chosen = []
    for k in long:
        if int(found.label[k]) in saturated:
            continue
        angle = 0.5 * np.arctan2(2 * rest[k, 1], rest[k, 0] - rest[k, 2])
        along, across = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
        reach = 1.3 * np.sqrt(large[k])  # three quarters of the line
        steps = np.linspace(-reach, reach, max(9, int(2 * reach)))
        places = found.uv[k] + steps[:, None, None] * along + np.arange(-2, 3)[None, :, None] * across
        at = np.rint(places).astype(np.intp)
        ridge = np.sort(filtered[at[..., 1].clip(0, height - 1), at[..., 0].clip(0, columns - 1)].max(axis=1))
        low, high = np.interp([0.2 * (len(ridge) - 1), 0.8 * (len(ridge) - 1)], np.arange(len(ridge)), ridge)
        if low > 0.5 * high > 0:
            chosen.append(int(found.label[k]))
    return np.array(chosen, dtype=np.int64)


def peaks(filtered: Filtered, noise: PixelMap, above: NDArray[np.intp], used: Mask) -> tuple[F8, F8, F8]:
    """Return local maxima of the filtered image among pixels above a threshold, brightest first.

    Parameters
    ----------
    filtered : Filtered
        The image under the matched filter.
    noise : PixelMap
        Standard deviation of white pixel noise that is equivalent to its noise.
    above : ndarray of int, shape (n,)
        Flat indices of the pixels above the threshold.
    used : ndarray of bool, shape (height, width)
        Where peaks count.

    Returns
    -------
    tuple of three ndarrays
        Positions to a fraction of a pixel, shape (n, 2); amplitudes, shape (n,); and their standard deviations, shape (n,).
    """
    amplitude = filtered.amplitude
    height, width = amplitude.shape
    flat = amplitude.ravel()
    at, value = above, flat.take(above)
    for offset in (-1, -width, -width - 1, -width + 1):
        good = value > flat.take(at + offset, mode="clip")
        good &= value >= flat.take(at - offset, mode="clip")
        at, value = at[good], value[good]
    rows = at // width
    columns = at - rows * width
    inner = (rows > 0) & (rows < height - 1) & (columns > 0) & (columns < width - 1) & used[rows, columns]
    at, value = at[inner], value[inner]
    order = np.argsort(-value, kind="stable")
    at, brightness = at[order], value[order].astype(np.float64)
    rows, columns = np.divmod(at, width)
    place = np.column_stack((columns, rows)).astype(np.float64)
    for axis, offset in ((0, 1), (1, width)):
        before, after = flat[at - offset].astype(np.float64), flat[at + offset].astype(np.float64)
        bend = before - 2 * brightness + after
        place[:, axis] += np.clip(0.5 * (before - after) / np.minimum(bend, -1e-12), -0.5, 0.5)
    factor = filtered.noise_factor
    sigma = noise.at(rows, columns) * (factor[rows, columns] if factor.size > 1 else factor[0, 0])
    return place, brightness, sigma.astype(np.float64)


def without_flanks(uv: F8, amplitude: F8, sigma: F8, seed_sigma: float, shape: StarShape, cores: Cores) -> Mask:
    """Return which peaks, brightest first, stand out from the light of brighter neighbours and cores; shape (n,)."""
    if not len(uv) or len(uv) + len(cores.uv) < 2:
        return np.ones(len(uv), dtype=bool)
    own = shape.at(uv)
    reach = 4.5 * float(np.sqrt(np.median(np.maximum(own[:, 0], own[:, 2])))) + 1
    kept = np.ones(len(uv), dtype=bool)
    pairs = close_pairs(uv, reach)
    if len(pairs):
        bright, faint = pairs.min(axis=1), pairs.max(axis=1)
        d = uv[faint] - uv[bright]
        p, q, r = inverse(own[bright]).T
        distance2 = p * d[:, 0] ** 2 + 2 * q * d[:, 0] * d[:, 1] + r * d[:, 1] ** 2
        wing = amplitude[bright] * (1.2 * np.exp(-0.25 * distance2) + _HALO)
        excess = amplitude[faint] - wing
        lost = excess < seed_sigma * sigma[faint] + 0.25 * amplitude[bright] * np.exp(-0.25 * distance2)
        kept[faint[lost]] = False
    if len(cores.uv):
        from scipy.spatial import cKDTree

        distance, core = cKDTree(cores.uv).query(uv)
        sigma_px = np.sqrt((own[:, 0] + own[:, 2]) / 2)
        # Beyond the rim, the light falls off like the wing of a star.
        from_rim = np.maximum(distance - cores.radius_px[core], 0) / sigma_px
        wing = cores.level * (np.exp(-0.25 * from_rim**2 - 0.5 * from_rim) + _HALO)
        kept &= (distance > cores.radius_px[core] + 1.5 * sigma_px) & (
            (amplitude > 1.5 * wing + seed_sigma * sigma) | (distance > 4 * cores.radius_px[core] + 6 * sigma_px)
        )
    return kept
