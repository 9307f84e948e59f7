"""Tiles of an image: robust levels of samples of each tile, smoothed and interpolated to every pixel.

The values of a tile depend only on its own pixels and those of its neighbours, so areas outside the sky, or masked ones,
change nothing farther away.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

F4 = NDArray[np.float32]
F8 = NDArray[np.float64]
Mask = NDArray[np.bool_]
Value = TypeVar("Value", bound=np.generic)

# Samples along each side of a tile: the mean of 144 pixels is good to 8 % of the noise.
SAMPLES = 12
# Least number of samples for the values of a tile; with fewer, it takes those of the nearest tile that has them.
_FEWEST = 12


class PixelMap(Protocol):
    """Values of all pixels, computed on demand."""

    def strip(self, top: int, bottom: int) -> F4:
        """Values of the rows from `top` to `bottom`, shape (bottom - top, width)."""

    def at(self, rows: NDArray[np.integer], columns: NDArray[np.integer]) -> F4:
        """Values of single pixels, shape (n,)."""

    def mesh(self, rows: NDArray[np.integer], columns: NDArray[np.integer]) -> F4:
        """Values where rows and columns cross, shape (rows, columns)."""


@dataclass(frozen=True, eq=False)
class Tiles:
    """A grid of tiles over an image.

    Attributes
    ----------
    row_edges, column_edges : ndarray
        Borders of the tiles, shapes (rows + 1,) and (columns + 1,); between pixels if the sizes are not divisible.
    """

    row_edges: F8
    column_edges: F8

    @classmethod
    def of(cls, size: tuple[int, int], tile_px: int) -> Tiles:
        """Divide an image of a height and width into tiles of about `tile_px`."""
        return _tiles_of(size[0], size[1], tile_px)

    @property
    def shape(self) -> tuple[int, int]:
        """Number of rows and columns of tiles."""
        return len(self.row_edges) - 1, len(self.column_edges) - 1

    @cached_property
    def both(self) -> tuple[Tiles, Tiles]:
        """The grid, and one that is shifted by half a tile.

        A mean over both (`mean_map`) hardly depends on the position of tiles relative to clouds, and so on cropping.
        """
        return self, Tiles(_half_further(self.row_edges), _half_further(self.column_edges))

    def pairs(self, image: NDArray[Value]) -> NDArray[Value]:
        """Sample every tile, shape (tiles, 144), in blocks of two by two neighbours, because of colour mosaics."""
        return self._sampled(image, paired=True)

    def spread_samples(self, image: NDArray[Value]) -> NDArray[Value]:
        """Sample every tile, shape (tiles, 144), at equal distances."""
        return self._sampled(image, paired=False)

    def spread_samples_of(self, values: PixelMap) -> F4:
        """Sample every tile of a map as `spread_samples` does of an image."""
        return self._by_tile(values.mesh(*self._places[False]))

    def _sampled(self, image: NDArray[Value], paired: bool) -> NDArray[Value]:
        rows, columns = self._places[paired]
        return self._by_tile(image[rows].take(columns, axis=1))

    @cached_property
    def _places(self) -> dict[bool, tuple[NDArray[np.int_], NDArray[np.int_]]]:
        """Rows and columns of the samples, for `spread_samples` (False) and for `pairs` (True)."""
        edges = self.row_edges, self.column_edges
        return {
            paired: (_places(edges[0], paired).ravel(), _places(edges[1], paired).ravel()) for paired in (False, True)
        }

    def _by_tile(self, cut: NDArray[Value]) -> NDArray[Value]:
        tiled = cut.reshape(self.shape[0], SAMPLES, self.shape[1], SAMPLES).transpose(0, 2, 1, 3)
        return tiled.reshape(self.shape[0] * self.shape[1], SAMPLES * SAMPLES)

    def filled(self, values: F4, number: NDArray[np.int_]) -> F4:
        """Arrange values of the tiles, shape (tiles,), as a grid; tiles with too few samples get their nearest neighbour's.

        Parameters
        ----------
        values : ndarray, shape (tiles,)
            One value for each tile; those that are not finite count as unknown.
        number : ndarray of int, shape (tiles,)
            Number of samples that each value comes from.
        """
        known = (np.isfinite(values) & (number >= _FEWEST)).reshape(self.shape)
        if not known.any():
            known = np.isfinite(values).reshape(self.shape)
        grid = values.reshape(self.shape)
        if known.all():
            return grid
        if not known.any():
            return np.nan_to_num(grid)
        from scipy import ndimage

        nearest = ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True)
        return np.asarray(grid[tuple(nearest)])

    def same_value(self, image: NDArray[Value]) -> Mask:
        """Return in which tiles all samples of `pairs` have the same value, shape (tiles,)."""
        rows, columns = self._places[True]
        first = image[rows[::SAMPLES]].take(columns, axis=1).reshape(*self.shape, SAMPLES)
        if not (first == first[..., :1]).all(axis=2).any():
            return np.zeros(self.shape[0] * self.shape[1], dtype=bool)
        samples = self.pairs(image)
        return np.asarray((samples == samples[:, :1]).all(axis=1))

    def map_of(self, grid: F4, extrapolated: bool = True) -> TileMap:
        """Return a map that interpolates a grid of values between the tiles' centres; linear or constant beyond these."""
        return TileMap(np.asarray(grid, dtype=np.float32), *self._axes[extrapolated])

    @cached_property
    def _axes(self) -> dict[bool, tuple[_Between, _Between]]:
        """Positions of pixels between tiles, along columns and rows, for maps that are extrapolated or not."""
        edges = self.row_edges, self.column_edges
        rows, columns = (
            [_Between(_middles(each), round(float(each[-1])), beyond) for beyond in (False, True)] for each in edges
        )
        return {beyond: (rows[beyond], columns[beyond]) for beyond in (False, True)}


@lru_cache(maxsize=4)
def _tiles_of(height: int, width: int, tile_px: int) -> Tiles:
    rows, columns = (max(1, round(side / tile_px)) for side in (height, width))
    return Tiles(np.linspace(0, height, rows + 1), np.linspace(0, width, columns + 1))


@dataclass(frozen=True, eq=False)
class TileMap:
    """A grid of values, interpolated linearly to pixels on demand, because a whole map would not stay in the cache.

    Attributes
    ----------
    grid : ndarray of float32, shape (tile rows, tile columns)
        Values at the centres of the tiles.
    """

    grid: F4
    _rows: _Between
    _columns: _Between

    @cached_property
    def _across(self) -> F4:
        """Values at the rows of tile centres and all columns of the image."""
        return _between(self.grid.T, self._columns.left, self._columns.part).T.copy()

    def strip(self, top: int, bottom: int) -> F4:
        """Values of the rows from `top` to `bottom`, shape (bottom - top, width)."""
        left, part = self._rows.left[top:bottom], self._rows.part[top:bottom]
        first, last = int(left[0]), min(int(left[-1]) + 1, len(self.grid) - 1)
        weights = np.zeros((bottom - top, last - first + 1), dtype=np.float32)
        at = np.arange(bottom - top)
        weights[at, left - first] = 1 - part
        weights[at, np.minimum(left + 1, last) - first] += part
        return np.asarray(weights @ self._across[first : last + 1])

    def least(self, pieces: list[tuple[int, int]]) -> F4:
        """Return a lower bound of the values for each strip (first row, row after the last) and each column.

        The map must not be extrapolated; shape (strips, width).
        """
        left, across = self._rows.left, self._across
        begin, end = np.array(pieces).T
        first, last = left.take(begin), np.minimum(left.take(end - 1) + 1, len(across) - 1)
        least = across.take(first, axis=0)
        for step in range(1, int((last - first).max()) + 1):
            np.minimum(least, across.take(np.minimum(first + step, last), axis=0), out=least)
        return least

    def at(self, rows: NDArray[np.integer], columns: NDArray[np.integer]) -> F4:
        """Values of single pixels, shape (n,)."""
        left, down, across = self._rows.left, self._rows.part.take(rows), self._across.ravel()
        width = self._across.shape[1]
        value = across.take((left * width).take(rows) + columns)
        value *= 1 - down
        down *= across.take((np.minimum(left + 1, len(self.grid) - 1) * width).take(rows) + columns)
        value += down
        return value

    def mesh(self, rows: NDArray[np.integer], columns: NDArray[np.integer]) -> F4:
        """Values where rows and columns cross, shape (rows, columns)."""
        return _between(self._across.take(columns, axis=1), self._rows.left[rows], self._rows.part[rows])

    def whole(self) -> F4:
        """Values of all pixels, shape (height, width)."""
        return self.strip(0, self._rows.pixels)


def mean_map(maps: Sequence[TileMap]) -> TileMap:
    """Return the mean of maps of one image, as a map over the centres of all their tiles, which is exact."""
    rows, of_rows = _joined(*(each._rows for each in maps))
    columns, of_columns = _joined(*(each._columns for each in maps))
    grids = [
        _between(_between(each.grid.T, *across).T, *down)
        for each, down, across in zip(maps, of_rows, of_columns, strict=True)
    ]
    return TileMap(np.stack(grids).mean(axis=0), rows, columns)


def smooth(grid: F4) -> F4:
    """Return 3 x 3 medians of grids of tiles, shape (..., rows, columns); beyond the border, the outermost are repeated.

    Each is the median of three values: the highest of the columns' lowest values, the median of their medians, and the
    lowest of their highest values.
    """
    rows, columns = grid.shape[-2:]
    wide = np.empty((*grid.shape[:-2], rows + 2, columns + 2), dtype=np.float32)
    wide[..., 1:-1, 1:-1] = grid
    wide[..., 0, 1:-1], wide[..., -1, 1:-1] = grid[..., 0, :], grid[..., -1, :]
    wide[..., 0], wide[..., -1] = wide[..., 1], wide[..., -2]
    lowest, middle, highest = _in_order(wide[..., :-2, :], wide[..., 1:-1, :], wide[..., 2:, :])
    of_lowest, of_middle, of_highest = (
        _in_order(each[..., :-2], each[..., 1:-1], each[..., 2:]) for each in (lowest, middle, highest)
    )
    return _in_order(of_lowest[2], of_middle[1], of_highest[0])[1]


def _in_order(a: F4, b: F4, c: F4) -> tuple[F4, F4, F4]:
    """Return the lowest, middle and highest of three."""
    low, high = np.minimum(a, b), np.maximum(a, b)
    return np.minimum(low, c), np.maximum(low, np.minimum(high, c)), np.maximum(high, c)


def _half_further(edges: F8) -> F8:
    """Return edges at the centres of tiles; a single tile stays unchanged."""
    if len(edges) == 2:
        return edges
    return np.concatenate((edges[:1], (edges[:-1] + edges[1:]) / 2, edges[-1:]))


def _places(edges: F8, paired: bool) -> NDArray[np.int_]:
    """Return the sampled pixels of each tile along one axis, shape (tiles, samples), symmetric under image reversal."""
    begin, size, side = edges[:-1, None], np.diff(edges)[:, None], round(float(edges[-1]))
    k = np.arange(SAMPLES)[None, :]
    # An offset of a ten-thousandth keeps rounding errors from deciding between whole numbers.
    if paired:
        first = begin + (k // 2) * (size * 2 / SAMPLES) + 1e-4
        places = np.minimum(first.astype(np.int_), side - 2) + k % 2
    else:
        places = (begin + (2 * k + 1) * (size / (2 * SAMPLES)) + 1e-4).astype(np.int_)
    half = places.ravel()[: places.size // 2]
    return np.asarray(np.concatenate((half, side - 1 - half[::-1])).reshape(places.shape))


@dataclass(frozen=True, eq=False)
class _Between:
    """Positions of the pixels along an axis between tile centres: the centre before, and the fraction to the next."""

    centres: F8
    pixels: int
    extrapolated: bool

    @property
    def left(self) -> NDArray[np.intp]:
        return self._located[0]

    @property
    def part(self) -> F4:
        return self._located[1]

    @cached_property
    def _located(self) -> tuple[NDArray[np.intp], F4]:
        return _within(self.centres, np.arange(self.pixels), self.extrapolated)


@lru_cache(maxsize=16)
def _joined(*axes: _Between) -> tuple[_Between, list[tuple[NDArray[np.intp], F4]]]:
    """Join axes into one with the centres of all; also return where these are between the centres of each axis."""
    centres = np.unique(np.concatenate([axis.centres for axis in axes]))
    return replace(axes[0], centres=centres), [_within(axis.centres, centres, axis.extrapolated) for axis in axes]


def _middles(edges: F8) -> F8:
    return np.asarray((edges[:-1] + edges[1:] - 1) / 2)


def _within(centres: F8, at: NDArray[np.number], extrapolated: bool) -> tuple[NDArray[np.intp], F4]:
    """Return the centre before each position, and the fraction of the way to the next, shapes (n,)."""
    if len(centres) == 1:
        return np.zeros(len(at), dtype=np.intp), np.zeros(len(at), dtype=np.float32)
    left = np.clip(np.searchsorted(centres, at) - 1, 0, len(centres) - 2)
    part = (at - centres[left]) / (centres[left + 1] - centres[left])
    return left, np.asarray(part if extrapolated else np.clip(part, 0, 1), dtype=np.float32)


def _between(values: F4, left: NDArray[np.intp], part: F4) -> F4:
    """Interpolate rows, shape (n, k), at positions between them, shape (m, k)."""
    between = values.take(left, axis=0)
    between *= (1 - part)[:, None]
    after = values.take(np.minimum(left + 1, len(values) - 1), axis=0)
    after *= part[:, None]
    between += after
    return between
