"""The filter matched to the stars' image."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.lib.stride_tricks import as_strided
from numpy.typing import NDArray

from celnav.detecting.star_shape import StarShape, inverse

F4 = NDArray[np.float32]
F8 = NDArray[np.float64]

_ZONE_PX = 180
# Pixels that are filtered at a time, which stay in the processor's cache.
_BLOCK_ROWS, _BLOCK_COLUMNS = 64, 1152


@dataclass(frozen=True, eq=False)
class Filtered:
    """An image under the matched filter.

    Attributes
    ----------
    amplitude : ndarray, shape (height, width)
        Peak of the star that fits best at each pixel.
    noise_factor : ndarray, shape (height, width) or (1, 1)
        Its standard deviation over that of a pixel.
    """

    amplitude: F4
    noise_factor: F4


def matched_filter(light: F4, shape: StarShape) -> Filtered:
    """Correlate with the star's image less its mean over a square: constant and sloping backgrounds cancel."""
    sigma = shape.filter_sigma_px
    if sigma is None:
        return _filter_by_zones(light, shape)
    reach = max(2, int(np.ceil(3 * sigma)))
    line = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
    half = int(np.ceil(7 * sigma))
    side = 2 * half + 1
    gain, noise = _response(np.outer(line, line), side**2)
    unit = line / line.sum()
    down, along = unit.astype(np.float32), (unit / gain).astype(np.float32)
    amplitude = np.empty_like(light)
    height, width = light.shape
    for top in range(0, height, _BLOCK_ROWS):
        bottom = min(top + _BLOCK_ROWS, height)
        for left in range(0, width, _BLOCK_COLUMNS):
            right = min(left + _BLOCK_COLUMNS, width)
            window = _with_margin(light, (top, bottom), (left, right), half)
            star = _correlated(window[half - reach : half + reach + bottom - top], down)
            star = _along_rows(star, _correlated(star.reshape(-1, 1), along))[:, half - reach :]
            square = _box_sums(window, side)
            square = _along_rows(square, _box_sums(square.reshape(-1, 1), side))
            square *= np.float32(1 / (gain * side**2))
            np.subtract(star[:, : right - left], square, out=amplitude[top:bottom, left:right])
    return Filtered(amplitude, np.full((1, 1), noise / gain, dtype=np.float32))


def _along_rows(values: F4, sums: F4) -> F4:
    """Sums along the rows of an image out of those along all of its rows as one column, which take half of the time.

    Sums that mix the end of a row with the next one's beginning are left out.
    """
    rows, width = values.shape
    lost = values.size - len(sums)
    return as_strided(sums, (rows, width - lost), (width * sums.itemsize, sums.itemsize))


def _with_margin(light: F4, rows: tuple[int, int], columns: tuple[int, int], margin: int) -> F4:
    """A block of an image with a margin around it; beyond the border its outermost pixels are repeated."""
    first_row, last_row, first, last = rows[0] - margin, rows[1] + margin, columns[0] - margin, columns[1] + margin
    part = light[max(first_row, 0) : last_row, max(first, 0) : last]
    above, left = max(-first_row, 0), max(-first, 0)
    below, right = above + part.shape[0], left + part.shape[1]
    if part.shape == (last_row - first_row, last - first):
        return part
    window = np.empty((last_row - first_row, last - first), dtype=light.dtype)
    window[above:below, left:right] = part
    window[above:below, :left], window[above:below, right:] = part[:, :1], part[:, -1:]
    window[:above], window[below:] = window[above], window[below - 1]
    return window


def _correlated(values: F4, line: F4) -> F4:
    """Correlate columns with a symmetrical line; shape (rows - len(line) + 1, columns)."""
    reach = len(line) // 2
    rows = len(values) - 2 * reach
    out = values[reach : reach + rows] * line[reach]
    pair = np.empty_like(out)
    for k in range(1, reach + 1):
        np.add(values[reach - k : reach - k + rows], values[reach + k : reach + k + rows], out=pair)
        pair *= line[reach + k]
        out += pair
    return out


def _box_sums(values: F4, side: int) -> F4:
    """Sum `side` rows from each on; shape (rows - side + 1, columns). Sums of 1, 2, 4, ... rows make those of any number."""
    rows = len(values) - side + 1
    done, power, size, total = 0, values, 1, None
    while done < side:
        if side & size:
            part = power[done : done + rows]
            total = part if total is None else total + part
            done += size
        if done < side:
            power = power[:-size] + power[size:]
            size *= 2
    assert total is not None
    return total


def _response(star: F8, area: int) -> tuple[float, float]:
    """Response of the filter to a star of unit peak, and to unit noise."""
    kernel = star / star.sum()
    gain = float((kernel * star).sum() - star.sum() / area)
    return gain, float(np.sqrt((kernel**2).sum() - 1 / area))


def _filter_by_zones(light: F4, shape: StarShape) -> Filtered:
    """Apply the filter of each zone of the frame; one zone where the shape is the same everywhere."""
    from scipy import ndimage, signal

    height, width = light.shape
    rows, columns = (max(1, round(n / _ZONE_PX)) if shape.varies else 1 for n in (height, width))
    row_edges, column_edges = (np.linspace(0, n, k + 1).astype(int) for n, k in ((height, rows), (width, columns)))
    amplitude, factor = np.empty_like(light), np.empty_like(light)
    for top, bottom in pairwise(row_edges):
        for left, right in pairwise(column_edges):
            covariance = shape.at(np.array([[(left + right - 1) / 2, (top + bottom - 1) / 2]]))
            p, q, r = inverse(covariance)[0]
            reach_u, reach_v = (int(np.ceil(3 * np.sqrt(covariance[0, k]))) for k in (0, 2))
            dv, du = np.mgrid[-reach_v : reach_v + 1, -reach_u : reach_u + 1]
            star = np.exp(-0.5 * (p * du * du + 2 * q * du * dv + r * dv * dv))
            side = 2 * int(np.ceil(2.4 * max(reach_u, reach_v))) + 1
            gain, noise = _response(star, side**2)
            margin = side // 2
            above, before = min(margin, top), min(margin, left)
            window = light[top - above : bottom + margin, left - before : right + margin]
            padded = np.pad(window, ((reach_v, reach_v), (reach_u, reach_u)), mode="edge")
            kernel = (star / star.sum()).astype(np.float32)  # symmetrical: convolution is correlation
            summed = signal.oaconvolve(padded, kernel, mode="valid") - ndimage.uniform_filter(
                window, side, mode="nearest"
            )
            part = slice(above, above + bottom - top), slice(before, before + right - left)
            amplitude[top:bottom, left:right] = summed[part] / gain
            factor[top:bottom, left:right] = noise / gain
    return Filtered(amplitude, factor)
