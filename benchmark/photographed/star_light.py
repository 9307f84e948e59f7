"""Photometry of stars at known positions: with the same apertures in a photograph and in its twin."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

HALF_PX = 14
"""Half side of the square around a star that is examined."""
APERTURE_PX = 3.5
SKY_PX = (8.0, 13.5)
"""Radii of the ring whose median is the sky and whose scatter is the noise."""
NORMAL_MAD = 1.4826
COARSE_DN = 3.0
"""Scatter below which the median absolute deviation, which moves in whole steps of the DN, is too coarse: 0 for most of an
8-bit stack's rings of 0.6 DN."""
CLIP = 4.0
"""Largest deviation of pixels whose standard deviation is taken then, in units of the coarse scatter (of 1 DN at least)."""


@dataclass(frozen=True, eq=False)
class StarLight:
    """Photometry of n stars; NaN for those too close to the frame's edge.

    Attributes
    ----------
    uv : (n, 2) array
        Centroids of the light within the aperture, px.
    flux : (n,) array
        Flux within the aperture, above the sky, DN.
    sky, noise : (n,) arrays
        Median of the ring's pixels, and their standard deviation from the median absolute deviation, DN; where that is below
        `COARSE_DN`, from the pixels without outliers.
    peak : (n,) array
        Value of the brightest pixel of the aperture, DN.
    nearest_share : (n,) array
        Fraction of the flux in the brightest pixel.
    """

    uv: Floats
    flux: Floats
    sky: Floats
    noise: Floats
    peak: Floats
    nearest_share: Floats

    @property
    def snr(self) -> Floats:
        """Flux over the sky's noise in the aperture (pi 3.5^2 pixels), without the photon noise of the star."""
        return np.asarray(self.flux / self.flux_at(1.0))

    def flux_at(self, snr: float) -> Floats:
        """Flux that corresponds to an SNR, (n,)."""
        return np.asarray(snr * self.noise * np.sqrt(np.pi) * APERTURE_PX)


def star_light(
    pixels: NDArray[np.floating], uv: Floats, search_px: float = 0.0, aperture_px: float = APERTURE_PX
) -> StarLight:
    """Measure stars at positions (n, 2); with `search_px`, around the brightest pixel within that distance."""
    height, width = pixels.shape
    n = len(uv)
    start = np.rint(np.where(np.isfinite(uv), uv, -1e6)).astype(np.int64)
    margin = HALF_PX + int(np.ceil(search_px))
    inside = ((start >= margin) & (start < np.array([width, height]) - margin)).all(axis=1)
    found = StarLight(np.full((n, 2), np.nan), *(np.full(n, np.nan) for _ in range(5)))
    if not inside.any():
        return found
    centre = uv[inside]
    if search_px:
        around = squares(pixels, np.rint(centre).astype(np.int64), margin - HALF_PX)
        centre = centre + _brightest(around, centre, search_px)
    place = np.rint(centre).astype(np.int64)
    square = squares(pixels, place, HALF_PX).astype(np.float64)
    v, u = np.mgrid[-HALF_PX : HALF_PX + 1, -HALF_PX : HALF_PX + 1]
    du, dv = (u - (centre - place)[:, 0, None, None], v - (centre - place)[:, 1, None, None])
    distance = np.hypot(du, dv)
    ring = np.where((distance >= SKY_PX[0]) & (distance <= SKY_PX[1]), square, np.nan)
    sky = np.nanmedian(ring, axis=(1, 2))
    noise = _scatter(ring - sky[:, None, None])
    light = np.where(distance <= aperture_px, square - sky[:, None, None], 0.0)
    flux, peak = light.sum(axis=(1, 2)), light.max(axis=(1, 2))
    weight = np.maximum(light, 0.0)
    total = np.maximum(weight.sum(axis=(1, 2)), 1e-9)
    found.uv[inside, 0] = place[:, 0] + (weight * u).sum(axis=(1, 2)) / total
    found.uv[inside, 1] = place[:, 1] + (weight * v).sum(axis=(1, 2)) / total
    found.flux[inside], found.sky[inside], found.noise[inside] = flux, sky, np.maximum(noise, 1e-6)
    found.peak[inside] = peak + sky
    found.nearest_share[inside] = peak / np.where(np.abs(flux) > 1e-9, flux, np.nan)
    return found


def _scatter(deviations: Floats) -> Floats:
    """Standard deviation, (n,), of the numbers in each of n squares that are not NaN, without outliers."""
    away = np.abs(deviations)
    scatter = NORMAL_MAD * np.nanmedian(away, axis=(1, 2))
    coarse = scatter < COARSE_DN
    if coarse.any():
        near = away[coarse] <= CLIP * np.maximum(scatter[coarse], 1.0)[:, None, None]
        scatter[coarse] = np.nanstd(np.where(near, deviations[coarse], np.nan), axis=(1, 2))
    return np.asarray(scatter)


def isolated(uv: Floats, v_mag: Floats, within_px: float = 8.0, fainter_mag: float = 2.5) -> NDArray[np.bool_]:
    """Find the stars without another one within a distance that is brighter than their magnitude plus `fainter_mag`; (n,)."""
    from scipy.spatial import cKDTree

    known = np.asarray(np.isfinite(uv).all(axis=1))
    alone = known.copy()
    index = np.flatnonzero(known)
    if not len(index):
        return alone
    pairs = cKDTree(uv[index]).query_pairs(within_px, output_type="ndarray")
    one, other = index[pairs[:, 0]], index[pairs[:, 1]]
    alone[one[v_mag[other] < v_mag[one] + fainter_mag]] = False
    alone[other[v_mag[one] < v_mag[other] + fainter_mag]] = False
    return alone


def squares(pixels: NDArray[np.floating], place: NDArray[np.int64], half: int) -> NDArray[np.floating]:
    """Squares (n, 2 half + 1, 2 half + 1) around pixels (n, 2)."""
    steps = np.arange(-half, half + 1)
    return pixels[place[:, 1, None, None] + steps[:, None], place[:, 0, None, None] + steps]


def _brightest(around: NDArray[np.floating], centre: Floats, search_px: float) -> Floats:
    """Displacements (n, 2) from centres to the brightest pixel of squares within a distance."""
    half = around.shape[1] // 2
    v, u = np.mgrid[-half : half + 1, -half : half + 1]
    far = np.hypot(u, v) > search_px
    best = np.argmax(np.where(far, -np.inf, around).reshape(len(around), -1), axis=1)
    rounded = np.rint(centre)
    return np.column_stack((u.ravel()[best], v.ravel()[best])) + rounded - centre
