"""Processor time of the default solver: from centroids, from an image, and from an image of 61 megapixels."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

import celnav
from benchmark.fields.solver_fields import HEIGHT, WIDTH, Condition, make_field
from benchmark.judge.geodesy import geodesic_km

SPEED = Condition("speed", noise_px=0.5)
# A full-frame camera of 61 megapixels: fields of 1080 x 720 pixels, enlarged.
LARGE = Condition("61 megapixels", hfov_deg=60.0, v_max=9.0)
ENLARGED = 8.8
LARGE_WIDTH, LARGE_HEIGHT = 9504, 6336
# Its stars: their standard deviation, and their peak at V = 6 above a sky of 400 DN. They are visible to V 11.5.
_LARGE_SIGMA_PX, _LARGE_PEAK_DN, _LARGE_SKY_DN = 1.3, 3090.0, 400.0
# Stars beyond the catalogue's V 9 are drawn at random, 2.8 times as many with every magnitude.
_FAINTEST_V, _GROWTH_DEX = 12.5, 0.45
_HOT_PIXELS = 2000


def image_of(condition: Condition, seed: int, number: int) -> np.ndarray:
    """Make a 16-bit image of a field: Gaussians of 1 px standard deviation on a sky of 400 DN, with photon noise."""
    field = make_field(condition, seed, number)
    rng = np.random.default_rng([seed, number, 1])
    image = np.full((HEIGHT, WIDTH), 400.0)
    grid = np.arange(-5, 6)
    for (u, v), flux in zip(field.uv, field.flux, strict=True):
        column, row = round(u), round(v)
        columns, rows = column + grid, row + grid
        star = np.exp(-0.5 * ((columns - u)[None, :] ** 2 + (rows - v)[:, None] ** 2))
        good_rows, good_columns = (rows >= 0) & (rows < HEIGHT), (columns >= 0) & (columns < WIDTH)
        image[np.ix_(rows[good_rows], columns[good_columns])] += 6e4 * flux * star[np.ix_(good_rows, good_columns)]
    return np.clip(rng.poisson(image), 0, 65535).astype(np.uint16)


def large_image_of(seed: int, number: int) -> NDArray[np.uint16]:
    """Make a 16-bit image of 9504 x 6336 pixels of a field of `LARGE`: a sloping sky, noise, stars to V 12.5, hot pixels."""
    field = make_field(LARGE, seed, number)
    rng = np.random.default_rng([seed, number, 2])
    more = 10 ** (_GROWTH_DEX * (_FAINTEST_V - LARGE.v_max)) - 1
    faint = rng.random(round(more * len(field.uv)))
    v_mag = np.concatenate((-2.5 * np.log10(field.flux), LARGE.v_max + np.log10(1 + faint * more) / _GROWTH_DEX))
    uv = np.concatenate(
        ((field.uv + 0.5) * ENLARGED - 0.5, rng.uniform(0, 1, (len(faint), 2)) * [LARGE_WIDTH, LARGE_HEIGHT])
    )
    rows, columns = np.arange(LARGE_HEIGHT)[:, None] / LARGE_HEIGHT, np.arange(LARGE_WIDTH) / LARGE_WIDTH
    image = np.asarray(_LARGE_SKY_DN * (1 + 0.3 * rows + 0.1 * columns), dtype=np.float32)
    grid = np.arange(-8, 9)
    for (u, v), peak in zip(uv, _LARGE_PEAK_DN * 10 ** (-0.4 * (v_mag - 6)), strict=True):
        column, row = round(u), round(v)
        if 8 <= column < LARGE_WIDTH - 8 and 8 <= row < LARGE_HEIGHT - 8:
            star = np.exp(
                -0.5 * ((column + grid - u)[None, :] ** 2 + (row + grid - v)[:, None] ** 2) / _LARGE_SIGMA_PX**2
            )
            image[row - 8 : row + 9, column - 8 : column + 9] += peak * star
    image += np.sqrt(image) * rng.standard_normal(image.shape, dtype=np.float32)
    image[rng.integers(0, LARGE_HEIGHT, _HOT_PIXELS), rng.integers(0, LARGE_WIDTH, _HOT_PIXELS)] += rng.exponential(
        3000, _HOT_PIXELS
    )
    return np.clip(np.rint(image), 0, 65535).astype(np.uint16)


@dataclass(frozen=True, eq=False)
class LargeImages:
    """Times from images of 61 megapixels to the fix, shape (n,); median detections, and median error (NaN for a refusal)."""

    time_ms: NDArray[np.float64]
    detections: float
    error_km: float


def large_image_times_ms(n_images: int, seed: int) -> LargeImages:
    """Time the path from an image of 61 megapixels to the fix; each time is the least of three."""
    camera = celnav.Camera("pinhole", LARGE_WIDTH, LARGE_HEIGHT, f_px=ENLARGED * LARGE.f_px)
    times, numbers, errors = [], [], []
    for number in range(n_images):
        field, image = make_field(LARGE, seed, number), large_image_of(seed, number)
        attitude = celnav.Attitude.up(field.R_cam[:, 2])
        detections = celnav.detect(image)
        fix = celnav.solve(detections, camera, field.utc, attitude)
        numbers.append(len(detections))
        errors.append(geodesic_km(field.lat_deg, field.lon_deg, fix.lat_deg, fix.lon_deg) if fix.ok else math.nan)
        times.append(_least_ms(partial(_solve_image, image, camera, field.utc, attitude)))
    return LargeImages(np.array(times), float(np.median(numbers)), float(np.median(errors)))


def centroid_times_ms(n_fields: int, seed: int) -> np.ndarray:
    """Times of `celnav.solve` from centroids, 120 deg, V <= 6, with only the vertical; each is the least of three.

    The program cycles through the fields three times, so that no field meets what its own last solution left in a cache.
    """
    camera = celnav.Camera("pinhole", WIDTH, HEIGHT, f_px=SPEED.f_px)
    fields = [make_field(SPEED, seed, number) for number in range(n_fields + 2)]
    times = np.empty((3, len(fields)))
    for turn in times:
        for number, field in enumerate(fields):
            attitude = celnav.Attitude.up(field.R_cam[:, 2])
            start = time.thread_time()
            celnav.solve(field.uv, camera, field.utc, attitude, flux=field.flux)
            turn[number] = 1000 * (time.thread_time() - start)
    return np.asarray(times[:, 2:].min(axis=0))  # the first two load the tables


def image_times_ms(n_images: int, seed: int) -> np.ndarray:
    """Times from a 1080x720 16-bit image to the fix; each is the least of three."""
    camera = celnav.Camera("pinhole", WIDTH, HEIGHT, f_px=SPEED.f_px)
    times = []
    for number in range(n_images + 1):
        field, image = make_field(SPEED, seed, number), image_of(SPEED, seed, number)
        attitude = celnav.Attitude.up(field.R_cam[:, 2])
        times.append(_least_ms(partial(_solve_image, image, camera, field.utc, attitude)))
    return np.array(times[1:])


def _solve_image(image: np.ndarray, camera: celnav.Camera, utc: str, attitude: celnav.Attitude) -> celnav.Fix:
    return celnav.solve(celnav.detect(image), camera, utc, attitude)


def _least_ms(call: Callable[[], object]) -> float:
    best = math.inf
    for _ in range(3):
        start = time.thread_time()
        call()
        best = min(best, 1000 * (time.thread_time() - start))
    return best
