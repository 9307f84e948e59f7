"""Star detection by flood fill above a brightness threshold, as in the thesis (section 4.iii)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from celnav.checking import bounded, check_fields
from celnav.detecting.image_background import as_image, background_and_noise, grey, used_pixels
from celnav.detecting.tiles import Tiles
from celnav.errors import ConfigError

F8 = NDArray[np.float64]


@dataclass(frozen=True)
class FloodFillConfig:
    """Configuration of the flood fill.

    Attributes
    ----------
    seed_sigma : float
        Threshold: a star has a pixel this many noise standard deviations above the background.
    grow_sigma : float
        Threshold above which the flood fill adds neighbouring pixels.
    min_area_px, max_area_px : int
        Limits of a component's area: smaller ones are hot pixels; larger ones are the Moon, clouds and lamps.
    tile_px : int
        Side of the tiles in which background and noise are estimated.
    weighted : bool
        Whether the centroid is weighted by brightness; otherwise it is the mean position of the component's pixels.
    """

    seed_sigma: float = 5.0
    grow_sigma: float = 2.5
    min_area_px: int = bounded(2, 1)
    max_area_px: int = 1000
    tile_px: int = bounded(32, 4)
    weighted: bool = True

    def __post_init__(self) -> None:
        check_fields(self)
        if not 0 < self.grow_sigma <= self.seed_sigma:
            raise ConfigError("flood fill needs 0 < grow_sigma <= seed_sigma")
        if self.min_area_px > self.max_area_px:
            raise ConfigError("flood fill needs min_area_px <= max_area_px")


def flood_fill(image: ArrayLike, mask: ArrayLike | None, config: FloodFillConfig) -> tuple[F8, F8, tuple[int, int]]:
    """Return positions (n, 2) and fluxes (n,), brightest first, and the image's height and width; see `celnav.detect`."""
    from scipy import ndimage

    original = as_image(image)
    pixels = grey(original)
    used = used_pixels(pixels, mask)
    size = (pixels.shape[0], pixels.shape[1])
    nothing = np.empty((0, 2)), np.empty(0), size
    if not used.any():
        return nothing
    tiles = Tiles.of(size, config.tile_px)
    background, noise = (each.whole() for each in background_and_noise(pixels, used, tiles))
    light = pixels - background
    light[~used] = 0.0
    # In noise-free images the noise is zero; the floor is one step for integers, and the rounding error for other numbers.
    whole = np.issubdtype(original.dtype, np.integer)
    floor = 1.0 if whole else max(1e-4 * float(light.max()), 4e-6 * float(np.abs(pixels).max()))
    if light.max() <= 0:
        return nothing
    labels, n = ndimage.label(light > np.maximum(config.grow_sigma * noise, floor), structure=np.ones((3, 3)))
    if n == 0:
        return nothing
    rows, columns = np.nonzero(labels)
    label, values = labels[rows, columns], light[rows, columns].astype(np.float64)
    seed_level = np.maximum(config.seed_sigma * noise, floor)[rows, columns]
    area = np.bincount(label, minlength=n + 1)
    good = np.bincount(label, weights=values > seed_level, minlength=n + 1) > 0
    good &= (area >= config.min_area_px) & (area <= config.max_area_px)
    good[0] = False
    weight = values if config.weighted else np.ones_like(values)
    total = np.bincount(label, weights=weight, minlength=n + 1)[good]
    u = np.bincount(label, weights=weight * columns, minlength=n + 1)[good] / total
    v = np.bincount(label, weights=weight * rows, minlength=n + 1)[good] / total
    flux = np.asarray(np.bincount(label, weights=values, minlength=n + 1)[good], dtype=np.float64)
    order = np.argsort(-flux, kind="stable")
    return np.column_stack((u, v))[order], flux[order], size
