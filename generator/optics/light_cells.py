"""Light on cells of a few pixels over the frame and its surroundings, and interpolation of smooth light back to pixels.

The finest cells cover the frame and a rim, and each level has cells of twice the side. The coarsest, of
:data:`generator.optics.wings.COARSE_PX`, extend over a margin around the frame from which scattered light still reaches
it. All values are densities: electrons per pixel.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from generator import mitsuba_runtime
from generator.optics.cell_kernels import Cells, PixelSums, of_pixels, on_pixels
from generator.optics.wings import COARSE_PX

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]

RIM = 5
"""Width in coarse cells of the rim around the frame with fine cells, as far as their Gaussians reach."""


@dataclass(frozen=True)
class PointPlaces:
    """Places of points of light on a grid's cells.

    Attributes
    ----------
    near, far : (k,), (l,) arrays
        Indices of the points on fine cells, and of the others.
    cells, shares : (4 k,) arrays
        Fine cells, and fractions of the light: the first corner for all near points, then the second, third and fourth.
    far_u, far_v : (l,) arrays
        Places of the others, px.
    """

    near: NDArray[np.intp]
    cells: NDArray[np.int32]
    shares: Floats
    far: NDArray[np.intp]
    far_u: Floats
    far_v: Floats


@dataclass(frozen=True)
class CellGrid:
    """Cells over a frame.

    Attributes
    ----------
    width, height : int
        Size of the frame, px.
    fine_px : int
        Side of the finest cells, px; a power of two, at most COARSE_PX.
    margin : int
        Coarse cells around the frame; at least RIM.
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

    def fine_from(self, frame: Any, sums: PixelSums, around: Floats, points: Singles | None = None) -> Cells:
        """Fine cells of a frame and of the light around it.

        Parameters
        ----------
        frame : Float
            Values, pixel by pixel.
        sums : PixelSums
            How pixels make up cells.
        around : (rows, columns) array
            Coarse cells, `shape`.
        points : array of `fine_shape`, optional
            Further light.
        """
        mi = mitsuba_runtime.start()
        import drjit as dr

        side, skip = self.fine_px, self.margin - RIM
        rows, columns = self.inner
        near = Cells.of(around[skip : skip + rows + 2 * RIM, skip : skip + columns + 2 * RIM])
        finer, first = COARSE_PX // side, RIM * COARSE_PX // side
        row, column = Cells(None, *self.fine_shape).lanes()
        covered = mi.Float(1)
        for place, size in ((row, self.height), (column, self.width)):
            in_frame = dr.select(place >= first, dr.clip(size - (place - first) * side, 0, side), 0)
            covered *= mi.Float(in_frame) * (1 / side)
        inside = of_pixels(frame, (self.height, self.width), sums, row - first, column - first)
        light = dr.fma(
            1 - covered, near.at(row // finer, column // finer), inside * covered if sums.mirrored else inside
        )
        if points is not None:
            light += Cells.of(points).values
        dr.eval(light)
        return Cells(light, *self.fine_shape)

    def place(self, u: Floats, v: Floats) -> PointPlaces:
        """Place points of light (n,) on their four nearest fine cells, or on a coarse cell beyond the rim."""
        rows, columns = self.fine_shape
        first = RIM * COARSE_PX
        column, row = ((place + 0.5 + first) / self.fine_px - 0.5 for place in (u, v))
        inside = (column >= 0) & (row >= 0) & (column < columns - 1) & (row < rows - 1)
        near = np.flatnonzero(inside)
        column, row = column[near], row[near]
        left, top = column.astype(np.int32), row.astype(np.int32)
        right, down = column - left, row - top
        cell = top * np.int32(columns) + left
        cells = np.concatenate([cell, cell + 1, cell + columns, cell + columns + 1])
        shares = np.concatenate([(1 - down) * (1 - right), (1 - down) * right, down * (1 - right), down * right])
        far = np.flatnonzero(~inside)
        return PointPlaces(near, cells, shares, far, u[far], v[far])

    def points_from(self, around: Floats, places: PointPlaces, electrons: Floats) -> Singles | None:
        """Light of points on fine cells; that of points beyond the rim is added to coarse cells.

        Returns
        -------
        array of `fine_shape` or None
            Light on fine cells; None if all points are beyond the rim.
        """
        self._add_far(around, places.far_u, places.far_v, electrons[places.far])
        if not len(places.near):
            return None
        light = np.tile(electrons[places.near] / self.fine_px**2, 4)
        light *= places.shares
        rows, columns = self.fine_shape
        return np.bincount(places.cells, light, rows * columns).reshape(rows, columns).astype(np.float32)

    def _add_far(self, around: Floats, u: Floats, v: Floats, electrons: Floats) -> None:
        """Add points of light beyond the rim to the coarse cells that contain them."""
        with np.errstate(invalid="ignore"):
            column, row = (np.floor((place + 0.5) / COARSE_PX) + self.margin for place in (u, v))
            inside = (column >= 0) & (row >= 0) & (column < self.shape[1]) & (row < self.shape[0])
        place = (row[inside] * self.shape[1] + column[inside]).astype(np.intp)
        np.add.at(around.reshape(-1), place, electrons[inside] / COARSE_PX**2)

    def on_pixels(self, cells: Cells) -> Any:
        """Fine cells' values on the frame's pixels (Float), interpolated linearly."""
        return on_pixels(cells, self.fine_px, RIM * COARSE_PX // self.fine_px, (self.height, self.width))


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
