"""Light of cloud: reflected light from below, and scattered moonlight."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
from numpy.typing import NDArray

from generator.light.atmosphere import Atmosphere, scattering_depth
from generator.light.bake_grids import DEFAULT_ALBEDO, BakedAir
from generator.light.disk_scattering import disk_irradiance
from generator.light.emission import pattern_weights
from generator.light.ground import Albedo, albedo_at
from generator.light.lamps import City
from generator.light.molecular_bands import beam_depth
from generator.light.photometry import GRID_NM
from generator.places.earth import EQUATORIAL_RADIUS_KM
from generator.sky.city_light import upward_spectrum
from generator.sky.clouds import CloudField, CloudVeil, mean_reflectance
from generator.sky.component import DIFFUSE_EXTINCTION_FACTOR, SkyTable, Veil, above_the_air, side_by_side
from generator.sky.directions import sky_grid
from generator.sky.moonlit_cloud import moon_veil
from generator.sky.zodiacal import upsampled

Floats = NDArray[np.float64]

WATER_HEIGHT_KM = 2.0
"""Scale height of water vapour; usually 1.5 to 2.5 km."""
DIFFUSIVITY = 1.66
"""Airmass whose transmission is that of a thin layer for diffuse light. Source: Elsasser 1942, Harvard Met. Studies 6."""
DEPTH_NODES = 5
"""Optical depths for which light of a city is computed; between them it is interpolated."""


@functools.lru_cache(maxsize=64)
def light_from_city(
    distance_km: float,
    azimuth_deg: float,
    radius_km: float,
    horizon_share: float | None,
    altitude_km: float,
    camera_km: float = 0.0,
    low_air: Atmosphere | None = None,
) -> tuple[Floats, Floats]:
    """Upward irradiance by a :class:`City` at the layer above each direction of a coarse grid, as sums of products.

    The layer is `altitude_km` above the camera, which is `camera_km` above the ground. `low_air` dims each ray on its way to
    the layer, so that distant lamps, whose rays are nearly level, lose most.

    Returns
    -------
    maps : (k, rows, columns) array
        Irradiance per unit V-band photon output, m^-2.
    weights : (k, n) array
        Factors at GRID_NM; maps times weights, summed, are the irradiance.
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
    offset = (place - distance_km * np.array([np.sin(turn), np.cos(turn)])).reshape(-1, 2)
    pattern, height = pattern_weights(horizon_share), camera_km + altitude_km
    if low_air is None:
        light = pattern @ disk_irradiance(offset, height, radius_km)[0]
        return 1e-6 * light.reshape(1, *enu.shape[:2]), np.ones((1, len(GRID_NM)))
    depth = DIFFUSE_EXTINCTION_FACTOR * scattering_depth(GRID_NM, low_air)
    nodes = np.linspace(depth.min(), depth.max(), DEPTH_NODES)
    maps = pattern @ disk_irradiance(offset, height, radius_km, nodes)
    # Between the nodes the loss of diffuse light, which is most of it, is exact. A sum of positive terms stays positive.
    share = np.stack([np.interp(depth, nodes, one) for one in np.eye(DEPTH_NODES)])
    return 1e-6 * maps.reshape(-1, *enu.shape[:2]), share * np.exp(-DIFFUSIVITY * (depth - nodes[:, None]))


def coarse_axes() -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Every sixth row and column of the grid, the zenith included."""
    ny, nx = sky_grid().shape
    return np.unique(np.append(np.arange(0, ny, 6), ny - 1)), np.arange(0, nx, 6)


def parted(atmosphere: Atmosphere, height_km: float) -> tuple[Atmosphere, Atmosphere]:
    """Divide the air at a height above the observer: that below and that above.

    Both have the exponential profiles of the bake, and all ozone is above.
    """
    layers = BakedAir()
    gas, aerosol, water = (
        float(-np.expm1(-max(height_km, 0.0) / scale))
        for scale in (layers.rayleigh_height_km, layers.aerosol_height_km, WATER_HEIGHT_KM)
    )
    below = dataclasses.replace(
        atmosphere,
        pressure_hpa=gas * atmosphere.pressure_hpa,
        aerosol_tau_550=aerosol * atmosphere.aerosol_tau_550,
        ozone_du=0.0,
        water_cm=water * atmosphere.water_cm,
    )
    above = dataclasses.replace(
        atmosphere,
        pressure_hpa=atmosphere.pressure_hpa - below.pressure_hpa,
        aerosol_tau_550=atmosphere.aerosol_tau_550 - below.aerosol_tau_550,
        water_cm=atmosphere.water_cm - below.water_cm,
    )
    return below, above


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
        Air. What is below the cloud dims light on its way up and down, what is above it dims the Moon.
    ground_albedo : float or points
        Albedo of the ground. City light is reflected repeatedly between cloud and ground, as between two infinite layers.

    Returns
    -------
    SkyTable
        The light of the cloud. It reflects light from below as a Lambert surface, so it is brighter over a city.
    """
    even = np.full((sky_grid().shape[0], 1), 1 / np.pi)
    rows, columns = coarse_axes()
    upward_loss, moon_loss, low_air = np.ones_like(GRID_NM), np.ones_like(GRID_NM), None
    if atmosphere is not None:
        low_air, high_air = parted(atmosphere, clouds.altitude_km)
        upward_loss = np.exp(-DIFFUSIVITY * DIFFUSE_EXTINCTION_FACTOR * scattering_depth(GRID_NM, low_air))
        moon_loss = np.exp(-beam_depth(high_air, float(np.degrees(np.arcsin(np.clip(moon_enu[2], 0.0, 1.0))))))
    again = 1 / (1 - albedo_at(ground_albedo, GRID_NM) * mean_reflectance(clouds.pattern, clouds.asymmetry))
    from_below = [above_the_air(even, ground_spectrum * upward_loss, low_air)]
    for city in cities:
        maps, weights = light_from_city(
            city.distance_km,
            city.azimuth_deg,
            city.radius_km,
            city.horizon_share,
            clouds.altitude_km,
            clouds.camera_km,
            low_air,
        )
        output = upward_spectrum(city, ground_albedo) * again
        for each, weight in zip(maps, weights, strict=True):
            fine = upsampled(each, rows, columns, sky_grid().shape) / np.pi
            from_below.append(above_the_air(fine, output * weight, low_air))
    below = side_by_side(from_below)
    # All light that is not transmitted is reflected: 1 minus the transmission.
    veiled: list[tuple[Veil, SkyTable]] = [(CloudVeil(clouds), below.scaled(-1.0))]
    if moon_enu[2] > 0 and moon_irradiance.any():
        moon = above_the_air(np.ones_like(even), moon_irradiance * moon_loss, low_air)
        veiled.append((moon_veil(clouds, moon_enu), moon))
    return dataclasses.replace(below, veiled=tuple(veiled))
