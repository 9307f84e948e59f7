"""The grid of directions on which the sky is tabulated for one frame."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]

ALTITUDE_POWER = 1.5
"""Exponent of the rows' spacing, finer near the horizon: altitude = 90 deg x (row / last row) to this power."""
ROWS, COLUMNS = 241, 720


@dataclass(frozen=True)
class SkyGrid:
    """Directions above the horizon: rows of equal altitude, columns of equal azimuth.

    Attributes
    ----------
    altitude_deg : (ny,) array
        Apparent altitudes, 0 to 90.
    azimuth_deg : (nx,) array
        Azimuths from 0 in equal steps; the column after the last is the first.
    """

    altitude_deg: Floats
    azimuth_deg: Floats

    @property
    def shape(self) -> tuple[int, int]:
        """Numbers of rows and columns."""
        return len(self.altitude_deg), len(self.azimuth_deg)

    @functools.cached_property
    def enu(self) -> Floats:
        """Unit vectors, (ny, nx, 3)."""
        return unit_vectors(self.altitude_deg[:, None], self.azimuth_deg[None, :])


def unit_vectors(altitude_deg: ArrayLike, azimuth_deg: ArrayLike) -> Floats:
    """ENU unit vectors of directions, (..., 3) array."""
    altitude, azimuth = np.radians(altitude_deg), np.radians(azimuth_deg)
    east, north, up = np.broadcast_arrays(
        np.sin(azimuth) * np.cos(altitude), np.cos(azimuth) * np.cos(altitude), np.sin(altitude)
    )
    return np.stack([east, north, up], axis=-1)


@functools.cache
def sky_grid(rows: int = ROWS, columns: int = COLUMNS) -> SkyGrid:
    """Return the grid of the emitter, with a resolution of about half a degree."""
    return SkyGrid(90 * np.linspace(0, 1, rows) ** ALTITUDE_POWER, np.arange(columns) * 360 / columns)


@functools.cache
def irradiance_weights() -> Floats:
    """Weights of the grid's rows in the hemisphere's mean radiance on a level surface, (ny,) array."""
    altitude = np.radians(sky_grid().altitude_deg)
    weight = np.sin(altitude) * np.cos(altitude) * np.gradient(altitude)
    return np.asarray(weight / weight.sum())


@dataclass(frozen=True, eq=False)
class Places:
    """Directions on the layout of :func:`sky_grid`, for bilinear look-ups as in the emitter.

    Attributes
    ----------
    row, column, next_column : (m,) int arrays
        Indices of the grid corner before each direction, and of the column after it.
    down, right : (m,) arrays
        Weights of the row and of the column after it.
    """

    row: NDArray[np.intp]
    column: NDArray[np.intp]
    next_column: NDArray[np.intp]
    down: Floats
    right: Floats

    def of(self, maps: NDArray[np.float32]) -> Floats:
        """Values of maps (k, ny, nx), or (k, ny, 1) if nothing depends on the azimuth, (k, m) array."""
        count, _, nx = maps.shape
        left, right = (self.column, self.next_column) if nx > 1 else (0, 0)
        # Indexing with one index is several times faster than with two.
        flat = np.ascontiguousarray(maps).reshape(count, -1)
        upper, lower = (
            flat.take(row * nx + left, axis=1) * (1 - self.right) + flat.take(row * nx + right, axis=1) * self.right
            for row in (self.row, self.row + 1)
        )
        return np.asarray(upper * (1 - self.down) + lower * self.down)


def places(altitude_deg: ArrayLike, azimuth_deg: ArrayLike) -> Places:
    """Locate directions (m,) on the grid of the emitter; altitudes below 0 take the horizon's value."""
    ny, nx = sky_grid().shape
    row = (np.clip(np.asarray(altitude_deg, float), 0, 90) / 90) ** (1 / ALTITUDE_POWER) * (ny - 1)
    column = (np.asarray(azimuth_deg, float) % 360) / 360 * nx
    r0, c0 = np.minimum(row.astype(np.intp), ny - 2), column.astype(np.intp)
    return Places(r0, c0 % nx, (c0 + 1) % nx, row - r0, column - c0)


def interpolate(maps: NDArray[np.float32], altitude_deg: ArrayLike, azimuth_deg: ArrayLike) -> Floats:
    """Bilinear interpolation of maps (k, ny, nx) or (k, ny, 1) in directions (m,), (k, m) array: see :class:`Places`."""
    return places(altitude_deg, azimuth_deg).of(maps)
