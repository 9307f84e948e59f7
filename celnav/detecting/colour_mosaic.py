"""The pattern that a coloured sky leaves in the mosaic of a colour sensor: every second pixel of every second row is alike.

A raw frame of such a sensor under a town's sky alternates by more than its noise, which hides stars and passes for noise. The
four sets of pixels are brought to one level, tile by tile; a frame whose sets do not differ is left as it is.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from celnav.detecting.image_background import medians
from celnav.detecting.tiles import Tiles

F4 = NDArray[np.float32]
Mask = NDArray[np.bool_]

_SETS = ((0, 0), (0, 1), (1, 0), (1, 1))
# A difference counts beyond so many standard deviations of chance, and beyond this part of a pixel's noise.
_SIGMAS, _LEAST_PART = 8.0, 0.1
_CLIP = np.float32(3.0)
_LEAST_SIDE_PX = 64


def level_mosaic(pixels: F4, used: Mask, tile_px: int) -> F4:
    """Take the mosaic's pattern off an image; the image itself where there is none.

    Parameters
    ----------
    pixels : ndarray, shape (height, width)
        Brightness.
    used : ndarray of bool, shape (height, width)
        Pixels that count.
    tile_px : int
        Side of the tiles, in pixels of one set.
    """
    if min(pixels.shape) < _LEAST_SIDE_PX:
        return pixels
    even = pixels[: pixels.shape[0] // 2 * 2, : pixels.shape[1] // 2 * 2]
    tiles = Tiles.of((even.shape[0] // 2, even.shape[1] // 2), tile_px)
    levels, scatters, known = [], [], np.ones(tiles.shape[0] * tiles.shape[1], dtype=bool)
    for row, column in _SETS:
        samples = tiles.spread_samples(even[row::2, column::2])
        counted = tiles.spread_samples(used[row::2, column::2][: even.shape[0] // 2, : even.shape[1] // 2])
        known &= counted.all(axis=1)
        off = samples - medians(samples, counted)[:, None]
        spread = np.float32(1.4826) * medians(np.abs(off), counted)
        kept = counted & (np.abs(off) <= _CLIP * np.maximum(spread, np.float32(1e-6))[:, None] + np.float32(0.5))
        number = np.maximum(kept.sum(axis=1), 1)
        levels.append(np.where(kept, samples, 0).sum(axis=1) / number)
        scatters.append(np.sqrt(np.where(kept, off * off, 0).sum(axis=1) / number))
    if not known.any():
        return pixels
    differences = np.stack(levels) - np.mean(levels, axis=0)
    noise = float(np.median(np.stack(scatters)[:, known]))
    size = np.abs(np.median(differences[:, known], axis=1)).max()
    chance = noise / math.sqrt(samples.shape[1] * int(known.sum()))
    if not size > max(_SIGMAS * chance, _LEAST_PART * noise):
        return pixels
    levelled = pixels.copy()
    enough = np.where(known, samples.shape[1], 0)
    for (row, column), difference in zip(_SETS, differences, strict=True):
        grid = tiles.smooth(tiles.filled(difference.astype(np.float32), enough))
        part = levelled[row::2, column::2]
        pattern = tiles.interpolated(grid, extrapolated=False)
        fill = [(0, whole - own) for whole, own in zip(part.shape, pattern.shape, strict=True)]
        part -= np.pad(pattern, fill, mode="edge")
    return levelled
