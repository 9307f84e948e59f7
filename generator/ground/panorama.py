"""Panoramas: the surroundings in each direction around the camera, on a grid of equal steps in azimuth and altitude."""

from __future__ import annotations

import dataclasses
import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from generator.ground.lamp import Lamp

Floats = NDArray[np.float64]
Bytes = NDArray[np.uint8]

MOST_TEXELS = 2**25
"""Largest number of texels of any panorama: 8192 x 4096, 134 MB with its colours."""
EYE_HEIGHT_M = 1.6
"""Height of the camera above the ground of a panorama with known distances."""
NEARLY = 0.98
POLE_DEG = 89.0
ROWS_AT_ONCE = 256
"""Rows of a large panorama processed at once, in twice the memory of as many rows in single precision."""


@dataclass(frozen=True, eq=False)
class Panorama:
    """A panorama. Column 0 begins at north and columns go east; row 0 begins at `top_deg` and rows go down.

    Attributes
    ----------
    colour : (ny, nx, 3) uint8 array
        Red, green, blue encoded in sRGB; the linear value is the diffuse reflectance.
    alpha : (ny, nx) uint8 array
        Fraction of the texel that is covered, times 255.
    top_deg, bottom_deg : float
        Altitudes of the upper edge of the first row and of the lower edge of the last; nothing is beyond them.
    glow : (ny, nx, 3) uint8 array or None
        Light that it emits, encoded in sRGB; the linear value is the fraction of `glow_cd_m2`.
    glow_cd_m2 : float
        Luminance of the glow's white.
    distance_m : (ny, nx) float32 array or None
        Distance from the camera, for the light of lamps; None if unknown.
    lamps : tuple of Lamp
        Lamps that belong to it.
    white_reflectance : float
        Reflectance of the colours' white.
    """

    colour: Bytes
    alpha: Bytes
    top_deg: float = 90.0
    bottom_deg: float = -90.0
    glow: Bytes | None = None
    glow_cd_m2: float = 0.0
    distance_m: NDArray[np.float32] | None = None
    lamps: tuple[Lamp, ...] = ()
    white_reflectance: float = 1.0

    @property
    def shape(self) -> tuple[int, int]:
        """Numbers of rows and columns."""
        return self.alpha.shape[0], self.alpha.shape[1]


@dataclass(frozen=True, eq=False)
class Window:
    """Part of a grid of directions: rows, and columns, which may extend across north."""

    rows: slice
    columns: NDArray[np.intp]

    @property
    def place(self) -> tuple[int, int, int, int]:
        """First row, the row after the last, first column, and number of columns."""
        return self.rows.start, self.rows.stop, int(self.columns[0]), len(self.columns)

    def of(self, values: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return that part of values (ny, nx, ...); a view of them unless it extends across north."""
        first, count, around = int(self.columns[0]), len(self.columns), values.shape[1]
        rows = values[self.rows]
        if first + count <= around:
            return rows[:, first : first + count]
        return np.concatenate([rows[:, first:], rows[:, : first + count - around]], axis=1)


@dataclass(frozen=True, eq=False)
class Layers:
    """A panorama in linear values at another resolution, each texel the mean over its area.

    Attributes
    ----------
    alpha : (ny, nx) float32 array
    reflectance, glow : (ny, nx, 3) float32 arrays
        Values of linear red, green and blue, times alpha; `glow` is None if there is none.
    distance_m : (ny, nx) float32 array or None
        Distance at the texel's centre.
    top_deg, bottom_deg : float
    first_column, whole_columns : int
        For a window, its first column among those around the circle, and their number; `whole_columns` is 0 if it has all
        columns.
    """

    alpha: NDArray[np.float32]
    reflectance: NDArray[np.float32]
    glow: NDArray[np.float32] | None
    distance_m: NDArray[np.float32] | None
    top_deg: float
    bottom_deg: float
    first_column: int = 0
    whole_columns: int = 0

    @functools.cached_property
    def level(self) -> NDArray[np.bool_]:
        """Whether a texel is level ground, (ny, nx) or (ny, 1) array: below the horizon, and as far as there is ground."""
        down = np.sin(np.radians(-self.altitude_deg))[:, None]
        if self.distance_m is None:
            return down > 0
        return (down > 0) & (self.distance_m * down > NEARLY * EYE_HEIGHT_M)

    @property
    def altitude_deg(self) -> Floats:
        """Altitude of the rows' centres, (ny,) array."""
        return row_altitudes(len(self.alpha), self.top_deg, self.bottom_deg)

    @property
    def azimuth_deg(self) -> Floats:
        """Azimuth of the columns' centres, (nx,) array."""
        count = self.alpha.shape[1]
        whole = self.whole_columns or count
        return ((self.first_column + np.arange(count) + 0.5) * 360 / whole) % 360

    def window(self, part: Window) -> Layers:
        """The rows and columns of a window."""

        def cut(values: NDArray[np.float32] | None) -> NDArray[np.float32] | None:
            return None if values is None else part.of(values)

        step = (self.bottom_deg - self.top_deg) / len(self.alpha)
        alpha, reflectance = cut(self.alpha), cut(self.reflectance)
        assert alpha is not None
        assert reflectance is not None
        top = self.top_deg + part.rows.start * step
        whole = 0 if len(part.columns) == self.alpha.shape[1] else self.alpha.shape[1]
        first = int(part.columns[0]) if whole else 0
        return Layers(
            alpha, reflectance, cut(self.glow), cut(self.distance_m), top, top + len(alpha) * step, first, whole
        )

    def part(self, place: tuple[int, int, int, int]) -> Window:
        """Return the window for such a :attr:`Window.place`."""
        first, stop, column, count = place
        return Window(slice(first, stop), (column + np.arange(count)) % self.alpha.shape[1])

    def around(self, altitude_deg: float, azimuth_deg: float, radius_deg: float) -> Window:
        """Return the window that contains all directions within an angle of a direction."""
        ny, nx = self.alpha.shape
        step = (self.top_deg - self.bottom_deg) / ny
        high, low = altitude_deg + radius_deg, altitude_deg - radius_deg
        first = int(np.clip((self.top_deg - high) / step - 2, 0, ny - 1))
        stop = int(np.clip((self.top_deg - low) / step + 3, first + 1, ny))
        columns = np.arange(nx)
        if high < POLE_DEG and low > -POLE_DEG:
            half = np.degrees(np.arcsin(np.sin(np.radians(radius_deg)) / np.cos(np.radians(altitude_deg))))
            reach = int(np.ceil(half / 360 * nx)) + 3
            if 2 * reach + 1 < nx:
                middle = int(azimuth_deg % 360 / 360 * nx)
                columns = (middle + np.arange(-reach, reach + 1)) % nx
        return Window(slice(first, stop), columns)


def row_altitudes(rows: int, top_deg: float = 90.0, bottom_deg: float = -90.0) -> Floats:
    """Altitudes of the centres of evenly spaced rows, deg, (rows,) array."""
    return top_deg + (np.arange(rows) + 0.5) / rows * (bottom_deg - top_deg)


def column_azimuths(columns: int) -> Floats:
    """Azimuths of the centres of columns around the circle, deg, (columns,) array."""
    return (np.arange(columns) + 0.5) * 360 / columns


def fitted_shape(panorama: Panorama, texel_deg: float) -> tuple[int, int]:
    """Rows and columns of texels of the requested size, or of the panorama's own if that is larger."""
    ny, nx = panorama.shape
    span = panorama.top_deg - panorama.bottom_deg
    return int(np.clip(np.ceil(span / texel_deg), 1, ny)), int(np.clip(np.ceil(360 / texel_deg), 1, nx))


def reduced(panorama: Panorama, texel_deg: float) -> Layers:
    """Reduce the panorama to a coarser resolution, by the mean over the area of each coarse texel.

    Parameters
    ----------
    panorama : Panorama
    texel_deg : float
        Step of the result; the panorama's own if that is coarser.
    """
    ny, nx = panorama.shape
    rows, columns = fitted_shape(panorama, texel_deg)
    sums = _averaged(panorama, averaging(ny, np.linspace(0, ny, rows + 1)), columns)
    near = [((np.arange(fine) + 0.5) * whole / fine).astype(np.intp) for fine, whole in ((rows, ny), (columns, nx))]
    distance = None if panorama.distance_m is None else panorama.distance_m[near[0][:, None], near[1]]
    return _layers(sums, distance, panorama.top_deg, panorama.bottom_deg)


def on_sphere(panorama: Panorama, rows: int) -> Layers:
    """The panorama on rows from the zenith to the nadir and twice as many columns, empty beyond its own edges."""
    edges = np.linspace(90, -90, rows + 1)
    ny = panorama.shape[0]
    own = (panorama.top_deg - edges) / (panorama.top_deg - panorama.bottom_deg) * ny
    return _layers(_averaged(panorama, averaging(ny, own), 2 * rows), None, 90.0, -90.0)


def _layers(sums: NDArray[np.float32], distance_m: NDArray[np.float32] | None, top: float, bottom: float) -> Layers:
    glow = sums[:, :, 4:7] if sums.shape[2] > 4 else None
    return Layers(np.clip(sums[:, :, 0], 0, 1), sums[:, :, 1:4], glow, distance_m, top, bottom)


def _averaged(panorama: Panorama, down: csr_array, columns: int) -> NDArray[np.float32]:
    """Means of alpha and of the linear colours times alpha over coarse texels, (rows, columns, 4 or 7) array."""
    ny, nx = panorama.shape
    across = averaging(nx, np.linspace(0, nx, columns + 1)).T.tocsr()
    as_it_is = _takes_each(down) and _takes_each(across)
    coloured = [panorama.colour] if panorama.glow is None else [panorama.colour, panorama.glow]
    sums = np.zeros((down.shape[0], columns, 1 + 3 * len(coloured)), np.float32)
    for first in range(0, ny, ROWS_AT_ONCE):
        part = slice(first, min(first + ROWS_AT_ONCE, ny))
        alpha = panorama.alpha[part].astype(np.float32) / 255
        planes = [alpha]
        for colour, white in zip(coloured, (panorama.white_reflectance, 1.0), strict=False):
            planes += list(np.moveaxis(linear(colour[part]) * (white * alpha)[..., None], -1, 0))
        if as_it_is:
            sums[part] = np.stack(planes, axis=-1)
            continue
        rows = down[:, part]
        for number, plane in enumerate(planes):
            sums[:, :, number] += (rows @ plane) @ across
    return sums


def _takes_each(means: csr_array) -> bool:
    """Whether a matrix of means leaves every cell as it is, because the result is as fine as the panorama."""
    rows, columns = means.shape
    alone = rows == columns == means.nnz and bool((means.data == 1).all())
    return alone and bool((means.indices == np.arange(columns)).all())


def averaging(whole: int, edges: Floats) -> csr_array:
    """Matrix (n, whole), float32, for means of `whole` equal cells over n parts between edges, in cells; 0 beyond them."""
    first, last = edges[:-1, None], edges[1:, None]
    reach = int(np.ceil(float((last - first).max()))) + 1
    cell = np.floor(first).astype(np.intp) + np.arange(reach)
    share = np.clip(np.minimum(cell + 1, last) - np.maximum(cell, first), 0, None) / (last - first)
    inside = (share > 0) & (cell >= 0) & (cell < whole)
    row = np.broadcast_to(np.arange(len(first))[:, None], cell.shape)[inside]
    return csr_array((share[inside].astype(np.float32), (row, cell[inside])), shape=(len(first), whole))


def linear(encoded: Bytes) -> NDArray[np.float32]:
    """Convert 8-bit sRGB values (IEC 61966-2-1) to linear values, 0-1."""
    return _DECODED[encoded]


def encoded(value: NDArray[np.floating]) -> Bytes:
    """Convert linear values from 0 to 1 to 8-bit sRGB values; the inverse of :func:`linear`."""
    result = np.zeros(value.shape, np.uint8)
    # One row fits into the processor's cache; many rows of a panorama are empty.
    for row, out in zip(value.reshape(len(value), -1), result.reshape(len(value), -1), strict=True):
        if row.any():
            level = np.clip(row, 0, 1)
            curve = np.where(level <= 0.0031308, 12.92 * level, 1.055 * level ** (1 / 2.4) - 0.055)
            out[:] = np.rint(255 * curve)
    return result


def _decoding() -> NDArray[np.float32]:
    level = np.arange(256) / 255
    return np.where(level <= 0.04045, level / 12.92, ((level + 0.055) / 1.055) ** 2.4).astype(np.float32)


_DECODED = _decoding()


def cropped(panorama: Panorama) -> Panorama:
    """Return the panorama without the empty rows above its highest and below its lowest texel, for speed."""
    used = np.flatnonzero(panorama.alpha.any(axis=1))
    if not len(used):
        used = np.array([panorama.shape[0] - 1])
    first, stop = int(used[0]), int(used[-1]) + 1
    step = (panorama.bottom_deg - panorama.top_deg) / panorama.shape[0]
    rows = slice(first, stop)
    return dataclasses.replace(
        panorama,
        colour=np.ascontiguousarray(panorama.colour[rows]),
        alpha=np.ascontiguousarray(panorama.alpha[rows]),
        top_deg=panorama.top_deg + first * step,
        bottom_deg=panorama.top_deg + stop * step,
        glow=None if panorama.glow is None else np.ascontiguousarray(panorama.glow[rows]),
        distance_m=None if panorama.distance_m is None else np.ascontiguousarray(panorama.distance_m[rows]),
    )


def opacity(layers: Layers, azimuth_deg: Floats, altitude_deg: Floats) -> Floats:
    """Alpha in m directions, bilinear between the texels' centres, (m,) array."""
    ny, nx = layers.alpha.shape
    row = (layers.top_deg - np.asarray(altitude_deg)) / (layers.top_deg - layers.bottom_deg) * ny - 0.5
    column = np.asarray(azimuth_deg) % 360 / 360 * nx - 0.5
    padded = np.zeros((ny + 2, nx), np.float32)
    padded[1:-1] = layers.alpha
    # At the zenith and the nadir the grid ends, but not the landscape.
    if layers.top_deg >= 90:
        padded[0] = layers.alpha[0]
    if layers.bottom_deg <= -90:
        padded[-1] = layers.alpha[-1]
    row = np.clip(row + 1, 0, ny + 1)
    r0 = np.minimum(np.floor(row).astype(np.intp), ny)
    c0 = np.floor(column).astype(np.intp)
    wr, wc = row - r0, column - c0
    left, right = c0 % nx, (c0 + 1) % nx
    upper = padded[r0, left] * (1 - wc) + padded[r0, right] * wc
    lower = padded[r0 + 1, left] * (1 - wc) + padded[r0 + 1, right] * wc
    return np.asarray(upper * (1 - wr) + lower * wr, dtype=np.float64)
