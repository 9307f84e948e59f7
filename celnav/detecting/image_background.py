"""Preparation of the image: grey levels, background and noise maps, offsets of rows and columns, defective pixels."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from celnav.detecting.noise_map import NoiseMap
from celnav.detecting.row_statistics import CLIP, all_true, count_true, medians, moments_within, scatter_of_steps
from celnav.detecting.strips import strips
from celnav.detecting.tiles import SAMPLES, PixelMap, TileMap, Tiles, smooth
from celnav.errors import ImageError

F4 = NDArray[np.float32]
Mask = NDArray[np.bool_]
LARGEST_VALUE = 1e15

# Noise below one step appears as zero in some places, and as half a step where the sky is between two values. Half a step is
# this fraction of a difference of one step over the root of two.
_ROUNDED = np.float32(0.7)
# Least number of sampled pixels for the offset of a row or column.
_FEWEST_OF_LINE = 12
# Least mean of the four neighbours of a star's central pixel, as a fraction of its value, for a star of 0.5 px, the sharpest
# that a lens makes.
_SHARPEST = 0.12
# Pixels this many standard deviations from the background may be defects.
OUTSTANDING = 5.0


def as_image(image: ArrayLike) -> NDArray[np.generic]:
    """Return an image as an array of its own type.

    Raises `ImageError` for rows of different lengths, and for masked entries, which have no value (`unmasked`).
    """
    if np.ma.is_masked(image):
        raise ImageError("an image or a mask has masked entries: give plain arrays, and what is not used as mask=")
    try:
        return np.asarray(image)
    except ValueError:
        raise ImageError("image must be an array of (height, width) or (height, width, 3 or 4) numbers") from None


def unmasked(image: ArrayLike, mask: ArrayLike | None) -> tuple[ArrayLike, ArrayLike | None]:
    """Move the masked entries of a `numpy.ma` image into the mask.

    Parameters
    ----------
    image : array_like, shape (height, width) or (height, width, channels)
        The image.
    mask : array_like of bool, shape (height, width), optional
        True where the image is not used.

    Returns
    -------
    image, mask
        Unchanged for an image without masked entries. A masked entry that is NaN or infinite gets the median of the others.
    """
    if not np.ma.is_masked(image):
        return image, mask
    assert isinstance(image, np.ma.MaskedArray)
    entries: Mask = np.ma.getmaskarray(image)
    hidden = entries.any(axis=tuple(range(2, entries.ndim)))
    data = np.asarray(image.data)
    if np.issubdtype(data.dtype, np.floating) and (void := entries & ~np.isfinite(data)).any():
        usual = np.median(data[~entries]) if not entries.all() else 0.0
        data = np.where(void, usual, data).astype(data.dtype)
    if mask is not None:
        hidden = hidden | ~used_pixels(np.broadcast_to(np.float32(0), hidden.shape), mask)
    return data, hidden


def grey(image: NDArray[np.generic]) -> F4:
    """Return an image as one channel of float32; colours are averaged with Rec. 601 weights.

    Raises `ImageError` for a wrong shape or type, NaN, infinity, and values whose squares exceed single precision.
    """
    if image.dtype == np.bool_ or not np.issubdtype(image.dtype, np.number) or np.iscomplexobj(image):
        raise ImageError(f"image must hold real numbers, not {image.dtype}")
    # 16-bit integers are always within the bounds; 16-bit floats may be NaN or infinite.
    unbounded = image.dtype.itemsize > 2 or np.issubdtype(image.dtype, np.floating)
    if unbounded and image.size and not (float(image.min()) >= -LARGEST_VALUE and float(image.max()) <= LARGEST_VALUE):
        raise ImageError(
            f"image holds NaN, infinity or values above {LARGEST_VALUE:g}: replace them, or scale the image"
        )
    if image.ndim == 3 and image.shape[2] in (3, 4):
        values = image[:, :, :3].astype(np.float32) @ np.array([0.299, 0.587, 0.114], dtype=np.float32)
    elif image.ndim == 2:
        # Row-major order, however the image was rotated, because single pixels are addressed by their flat indices.
        values = image.astype(np.float32, order="C")
    else:
        raise ImageError(f"image has shape {image.shape}; it must be (height, width) or (height, width, 3 or 4)")
    if min(values.shape) < 3:
        raise ImageError(f"image of {values.shape[1]} x {values.shape[0]} pixels is too small")
    return np.asarray(values)


def used_pixels(pixels: F4, mask: ArrayLike | None) -> Mask:
    """Return where an image is to be used; raise `ImageError` for a mask that does not fit it."""
    if mask is None:
        return np.broadcast_to(np.True_, pixels.shape)
    ignored = as_image(mask)
    if ignored.shape != pixels.shape or ignored.dtype != np.bool_:
        raise ImageError(f"mask must be boolean of shape {pixels.shape}, true where the image is not to be used")
    return np.logical_not(ignored)


def step_of(pixels: F4) -> float:
    """Return the step between the values of an image that has few distinct ones; for any other image, almost zero.

    This is the second percentile of the nonzero differences between pixels and their second neighbours.
    """
    apart = np.abs(pixels[::7, 2::11] - pixels[::7, :-2:11])
    apart = np.sort(apart[apart > 0])
    return float(apart[len(apart) // 50]) if len(apart) else 0.0


def background_and_noise(pixels: F4, used: Mask, tiles: Tiles, step: float = 0.0) -> tuple[TileMap, TileMap]:
    """Estimate background and noise.

    They are clipped means of tiles, and standard deviations of the differences between neighbouring pixels along rows and
    columns, smoothed by a 3x3 median and interpolated bilinearly. Unused pixels do not count; a tile without used pixels
    takes the values of the nearest other tile. In an image with few distinct values, deviations of one step are never
    clipped, and the noise is at least half a step; `step` is that of the whole image (`step_of`), and zero disables this.
    """
    samples = tiles.pairs(pixels)
    counted = None if all_true(used) else tiles.pairs(used)
    blocks = samples.reshape(-1, SAMPLES, SAMPLES)
    counting = np.ones(blocks.shape, dtype=bool) if counted is None else counted.reshape(-1, SAMPLES, SAMPLES)
    down = scatter_of_steps(blocks, counting)
    along = scatter_of_steps(blocks.swapaxes(1, 2), counting.swapaxes(1, 2))
    number = down.number + along.number
    variance = (down.variance * down.number + along.variance * along.number) / np.maximum(number, 1)
    spread = np.asarray(np.where(number > 0, np.sqrt(variance), np.float32(np.nan)), dtype=np.float32)
    middle = medians(samples, counted)
    steps = np.maximum(down.step, along.step)
    np.maximum(spread, _ROUNDED * np.minimum(steps, np.float32(step)), out=spread, where=number > 0)
    limit = np.maximum(CLIP * spread, steps)
    offset, _ = moments_within(samples - middle[:, None], limit, counted)
    level = middle + offset
    whole = np.full(len(samples), samples.shape[1]) if counted is None else count_true(counted)
    levels, spreads = smooth(np.stack((tiles.filled(level, whole), tiles.filled(spread, number))))
    return tiles.map_of(levels), tiles.map_of(spreads, extrapolated=False)


def typical(values: PixelMap, used: Mask) -> float:
    """Return the median of a map over a sample of its used pixels, of which there is at least one."""
    rows, columns = (np.arange(0, side, 16) for side in used.shape)
    some = values.mesh(rows, columns)[used[::16, ::16]]
    return float(np.median(some if len(some) else values.at(*np.nonzero(used))))


def take_off(pixels: F4, background: TileMap, used: Mask) -> float:
    """Subtract the background in place, set unused pixels to zero, and return the highest remaining value."""
    highest, whole = -np.inf, all_true(used)
    for top, bottom in strips(*pixels.shape):
        strip = pixels[top:bottom]
        strip -= background.strip(top, bottom)
        if not whole:
            strip[~used[top:bottom]] = 0.0
        highest = max(highest, float(strip.max()))
    return highest


def highest_of_two(light: F4) -> float:
    """Return the highest value that two neighbouring pixels reach: a single pixel may be a defect."""
    pairs = ((light[:, :-1], light[:, 1:]), (light[:-1], light[1:]))
    return max((float(np.minimum(one, other).max()) for one, other in pairs if one.size), default=0.0)


def remove_line_offsets(light: F4, usual: float, used: Mask) -> F4:
    """Subtract common offsets of rows and columns if they are larger than by chance.

    Parameters
    ----------
    light : ndarray, shape (height, width)
        Image minus background.
    usual : float
        Typical standard deviation of its pixels.
    used : ndarray of bool, shape (height, width)
        Pixels to use. The light of the others is zero.
    """
    whole = all_true(used)
    for axis in (1, 0):
        lines, counted = (light, used) if axis == 1 else (light.T, used.T)
        if lines.shape[1] < 32:
            continue
        few = lines[:, :: max(1, lines.shape[1] // 120)]
        number = np.full(len(few), few.shape[1]) if whole else counted[:, :: max(1, lines.shape[1] // 120)].sum(axis=1)
        known = number >= _FEWEST_OF_LINE
        if known.sum() < 2:
            continue
        few = np.clip(few, -3 * usual, 3 * usual)
        means, squares = ((each.sum(axis=1) / np.maximum(number, 1))[known] for each in (few, few * few))
        # Compare neighbouring lines, each in units of its own scatter: the effects of stars and clouds change slowly from
        # line to line. Correlated noise scatters by more than its neighbours differ.
        scatter = np.sqrt(np.maximum(squares - means**2, usual**2) / number[known])
        change = np.diff(means) / np.hypot(scatter[1:], scatter[:-1])
        if 1.4826 * float(np.median(np.abs(change))) > 1.4:
            middle = lines.shape[1] // 2
            if whole:
                offset = np.partition(lines, middle, axis=1)[:, middle]
            else:
                offset = np.where(known, medians(lines, counted), np.float32(0))
            light = light - (offset[:, None] if axis == 1 else offset[None, :])
            if not whole:
                light[~used] = 0.0
    return light


@dataclass(frozen=True, eq=False)
class Outstanding:
    """Pixels that differ strongly from the background, excluding those at the border.

    Attributes
    ----------
    at : ndarray of int, shape (n,)
        Flat indices of the pixels, in ascending order.
    value, beside : ndarray, shape (n,)
        Light of each pixel, and the mean of its four neighbours.
    sigma : ndarray, shape (n,)
        Standard deviation of each pixel.
    """

    at: NDArray[np.intp]
    value: F4
    beside: F4
    sigma: F4


def outstanding(light: F4, noise: NoiseMap) -> Outstanding:
    """Find pixels that differ from the background by `OUTSTANDING` standard deviations."""
    height, width = light.shape
    at, limit = noise.exceeding(light, OUTSTANDING, either_sign=True)
    rows = at // width
    columns = at - rows * width
    inner = ((rows > 0) & (rows < height - 1) & (columns > 0) & (columns < width - 1)).nonzero()[0]
    at, flat = at.take(inner), light.ravel()
    beside = flat.take(at - width)
    for neighbour in (at + width, at - 1, at + 1):
        beside += flat.take(neighbour)
    return Outstanding(at, flat.take(at), beside * np.float32(0.25), limit.take(inner) / np.float32(OUTSTANDING))


def repair_defects(light: F4, far: Outstanding) -> Outstanding:
    """Replace, in place, single pixels that no optics could produce (hot, dead) by the mean of their four neighbours.

    A pixel is hot if its neighbours have less light than those of the sharpest star would, and dead if it is far below
    neighbours that are not.

    Parameters
    ----------
    light : ndarray, shape (height, width)
        Image minus background.
    far : Outstanding
        Pixels that may be defects.

    Returns
    -------
    Outstanding
        The pixels with their new light.
    """
    hot = (far.value > 0) & (far.beside < np.float32(_SHARPEST) * far.value + np.float32(0.5) * far.sigma)
    dead = (far.value < 0) & (far.beside > np.float32(0.4) * far.value)
    value = far.value.copy()
    value[hot] = np.minimum(far.beside[hot], far.sigma[hot])
    value[dead] = np.maximum(far.beside[dead], 0)
    changed = hot | dead
    light.ravel()[far.at[changed]] = value[changed]
    return replace(far, value=value)
