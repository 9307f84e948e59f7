"""Artificial skyglow: light of cities from precomputed radiative transfer."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Hashable

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RegularGridInterpolator

from generator.identity.kept import kept
from generator.light.atmosphere import Atmosphere, aerosol_optical_depth, rayleigh_optical_depth
from generator.light.bake_grids import DEFAULT_ALBEDO, VIEW_ALTITUDES_DEG, WAVELENGTHS_NM, BakedAir, CityGrid
from generator.light.baked_maps import city_kernel, city_multiple
from generator.light.disk_scattering import disk_nodes, disk_single
from generator.light.emission import PATTERNS, output_over_ground, pattern_weights
from generator.light.ground import Albedo, albedo_at, with_ground
from generator.light.lamps import City, luminous, mixed_lamps
from generator.light.photometry import GRID_NM
from generator.light.single_scattering import city_single, disk_points
from generator.light.view_directions import view_directions
from generator.places.earth import MEAN_RADIUS_KM
from generator.sky.component import SkyTable, black_sky, total
from generator.sky.directions import sky_grid
from generator.sky.zodiacal import upsampled

Floats = NDArray[np.float64]

STANDARD_AIR = Atmosphere(1013.25, 0.1, 1.3, 300.0)


BORTLE_DISTANCE_KM = {1: 60.0, 2: 50.0, 3: 40.0, 4: 30.0, 5: 20.0, 6: 14.0, 7: 8.0, 8: 4.0, 9: 0.0}
BORTLE_CITY_RADIUS_KM = 10.0
BORTLE_CITY_AZIMUTH_DEG = 225.0
BORTLE_NEARBY_RADIUS_KM = 5.0
BORTLE_NEARBY_MLM = {1: 0.20, 2: 0.35, 3: 0.69, 4: 1.64, 5: 5.36, 6: 15.6}
"""Upward light of settlements within 5 km of the observer, if that of the city is 100 Mlm. It makes four fifths of the
artificial light at the zenith in standard air."""


def bortle_city(bortle: int) -> City:
    """Return the city of a Bortle class: its distance depends on the class, its radius is 10 km, in the south-west.

    This is skybench's convention.
    """
    return City(BORTLE_DISTANCE_KM[bortle], BORTLE_CITY_AZIMUTH_DEG, BORTLE_CITY_RADIUS_KM)


def bortle_layout(bortle: int) -> tuple[City, ...]:
    """Return the default surroundings of a Bortle class: its city, and outside it the settlements around the observer.

    If a city were the only light (classes 1 to 6), the sky low above it would be 13 to 18 times brighter than the zenith;
    measured skies reach 5 (docs/physics.md). Most light at the zenith therefore comes from nearby.
    """
    city = bortle_city(bortle)
    if bortle not in BORTLE_NEARBY_MLM:
        return (city,)
    return city, City(0.0, 0.0, BORTLE_NEARBY_RADIUS_KM, upward_mlm=BORTLE_NEARBY_MLM[bortle])


_VIEW_DEG: Floats = np.array(VIEW_ALTITUDES_DEG)
_RELATIVE_DEG: Floats = np.array([0.0, 5.0, 10.0, 17.0, 25.0, 35.0, 50.0, 70.0, 90.0, 115.0, 145.0, 180.0])


@functools.lru_cache(maxsize=256)
def city_radiance(
    distance_km: float,
    radius_km: float,
    horizon_share: float | None,
    atmosphere: Atmosphere = STANDARD_AIR,
    albedo: Albedo = DEFAULT_ALBEDO,
) -> Floats:
    """Transfer from a city to the sky: radiance per unit output, m^-2 sr^-1, (wavelength, altitude, azimuth) array.

    Axes: WAVELENGTHS_NM, the bake's view altitudes, and azimuths relative to the city's. Single scattering is integrated
    here over the disk; the rest is the baked kernel of a lamp, integrated over the disk. Both are above flat ground. The
    effect of the Earth's curvature on single scattering is applied as a factor in each direction; the rest is multiplied
    by the factor at the zenith.
    """
    inputs = (distance_km, radius_km, horizon_share, atmosphere, albedo)
    arrays = kept("city", inputs, lambda: {"transfer": _transfer(*inputs)})
    return np.asarray(arrays["transfer"], dtype=np.float64)


def _transfer(
    distance_km: float, radius_km: float, horizon_share: float | None, atmosphere: Atmosphere, albedo: Albedo
) -> Floats:
    wavelength, views = np.array(WAVELENGTHS_NM), view_directions(_VIEW_DEG, _RELATIVE_DEG)
    shape = (len(PATTERNS), len(wavelength), len(_VIEW_DEG), len(_RELATIVE_DEG))
    tau = atmosphere.aerosol_tau_550
    air = dataclasses.replace(
        BakedAir(), pressure_hpa=atmosphere.pressure_hpa, angstrom_exponent=atmosphere.angstrom_exponent
    )
    spots = disk_points(radius_km, 2, 8) + np.array([0.0, distance_km])
    patch = radius_km / float(np.sqrt(len(spots)))
    curved, flat = (
        city_single(air, wavelength, tau, spots, views, spot_radius_km=patch, earth_radius_km=earth_radius_km)
        for earth_radius_km in (MEAN_RADIUS_KM, np.inf)
    )
    curvature = (curved / flat).reshape(shape)
    once = disk_single(air, wavelength, tau, distance_km, radius_km, views).reshape(shape)
    nodes = [disk_nodes(distance_km, radius_km, azimuth, CityGrid().core_km) for azimuth in _RELATIVE_DEG]
    distance, relative, weight = (np.concatenate(each) for each in zip(*nodes, strict=True))
    multiple = city_multiple(with_ground(city_kernel(atmosphere), albedo, atmosphere), distance, relative) * weight
    kernel = once * curvature + multiple.reshape(*shape, -1).sum(axis=-1) * curvature[:, :, -1:, :1]
    return np.tensordot(pattern_weights(horizon_share), kernel, axes=1) * 1e-6


def upward_spectrum(city: City, albedo: Albedo = DEFAULT_ALBEDO) -> Floats:
    """Upward photon output of a city, s^-1 nm^-1 at GRID_NM."""
    ground = output_over_ground(city.horizon_share, albedo_at(albedo, GRID_NM))
    lamps = mixed_lamps(city.lamps)
    return city.upward_mlm * 1e6 / luminous(lamps) * lamps * ground


def city_table(city: City, atmosphere: Atmosphere = STANDARD_AIR, albedo: Albedo = DEFAULT_ALBEDO) -> SkyTable:
    """Skyglow of one city at the ground."""
    grid = sky_grid()
    transfer = city_radiance(city.distance_km, city.radius_km, city.horizon_share, atmosphere, albedo)
    interpolator = RegularGridInterpolator((np.log(_VIEW_DEG), _RELATIVE_DEG), np.moveaxis(np.log(transfer), 0, -1))
    rows = np.unique(np.append(np.arange(0, grid.shape[0], 4), grid.shape[0] - 1))
    columns = np.arange(0, grid.shape[1], 4)
    view = np.log(np.maximum(grid.altitude_deg[rows], _VIEW_DEG[0]))
    relative = np.abs((grid.azimuth_deg[columns] - city.azimuth_deg + 180) % 360 - 180)
    coarse = np.exp(interpolator(np.stack(np.meshgrid(view, relative, indexing="ij"), axis=-1)))
    maps = np.stack([upsampled(coarse[..., k], rows, columns, grid.shape) for k in range(len(WAVELENGTHS_NM))])
    hats = np.array([np.interp(GRID_NM, WAVELENGTHS_NM, row) for row in np.eye(len(WAVELENGTHS_NM))])
    # Between nodes the light is interpolated over the scattering optical depth, which removes most of the curvature.
    depth = rayleigh_optical_depth(GRID_NM, atmosphere.pressure_hpa) + aerosol_optical_depth(
        GRID_NM, atmosphere.aerosol_tau_550, atmosphere.angstrom_exponent
    )
    followed = hats * depth / np.interp(WAVELENGTHS_NM, GRID_NM, depth)[:, None]
    return SkyTable(maps.astype(np.float32), followed * upward_spectrum(city, albedo))


@functools.lru_cache(maxsize=16)
def skyglow(cities: tuple[City, ...], atmosphere: Atmosphere | None, albedo: Albedo = DEFAULT_ALBEDO) -> SkyTable:
    """Skyglow of a layout of cities at the ground; without a dimming atmosphere, as in the standard one."""
    tables: dict[Hashable, SkyTable] = {}
    for city in cities:
        # Cities with the same lamps and emission have the same spectra except for their output, so their maps are added.
        table = city_table(dataclasses.replace(city, upward_mlm=1.0), atmosphere or STANDARD_AIR, albedo)
        maps = table.parts * np.float32(city.upward_mlm)
        alike = city.lamps, city.horizon_share
        known = tables.get(alike)
        tables[alike] = SkyTable(maps if known is None else known.parts + maps, table.spectra)
    return total(list(tables.values())) if tables else black_sky()
