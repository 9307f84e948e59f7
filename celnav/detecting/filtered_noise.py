"""The noise under the matched filter as it is: correlated by video or compression, and the texture of what is not sky.

The scatter of the filtered image itself is measured, tile by tile, on both sides of its median. Noise and texture are on
both; faint stars are above alone, the hollows that the filter leaves around bright ones below alone: the smaller side counts.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from celnav.detecting.image_background import medians
from celnav.detecting.star_shape import Filtered
from celnav.detecting.tiles import Tiles

F4 = NDArray[np.float32]
Mask = NDArray[np.bool_]

# Clipped at three standard deviations a normal distribution keeps this part of its own.
_CLIP, _CLIPPED_NORMAL = np.float32(3.0), np.float32(0.98658)
# A single tile counts by itself where it exceeds its neighbours' median by this factor, three sigma of the estimate.
_OWN = 1.4
# Variance, over that of white noise, that the hollows around stars add where one of 50 sigma stands in every 24 x 24 pixels.
_HOLLOWS = np.float32(0.25)
_LEAST_NOISE = np.float32(1e-30)


def noise_ratio(filtered: Filtered, noise: F4, floor: float, used: Mask, tiles: Tiles) -> F4:
    """How much more the filtered image scatters than white noise would, at least 1.

    Parameters
    ----------
    filtered : Filtered
        The image under the matched filter.
    noise : ndarray, shape (height, width)
        Standard deviation of its pixels, by the differences of neighbours.
    floor : float
        Least noise that is assumed; where it is, there is none to be measured.
    used : ndarray of bool, shape (height, width)
        Pixels that count.
    tiles : Tiles
        Where it is measured.

    Returns
    -------
    ndarray of float32, shape (height, width)
    """
    amplitude = tiles.spread_samples(filtered.amplitude)
    white = tiles.spread_samples(noise)
    counted = np.asarray(white > np.float32(1.001 * floor))
    if not used.all():
        counted &= tiles.spread_samples(used)
    white = np.maximum(white, _LEAST_NOISE)
    if filtered.noise_factor.size > 1:
        white = white * tiles.spread_samples(filtered.noise_factor)
    else:
        white = white * filtered.noise_factor[0, 0]
    relative = np.asarray(amplitude / white, dtype=np.float32)
    from_median = relative - medians(relative, counted)[:, None]
    spreads = [_one_sided(sign * from_median, counted, tiles) for sign in (np.float32(1), np.float32(-1))]
    alike = np.minimum(*(tiles.smooth(spread) for spread in spreads))
    own = np.minimum(*spreads)
    ratio = np.maximum(alike, own / np.float32(_OWN))
    return tiles.interpolated(np.sqrt(np.maximum(ratio * ratio - _HOLLOWS, 1)), extrapolated=False)


def _one_sided(deviation: F4, counted: Mask, tiles: Tiles) -> F4:
    """Standard deviation of a normal distribution by one side of it, as a grid of tiles."""
    side = counted & (deviation > 0)
    limit = _CLIP * np.float32(1.4826) * medians(deviation, side)
    side &= deviation <= limit[:, None]
    number = side.sum(axis=1)
    inside = deviation * side
    square = np.einsum("ij,ij->i", inside, inside) / np.maximum(number, 1)
    spread = np.where(number > 0, np.sqrt(square) / _CLIPPED_NORMAL, np.nan)
    return tiles.filled(np.asarray(spread, dtype=np.float32), 2 * number)
