"""Light on cells of a few pixels over the frame and its surroundings, and smooth light on cells back on pixels.

The finest cells cover the frame and a rim, each level has cells of twice the side, and the coarsest, of
:data:`generator.optics.wings.COARSE_PX`, extend to a margin around the frame from where scattered light still reaches it. All
values are densities: electrons per pixel.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from generator.optics.wings import COARSE_PX

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]

RIM = 5
"""Coarse cells around the frame in which light is kept on fine cells, as far as the Gaussians of these reach."""


@dataclass(frozen=True)
class CellGrid:
    """Cells over a frame.

    Attributes
    ----------
    width, height : int
        Of the frame, px.
    fine_px : int
        Side of the finest cells, px; a power of two, COARSE_PX at most.
    margin : int
        Coarse cells around the frame; RIM at least.
    """

    width: int
    height: int
    fine_px: int
    margin: int

    @property
    def inner(self) -> tuple[int, int]:
        """Rows and columns of coarse cells that touch the frame."""
        return math.ceil(self.height / COARSE_PX), math.ceil(self.width / COARSE_PX)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of all coarse cells."""
        rows, columns = self.inner
        return rows + 2 * self.margin, columns + 2 * self.margin

    @property
    def fine_shape(self) -> tuple[int, int]:
        """Rows and columns of the fine cells: over the frame and its rim."""
        rows, columns = self.inner
        finer = COARSE_PX // self.fine_px
        return (rows + 2 * RIM) * finer, (columns + 2 * RIM) * finer

    def fine_from(self, frame: Singles, around: Floats) -> Singles:
        """Fine cells of an image (height, width) and of the light around it (coarse cells, `shape`)."""
        side = self.fine_px
        skip = self.margin - RIM
        rows, columns = self.inner
        near = around[skip : skip + rows + 2 * RIM, skip : skip + columns + 2 * RIM].astype(np.float32)
        finer = COARSE_PX // side
        parts = np.broadcast_to(near[:, None, :, None], (len(near), finer, near.shape[1], finer))
        cells = np.array(parts).reshape(len(near) * finer, near.shape[1] * finer)
        first = RIM * COARSE_PX // side
        down, across = math.ceil(self.height / side), math.ceil(self.width / side)
        inside = cells[first : first + down, first : first + across]
        if (down * side, across * side) == frame.shape:
            inside[:] = block_mean(frame, side)
            return cells
        covered = [np.clip(size - np.arange(count) * side, 0, side) / side for size, count in
                   ((self.height, down), (self.width, across))]  # fmt: skip
        inside *= (1 - covered[0][:, None] * covered[1]).astype(np.float32)
        whole = np.pad(frame, [(0, down * side - self.height), (0, across * side - self.width)])
        inside += block_mean(whole, side)
        return cells

    def add_points(self, cells: Singles, around: Floats, u: Floats, v: Floats, electrons: Floats) -> None:
        """Add points of light: to the four nearest fine cells, or to a coarse cell where they lie beyond the rim."""
        rows, columns = cells.shape
        first = RIM * COARSE_PX
        column, row = ((place + 0.5 + first) / self.fine_px - 0.5 for place in (u, v))
        near = (column >= 0) & (row >= 0) & (column < columns - 1) & (row < rows - 1)
        far = np.flatnonzero(~near)
        self._add_far(around, u[far], v[far], electrons[far])
        if len(far) == len(near):
            return
        light = electrons[near] / self.fine_px**2
        left, top = np.floor(column[near]).astype(np.intp), np.floor(row[near]).astype(np.intp)
        right, down = column[near] - left, row[near] - top
        corners = [
            ((top + step_down) * columns + left + step_right, light * by_row * by_column)
            for step_down, by_row in ((0, 1 - down), (1, down))
            for step_right, by_column in ((0, 1 - right), (1, right))
        ]
        place, weight = (np.concatenate(parts) for parts in zip(*corners, strict=True))
        cells += np.bincount(place, weight, cells.size).reshape(rows, columns).astype(np.float32)

    def _add_far(self, around: Floats, u: Floats, v: Floats, electrons: Floats) -> None:
        """Add points of light beyond the rim to the coarse cells that they lie in."""
        with np.errstate(invalid="ignore"):
            column, row = (np.floor((place + 0.5) / COARSE_PX) + self.margin for place in (u, v))
            inside = (column >= 0) & (row >= 0) & (column < self.shape[1]) & (row < self.shape[0])
        place = (row[inside] * self.shape[1] + column[inside]).astype(np.intp)
        np.add.at(around.reshape(-1), place, electrons[inside] / COARSE_PX**2)

    def on_pixels(self, cells: Singles) -> Singles:
        """Fine cells' values on the frame's pixels, (height, width), interpolated linearly."""
        first = RIM * COARSE_PX // self.fine_px
        down, across = math.ceil(self.height / self.fine_px), math.ceil(self.width / self.fine_px)
        part = cells[first - 1 : first + down + 1, first - 1 : first + across + 1]
        return enlarged(part, self.fine_px)[: self.height, : self.width]


@functools.lru_cache(maxsize=4)
def cells_outside(grid: CellGrid) -> tuple[NDArray[np.intp], Floats, Floats]:
    """Coarse cells that are not wholly inside the frame: flat index, and u and v of their middles, px."""
    rows, columns = grid.shape
    row, column = np.divmod(np.arange(rows * columns), columns)
    left, top = ((place - grid.margin) * COARSE_PX for place in (column, row))
    within = (left >= 0) & (left + COARSE_PX <= grid.width) & (top >= 0) & (top + COARSE_PX <= grid.height)
    index = np.flatnonzero(~within)
    middle = (COARSE_PX - 1) / 2
    return index, left[index] + middle, top[index] + middle


def block_mean(image: Singles, side: int) -> Singles:
    """Means over blocks of side x side; the image's size is a multiple of it."""
    if side == 1:
        return image
    rows = image[0::side].copy()
    for step in range(1, side):
        rows += image[step::side]
    mean = rows[:, 0::side].copy()
    for step in range(1, side):
        mean += rows[:, step::side]
    mean *= np.float32(1 / side**2)
    return mean


def halved(cells: Singles) -> Singles:
    """Values on cells of twice the side, without moving the light's centroid: the transpose of linear interpolation."""
    wide = np.pad(cells, 1, mode="edge")
    rows = np.float32(0.375) * (wide[1:-1:2] + wide[2:-1:2])
    rows += np.float32(0.125) * (wide[0:-3:2] + wide[3::2])
    result = np.float32(0.375) * (rows[:, 1:-1:2] + rows[:, 2:-1:2])
    result += np.float32(0.125) * (rows[:, 0:-3:2] + rows[:, 3::2])
    return result


def enlarged(cells: Singles, side: int) -> Singles:
    """Values (rows, columns) of cells, without the outermost, on side x side points in each, interpolated linearly."""
    if side == 1:
        return cells[1:-1, 1:-1]
    rows, columns = cells.shape
    wide = np.empty((rows, (columns - 2) * side), np.float32)
    for step in range(side):
        weight = np.float32((step + 0.5) / side - 0.5)
        other = cells[:, :-2] if weight < 0 else cells[:, 2:]
        wide[:, step::side] = cells[:, 1:-1] + abs(weight) * (other - cells[:, 1:-1])
    result = np.empty(((rows - 2) * side, wide.shape[1]), np.float32)
    for step in range(side):
        weight = np.float32((step + 0.5) / side - 0.5)
        other = wide[:-2] if weight < 0 else wide[2:]
        result[step::side] = wide[1:-1] + abs(weight) * (other - wide[1:-1])
    return result
