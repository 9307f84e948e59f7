"""Zodiacal light: Leinert's table of brightness over the sky, with a reddened solar spectrum."""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import RegularGridInterpolator

from generator.light.atmosphere import Atmosphere
from generator.light.photometry import GRID_NM
from generator.sky.component import SkyTable, above_the_air
from generator.sky.directions import sky_grid
from generator.sky.sunlight import solar_shape

Floats = NDArray[np.float64]

# Brightness at 500 nm, 1e-8 W m^-2 sr^-1 um^-1, by |ecliptic longitude - Sun's| (rows) and |ecliptic latitude| (columns).
# Source: Levasseur-Regourd & Dumont 1980 as given by Leinert et al. 1998, A&AS 127, 1, table 17. Empty entries of the
# table (closer to the Sun than 15 deg) are filled with the nearest value towards the pole; the pole itself is 77.
_LATITUDE_DEG = [0, 5, 10, 15, 20, 25, 30, 45, 60, 75, 90]
_LONGITUDE_DEG = [0, 15, 20, 25, 30, 35, 40, 45, 60, 75, 90, 105, 120, 135, 150, 165, 180]
_BRIGHTNESS = [
    [11500, 6780, 3440, 3140, 1610, 985, 640, 275, 150, 100, 77],
    [11500, 6780, 3440, 1860, 1110, 755, 525, 251, 146, 100, 77],
    [6400, 4480, 2410, 1410, 910, 635, 454, 237, 141, 99, 77],
    [3840, 2830, 1730, 1100, 749, 545, 410, 223, 136, 97, 77],
    [2480, 1870, 1220, 845, 615, 467, 365, 207, 131, 95, 77],
    [1650, 1270, 910, 680, 510, 397, 320, 193, 125, 93, 77],
    [1180, 940, 700, 530, 416, 338, 282, 179, 120, 92, 77],
    [910, 730, 555, 442, 356, 292, 250, 166, 116, 90, 77],
    [505, 442, 352, 292, 243, 209, 183, 134, 104, 86, 77],
    [338, 317, 269, 227, 196, 172, 151, 116, 93, 82, 77],
    [259, 251, 225, 193, 166, 147, 132, 104, 86, 79, 77],
    [212, 210, 197, 170, 150, 133, 119, 96, 82, 77, 77],
    [188, 186, 177, 154, 138, 125, 113, 90, 77, 74, 77],
    [179, 178, 166, 147, 134, 122, 110, 90, 77, 73, 77],
    [179, 178, 165, 148, 137, 127, 116, 96, 79, 72, 77],
    [196, 192, 179, 165, 151, 141, 131, 104, 82, 72, 77],
    [230, 212, 195, 178, 163, 148, 134, 105, 83, 72, 77],
]
PHOTONS_PER_UNIT_AT_500_NM = 1e-11 * 500e-9 / (6.62607015e-34 * 299792458.0)
"""Photons s^-1 m^-2 nm^-1 sr^-1 in 1e-8 W m^-2 sr^-1 um^-1 at 500 nm."""
OBLIQUITY_DEG = 23.43928


@functools.cache
def _interpolator() -> RegularGridInterpolator:
    # Interpolated linearly in the logarithm, because the table falls by a third from step to step near the Sun.
    table = np.log(np.array(_BRIGHTNESS, float))
    return RegularGridInterpolator((np.array(_LONGITUDE_DEG, float), np.array(_LATITUDE_DEG, float)), table)


def brightness(longitude_from_sun_deg: ArrayLike, latitude_deg: ArrayLike) -> Floats:
    """Brightness at 500 nm, 1e-8 W m^-2 sr^-1 um^-1, by ecliptic longitude from the Sun and ecliptic latitude."""
    longitude = np.abs((np.asarray(longitude_from_sun_deg, float) + 180) % 360 - 180)
    return np.exp(_interpolator()((longitude, np.abs(np.asarray(latitude_deg, float)))))


@functools.cache
def spectrum() -> Floats:
    """Photon spectrum per unit of :func:`brightness`, photons s^-1 m^-2 nm^-1 sr^-1 at GRID_NM.

    Sunlight, reddened by 1 + 0.9 log10(l/500 nm) below and 1 + 0.6 log10(l/500 nm) above 500 nm (elongation 90 deg).
    Source: Leinert et al. 1998, eq. 22.
    """
    reddening = 1 + np.where(GRID_NM < 500, 0.9, 0.6) * np.log10(GRID_NM / 500)
    return PHOTONS_PER_UNIT_AT_500_NM * solar_shape() * reddening


def ecliptic_from_icrs() -> Floats:
    """Rotation ICRS to the mean ecliptic of J2000 (3, 3)."""
    sine, cosine = np.sin(np.radians(OBLIQUITY_DEG)), np.cos(np.radians(OBLIQUITY_DEG))
    return np.array([[1, 0, 0], [0, cosine, sine], [0, -sine, cosine]])


@functools.cache
def _coarse_directions() -> tuple[NDArray[np.intp], NDArray[np.intp], Floats]:
    """Every third row and column of the grid, and their unit vectors, (3, directions) array.

    The table is smooth, so linear interpolation in between is as good as evaluating all.
    """
    grid = sky_grid()
    rows = np.unique(np.append(np.arange(0, grid.shape[0], 3), grid.shape[0] - 1))
    columns = np.arange(0, grid.shape[1], 3)
    return rows, columns, np.ascontiguousarray(grid.enu[rows][:, columns].reshape(-1, 3).T)


def zodiacal(icrs_from_enu: Floats, sun_icrs: Floats, atmosphere: Atmosphere | None) -> SkyTable:
    """Zodiacal light at the ground.

    Parameters
    ----------
    icrs_from_enu : (3, 3) array
    sun_icrs : (3,) array
        Unit vector to the Sun.
    atmosphere : Atmosphere or None
    """
    rotation = ecliptic_from_icrs()
    sun = rotation @ sun_icrs
    grid = sky_grid()
    rows, columns, towards = _coarse_directions()
    x, y, z = ((rotation @ icrs_from_enu) @ towards).reshape(3, len(rows), len(columns))
    longitude = np.degrees(np.arctan2(y, x) - np.arctan2(sun[1], sun[0]))
    coarse = brightness(longitude, np.degrees(np.arcsin(np.clip(z, -1, 1))))
    return above_the_air(upsampled(coarse, rows, columns, grid.shape), spectrum(), atmosphere)


def upsampled(
    coarse: Floats, rows: NDArray[np.intp], columns: NDArray[np.intp], shape: tuple[int, int]
) -> NDArray[np.float32]:
    """Linear interpolation from some of the grid's rows and even (periodic) columns to all of them, (ny, nx) array."""
    down = upsampled_rows(coarse, rows, shape[0])
    step = shape[1] // len(columns)
    change = np.roll(down, -1, axis=1) - down
    result = np.empty((shape[0], len(columns), step), np.float32)
    for number in range(step):
        np.add(down, np.float32(number / step) * change, out=result[:, :, number])
    return result.reshape(shape)


def upsampled_rows(coarse: Floats, rows: NDArray[np.intp], size: int) -> NDArray[np.float32]:
    """Linear interpolation from some of the grid's rows, (..., rows, m) array, to all of them, (..., size, m) array."""
    return _hats(tuple(rows.tolist()), size, False) @ coarse.astype(np.float32)


def column_weights(columns: NDArray[np.intp], size: int) -> NDArray[np.float32]:
    """Weights (columns, size) of linear interpolation from some (periodic) columns to all of them."""
    return _hats(tuple(columns.tolist()), size, True).T


@functools.lru_cache(maxsize=32)
def _hats(nodes: tuple[int, ...], size: int, periodic: bool) -> NDArray[np.float32]:
    """Weights (size, nodes) of linear interpolation from nodes, of which the first is 0, to all of `size` numbers."""
    ends = (*nodes, size) if periodic else nodes
    weights = np.array([np.interp(np.arange(size), ends, row) for row in np.eye(len(ends), dtype=np.float32)]).T
    if periodic:
        weights[:, 0] += weights[:, -1]
    return np.ascontiguousarray(weights[:, : len(nodes)], np.float32)
