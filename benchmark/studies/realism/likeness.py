"""Similarity of a photograph and its twin: structure of the sky, positions of the stars, patches of light.

- *Structure*: structural similarity (Wang et al. 2004, IEEE Transactions on Image Processing 13(4), 600) of the logarithm of
  the light in blocks of 8 pixels, each picture relative to its own median; 1 for equal pictures. As a reference, the same is
  computed between the photograph and the twins of the other photographs.
- *Shift*: shift of the stars, from the peak of the pictures' cross-correlation (Guizar-Sicairos et al. 2008, Optics Letters
  33(2), 156).
- *Patches*: connected regions of blocks of 4 pixels that are brighter than their surroundings and larger than stars: glare,
  ghosts, rays, edges of cloud.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, median_filter

Floats = NDArray[np.float64]

BLOCK_PX, PATCH_BLOCK_PX = 8, 4
LEAST_LIGHT, MOST_LIGHT = 0.1, 10.0
"""Limits relative to the median: darker and brighter blocks count as this dark and this bright."""
WINDOW = 7
"""Blocks along a side of the windows whose structure is compared."""
STAR_PX = 4.0
"""Standard deviation, px, of the smoothed image that is subtracted before stars are registered."""
STAR_SIGMAS = 10.0
"""Upper limit of light over noise, to which brighter stars are clipped, so that a few do not decide."""
STEPS_PER_PX = 50
INNER_SHARE = 0.9
"""Fraction of the image circle's radius within which stars are registered and patches counted; the ground is beyond."""
CONTRAST = 1.25
"""Least ratio of a patch to the median of its surroundings."""
AROUND_BLOCKS = 25
LEAST_BLOCKS = 12
"""Least number of blocks of a patch."""


@dataclass(frozen=True)
class Likeness:
    """Similarity of two pictures.

    Attributes
    ----------
    structure : float
        Structural similarity with the photograph's own twin, mean over the image circle.
    structure_of_others : float
        Median of the same with the twins of other photographs; NaN without any.
    shift_px : (float, float)
        Shift of the twin's stars along u and v that aligns them with the photograph's.
    patches_real, patches_twin : int
    patch_share_real, patch_share_twin : float
        Fraction of the image circle that the patches cover.
    """

    structure: float
    structure_of_others: float
    shift_px: tuple[float, float]
    patches_real: int
    patches_twin: int
    patch_share_real: float
    patch_share_twin: float


def likenesses(
    real: Sequence[NDArray[np.floating]],
    twins: Sequence[NDArray[np.floating]],
    dark_dn: float,
    middle_px: tuple[float, float],
    circle_px: float,
) -> list[Likeness]:
    """Compare photographs with their twins.

    Parameters
    ----------
    real, twins : sequences of (height, width) arrays
        DN, in the same order.
    dark_dn : float
        Level without light.
    middle_px : (u, v)
        Centre of the image circle.
    circle_px : float
        Radius of the image circle.
    """
    ours, theirs = (
        [structure_of(picture - dark_dn, middle_px, circle_px) for picture in pictures] for pictures in (real, twins)
    )
    found = []
    for number, (photograph, twin) in enumerate(zip(real, twins, strict=True)):
        similar = [similarity(ours[number], other, middle_px, circle_px) for other in theirs]
        others = [value for place, value in enumerate(similar) if place != number]
        counts = [patches(picture - dark_dn, middle_px, circle_px) for picture in (photograph, twin)]
        found.append(
            Likeness(
                similar[number],
                float(np.median(others)) if others else float("nan"),
                shift_of(photograph, twin, middle_px, circle_px),
                *(count for count, _ in counts),
                *(share for _, share in counts),
            )
        )
    return found


def structure_of(light: NDArray[np.floating], middle_px: tuple[float, float], circle_px: float) -> Floats:
    """Logarithm (base 10) of the light in blocks relative to its median within the circle, bounded."""
    blocks = blocked(light, BLOCK_PX)
    inside = disk(blocks.shape, middle_px, circle_px, BLOCK_PX)
    relative = blocks / max(float(np.median(blocks[inside])), 1e-6)
    return np.asarray(np.log10(np.clip(relative, LEAST_LIGHT, MOST_LIGHT)))


def similarity(one: Floats, other: Floats, middle_px: tuple[float, float], circle_px: float) -> float:
    """Structural similarity of two structures, mean over the circle."""
    from skimage.metrics import structural_similarity

    span = float(np.log10(MOST_LIGHT / LEAST_LIGHT))
    _, everywhere = structural_similarity(one, other, win_size=WINDOW, data_range=span, full=True)
    return float(everywhere[disk(one.shape, middle_px, circle_px, BLOCK_PX)].mean())


def shift_of(
    real: NDArray[np.floating], twin: NDArray[np.floating], middle_px: tuple[float, float], circle_px: float
) -> tuple[float, float]:
    """Shift (u, v), px, of a twin that aligns its stars with the photograph's."""
    from skimage.registration import phase_cross_correlation

    inside = disk(real.shape, middle_px, INNER_SHARE * circle_px, 1)
    stars = [_stars(picture, inside) for picture in (real, twin)]
    (rows, columns), *_ = phase_cross_correlation(*stars, upsample_factor=STEPS_PER_PX, normalization=None)
    return float(columns), float(rows)


def _stars(pixels: NDArray[np.floating], inside: NDArray[np.bool_]) -> Floats:
    """Sharp features within a mask, relative to their noise, bounded."""
    sharp = pixels.astype(np.float64) - gaussian_filter(pixels.astype(np.float64), STAR_PX)
    noise = 1.4826 * float(np.median(np.abs(sharp[inside])))
    return np.where(inside, np.clip(sharp / max(noise, 1e-6), 0, STAR_SIGMAS), 0.0)


def patches(light: NDArray[np.floating], middle_px: tuple[float, float], circle_px: float) -> tuple[int, float]:
    """Number of patches of light within the circle, and the fraction of it that they cover."""
    from skimage.measure import label, regionprops

    blocks = blocked(light, PATCH_BLOCK_PX)
    inside = disk(blocks.shape, middle_px, INNER_SHARE * circle_px, PATCH_BLOCK_PX)
    around = median_filter(blocks, AROUND_BLOCKS, mode="nearest")
    found = [
        region.area
        for region in regionprops(label(inside & (blocks > CONTRAST * np.maximum(around, 1e-6)), connectivity=2))
        if region.area >= LEAST_BLOCKS
    ]
    return len(found), float(np.sum(found) / inside.sum())


def blocked(light: NDArray[np.floating], side: int) -> Floats:
    """Means over blocks; incomplete blocks at the right and at the bottom are dropped."""
    height, width = (length // side for length in light.shape)
    return (
        np.asarray(light[: height * side, : width * side], dtype=np.float64)
        .reshape(height, side, width, side)
        .mean(axis=(1, 3))
    )


def disk(shape: tuple[int, ...], middle_px: tuple[float, float], radius_px: float, side: int) -> NDArray[np.bool_]:
    """Blocks of a side whose centres are within a circle given in pixels."""
    v, u = ((np.arange(length) + 0.5) * side - 0.5 for length in shape)
    return np.asarray(np.hypot(u - middle_px[0], v[:, None] - middle_px[1]) < radius_px)
