"""The actual noise under the matched filter, which includes correlations from video or compression, and texture of non-sky.

The scatter of the filtered image itself is measured, tile by tile, on both sides of its median. Noise and texture appear on
both sides; faint stars only above, and the hollows that the filter leaves around bright stars only below. The smaller side
therefore counts.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from celnav.detecting.matched_filter import Filtered
from celnav.detecting.noise_map import NoiseMap
from celnav.detecting.row_statistics import all_true, count_true
from celnav.detecting.tiles import TileMap, Tiles, smooth

F4 = NDArray[np.float32]
Mask = NDArray[np.bool_]

# Standard deviation of a normal distribution after clipping at three standard deviations, as a fraction of its own.
_CLIP, _CLIPPED_NORMAL = np.float32(3.0), np.float32(0.98658)
# A single tile counts on its own if it exceeds the median of its neighbours by this factor, three sigma of the estimate.
_OWN = 1.4
# And if it falls short of the median by this one, as clear sky between clouds does.
_OWN_LESS = 1.6
# Variance, relative to white noise, that the hollows around stars add if every 24 x 24 pixels contain a star of 50 sigma.
_HOLLOWS = np.float32(0.25)
_LEAST_NOISE = np.float32(1e-30)


def noise_ratio(filtered: Filtered, noise: NoiseMap, used: Mask, tiles: Tiles) -> TileMap:
    """Return the factor by which the filtered image scatters more than white noise would, at least 1.

    Parameters
    ----------
    filtered : Filtered
        The image under the matched filter.
    noise : NoiseMap
        Standard deviation of its pixels, from the differences of neighbours. Where it equals the assumed minimum, there is
        no noise to measure.
    used : ndarray of bool, shape (height, width)
        Pixels to use.
    tiles : Tiles
        Tiles in which the scatter is measured.
    """
    relative = tiles.spread_samples(filtered.amplitude)
    white = tiles.spread_samples_of(noise)
    counted = np.asarray(white > np.float32(1.001 * noise.least))
    if not all_true(used):
        counted &= tiles.spread_samples(used)
    np.maximum(white, _LEAST_NOISE, out=white)
    if filtered.noise_factor.size > 1:
        white *= tiles.spread_samples(filtered.noise_factor)
    else:
        white *= filtered.noise_factor[0, 0]
    relative /= white
    number = count_true(counted)
    if number.min() < counted.shape[1]:
        relative[~counted] = np.inf
    relative.sort(axis=1)
    spreads = _one_sided(relative, number, tiles)
    alike, own = smooth(spreads).min(axis=0), spreads.min(axis=0)
    ratio = np.clip(alike, own / np.float32(_OWN), own * np.float32(_OWN_LESS))
    return tiles.map_of(np.sqrt(np.maximum(ratio * ratio - _HOLLOWS, 1)), extrapolated=False)


def _one_sided(ordered: F4, number: NDArray[np.int_], tiles: Tiles) -> F4:
    """Return standard deviations of normal distributions, estimated from the upper and the lower sides, as grids of tiles.

    Parameters
    ----------
    ordered : ndarray, shape (tiles, samples)
        Samples in ascending order; unused ones are infinite.
    number : ndarray of int, shape (tiles,)
        Number of used samples.
    """
    row = np.arange(len(ordered))
    middle = ordered[row, np.minimum(number // 2, ordered.shape[1] - 1)]
    with np.errstate(invalid="ignore"):  # tiles without any sample are unknown
        deviation = ordered - middle[:, None]
    whole = bool((number == ordered.shape[1]).all())
    if not whole:
        deviation[np.arange(ordered.shape[1]) >= number[:, None]] = 0
    below, above = count_true(deviation < 0), count_true(deviation > 0)
    # Upper medians of the deviations of each side.
    typical = (
        deviation[row, np.minimum(number - above + above // 2, ordered.shape[1] - 1)],
        -deviation[row, np.maximum(below - 1 - below // 2, 0)],
    )
    spreads = []
    # If all samples are used, the middle one separates the two sides.
    half = ordered.shape[1] // 2 if whole else None
    sides = (
        (deviation[:, half:], above, typical[0]),
        (-deviation[:, :half], below, typical[1]),
    )
    for side, count, usual in sides:
        limit = _CLIP * np.float32(1.4826) * usual
        within = side > 0
        within &= side <= limit[:, None]
        inside, kept = side * within.astype(np.float32), count_true(within)
        square = np.einsum("ij,ij->i", inside, inside) / np.maximum(kept, 1)
        spread = np.where(count > 0, np.sqrt(square) / _CLIPPED_NORMAL, np.nan)
        spreads.append(tiles.filled(np.asarray(spread, dtype=np.float32), 2 * kept))
    return np.stack(spreads)
