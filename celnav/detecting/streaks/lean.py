"""Small corrections of a common streak shape for direction and length, which vary smoothly over the frame.

If a camera turns, the direction and length of streaks vary over the frame as the lens maps lines, to second order in the
position. The light of a streak determines its direction to the error of a position across it, divided by its length, far
better than the moments of a few stars do.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

F4 = NDArray[np.float32]
F8 = NDArray[np.float64]

# Standard deviations of the terms of a correction at the frame's longer edges: constant, first order, second order.
_TERMS = (0.15, 0.15, 0.15, 0.15, 0.15, 0.15)
# Widths of the windows across streaks, in units of the streak width: to find a line, and to measure its position. Light is
# read up to `_REACH` window widths from the line.
FINDING, PLACING = 2.0, 1.0
_REACH = 2.5
# Residual error from neighbours, noise other than pixel noise, and third-order terms; larger residuals get less weight.
_FLOOR, _ROBUST, _ROUNDS = 0.004, 3.0, 4
# Number of streaks read at a time.
_AT_ONCE = 256


def lean(light: F4, uv: F8, along: F8, length: F8, width: F8, noise: F8, part: float, wide: float) -> tuple[F8, F8, F8]:
    """Fit lines to the light around the midpoints of streaks.

    Parameters
    ----------
    light : ndarray, shape (height, width)
        Image minus background.
    uv, along : ndarray, shape (n, 2)
        Approximate midpoints and directions.
    length, width, noise : ndarray, shape (n,)
        Lengths and standard deviations across the streaks, px, and standard deviation of a pixel's noise.
    part : float
        Fraction of the lengths to use.
    wide : float
        Standard deviation of the Gaussian window across streaks, over that of the streaks.

    Returns
    -------
    tuple of three ndarrays, shape (n,)
        Offsets across the streaks at the midpoints, px; slopes; and the standard deviations of the slopes.
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
    # Under the window, a line with an offset d has its mean at d / (1 + wide^-2).
    first = np.einsum("nty,ny->nt", values, window * beside) * (1 + wide**-2)
    strength = np.maximum(strength, 1e-30)
    offset = first.mean(axis=1) / strength
    turning = np.einsum("nt,nt->n", first, far) / np.einsum("nt,nt->n", far, far)
    step = np.maximum((part * length) * (at[1] - at[0]), 1e-9)
    scatter = noise * np.sqrt(((window * beside) ** 2).sum(axis=1)) * (1 + wide**-2)
    sigma = scatter / strength / np.sqrt(np.einsum("nt,nt->n", far, far) * step)
    return offset, turning / strength, sigma


def smooth(uv: F8, size: tuple[int, int], value: F8, sigma: F8, at: F8) -> F8:
    """Fit a second-order polynomial, with priors `_TERMS`, to values at positions (n, 2); evaluate it at others (m, 2)."""
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
