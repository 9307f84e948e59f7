"""Areas of constant value around the sky: a border, a bar, or the outside of an image circle."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from celnav.detecting.tiles import Tiles

F4 = NDArray[np.float32]
Mask = NDArray[np.bool_]

_BLOCK_PX = 8
# Least fraction of the frame in tiles without constant areas, which must be noisy: a dark sky without noise is not a border.
_LEAST_SKY = 0.1


def blank_border(pixels: F4, tiles: Tiles) -> Mask | None:
    """Find areas of one value that touch the frame's border; None if there are none.

    They cannot contain stars, nor sky whose level or noise could be measured. If the sky is so dark that its pixels have a
    single value too, nothing is taken for a border.

    Parameters
    ----------
    pixels : ndarray, shape (height, width)
        The image.
    tiles : Tiles
        Tiles of the image.
    """
    from scipy import ndimage

    same = tiles.same_value(pixels)
    if not same.any() or same.all():
        return None
    rows, columns = pixels.shape[0] // _BLOCK_PX, pixels.shape[1] // _BLOCK_PX
    if not rows or not columns:
        return None
    blocks = pixels[: rows * _BLOCK_PX, : columns * _BLOCK_PX].reshape(rows, _BLOCK_PX, columns * _BLOCK_PX)
    lowest = blocks.min(axis=1).reshape(rows, columns, _BLOCK_PX).min(axis=2)
    highest = blocks.max(axis=1).reshape(rows, columns, _BLOCK_PX).max(axis=2)
    labels, _ = ndimage.label(lowest == highest, structure=np.ones((3, 3)))
    edges = np.concatenate((labels[0], labels[-1], labels[:, 0], labels[:, -1]))
    painted = np.isin(labels, edges[edges > 0])
    square = np.ones((3, 3), dtype=bool)
    inner = ndimage.binary_erosion(painted, structure=square, border_value=1)
    if not inner.any():
        return None
    value = lowest[tuple(ndimage.distance_transform_edt(~inner, return_distances=False, return_indices=True))]
    near = ndimage.binary_dilation(inner, structure=square, iterations=2)
    fill = [(0, pixels.shape[axis] - side * _BLOCK_PX) for axis, side in ((0, rows), (1, columns))]
    value, near = (
        np.pad(part.repeat(_BLOCK_PX, axis=0).repeat(_BLOCK_PX, axis=1), fill, mode="edge") for part in (value, near)
    )
    blank = np.asarray(near & (pixels == value))
    of_sky = ~tiles.pairs(blank).any(axis=1)
    if of_sky.mean() < _LEAST_SKY or same[of_sky].mean() > _LEAST_SKY:
        return None
    return blank
