"""The matched filter for star images."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from celnav.detecting.star_shape import StarShape, inverse

F4 = NDArray[np.float32]
F8 = NDArray[np.float64]

# Sides of the zones that are filtered at a time: for a shape that varies over the frame, and for one that does not.
_ZONE_PX, _ALIKE_PX = 180, 450
# Size of the blocks of pixels that are filtered at a time.
_BLOCK_ROWS, _BLOCK_COLUMNS = 360, 1152
# Rows and columns produced by one matrix product: wider bands contain more zeros, narrower ones need more products.
_ROWS, _COLUMNS = 8, 16
# OpenBLAS splits larger products over threads, which costs more than it gains.
_MOST_PRODUCTS = 262_144


@dataclass(frozen=True, eq=False)
class Filtered:
    """An image under the matched filter.

    Attributes
    ----------
    amplitude : ndarray, shape (height, width)
        Peak of the best-fitting star at each pixel.
    noise_factor : ndarray, shape (height, width) or (1, 1)
        Standard deviation of the amplitude over that of a pixel.
    """

    amplitude: F4
    noise_factor: F4


def matched_filter(light: F4, shape: StarShape) -> Filtered:
    """Correlate with the star image minus its mean over a square, so that constant and sloping backgrounds cancel."""
    sigma = shape.filter_sigma_px
    if sigma is None:
        return _filter_by_zones(light, shape)
    reach = max(2, int(np.ceil(3 * sigma)))
    line = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
    side = 2 * int(np.ceil(7 * sigma)) + 1
    gain, noise = _response(np.outer(line, line), side**2)
    unit = line / line.sum()
    star = _Lines.of(unit, unit / gain)
    square = _Lines.of(np.ones(side), np.full(side, 1 / (gain * side**2)))
    amplitude = np.empty_like(light)
    height, width = light.shape
    for top in range(0, height, _BLOCK_ROWS):
        for left in range(0, width, _BLOCK_COLUMNS):
            out = amplitude[top : top + _BLOCK_ROWS, left : left + _BLOCK_COLUMNS]
            mean = np.empty(out.shape, dtype=np.float32)
            star.apply(light, top, left, out)
            square.apply(light, top, left, mean)
            out -= mean
    return Filtered(amplitude, np.full((1, 1), noise / gain, dtype=np.float32))


@dataclass(frozen=True, eq=False)
class _Lines:
    """Weights along columns and rows as banded matrices, whose products are faster than sums of shifted pixels.

    Attributes
    ----------
    down : ndarray, shape (_ROWS, _ROWS + 2 reach)
        Weights along columns, shifted by one place in each row.
    along : ndarray, shape (_COLUMNS + 2 reach, _COLUMNS)
        Weights along rows, shifted by one place in each column.
    """

    down: F4
    along: F4

    @classmethod
    def of(cls, down: F8, along: F8) -> _Lines:
        """Make the matrices from two sets of weights of odd lengths."""
        return cls(_banded(down, _ROWS), np.ascontiguousarray(_banded(along, _COLUMNS).T))

    def apply(self, light: F4, top: int, left: int, out: F4) -> None:
        """Filter the part of an image that starts at a row and column and has the shape of `out`.

        Beyond the border, the outermost pixels are repeated.
        """
        rows, columns = out.shape
        reach = (self.down.shape[1] - _ROWS) // 2
        first, last = max(left - reach, 0), min(left + columns + reach, light.shape[1])
        begin, end = first - left + reach, last - left + reach
        summed = np.empty((rows, columns + 2 * reach), dtype=np.float32)
        step = max(1, _MOST_PRODUCTS // self.down.size)
        for row in range(0, rows, _ROWS):
            lines = summed[row : row + _ROWS, begin:end]
            window = _rows_with_margin(light, top + row, len(lines), reach)[:, first:last]
            weights = self.down[: len(lines), : len(window)]
            for column in range(0, last - first, step):
                np.matmul(weights, window[:, column : column + step], out=lines[:, column : column + step])
        summed[:, :begin], summed[:, end:] = summed[:, begin, None], summed[:, end - 1, None]
        step = max(1, _MOST_PRODUCTS // self.along.size)
        for row in range(0, rows, step):
            lines, result = summed[row : row + step], out[row : row + step]
            for column in range(0, columns, _COLUMNS):
                part = result[:, column : column + _COLUMNS]
                width = part.shape[1]
                np.matmul(
                    lines[:, column : column + width + 2 * reach], self.along[: width + 2 * reach, :width], out=part
                )


def _banded(line: F8, rows: int) -> F4:
    """Return a matrix with a line in every row, shifted by one place from row to row; (rows, rows + len(line) - 1)."""
    banded = np.zeros((rows, rows + len(line) - 1), dtype=np.float32)
    for row in range(rows):
        banded[row, row : row + len(line)] = line
    return banded


def _rows_with_margin(light: F4, top: int, rows: int, margin: int) -> F4:
    """Return rows of an image with a margin above and below; beyond the border, the outermost row is repeated."""
    first, last = top - margin, top + rows + margin
    if first >= 0 and last <= len(light):
        return light[first:last]
    return light.take(np.arange(first, last).clip(0, len(light) - 1), axis=0)


def _response(star: F8, area: int) -> tuple[float, float]:
    """Return the response of the filter to a star of unit peak, and to unit noise."""
    kernel = star / star.sum()
    gain = float((kernel * star).sum() - star.sum() / area)
    return gain, float(np.sqrt((kernel**2).sum() - 1 / area))


def _filter_by_zones(light: F4, shape: StarShape) -> Filtered:
    """Apply in each zone of the frame the filter for the shape at its middle."""
    height, width = light.shape
    zone = _ZONE_PX if shape.varies else _ALIKE_PX
    row_edges, column_edges = (np.linspace(0, n, max(1, round(n / zone)) + 1).astype(int) for n in (height, width))
    amplitude, factor = np.empty_like(light), np.empty_like(light)
    for top, bottom in pairwise(row_edges):
        for left, right in pairwise(column_edges):
            covariance = shape.at(np.array([[(left + right - 1) / 2, (top + bottom - 1) / 2]]))
            p, q, r = inverse(covariance)[0]
            reach_u, reach_v = (int(np.ceil(3 * np.sqrt(covariance[0, k]))) for k in (0, 2))
            dv, du = np.mgrid[-reach_v : reach_v + 1, -reach_u : reach_u + 1]
            star = np.exp(-0.5 * (p * du * du + 2 * q * du * dv + r * dv * dv))
            margin = int(np.ceil(2.4 * max(reach_u, reach_v)))
            gain, noise = _response(star, (2 * margin + 1) ** 2)
            window = _with_margin(light, top, bottom, left, right, margin)
            beyond = window[margin - reach_v : len(window) - margin + reach_v]
            summed = _correlated(beyond[:, margin - reach_u : beyond.shape[1] - margin + reach_u], star / star.sum())
            summed -= _mean_around(window, margin)
            np.divide(summed, np.float32(gain), out=amplitude[top:bottom, left:right])
            factor[top:bottom, left:right] = noise / gain
    return Filtered(amplitude, factor if shape.varies else factor[:1, :1])


def _with_margin(light: F4, top: int, bottom: int, left: int, right: int, margin: int) -> F4:
    """Return a part of an image with a margin on all sides; beyond the border, the outermost pixels are repeated."""
    rows = _rows_with_margin(light, top, bottom - top, margin)
    first, last = left - margin, right + margin
    if first >= 0 and last <= light.shape[1]:
        return rows[:, first:last]
    return rows.take(np.arange(first, last).clip(0, light.shape[1] - 1), axis=1)


def _correlated(light: F4, star: F8) -> F4:
    """Correlate with a symmetrical star image, where all of it lies on the light; (rows - star's rows + 1, ...)."""
    from scipy import fft

    size = tuple(fft.next_fast_len(side, real=True) for side in light.shape)
    spectrum = fft.rfft2(light, size)
    # Most rows of the enlarged star image are empty, so only its own are transformed along the first direction.
    spectrum *= fft.fft(fft.rfft(star.astype(np.float32), size[1], axis=1), size[0], axis=0)
    whole = fft.irfft2(spectrum, size, overwrite_x=True)
    return np.asarray(whole[star.shape[0] - 1 : light.shape[0], star.shape[1] - 1 : light.shape[1]])


def _mean_around(light: F4, reach: int) -> F4:
    """Return the means over squares of 2 reach + 1 pixels that lie on the light; (rows - 2 reach, columns - 2 reach)."""
    from scipy import ndimage

    down = ndimage.uniform_filter1d(light, 2 * reach + 1, axis=0)[reach : len(light) - reach]
    return np.asarray(ndimage.uniform_filter1d(down, 2 * reach + 1, axis=1)[:, reach : light.shape[1] - reach])
