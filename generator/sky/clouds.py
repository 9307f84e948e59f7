"""Thin cloud: optical depth on one layer, which dims what lies above and shines by light from below and the Moon."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import map_coordinates
from scipy.stats import norm

from generator.atmosphere import Atmosphere, optical_depth
from generator.bake.single_scattering import disk_points, lamp_patterns
from generator.photometry import GRID_NM
from generator.sky.airglow import EARTH_RADIUS_KM
from generator.sky.city_light import LUMEN_PER_V_PHOTON, City, mixed_lamps
from generator.sky.component import DIFFUSE_EXTINCTION_FACTOR, SkyTable, above_the_air, total
from generator.sky.directions import sky_grid
from generator.sky.zodiacal import upsampled

Floats = NDArray[np.float64]

TILE_CELLS, CELL_KM = 512, 0.25
ASYMMETRY = 0.85
"""Of cloud droplets and ice, visible light. Source: Bohren 1987, Am. J. Phys. 55, 524."""


@dataclass(frozen=True)
class CloudField:
    """Cloud over the site during one frame.

    Attributes
    ----------
    altitude_km : float
    vertical_depth : (n, n) array
        Optical depth of a vertical ray, periodic, CELL_KM apart; [0, 0] is over the site when `east_km` = `north_km` = 0.
    east_km, north_km : float
        How far the wind has carried the field.
    """

    altitude_km: float
    vertical_depth: NDArray[np.float32]
    east_km: float
    north_km: float

    def slant_depth(self, enu: Floats) -> Floats:
        """Optical depth along lines of sight, (...) array for (..., 3) unit vectors above the horizon."""
        ratio = EARTH_RADIUS_KM / (EARTH_RADIUS_KM + self.altitude_km)
        horizontal = np.hypot(enu[..., 0], enu[..., 1])
        at_layer = np.arcsin(np.clip(horizontal * ratio, 0, 1))
        distance = EARTH_RADIUS_KM * (np.arctan2(horizontal, enu[..., 2]) - at_layer)
        away = distance / np.maximum(horizontal, 1e-12)
        place = np.stack([enu[..., 1] * away - self.north_km, enu[..., 0] * away - self.east_km]) / CELL_KM
        return map_coordinates(self.vertical_depth, place, order=1, mode="grid-wrap") / np.cos(at_layer)


def cloud_field(
    mean_optical_depth: float,
    coverage: float,
    spectral_slope: float,
    outer_scale_km: float,
    random: np.random.Generator,
) -> NDArray[np.float32]:
    """Draw a periodic field of vertical optical depth, (n, n) array.

    A Gaussian field of isotropic power k^slope above 1/outer scale, flat below; the lowest values are cut to clear sky so
    that `coverage` of the area is cloud, and the rest is scaled to the mean. A slope of -8/3 in two dimensions is the -5/3
    of a cut through turbulence, which liquid water shows (Davis et al. 1996, J. Atmos. Sci. 53, 1538).
    """
    white = np.fft.rfft2(random.standard_normal((TILE_CELLS, TILE_CELLS)))
    ky = np.fft.fftfreq(TILE_CELLS, CELL_KM)[:, None]
    kx = np.fft.rfftfreq(TILE_CELLS, CELL_KM)[None, :]
    power = (np.hypot(kx, ky) ** 2 + outer_scale_km**-2) ** (spectral_slope / 2)
    power[0, 0] = 0
    field = np.fft.irfft2(white * np.sqrt(power), s=(TILE_CELLS, TILE_CELLS))
    field /= field.std()
    thick = np.maximum(field - norm.ppf(1 - coverage), 0) if coverage < 1 else np.maximum(field - field.min(), 0)
    return (thick * mean_optical_depth / max(float(thick.mean()), 1e-12)).astype(np.float32)


def diffuse_transmission(depth: ArrayLike) -> Floats:
    """Part of diffuse light that a cloud of optical depth passes on: 1 / (1 + 3/4 (1 - g) depth); the rest it reflects.

    Two-stream approximation without absorption. Source: Bohren 1987, Am. J. Phys. 55, 524, eq. 20.
    """
    return 1 / (1 + 0.75 * (1 - ASYMMETRY) * np.asarray(depth, float))


def light_from_cities(cities: tuple[City, ...], altitude_km: float) -> Floats:
    """Upward irradiance at the layer over each direction of a coarse grid, per unit V-band photon output, m^-2.

    Returns
    -------
    (len(cities), rows, columns) array
    """
    grid = sky_grid()
    rows, columns = coarse_axes()
    enu = grid.enu[rows][:, columns]
    ratio = EARTH_RADIUS_KM / (EARTH_RADIUS_KM + altitude_km)
    horizontal = np.hypot(enu[..., 0], enu[..., 1])
    distance = EARTH_RADIUS_KM * (np.arctan2(horizontal, enu[..., 2]) - np.arcsin(np.clip(horizontal * ratio, 0, 1)))
    place = enu[..., :2] * (distance / np.maximum(horizontal, 1e-12))[..., None]
    result = []
    for city in cities:
        turn = np.radians(city.azimuth_deg)
        middle = city.distance_km * np.array([np.sin(turn), np.cos(turn)])
        light = np.zeros(enu.shape[:2])
        spots = disk_points(city.radius_km) + middle
        for spot in spots:
            square = np.sum((place - spot) ** 2, axis=-1) + altitude_km**2
            cosine = altitude_km / np.sqrt(square)
            lambert, horizon = lamp_patterns(cosine)
            intensity = (1 - city.horizon_share) * lambert + city.horizon_share * horizon
            light += intensity * cosine / square / len(spots)
        result.append(light * 1e-6)
    return np.array(result)


def coarse_axes() -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Every sixth row and column of the grid, the zenith included."""
    ny, nx = sky_grid().shape
    return np.unique(np.append(np.arange(0, ny, 6), ny - 1)), np.arange(0, nx, 6)


def cloud_light(
    depth: Floats,
    altitude_km: float,
    cities: tuple[City, ...],
    ground_spectrum: Floats,
    moon_irradiance: Floats,
    moon_sine: float,
    atmosphere: Atmosphere | None,
) -> SkyTable:
    """What cloud adds to the sky: light from the ground that it reflects, and moonlight that it spreads.

    Parameters
    ----------
    depth : (ny, nx) array
        Optical depth along each line of sight.
    altitude_km : float
    cities : tuple of City
        With their final output.
    ground_spectrum : (n,) array
        Photon irradiance that the ground sends up by reflecting the natural sky and the Moon, s^-1 m^-2 nm^-1.
    moon_irradiance : (n,) array
        Above the air; zero when the Moon is down.
    moon_sine : float
        Sine of its altitude.
    atmosphere : Atmosphere or None
        All of it is taken to lie below the cloud.

    Returns
    -------
    SkyTable
        Cloud is a Lambert reflector and transmitter: brighter over a city, and without corona around the Moon.
    """
    reflected = (1 - diffuse_transmission(depth)) / np.pi
    tables = []
    rows, columns = coarse_axes()
    zenith_loss = np.ones_like(GRID_NM)
    if atmosphere is not None:
        zenith_loss = np.exp(-DIFFUSE_EXTINCTION_FACTOR * optical_depth(GRID_NM, atmosphere))
    if cities:
        shapes = light_from_cities(cities, altitude_km)
        for city, shape in zip(cities, shapes, strict=True):
            fine = upsampled(shape, rows, columns, sky_grid().shape)
            output = city.upward_mlm * 1e6 / LUMEN_PER_V_PHOTON * mixed_lamps(city.lamps)
            tables.append(above_the_air(reflected * fine, output * zenith_loss, atmosphere))
    tables.append(above_the_air(reflected, ground_spectrum * zenith_loss, atmosphere))
    if moon_sine > 0:
        path = depth / max(moon_sine, 0.1)
        spread = np.maximum(diffuse_transmission(path) - np.exp(-path), 0) * moon_sine / np.pi
        tables.append(above_the_air(spread, moon_irradiance, atmosphere))
    return total(tables)
