"""A mask of a fixed camera, learnt from several frames: what stays in place while the sky turns, and areas without stars."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from celnav.detecting.blank_border import blank_border
from celnav.detecting.image_background import as_image, background_and_noise, grey, unmasked
from celnav.detecting.tiles import Tiles
from celnav.detection import DetectionConfig, detect
from celnav.detections import Detections
from celnav.errors import ImageError

F4 = NDArray[np.float32]
F8 = NDArray[np.float64]
Mask = NDArray[np.bool_]

FEWEST_FRAMES = 3
# Unmasked islands smaller than this are masked too, because the surroundings of a star in them would not be visible.
_LEAST_SKY_PX = 25
_TILE_PX, _STEP_PX = 32, 8
# A pixel is hot or dead if it differs by this many sigma from its four neighbours in this fraction of the frames.
_HOT_SIGMA, _HOT_SHARE = 5.0, 0.7
# Structure stands still where the mean of 3 x 3 pixels differs from the background, to the same side in this fraction of the
# frames, by this many of its own sigma and by this multiple of a pixel's.
_STILL_SIGMA, _LEAST_STILL, _STILL_SHARE, _STILL_PX = 2.5, 1.5, 0.7, 1.5
# Ground is darker than the sky within a tile and a half: by this fraction of the difference to the frame's darkest places,
# and by this many sigma of a pixel. It pulls the background down by the third value, as a fraction of that difference. Tiles
# with at least the fourth value times the usual number of moving detections are sky.
_DARK, _DARK_SIGMA, _PULLED, _STARRY = 0.35, 5.0, 0.05, 0.25
# A detection moves if fewer than this fraction of the other frames show one at its place. If the sky turned, at least this
# fraction of the detections move.
_STANDING_SHARE, _LEAST_MOVING = 0.5, 0.2
# Edges of lamps, and the pattern that video encoding makes of a sensor's own, are hardly brighter than the noise. Detections
# with this low threshold that recur in this fraction of the frames, at least three, are masked with the pixels within this
# distance.
_FAINT_SIGMA, _FAINT_SHARE, _FAINT_PX = 3.5, 0.5, 2
# Sky is where moving detections are: a disk of the size that contains this many on average must contain this fraction of the
# median, and at least two.
_BLOCK_PX, _IN_DISK, _PART_OF_MEDIAN = 8, 10.0, 0.12
_FEWEST_MOVING, _LEAST_PART = 60, 0.05


@dataclass(frozen=True, eq=False)
class _Still:
    """Counts of the frames in which each pixel was hot, dead or blank, and its surroundings stood out; (height, width)."""

    hot: NDArray[np.uint16]
    above: NDArray[np.uint16]
    below: NDArray[np.uint16]


def sky_mask(frames: Sequence[ArrayLike]) -> Mask:
    """Learn which parts of a fixed camera's frames are not sky.

    Hot and dead pixels differ from their neighbours in most frames. Trees, walls and scratches stand out at the same place
    in most frames. The sky is where detections come and go; this bounds it where nothing stands out, as outside the image
    circle.

    Parameters
    ----------
    frames : sequence of array_like
        Three or more images, as for `celnav.detect`, of a camera that did not move while the sky turned between them.
        Five or more give a clear result.

    Returns
    -------
    ndarray of bool, shape (height, width)
        True where the image is not to be used: a `mask` for `celnav.detect`.

    Raises
    ------
    ImageError
        For too few frames, frames of different sizes, or a sky that has not turned between them.
    """
    if len(frames) < FEWEST_FRAMES:
        raise ImageError(f"a mask is learnt from {FEWEST_FRAMES} frames or more, not from {len(frames)}")
    pixels, hidden = zip(*(unmasked(frame, None) for frame in frames), strict=True)
    images = [grey(as_image(each)) for each in pixels]
    size = images[0].shape
    if other := [image.shape for image in images if image.shape != size]:
        raise ImageError(f"a mask is learnt from frames of one size; these are of {size} and of {other[0]}")
    found = [detect(frame) for frame in frames]
    moving = _moving(found)
    number = sum(len(one) for one in found)
    if number and len(moving) < _LEAST_MOVING * number:
        raise ImageError(
            "most detections stand still in these frames: a mask is learnt from frames between which the sky turned"
        )
    still = _standing(images, hidden, _starry(moving, (size[0], size[1])))
    least = len(images)
    mask = still.hot >= np.ceil(_HOT_SHARE * least)
    structure = _dilated(np.maximum(still.above, still.below) >= np.ceil(_STILL_SHARE * least))
    mask |= structure
    mask |= _faint_standing([detect(frame, config=_FAINT) for frame in frames], (size[0], size[1]))
    at = np.clip(np.rint(moving).astype(np.intp), 0, np.array(size[::-1]) - 1)
    sky = _where_stars_come_and_go(moving[~structure[at[:, 1], at[:, 0]]], (size[0], size[1]))
    if sky is not None:
        mask |= ~sky
    return mask | _specks(~mask)


def _moving(found: list[Detections]) -> F8:
    """Return positions, shape (n, 2), of the detections that few other frames show at the same place."""
    from scipy.spatial import cKDTree

    trees = [cKDTree(one.uv) if len(one) else None for one in found]
    result = [np.empty((0, 2))]
    for i, one in enumerate(found):
        if not len(one):
            continue
        others = [tree for j, tree in enumerate(trees) if j != i and tree is not None]
        seen: F8 = np.zeros(len(one))
        for tree in others:
            seen += tree.query(one.uv)[0] < _STILL_PX
        result.append(one.uv[seen < max(1.0, _STANDING_SHARE * len(others))])
    return np.concatenate(result)


_FAINT = DetectionConfig(seed_sigma=_FAINT_SIGMA, grow_sigma=min(_FAINT_SIGMA, DetectionConfig.grow_sigma))


def _faint_standing(found: list[Detections], size: tuple[int, int]) -> Mask:
    """Return a mask of the surroundings of detections that stay in place."""
    from scipy import ndimage
    from scipy.spatial import cKDTree

    standing = np.zeros(size, dtype=bool)
    places = np.concatenate([one.uv for one in found])
    seen = np.zeros(len(places))
    for one in found:
        if len(one):
            seen += cKDTree(one.uv).query(places)[0] < _STILL_PX
    at = np.rint(places[seen >= max(FEWEST_FRAMES, _FAINT_SHARE * len(found))]).astype(np.intp)
    at = at.clip(0, np.array(size[::-1]) - 1)
    standing[at[:, 1], at[:, 0]] = True
    side = 2 * _FAINT_PX + 1
    return np.asarray(ndimage.binary_dilation(standing, structure=np.ones((side, side), dtype=bool)))


def _starry(moving: F8, size: tuple[int, int]) -> Mask:
    """Return where tiles contain as many moving detections, shape (n, 2), as sky does, at every `_STEP_PX`-th pixel."""
    shape = tuple(-(-side // _TILE_PX) for side in size)
    at = np.clip(np.rint(moving[:, ::-1]) // _TILE_PX, 0, np.array(shape) - 1).astype(np.intp)
    count = np.zeros(shape)
    np.add.at(count, (at[:, 0], at[:, 1]), 1)
    typical = np.median(count[count > 0]) if len(moving) else 0.0
    repeat = _TILE_PX // _STEP_PX
    starry = (count >= max(2.0, _STARRY * typical)).repeat(repeat, axis=0).repeat(repeat, axis=1)
    return np.asarray(starry[: -(-size[0] // _STEP_PX), : -(-size[1] // _STEP_PX)])


def _standing(images: list[F4], hidden: Sequence[ArrayLike | None], starry: Mask) -> _Still:
    """Count the frames in which each pixel stands out by itself, and its surroundings above or below the background.

    `hidden` holds the masked entries of each frame that has some; they count as blank. `starry` marks, at every `_STEP_PX`-th
    pixel, where stars come and go.
    """
    from scipy import ndimage

    size = images[0].shape
    tiles = Tiles.of((size[0], size[1]), _TILE_PX)
    hot, above, below = (np.zeros(size, dtype=np.uint16) for _ in range(3))
    for pixels, out in zip(images, hidden, strict=True):
        used = np.ones(size, dtype=bool) if out is None else ~np.asarray(out, dtype=np.bool_)
        if (blank := blank_border(pixels, tiles)) is not None:
            used &= ~blank
        background, noise = (each.whole() for each in background_and_noise(pixels, used, tiles))
        noise = np.maximum(noise, np.float32(1e-6 * max(1.0, float(np.abs(pixels).max()))))
        relative = (pixels - background) / noise
        relative[~used] = 0
        clipped = np.clip(relative, -1000, 1000)
        beside = ndimage.convolve(clipped, _CROSS, mode="nearest")
        difference = clipped - beside
        # For a star, the neighbouring pixels contain light too.
        hot += ((np.abs(difference) > _HOT_SIGMA) & (np.abs(beside) < 0.2 * np.abs(clipped) + 1)) | ~used
        mean = ndimage.uniform_filter(np.clip(relative, -5, 5), 3, mode="nearest")
        # Scatter in the quieter part of the frame, in units of the noise from differences of neighbours, which correlated
        # noise exceeds.
        scatter = 1.4826 * float(np.percentile(np.median(np.abs(tiles.spread_samples(mean)), axis=1), 25))
        least = max(_STILL_SIGMA * scatter, _LEAST_STILL)
        highest = _sky_around(background, starry)
        span = highest - np.float32(np.percentile(background[::_TILE_PX, ::_TILE_PX], 1))
        lack = ndimage.uniform_filter(highest - pixels, 3, mode="nearest")
        # Dark trees pull the background down, so the sky next to them is above it.
        pulled_down = (highest - background > _PULLED * span) & (lack > -least * noise)
        above += (mean > least) & ~pulled_down
        below += (mean < -least) | ((lack > np.maximum(_DARK * span, _DARK_SIGMA * noise)) & used)
    return _Still(hot, above, below)


def _sky_around(background: F4, starry: Mask) -> F4:
    """Return the highest background of the sky within a tile and a half; where there is no sky, the background itself.

    Sky next to dark trees is brighter than the background of their tile but still sky, and the trees are darker than it.
    """
    from scipy import ndimage

    own = background[::_STEP_PX, ::_STEP_PX]
    side = 2 * round(1.5 * _TILE_PX / _STEP_PX) + 1
    highest = ndimage.maximum_filter(np.where(starry, own, np.float32(-np.inf)), side, mode="nearest")
    highest = np.maximum(highest, own)
    repeated = np.repeat(np.repeat(highest, _STEP_PX, axis=0), _STEP_PX, axis=1)
    return np.asarray(repeated[: background.shape[0], : background.shape[1]])


_CROSS = np.array([[0, 0.25, 0], [0.25, 0, 0.25], [0, 0.25, 0]], dtype=np.float32)


def _dilated(mask: Mask) -> Mask:
    from scipy import ndimage

    return np.asarray(ndimage.binary_dilation(mask, structure=np.ones((3, 3), dtype=bool)))


def _specks(sky: Mask) -> Mask:
    """Return the parts of the sky with fewer than `_LEAST_SKY_PX` pixels, connected by their sides."""
    from scipy import ndimage

    label, _ = ndimage.label(sky)
    return np.asarray(sky & (np.bincount(label.ravel())[label] < _LEAST_SKY_PX))


def _where_stars_come_and_go(uv: F8, size: tuple[int, int]) -> Mask | None:
    """Return the part of the frame that moving detections, shape (n, 2), fill; None if they are too few."""
    from scipy import ndimage, signal

    if len(uv) < _FEWEST_MOVING:
        return None
    shape = tuple(-(-side // _BLOCK_PX) for side in size)
    at = np.clip(np.rint(uv[:, ::-1]) // _BLOCK_PX, 0, np.array(shape) - 1).astype(np.intp)
    count = np.zeros(shape)
    np.add.at(count, (at[:, 0], at[:, 1]), 1)
    covered = np.ones(shape, dtype=bool)
    for _ in range(3):
        # Radius of a disk that contains `_IN_DISK` detections on average over the area that they cover.
        radius = np.clip(np.sqrt(_IN_DISK * covered.sum() / (np.pi * len(uv))), 1.5, min(shape) / 4)
        reach = int(np.ceil(radius))
        y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1]
        disk = (np.hypot(x, y) <= radius).astype(np.float64)
        inside = signal.fftconvolve(count, disk, mode="same") / signal.fftconvolve(np.ones(shape), disk, mode="same")
        inside *= disk.sum()
        typical = np.median(inside[at[:, 0], at[:, 1]])
        covered = inside > max(1.5, _PART_OF_MEDIAN * typical)
    labels, n = ndimage.label(ndimage.binary_fill_holes(covered))
    if n == 0:
        return None
    large = np.flatnonzero(np.bincount(labels.ravel())[1:] >= _LEAST_PART * labels.size) + 1
    if not len(large):
        return None
    sky = np.isin(labels, large)
    return np.asarray(sky.repeat(_BLOCK_PX, axis=0).repeat(_BLOCK_PX, axis=1)[: size[0], : size[1]])
