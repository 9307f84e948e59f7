"""Photometry of stars at known positions: signal-to-noise ratio of a matched filter, centroid, flux."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

Floats = NDArray[np.float64]

HALF_PX = 9
"""Half side of the square around a star."""
RING_PX = (5.0, 8.5)
"""Radii of the ring from which the sky and its noise are measured."""
APERTURE_PX = 3.5
NORMAL_MAD = 1.4826
CLIP = 3.0
"""Deviations at which a pixel of the ring (another star) is clipped when the slope of the sky is fitted."""
CENTROID_SNR = 5.0
"""Least signal-to-noise ratio of a star whose centroid is measured."""
CENTROID_ROUNDS = 3
USUAL_SIGMA_PX = 0.8
SIGMA_LIMITS_PX = (0.4, 3.0)
BRIGHT_SNR = 30.0
LEAST_BRIGHT = 10
AT_A_TIME = 2000


@dataclass(frozen=True, eq=False)
class Light:
    """Photometry of n stars; NaN where a star is too close to the frame's edge.

    Attributes
    ----------
    uv : (n, 2) array
        Centroids, px; also NaN below a signal-to-noise ratio of `CENTROID_SNR`.
    snr : (n,) array
        Signal-to-noise ratio of a matched filter of the star's shape at its position, over the noise of the sky around it,
        without the star's own photon noise.
    flux : (n,) array
        Flux within 3.5 px, above the sky, DN.
    highest : (n,) array
        Value of the brightest pixel, DN.
    """

    uv: Floats
    snr: Floats
    flux: Floats
    highest: Floats


def measure_light(pixels: NDArray[np.floating], uv: Floats) -> Light:
    """Measure stars at positions (n, 2), px.

    The filter is a Gaussian as wide as the frame's bright stars.
    """
    first = _measure(pixels, uv, USUAL_SIGMA_PX)
    sigma_px = _width(pixels, first)
    return first if sigma_px == USUAL_SIGMA_PX else _measure(pixels, uv, sigma_px)


def any_near(mask: NDArray[np.bool_], uv: Floats) -> NDArray[np.bool_]:
    """Whether a pixel of a mask lies within the aperture around the pixel of a position (n, 2), px; (n,)."""
    steps = np.arange(-int(APERTURE_PX), int(APERTURE_PX) + 1)
    v, u = np.meshgrid(steps, steps, indexing="ij")
    place = np.rint(np.where(np.isfinite(uv), uv, -1e6)).astype(np.int64)
    rows, columns = place[:, 1, None, None] + v, place[:, 0, None, None] + u
    height, width = mask.shape
    counted = (np.hypot(u, v) <= APERTURE_PX) & (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)
    found = mask[np.clip(rows, 0, height - 1), np.clip(columns, 0, width - 1)] & counted
    return np.asarray(found.any(axis=(1, 2)))


def _measure(pixels: NDArray[np.floating], uv: Floats, sigma_px: float) -> Light:
    found = Light(*(np.full(shape, np.nan) for shape in (uv.shape, len(uv), len(uv), len(uv))))
    height, width = pixels.shape
    start = np.rint(np.where(np.isfinite(uv), uv, -1e6)).astype(np.int64)
    inside = np.flatnonzero(((start >= HALF_PX) & (start < np.array([width, height]) - HALF_PX)).all(axis=1))
    for begin in range(0, len(inside), AT_A_TIME):
        rows = inside[begin : begin + AT_A_TIME]
        part = _measure_some(pixels, uv[rows], sigma_px)
        for name in ("uv", "snr", "flux", "highest"):
            getattr(found, name)[rows] = getattr(part, name)
    return found


def _measure_some(pixels: NDArray[np.floating], uv: Floats, sigma_px: float) -> Light:
    steps = np.arange(-HALF_PX, HALF_PX + 1)
    v, u = np.meshgrid(steps, steps, indexing="ij")
    place = np.rint(uv).astype(np.int64)
    square = pixels[place[:, 1, None, None] + steps[:, None], place[:, 0, None, None] + steps].astype(np.float64)
    ring = (np.hypot(u, v) >= RING_PX[0]) & (np.hypot(u, v) <= RING_PX[1])
    around, along = square[:, ring], np.column_stack((u[ring], v[ring])).astype(np.float64)
    level, scatter = _median_and_scatter(around)
    limit = CLIP * scatter[:, None]
    # The ring is symmetrical, so the level and the slopes of a plane are independent.
    slope = np.clip(around - level[:, None], -limit, limit) @ along / (along**2).sum(axis=0)
    flat = square - level[:, None, None] - slope[:, 0, None, None] * u - slope[:, 1, None, None] * v
    rest, noise = _median_and_scatter(flat[:, ring])
    flat -= rest[:, None, None]
    centre = uv - place
    weight = _gaussian(u, v, centre, sigma_px)
    with np.errstate(divide="ignore", invalid="ignore"):
        snr = (weight * flat).sum(axis=(1, 2)) / (noise * np.sqrt((weight**2).sum(axis=(1, 2))))
    for _ in range(CENTROID_ROUNDS):
        light = _gaussian(u, v, centre, sigma_px) * flat
        total = light.sum(axis=(1, 2))
        moved = np.column_stack(((light * (u - centre[:, 0, None, None])).sum(axis=(1, 2)),
                                 (light * (v - centre[:, 1, None, None])).sum(axis=(1, 2))))  # fmt: skip
        with np.errstate(divide="ignore", invalid="ignore"):
            # For a Gaussian weighted with its own shape, the moment is half of the displacement.
            centre = centre + np.clip(np.nan_to_num(2.0 * moved / total[:, None]), -1.0, 1.0)
    distance = np.hypot(u - centre[:, 0, None, None], v - centre[:, 1, None, None])
    flux = np.where(distance <= APERTURE_PX, flat, 0.0).sum(axis=(1, 2))
    near = np.where(np.hypot(u, v) <= APERTURE_PX, square, -np.inf)
    snr = np.where(np.isfinite(snr), snr, np.nan)
    sure = snr >= CENTROID_SNR
    return Light(np.where(sure[:, None], place + centre, np.nan), snr, flux, near.max(axis=(1, 2)))


def _median_and_scatter(values: Floats) -> tuple[Floats, Floats]:
    """Median of each row, and its standard deviation from the median absolute deviation."""
    level = np.median(values, axis=1)
    return level, NORMAL_MAD * np.median(np.abs(values - level[:, None]), axis=1)


def _gaussian(u: NDArray[np.int64], v: NDArray[np.int64], centre: Floats, sigma_px: float) -> Floats:
    squared = (u - centre[:, 0, None, None]) ** 2 + (v - centre[:, 1, None, None]) ** 2
    return np.asarray(np.exp(-squared / (2.0 * (sigma_px**2 + 1.0 / 12.0))))


def _width(pixels: NDArray[np.floating], found: Light) -> float:
    """Width, px, of the Gaussian with the bright stars' fraction of light in 3 x 3 pixels; the usual one if there are few."""
    bright = np.flatnonzero((found.snr > BRIGHT_SNR) & (found.flux > 0) & (found.highest < 0.9 * pixels.max()))
    if len(bright) < LEAST_BRIGHT:
        return USUAL_SIGMA_PX
    steps = np.arange(-HALF_PX, HALF_PX + 1)
    v, u = np.meshgrid(steps, steps, indexing="ij")
    place = np.rint(found.uv[bright]).astype(np.int64)
    square = pixels[place[:, 1, None, None] + steps[:, None], place[:, 0, None, None] + steps].astype(np.float64)
    sky = np.median(square[:, np.hypot(u, v) >= RING_PX[0]], axis=1)
    core = (np.abs(u) <= 1) & (np.abs(v) <= 1)
    share = float(np.median((square[:, core] - sky[:, None]).sum(axis=1) / found.flux[bright]))
    # A Gaussian has erf(1.5 / (sqrt(2) s))^2 of its light in that square, averaged here around the star's centre.
    trial = np.linspace(*SIGMA_LIMITS_PX, 261)
    return float(trial[np.argmin(np.abs(erf(1.5 / (np.sqrt(2.0) * trial)) ** 2 - share))])
