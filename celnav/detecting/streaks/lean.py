"""How streaks lean and differ in length over the frame: small corrections of a common shape, alike for neighbours.

A camera that turns draws streaks whose direction and length change over the frame by what the lens does to lines: to the
second order in the place. A streak's own light tells its direction to the noise of one place across it over its length, far
better than the moments of a few stars do.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

F4 = NDArray[np.float32]
F8 = NDArray[np.float64]

# Standard deviations of a correction's terms at the frame's longer edges: constant, of the first, of the second order.
_TERMS = (0.15, 0.15, 0.15, 0.15, 0.15, 0.15)
# Windows across streaks, in their widths: to find a line with, and to place one. Reading ends so many of their widths off.
FINDING, PLACING = 2.0, 1.0
_REACH = 2.5
# What neighbours, noise that is no noise of pixels, and the third order leave; where residuals are larger, they count less.
_FLOOR, _ROBUST, _ROUNDS = 0.004, 3.0, 4
# Streaks that are read at a time.
_AT_ONCE = 256


def lean(light: F4, uv: F8, along: F8, length: F8, width: F8, noise: F8, part: float, wide: float) -> tuple[F8, F8, F8]:
    """Fit lines to the light around the middles of streaks.

    Parameters
    ----------
    light : ndarray, shape (height, width)
        Image less background.
    uv, along : ndarray, shape (n, 2)
        Middles and directions as they are thought to be.
    length, width, noise : ndarray, shape (n,)
        Lengths, standard deviations across, both px, and of a pixel's noise.
    part : float
        Of the lengths, which counts.
    wide : float
        The window across streaks: standard deviation of a Gaussian, over theirs.

    Returns
    -------
    Offsets across the streaks, px, at the middles, slopes, and the standard deviations of these, each of shape (n,).
    """
    from scipy import ndimage

    if len(uv) > _AT_ONCE:
        cuts = range(_AT_ONCE, len(uv), _AT_ONCE)
        split = zip(*(np.split(column, cuts) for column in (uv, along, length, width, noise)), strict=True)
        parts = [lean(light, at, to, long, thick, dark, part, wide) for at, to, long, thick, dark in split]
        together = np.concatenate(parts, axis=1)
        return together[0], together[1], together[2]
    reach = np.ceil(_REACH * wide * width.max())
    beside = np.arange(-reach, reach + 1.0)
    at = np.arange(-0.5, 0.5, 1 / max(float(np.median(part * length)), 8.0))
    far = (part * length)[:, None] * at
    columns = uv[:, 0, None, None] + far[:, :, None] * along[:, 0, None, None] - beside * along[:, 1, None, None]
    rows = uv[:, 1, None, None] + far[:, :, None] * along[:, 1, None, None] + beside * along[:, 0, None, None]
    window = np.exp(-0.5 * (beside / (wide * width[:, None])) ** 2)
    values = ndimage.map_coordinates(light, [rows, columns], order=1, mode="constant")
    strength = np.einsum("nty,ny->n", values, window) / len(at)
    # Under the window a line that is off by d has its mean at d over one and the inverse square of the window's width.
    first = np.einsum("nty,ny->nt", values, window * beside) * (1 + wide**-2)
    strength = np.maximum(strength, 1e-30)
    offset = first.mean(axis=1) / strength
    turning = np.einsum("nt,nt->n", first, far) / np.einsum("nt,nt->n", far, far)
    step = np.maximum((part * length) * (at[1] - at[0]), 1e-9)
    scatter = noise * np.sqrt(((window * beside) ** 2).sum(axis=1)) * (1 + wide**-2)
    sigma = scatter / strength / np.sqrt(np.einsum("nt,nt->n", far, far) * step)
    return offset, turning / strength, sigma


def smooth(uv: F8, size: tuple[int, int], value: F8, sigma: F8, at: F8) -> F8:
    """Fit a polynomial of the second order, held by `_TERMS`, to values at places, (n, 2); return it at others, (m, 2)."""
    columns = _terms(uv, size)
    sigma = np.hypot(sigma, _FLOOR)
    held, weight = np.diag(1 / np.array(_TERMS) ** 2), np.ones_like(sigma)
    fitted: F8 = np.zeros(len(held))
    for _ in range(_ROUNDS):
        weighted = columns * (weight / sigma**2)[:, None]
        fitted = np.asarray(np.linalg.solve(weighted.T @ columns + held, weighted.T @ value), dtype=np.float64)
        weight = 1 / (1 + ((value - columns @ fitted) / (_ROBUST * sigma)) ** 2)
    return np.asarray(_terms(at, size) @ fitted)


def _terms(uv: F8, size: tuple[int, int]) -> F8:
    middle, half = (np.array([size[1], size[0]]) - 1) / 2, max(size) / 2
    x, y = ((uv - middle) / half).T
    return np.stack((np.ones_like(x), x, y, x * x, x * y, y * y), axis=1)
