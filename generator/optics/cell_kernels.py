"""Arithmetic on cells of light in Dr.Jit: coarser and finer cells, Gaussian blur, and conversion between cells and pixels."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from generator import mitsuba_runtime
from generator.device_arrays import aligned
from generator.optics.wings import TRUNCATE

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]

LARGER_CELLS = ((-1, 0.125), (0, 0.375), (1, 0.375), (2, 0.125))
"""Weights of cells in a larger cell, counted from the first of the two that it contains: the transpose of linear
interpolation."""


SMALLEST_SIGMA = 1e-3
"""Smallest sigma in cells, so that no divisor is 0."""


@dataclass(frozen=True)
class Cells:
    """Values on rows and columns of cells.

    Attributes
    ----------
    values : Float
        Values, row by row.
    rows, columns : int
    """

    values: Any
    rows: int
    columns: int

    @classmethod
    def of(cls, array: Floats | Singles) -> Cells:
        """Convert from an array (rows, columns)."""
        mi = mitsuba_runtime.start()
        return cls(mi.Float(aligned(np.ascontiguousarray(array, np.float32).ravel())), *array.shape)

    def array(self) -> Singles:
        """Return the values, (rows, columns) array."""
        return np.array(self.values).reshape(self.rows, self.columns)

    def lanes(self) -> tuple[Any, Any]:
        """Return row and column (Int32) of each cell."""
        mi = mitsuba_runtime.start()
        import drjit as dr

        lane = dr.arange(mi.UInt32, self.rows * self.columns)
        return mi.Int32(lane // self.columns), mi.Int32(lane % self.columns)

    def at(self, row: Any, column: Any) -> Any:
        """Values (Float) at rows and columns (Int32); beyond the edges, those of the outermost cells."""
        mi = mitsuba_runtime.start()
        import drjit as dr

        place = dr.clip(row, 0, self.rows - 1) * self.columns + dr.clip(column, 0, self.columns - 1)
        return dr.gather(mi.Float, self.values, mi.UInt32(place))

    def between(self, row: Any, column: Any) -> Any:
        """Values (Float) at fractional rows and columns (Float), interpolated linearly."""
        mi = mitsuba_runtime.start()
        import drjit as dr

        top, left = dr.floor(row), dr.floor(column)
        down, right = row - top, column - left
        top, left = mi.Int32(top), mi.Int32(left)
        upper, lower = (dr.lerp(self.at(at, left), self.at(at, left + 1), right) for at in (top, top + 1))
        return dr.lerp(upper, lower, down)

    def halved(self) -> Cells:
        """Values on cells of twice the side, each of which contains four; the light's centroid does not move."""
        import drjit as dr

        rows, columns = self.rows // 2, self.columns // 2
        row, column = Cells(None, rows, columns).lanes()
        total = self.at(row, column) * 0
        for down, by_row in LARGER_CELLS:
            line = total * 0
            for right, by_column in LARGER_CELLS:
                line = dr.fma(self.at(2 * row + down, 2 * column + right), by_column, line)
            total = dr.fma(line, by_row, total)
        dr.eval(total)
        return Cells(total, rows, columns)

    def blurred(self, sigma: float, share: float) -> Cells:
        """A fraction of the values, convolved with a Gaussian of sigma cells; no light comes from beyond the edges."""
        import drjit as dr

        radius = int(TRUNCATE * sigma + 0.5)
        # A sigma of 0, for wings that cells blur enough by themselves, has a single weight at distance 0.
        weights = np.exp(-0.5 * (np.arange(-radius, radius + 1) / max(sigma, SMALLEST_SIGMA)) ** 2)
        weights /= weights.sum()
        row, column = self.lanes()
        down = self._sum(share * weights, lambda step: (row + step, column, row + step, self.rows))
        dr.eval(down)
        across = Cells(down, self.rows, self.columns)
        blurred = across._sum(weights, lambda step: (row, column + step, column + step, self.columns))
        dr.eval(blurred)
        return Cells(blurred, self.rows, self.columns)

    def _sum(self, weights: Floats, place: Callable[[int], tuple[Any, Any, Any, int]]) -> Any:
        """Weighted sum over steps; `place` returns row, column, and the one of the two that moves, with its size."""
        mi = mitsuba_runtime.start()
        import drjit as dr

        # Not as literals, so that other widths do not need other kernels.
        stored, middle, total = mi.Float(weights.astype(np.float32)), len(weights) // 2, mi.Float(0)
        for number in range(len(weights)):
            row, column, along, size = place(number - middle)
            inside = (along >= 0) & (along < size)
            value = dr.gather(mi.Float, self.values, mi.UInt32(row * self.columns + column), inside)
            total = dr.fma(value, dr.gather(mi.Float, stored, mi.UInt32(number)), total)
        return total

    def plus_enlarged(self, coarse: Cells) -> Cells:
        """The values plus those of cells of twice the side, interpolated linearly."""
        mi = mitsuba_runtime.start()
        import drjit as dr

        row, column = self.lanes()
        total = self.values + coarse.between(0.5 * mi.Float(row) - 0.25, 0.5 * mi.Float(column) - 0.25)
        dr.eval(total)
        return Cells(total, self.rows, self.columns)


@dataclass(frozen=True)
class PixelSums:
    """Pixels that contribute to a cell.

    Attributes
    ----------
    side : int
        Side of a cell, px.
    planes : int
        Number of values of a pixel.
    parts : tuple of (row, column, plane, weight)
        Contributing places in a cell.
    mirrored : bool
        Whether the frame continues beyond its last pixels, mirrored at them, or ends there.
    """

    side: int
    planes: int
    parts: tuple[tuple[int, int, int, float], ...]
    mirrored: bool


def on_pixels(cells: Cells, side: int, first: int, shape: tuple[int, int]) -> Any:
    """Values of cells on a frame's pixels (Float), interpolated linearly.

    Parameters
    ----------
    cells : Cells
        Cells of side x side px.
    side : int
    first : int
        Row and column of the cell in the frame's corner.
    shape : tuple of int
        Height and width of the frame.
    """
    mi = mitsuba_runtime.start()
    row, column = Cells(None, *shape).lanes()
    places = [(mi.Float(pixel) + 0.5) * (1 / side) + (first - 0.5) for pixel in (row, column)]
    return cells.between(*places)


def of_pixels(image: Any, shape: tuple[int, int], sums: PixelSums, rows: Any, columns: Any) -> Any:
    """Weighted sums (Float) over the pixels in cells at rows and columns (Int32), counted from the frame's corner.

    Parameters
    ----------
    image : Float
        Values of a frame, pixel by pixel.
    shape : tuple of int
        Height and width of the frame.
    sums : PixelSums
    rows, columns : Int32
    """
    mi = mitsuba_runtime.start()
    import drjit as dr

    height, width = shape
    total = mi.Float(0)
    for down, right, plane, weight in sums.parts:
        y, x = rows * sums.side + down, columns * sums.side + right
        seen = (y >= 0) & (x >= 0)
        if sums.mirrored:
            seen &= (y < height + sums.side - 1) & (x < width + sums.side - 1)
            y, x = dr.minimum(y, 2 * (height - 1) - y), dr.minimum(x, 2 * (width - 1) - x)
        seen &= (y < height) & (x < width) & (y >= 0) & (x >= 0)
        place = mi.UInt32((y * width + x) * sums.planes + plane)
        total = dr.fma(dr.gather(mi.Float, image, place, seen), weight, total)
    return total
