"""Light on a landscape: from the sky around it, from the Moon, and from the rest of the landscape.

The picture of a landscape contains no shapes. Everything above the horizon is taken as upright and facing the camera
(houses, the edge of a wood, a slope seen from the plain), and everything below it as level ground; both reflect evenly in
all directions (Lambert 1760). Each surface is lit by the sky that it faces, by the Moon unless the landscape hides it,
and by the opposite landscape, as if all surfaces were at the camera's place. All orders of reflection are included, so
that a white landscape under a uniform sky becomes as bright as the sky (it neither creates nor absorbs light).

Radiance and irradiance are in photons s^-1 m^-2 nm^-1 (sr^-1) at GRID_NM.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from generator.ground.lamp import Lamp
from generator.ground.panorama import Layers, Panorama, column_azimuths, on_sphere, opacity, row_altitudes
from generator.ground.reflectance import primaries

Floats = NDArray[np.float64]

WALLS = 72
"""Number of azimuths of upright surfaces, evenly spaced from north."""
ROWS = 72
"""Rows of the grid of directions from which light comes: cells of 2.5 deg."""

LAMP_ROWS = 128
LEAST_LAMP_DISTANCE_M = 0.3
MOST_RETURNED = 1 - 1e-6
"""Largest fraction of the light that a surface reflects; otherwise the series of reflections in a closed white room would not
end."""


@dataclass(frozen=True, eq=False)
class SkyLight:
    """Light from above.

    Attributes
    ----------
    maps : (k, ROWS^2) array
        Values in the directions of :func:`sky_directions`.
    spectra : (k, n) array
        Spectra; the sky's radiance is the sum of map times spectrum.
    moon_enu : (3,) array
    moon_irradiance : (n,) array
        Irradiance of the Moon's direct light at the ground, perpendicular to it; 0 without Moon.
    """

    maps: Floats
    spectra: Floats
    moon_enu: Floats
    moon_irradiance: Floats


def unit_vectors(altitude_deg: Floats, azimuth_deg: Floats) -> Floats:
    """Unit vectors east, north, up of directions, (..., 3) array."""
    altitude, azimuth = np.radians(altitude_deg), np.radians(azimuth_deg)
    level = np.cos(altitude)
    parts = np.broadcast_arrays(np.sin(azimuth) * level, np.cos(azimuth) * level, np.sin(altitude))
    return np.stack(parts, axis=-1)


def _cells() -> tuple[Floats, Floats]:
    """Altitudes and azimuths of the centres of all cells, row by row from the zenith, (2 ROWS^2,) arrays."""
    grid = np.meshgrid(row_altitudes(ROWS), column_azimuths(2 * ROWS), indexing="ij")
    return grid[0].ravel(), grid[1].ravel()


def sky_directions() -> tuple[Floats, Floats]:
    """Altitudes and azimuths, deg, at which the sky's radiance is needed: the cells above the horizon, (ROWS^2,) arrays."""
    altitude, azimuth = _cells()
    return altitude[: ROWS * ROWS], azimuth[: ROWS * ROWS]


def surface_normals() -> Floats:
    """Outward normals of the WALLS upright surfaces that face the camera, and of level ground, (WALLS + 1, 3) array."""
    walls = -unit_vectors(np.zeros(WALLS), np.arange(WALLS) * 360 / WALLS)
    return np.concatenate([walls, [[0.0, 0.0, 1.0]]])


@functools.cache
def _projected() -> Floats:
    """Projected solid angles of all cells over surfaces, sr, (WALLS + 1, cells) array; pi in sum for each surface."""
    altitude, azimuth = _cells()
    weight = np.maximum(surface_normals() @ unit_vectors(altitude, azimuth).T, 0) * np.cos(np.radians(altitude))
    return np.asarray(np.pi * weight / weight.sum(axis=1, keepdims=True))


def irradiance(panorama: Panorama, light: SkyLight) -> Floats:
    """Irradiance of the surfaces of :func:`surface_normals` at the centre of a landscape, (WALLS + 1, n) array."""
    around = _surroundings(panorama)
    moon_seen = 1 - float(opacity(around.sphere, *_azimuth_altitude(light.moon_enu))[0])
    moon = np.maximum(surface_normals() @ light.moon_enu, 0)[:, None] * (moon_seen * light.moon_irradiance)
    direct = (around.from_sky @ light.maps.T) @ light.spectra + moon
    return np.asarray(np.linalg.solve(around.kept, direct.T[:, :, None])[:, :, 0].T)


@dataclass(frozen=True, eq=False)
class _Surroundings:
    """Surroundings of the surfaces at the centre of a landscape.

    Attributes
    ----------
    sphere : Layers
        The landscape on the grid of cells.
    from_sky : (WALLS + 1, ROWS^2) array
        Projected solid angles of the sky's directions, without hidden parts, sr.
    kept : (n, WALLS + 1, WALLS + 1) array
        Matrices by wavelength; their product with the irradiance of all surfaces is the light that arrives without
        reflections by the landscape.
    """

    sphere: Layers
    from_sky: Floats
    kept: Floats


@functools.lru_cache(maxsize=2)
def _surroundings(panorama: Panorama) -> _Surroundings:
    sphere = on_sphere(panorama, ROWS)
    covered = sphere.alpha.reshape(-1).astype(np.float64)
    above, projected = ROWS * ROWS, _projected()
    used = np.flatnonzero(covered)
    altitude, azimuth = (angle[used] for angle in _cells())
    wall, weight = walls_around(azimuth)
    level = altitude < 0
    lit = np.zeros((len(used), WALLS + 1))
    row = np.arange(len(used))
    lit[row, wall] = np.where(level, 0, 1 - weight)
    lit[row, (wall + 1) % WALLS] = np.where(level, 0, weight)
    lit[row, -1] = level
    colours = sphere.reflectance.reshape(-1, 3)[used] / np.pi
    # Light from every surface to every other one, via the landscape's linear red, green and blue.
    by_colour = np.stack([(projected[:, used] * colours[:, band]) @ lit for band in range(3)])
    exchange = MOST_RETURNED * np.einsum("bn,bst->nst", primaries(), by_colour)
    return _Surroundings(sphere, projected[:, :above] * (1 - covered[:above]), np.eye(WALLS + 1) - exchange)


def walls_around(azimuth_deg: Floats) -> tuple[NDArray[np.intp], Floats]:
    """For azimuths (m,), return the wall before each, and the weight of the wall after it, (m,) arrays."""
    place = np.asarray(azimuth_deg) % 360 / 360 * WALLS
    wall = np.minimum(place.astype(np.intp), WALLS - 1)
    return wall, place - wall


def _azimuth_altitude(enu: Floats) -> tuple[Floats, Floats]:
    azimuth = np.degrees(np.arctan2(enu[0], enu[1]))
    altitude = np.degrees(np.arctan2(enu[2], np.hypot(enu[0], enu[1])))
    return np.array([azimuth]), np.array([altitude])


def transmission(layers: Layers, extinction_per_km: float) -> NDArray[np.float32] | None:
    """Fraction of a landscape's light that passes the air between it and the camera, (ny, nx) array; None if all does.

    Pictures with unknown distances already contain the air of their photograph.
    """
    if layers.distance_m is None or extinction_per_km == 0:
        return None
    return np.asarray(np.exp(np.float32(-extinction_per_km / 1000) * layers.distance_m))


def lamp_illuminance(layers: Layers, lamps: tuple[Lamp, ...], plain: tuple[float, float]) -> NDArray[np.float32]:
    """Illuminance of a landscape's surfaces by lamps near them, lx, (ny, nx) array.

    Each lamp shines evenly below the horizontal with its `downward_cd`; there are no shadows.

    Parameters
    ----------
    layers : Layers
    lamps : tuple of Lamp
    plain : (eye height, distance)
        Eye height above the ground and distance of everything above the horizon, m, if the layers have no distances.
    """
    total = np.zeros(layers.alpha.shape, np.float32)
    azimuth = np.radians(layers.azimuth_deg).astype(np.float32)
    east, north = np.sin(azimuth), np.cos(azimuth)
    for first in range(0, len(total), LAMP_ROWS):
        rows = slice(first, first + LAMP_ROWS)
        altitude = np.radians(layers.altitude_deg[rows]).astype(np.float32)[:, None]
        distance = _distances(layers, rows, plain)
        level = distance * np.cos(altitude)
        place = (level * east, level * north, distance * np.sin(altitude))
        upright = ~layers.level[rows]
        for lamp in lamps:
            to_east, to_north, to_up = (float(end) - start for end, start in zip(lamp.place_m, place, strict=True))
            square = to_east**2 + to_north**2 + to_up**2
            facing = np.where(upright, -(to_east * east + to_north * north), to_up)
            lit = np.where(to_up > 0, np.maximum(facing, 0), 0)
            # A surface cannot be nearer to a lamp than the size of the lamp.
            total[rows] += lamp.downward_cd * lit / np.maximum(square, LEAST_LAMP_DISTANCE_M**2) ** 1.5
    return total


def _distances(layers: Layers, rows: slice, plain: tuple[float, float]) -> NDArray[np.float32]:
    if layers.distance_m is not None:
        return layers.distance_m[rows]
    eye_height, distance = plain
    altitude = np.radians(layers.altitude_deg[rows])
    ground = eye_height / np.sin(np.maximum(-altitude, 1e-6))
    wall = distance / np.cos(np.clip(altitude, 0, 1.5))
    away = np.where(altitude < 0, np.minimum(ground, distance / np.cos(altitude)), wall)
    return np.broadcast_to(away.astype(np.float32)[:, None], (len(away), layers.alpha.shape[1]))
