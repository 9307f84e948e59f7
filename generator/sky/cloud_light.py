"""Light of cloud: reflected light from below, and scattered moonlight."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
from numpy.typing import NDArray

from generator.light.atmosphere import Atmosphere, optical_depth
from generator.light.bake_grids import DEFAULT_ALBEDO
from generator.light.disk_scattering import disk_irradiance
from generator.light.emission import pattern_weights
from generator.light.ground import Albedo, albedo_at
from generator.light.lamps import City
from generator.light.photometry import GRID_NM
from generator.places.earth import EQUATORIAL_RADIUS_KM
from generator.sky.city_light import upward_spectrum
from generator.sky.clouds import CloudField, CloudVeil, mean_reflectance
from generator.sky.component import DIFFUSE_EXTINCTION_FACTOR, SkyTable, Veil, above_the_air, side_by_side
from generator.sky.directions import sky_grid
from generator.sky.moonlit_cloud import moon_veil
from generator.sky.zodiacal import upsampled

Floats = NDArray[np.float64]


@functools.lru_cache(maxsize=64)
def light_from_city(
    distance_km: float,
    azimuth_deg: float,
    radius_km: float,
    horizon_share: float | None,
    altitude_km: float,
    camera_km: float = 0.0,
) -> Floats:
    """Upward irradiance by a :class:`City` at the layer above each direction of a coarse grid, (rows, columns) array.

    It is per unit V-band photon output, m^-2. The layer is `altitude_km` above the camera, which is `camera_km` above the
    ground.
    """
    grid = sky_grid()
    rows, columns = coarse_axes()
    enu = grid.enu[rows][:, columns]
    ratio = EQUATORIAL_RADIUS_KM / (EQUATORIAL_RADIUS_KM + altitude_km)
    horizontal = np.hypot(enu[..., 0], enu[..., 1])
    distance = EQUATORIAL_RADIUS_KM * (
        np.arctan2(horizontal, enu[..., 2]) - np.arcsin(np.clip(horizontal * ratio, 0, 1))
    )
    place = enu[..., :2] * (distance / np.maximum(horizontal, 1e-12))[..., None]
    turn = np.radians(azimuth_deg)
    middle = distance_km * np.array([np.sin(turn), np.cos(turn)])
    light = pattern_weights(horizon_share) @ disk_irradiance(
        (place - middle).reshape(-1, 2), camera_km + altitude_km, radius_km
    )
    return 1e-6 * light.reshape(enu.shape[:2])


def coarse_axes() -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Every sixth row and column of the grid, the zenith included."""
    ny, nx = sky_grid().shape
    return np.unique(np.append(np.arange(0, ny, 6), ny - 1)), np.arange(0, nx, 6)


def cloud_light(
    clouds: CloudField,
    cities: tuple[City, ...],
    ground_spectrum: Floats,
    moon_irradiance: Floats,
    moon_enu: Floats,
    atmosphere: Atmosphere | None,
    ground_albedo: Albedo = DEFAULT_ALBEDO,
) -> SkyTable:
    """Light that cloud adds to the sky: reflected light from the ground, and scattered moonlight.

    Parameters
    ----------
    clouds : CloudField
    cities : tuple of City
        Cities with their final output.
    ground_spectrum : (n,) array
        Upward photon irradiance of natural sky light and moonlight that the ground reflects, s^-1 m^-2 nm^-1.
    moon_irradiance : (n,) array
        Irradiance above the air; zero when the Moon is down.
    moon_enu : (3,) array
        Apparent direction of the Moon.
    atmosphere : Atmosphere or None
        Air, all of which is taken to be below the cloud.
    ground_albedo : float or points
        Albedo of the ground. City light is reflected repeatedly between cloud and ground, as between two infinite layers.

    Returns
    -------
    SkyTable
        The light of the cloud. It reflects light from below as a Lambert surface, so it is brighter over a city.
    """
    even = np.full((sky_grid().shape[0], 1), 1 / np.pi)
    rows, columns = coarse_axes()
    zenith_loss = np.ones_like(GRID_NM)
    if atmosphere is not None:
        zenith_loss = np.exp(-DIFFUSE_EXTINCTION_FACTOR * optical_depth(GRID_NM, atmosphere))
    again = 1 / (1 - albedo_at(ground_albedo, GRID_NM) * mean_reflectance(clouds.pattern, clouds.asymmetry))
    from_below = [above_the_air(even, ground_spectrum * zenith_loss, atmosphere)]
    for city in cities:
        shape = light_from_city(
            city.distance_km,
            city.azimuth_deg,
            city.radius_km,
            city.horizon_share,
            clouds.altitude_km,
            clouds.camera_km,
        )
        fine = upsampled(shape, rows, columns, sky_grid().shape) / np.pi
        output = upward_spectrum(city, ground_albedo) * again
        from_below.append(above_the_air(fine, output * zenith_loss, atmosphere))
    below = side_by_side(from_below)
    # All light that is not transmitted is reflected: 1 minus the transmission.
    veiled: list[tuple[Veil, SkyTable]] = [(CloudVeil(clouds), below.scaled(-1.0))]
    if moon_enu[2] > 0 and moon_irradiance.any():
        moon = above_the_air(np.ones_like(even), moon_irradiance, atmosphere)
        veiled.append((moon_veil(clouds, moon_enu), moon))
    return dataclasses.replace(below, veiled=tuple(veiled))
