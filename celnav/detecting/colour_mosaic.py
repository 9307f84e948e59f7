"""Removal of the pattern that a coloured sky leaves in the mosaic of a colour sensor, with a period of two pixels.

In a raw frame of such a sensor under the sky of a town, neighbouring pixels differ by more than the noise; this hides stars
and is mistaken for noise. The four sets of pixels are brought to the same level, tile by tile. A frame whose sets do not
differ is left unchanged.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from celnav.detecting.row_statistics import all_true, count_true, medians, moments_within
from celnav.detecting.tiles import SAMPLES, Tiles, smooth

F4 = NDArray[np.float32]
F8 = NDArray[np.float64]
Mask = NDArray[np.bool_]

_SETS = ((0, 0), (0, 1), (1, 0), (1, 1))
# A difference is significant beyond this many standard deviations and this fraction of a pixel's noise.
_SIGMAS, _LEAST_PART = 8.0, 0.1
_CLIP = np.float32(3.0)
_LEAST_SIDE_PX = 64
_ENOUGH_TILES = 80
# Least number of usable samples of each set in a tile: a learnt mask contains hot pixels all over the frame.
_FEWEST = SAMPLES**2 // 2


def level_mosaic(pixels: F4, used: Mask, tile_px: int, step: float) -> F4:
    """Remove the mosaic pattern from an image; an image without one is returned unchanged.

    Parameters
    ----------
    pixels : ndarray, shape (height, width)
        Brightness.
    used : ndarray of bool, shape (height, width)
        Pixels to use.
    tile_px : int
        Side of the tiles, in pixels of one set.
    step : float
        Deviation up to which nothing is clipped: the step of an integer image, whose noise may be smaller.
    """
    if min(pixels.shape) < _LEAST_SIDE_PX:
        return pixels
    size = pixels.shape[0] // 2, pixels.shape[1] // 2
    # Just enough tiles to decide whether there is a pattern.
    coarse = Tiles.of(size, max(tile_px, math.isqrt(size[0] * size[1] // _ENOUGH_TILES)))
    some = _differences(pixels, used, coarse, step)
    if not some.known.any():
        return pixels
    largest = np.abs(np.median(some.values[:, some.known], axis=1)).max()
    chance = some.noise / math.sqrt(_FEWEST * int(some.known.sum()))
    if not largest > max(_SIGMAS * chance, _LEAST_PART * some.noise):
        return pixels
    tiles = Tiles.of(size, tile_px)
    found = _differences(pixels, used, tiles, step)
    levelled = pixels.copy()
    enough = np.where(found.known, SAMPLES**2, 0)
    for (row, column), difference in zip(_SETS, found.values, strict=True):
        grid = smooth(tiles.filled(difference.astype(np.float32), enough))
        part = levelled[row::2, column::2]
        pattern = tiles.map_of(grid, extrapolated=False).whole()
        fill = [(0, whole - own) for whole, own in zip(part.shape, pattern.shape, strict=True)]
        part -= np.pad(pattern, fill, mode="edge")
    return levelled


@dataclass(frozen=True, eq=False)
class _Differences:
    """Levels of the four pixel sets relative to their mean, shape (4, tiles); the usable tiles; and the pixel noise."""

    values: F8
    known: Mask
    noise: float


def _differences(pixels: F4, used: Mask, tiles: Tiles, step: float) -> _Differences:
    height, width = pixels.shape[0] // 2 * 2, pixels.shape[1] // 2 * 2
    sets = [(slice(row, height, 2), slice(column, width, 2)) for row, column in _SETS]
    samples = np.concatenate([tiles.spread_samples(pixels[each]) for each in sets])
    counted = np.ones(samples.shape, dtype=bool)
    if not all_true(used):
        counted = np.concatenate([tiles.spread_samples(used[each]) for each in sets])
    known = np.asarray((count_true(counted).reshape(len(sets), -1) >= _FEWEST).all(axis=0))
    middle = medians(samples, counted)
    off = samples - middle[:, None]
    spread = np.float32(1.4826) * medians(np.abs(off), counted)
    mean, square = moments_within(off, np.maximum(_CLIP * spread, np.float32(step)), counted)
    levels = (middle + mean).astype(np.float64).reshape(len(sets), -1)
    scatter = np.sqrt(square).reshape(len(sets), -1)
    noise = float(np.median(scatter[:, known])) if known.any() else 0.0
    return _Differences(levels - levels.mean(axis=0), known, noise)
