"""The image under the stars: grey levels, background and noise maps, offsets of rows and columns, defective pixels."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from celnav.errors import ImageError

F4 = NDArray[np.float32]
Mask = NDArray[np.bool_]
LARGEST_VALUE = 1e15

# Samples along each side of a tile: the mean of 144 pixels is good to 8 % of the noise.
_SAMPLES = 12
# Clipped at three standard deviations a normal distribution keeps this part of its own.
_CLIP, _CLIPPED_NORMAL = np.float32(3.0), np.float32(0.98658)
# A star of 0.5 px, the sharpest that a lens makes, puts this part of its middle pixel into the four beside it, at least.
_SHARPEST = 0.12


def as_image(image: ArrayLike) -> NDArray[np.generic]:
    """Return an image as an array of the type that it has; raises `ImageError` for rows of different lengths."""
    try:
        return np.asarray(image)
    except ValueError:
        raise ImageError("image must be an array of (height, width) or (height, width, 3 or 4) numbers") from None


def grey(image: NDArray[np.generic]) -> F4:
    """Return an image as one channel of float32; colours are averaged with the weights of Rec. 601.

    Raises `ImageError` for a wrong shape or type, NaN, infinity, and values whose squares single precision cannot hold.
    """
    if image.dtype == np.bool_ or not np.issubdtype(image.dtype, np.number) or np.iscomplexobj(image):
        raise ImageError(f"image must hold real numbers, not {image.dtype}")
    if image.dtype.itemsize > 2 and image.size and not (image.min() >= -LARGEST_VALUE and image.max() <= LARGEST_VALUE):
        raise ImageError(
            f"image holds NaN, infinity or values above {LARGEST_VALUE:g}: replace them, or scale the image"
        )
    if image.ndim == 3 and image.shape[2] in (3, 4):
        values = image[:, :, :3].astype(np.float32) @ np.array([0.299, 0.587, 0.114], dtype=np.float32)
    elif image.ndim == 2:
        values = image.astype(np.float32)
    else:
        raise ImageError(f"image has shape {image.shape}; it must be (height, width) or (height, width, 3 or 4)")
    if min(values.shape) < 3:
        raise ImageError(f"image of {values.shape[1]} x {values.shape[0]} pixels is too small")
    return np.asarray(values)


def used_pixels(pixels: F4, mask: ArrayLike | None) -> Mask:
    """Return where an image is to be used; raises `ImageError` for a mask that does not fit."""
    if mask is None:
        return np.ones(pixels.shape, dtype=bool)
    ignored = as_image(mask)
    if ignored.shape != pixels.shape or ignored.dtype != np.bool_:
        raise ImageError(f"mask must be boolean of shape {pixels.shape}, true where the image is not to be used")
    return np.logical_not(ignored)


def background_and_noise(pixels: F4, used: Mask, tile_px: int) -> tuple[F4, F4]:
    """Estimate background and noise, both of the image's shape.

    Clipped means of tiles, and standard deviations of the differences between neighbouring pixels, smoothed by a 3x3
    median and interpolated bilinearly. Unused pixels do not count; a tile without pixels takes the image's median.
    """
    from scipy import ndimage

    height, width = pixels.shape
    rows, columns = max(1, round(height / tile_px)), max(1, round(width / tile_px))
    row_edges = np.linspace(0, height, rows + 1).astype(int)
    column_edges = np.linspace(0, width, columns + 1).astype(int)
    at = _sample_places(row_edges)[:, None, :, None], _sample_places(column_edges)[None, :, None, :]
    samples = pixels[at].reshape(rows * columns, -1)
    counted = np.ones(samples.shape, dtype=bool) if used.all() else used[at].reshape(samples.shape)
    one = 1.01 if (samples[:, ::8] == np.rint(samples[:, ::8])).all() else 0.0  # the step of an integer image
    # Differences of neighbours know nothing of the sky's slope.
    steps = (samples[:, 1::2] - samples[:, ::2]) * np.float32(np.sqrt(0.5))
    both = counted[:, 1::2] & counted[:, ::2]
    limit = np.maximum(_CLIP * np.float32(1.4826) * _medians(np.abs(steps), both), np.float32(one))
    mean, square = _moments_within(steps, limit, both)
    spread = np.asarray(np.sqrt(np.maximum(square - mean * mean, 0)) / _CLIPPED_NORMAL, dtype=np.float32)
    middle = _medians(samples, counted)
    offset, _ = _moments_within(samples - middle[:, None], np.maximum(_CLIP * spread, np.float32(one)), counted)
    level = middle + offset
    known = np.isfinite(level) & np.isfinite(spread)
    if not known.all():
        level = np.where(known, level, np.median(pixels[used]))
        spread = np.where(known, spread, np.median(spread[known]) if known.any() else np.float32(0))
    row_weights, column_weights = _interpolation(row_edges), _interpolation(column_edges)

    def spread_out(tiles: F4) -> F4:
        smooth = ndimage.median_filter(tiles.astype(np.float32).reshape(rows, columns), 3, mode="nearest")
        return np.asarray(row_weights @ (smooth @ column_weights.T), dtype=np.float32)

    return spread_out(level), spread_out(spread)


def _sample_places(edges: NDArray[np.int_]) -> NDArray[np.int_]:
    """Pixels of each tile that are sampled, shape (tiles, samples): neighbours two by two, for the sake of colour mosaics."""
    size = np.diff(edges)[:, None]
    k = np.arange(_SAMPLES)[None, :]
    return np.asarray(edges[:-1, None] + np.minimum((k // 2) * size * 2 // _SAMPLES + k % 2, size - 1))


def _moments_within(deviation: F4, limit: F4, counted: Mask) -> tuple[F4, F4]:
    """Means of each row, shape (n,), and of its squares, of the values no larger than the row's limit.

    Medians alone are too coarse for integers where the noise is less than a step or two.
    """
    kept = counted & (np.abs(deviation) <= limit[:, None])
    number = np.maximum(kept.sum(axis=1), 1).astype(np.float32)
    inside = deviation * kept
    return inside.sum(axis=1) / number, np.asarray(np.einsum("ij,ij->i", inside, inside) / number, dtype=np.float32)


def _medians(samples: F4, counted: Mask) -> F4:
    """Upper medians of the counted samples of each row, shape (n,); NaN for rows without any."""
    number = counted.sum(axis=1)
    if (number == samples.shape[1]).all():
        middle = samples.shape[1] // 2
        return np.asarray(np.partition(samples, middle, axis=1)[:, middle])
    ordered = np.sort(np.where(counted, samples, np.float32(np.inf)), axis=1)
    middles = ordered[np.arange(len(samples)), np.minimum(number // 2, samples.shape[1] - 1)]
    return np.where(number > 0, middles, np.float32(np.nan))


def _interpolation(edges: NDArray[np.int_]) -> F4:
    """Matrix, shape (pixels, tiles), that interpolates linearly between tile centres and extrapolates at the ends."""
    pixels, tiles = int(edges[-1]), len(edges) - 1
    weights = np.zeros((pixels, tiles), dtype=np.float32)
    if tiles == 1:
        weights[:, 0] = 1
        return weights
    centres = (edges[:-1] + edges[1:] - 1) / 2
    at = np.arange(pixels)
    left = np.clip(np.searchsorted(centres, at) - 1, 0, tiles - 2)
    part = (at - centres[left]) / (centres[left + 1] - centres[left])
    weights[at, left] = 1 - part
    weights[at, left + 1] = part
    return weights


def remove_line_offsets(light: F4, noise: F4) -> F4:
    """Take off what rows and columns have in common, where that is more than chance leaves.

    Parameters
    ----------
    light : ndarray, shape (height, width)
        Image less background.
    noise : ndarray, shape (height, width)
        Standard deviation of its pixels.
    """
    typical = float(np.median(noise[::16, ::16]))
    for axis in (1, 0):
        lines = light if axis == 1 else light.T
        if lines.shape[1] < 32:
            continue
        few = lines[:, :: max(1, lines.shape[1] // 120)]
        means = np.clip(few, -3 * typical, 3 * typical).mean(axis=1)
        # Of neighbouring lines: what stars and clouds change, changes slowly.
        change = 1.4826 * float(np.median(np.abs(np.diff(means)))) / np.sqrt(2)
        if change > 1.4 * typical / np.sqrt(few.shape[1]):
            middle = lines.shape[1] // 2
            offset = np.partition(lines, middle, axis=1)[:, middle]
            light = light - (offset[:, None] if axis == 1 else offset[None, :])
    return light


def repair_defects(light: F4, noise: F4, used: Mask) -> F4:
    """Replace single pixels that no optics could make (hot, dead, unused) by the mean of the four beside them.

    A pixel is hot where its neighbours hold less light than those of the sharpest star would, dead where it is far
    below neighbours that are not.
    """
    repaired = light.copy()
    repaired[~used] = 0.0
    inner, spread = repaired[1:-1, 1:-1], noise[1:-1, 1:-1]
    at = np.flatnonzero(np.abs(inner) > 5 * spread)
    rows, columns = np.divmod(at, inner.shape[1])
    rows, columns = rows + 1, columns + 1
    value, sigma = repaired[rows, columns], noise[rows, columns]
    beside = 0.25 * (
        repaired[rows - 1, columns] + repaired[rows + 1, columns] + repaired[rows, columns - 1]
        + repaired[rows, columns + 1]
    )  # fmt: skip
    hot = (value > 0) & (beside < _SHARPEST * value + 0.5 * sigma)
    dead = (value < 0) & (beside > 0.4 * value)
    bad = hot | dead
    repaired[rows[bad], columns[bad]] = np.where(
        dead[bad], np.maximum(beside[bad], 0), np.minimum(beside[bad], sigma[bad])
    )
    return repaired
