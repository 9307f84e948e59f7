"""Previews: frames stretched such that faint and bright stars are both visible, and contact sheets of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from PIL import Image


def stretch(dn: NDArray[np.generic]) -> NDArray[np.uint8]:
    """Convert linear data to an 8-bit picture: arcsinh in units of the sky's spread.

    Parameters
    ----------
    dn : (height, width) array
        DN or electrons.

    Returns
    -------
    (height, width) uint8 array
    """
    value = np.asarray(dn, dtype=np.float64)
    sky = np.median(value)
    low, high = np.percentile(value, [25, 75])
    spread = max(high - low, 1e-3 * max(abs(sky), 1.0))
    bright = np.arcsinh(max(value.max() - sky, spread) / spread)
    level = np.arcsinh((value - sky + 0.3 * spread) / spread) / bright
    return np.rint(255 * np.clip(1.15 * level, 0, 1)).astype(np.uint8)


def contact_sheet(frames: Sequence[NDArray[np.generic]], columns: int = 4, width: int = 300) -> Image.Image:
    """Lay stretched frames out on one sheet, row by row, each `width` pixels wide."""
    tiles = []
    for frame in frames:
        picture = Image.fromarray(stretch(frame))
        height = round(picture.height * width / picture.width)
        tiles.append(picture.resize((width, height), Image.Resampling.LANCZOS))
    tall = max(tile.height for tile in tiles)
    rows = -(-len(tiles) // columns)
    gap = 4
    sheet = Image.new("L", (min(columns, len(tiles)) * (width + gap) - gap, rows * (tall + gap) - gap), 255)
    for position, tile in enumerate(tiles):
        sheet.paste(tile, ((position % columns) * (width + gap), (position // columns) * (tall + gap)))
    return sheet
