"""Twilight: sunlight scattered by the air above the Earth's shadow, as radiance by direction and wavelength."""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline

from generator.errors import GeneratorError
from generator.light.atmosphere import (
    STANDARD_PRESSURE_HPA,
    Atmosphere,
    aerosol_optical_depth,
    ozone_optical_depth,
    rayleigh_optical_depth,
    standard_pressure_hpa,
)  # fmt: skip
from generator.light.bake_grids import BakedAir, TwilightGrid
from generator.light.photometry import GRID_NM
from generator.light.stellar_spectra import star_spectra
from generator.sky.component import SkyTable, black_sky, low_rank
from generator.sky.directions import sky_grid
from generator.sky.sunlight import SUN_BV_MAG, SUN_VI_MAG
from generator.twilight.air_profiles import STEP_KM
from generator.twilight.solar_beam import solar_beam
from generator.twilight.twilight_map import twilight_multiple
from generator.twilight.twilight_single import TwilightDepths, twilight_single

Floats = NDArray[np.float64]

SUN_V_MAG = -26.76
"""V of the Sun at 1 au. Source: Willmer 2018, ApJS 236, 47."""
MAP_END_DEG = 18.0
"""Depression up to which the light is computed; astronomical twilight ends there, but only the zenith is dark then."""
NIGHT_DEPRESSION_DEG = 22.0
"""Depression at which the Sun adds at most 1 % to the darkest sky, low above it."""
GROUND_ALBEDO = BakedAir().ground_albedo
RANK = 10
_NODES_NM = (350, 375, 400, 425, 450, 480, 510, 540, 570, 600, 630, 660, 700, 750, 800, 900, 1000, 1100)
_AZIMUTHS_DEG: Floats = np.array([0, 2, 4, 8, 13, 20, 28, 38, 50, 65, 80, 95, 110, 125, 140, 160, 180], float)
_ROWS = np.array([0, 2, 4, 7, 10, 14, 19, 25, 32, 40, 50, 60, 80, 100, 120, 140, 160, 180, 200, 220, 230, 240])
"""Rows of the sky's grid at which light is computed, closer where it is steeper: near the horizon."""


@functools.cache
def nodes_nm() -> Floats:
    """Wavelengths of the radiative transfer, within the grid's range."""
    first, last = GRID_NM[0], GRID_NM[-1]
    return np.array([first, *(node for node in _NODES_NM if first < node < last), last])


def twilight_depths(wavelength_nm: Floats, atmosphere: Atmosphere, height_km: float) -> TwilightDepths:
    """Optical depths of a scenario's air, whose density at all heights follows from the pressure at the observer."""
    sea_level_hpa = STANDARD_PRESSURE_HPA * atmosphere.pressure_hpa / float(standard_pressure_hpa(1000 * height_km))
    layer = TwilightGrid().stratosphere_tau(wavelength_nm)
    aerosol = aerosol_optical_depth(wavelength_nm, atmosphere.aerosol_tau_550, atmosphere.angstrom_exponent)
    return TwilightDepths(
        rayleigh_optical_depth(wavelength_nm, sea_level_hpa),
        # The scenario's depth is that of all aerosol.
        np.maximum(aerosol - layer, 0),
        ozone_optical_depth(wavelength_nm, atmosphere.ozone_du),
        layer,
    )


def twilight_field(
    depression_deg: float,
    atmosphere: Atmosphere,
    height_km: float,
    altitude_deg: Floats,
    relative_azimuth_deg: Floats,
    ground_albedo: ArrayLike = GROUND_ALBEDO,
) -> Floats:
    """Radiance of twilight per unit solar irradiance above the air, sr^-1.

    Sunlight scattered once is integrated along each line of sight through spherical shells, with the Sun's rays bent and
    spread by refraction; multiply scattered light is taken from the baked map of random walks through the same shells.
    Both are computed at some wavelengths. In between, the logarithm of the light without ozone is interpolated, and
    absorption by ozone is applied along the light's mean path.

    Parameters
    ----------
    depression_deg : float
        Depression of the Sun's true place, from 0. Beyond 18, the light in each direction decreases at the same rate as
        from 17 to 18.
    atmosphere : Atmosphere
    height_km : float
        Height of the observer above sea level.
    altitude_deg, relative_azimuth_deg : (m,), (k,) arrays
        Directions of the lines of sight, from the horizontal up; azimuths are relative to the Sun's, 0 to 180.
    ground_albedo : float or (n,) array
        Albedo of the ground at :func:`nodes_nm`.

    Returns
    -------
    (m, k, n) array
        At GRID_NM.
    """
    if depression_deg > MAP_END_DEG:
        before, last = (
            twilight_field(end, atmosphere, height_km, altitude_deg, relative_azimuth_deg, ground_albedo)
            for end in (MAP_END_DEG - 1, MAP_END_DEG)
        )
        further: Floats = last * np.minimum(last / before, 1.0) ** (depression_deg - MAP_END_DEG)
        return further
    nodes = nodes_nm()
    observer = min(max(height_km, 0.0), TwilightGrid().observer_km[-1])
    floor = round(observer / STEP_KM) * STEP_KM
    depths = twilight_depths(nodes, atmosphere, height_km)
    albedo = np.broadcast_to(np.asarray(ground_albedo, float), nodes.shape)
    once = twilight_single(
        solar_beam(floor), depths, observer, depression_deg, altitude_deg, relative_azimuth_deg, floor, BakedAir()
    )
    more = twilight_multiple(depths, observer, depression_deg, altitude_deg, relative_azimuth_deg, albedo)
    light = once.radiance + more.radiance
    path = (once.radiance * once.ozone_path + more.radiance * more.ozone_path) / light
    without_ozone = np.log(light) + depths.ozone[:, None, None] * path
    between = _interpolation(nodes)
    ozone = ozone_optical_depth(GRID_NM, atmosphere.ozone_du)
    flat = [between @ part.reshape(len(nodes), -1) for part in (without_ozone, path)]
    result: Floats = np.exp(flat[0] - ozone[:, None] * flat[1]).T.reshape(*light.shape[1:], len(GRID_NM))
    return result


def _interpolation(nodes: Floats) -> Floats:
    """Weights (n, nodes) of linear interpolation in the logarithm of wavelength."""
    return np.array([np.interp(np.log(GRID_NM), np.log(nodes), row) for row in np.eye(len(nodes))]).T


@functools.cache
def _azimuth_spline() -> CubicSpline:
    """Weights of the nodes by azimuth: cubics through the values at _AZIMUTHS_DEG, with zero slope on both sides."""
    return CubicSpline(_AZIMUTHS_DEG, np.eye(len(_AZIMUTHS_DEG)), bc_type="clamped")


def twilight(
    sun_enu: Floats,
    depression_deg: float,
    atmosphere: Atmosphere | None,
    height_m: float,
    sun_distance_au: float = 1.0,
    ground_albedo: ArrayLike = GROUND_ALBEDO,
    horizon_deg: float = 0.0,
) -> SkyTable:
    """Twilight at the observer; black without scattering air, and if the Sun is NIGHT_DEPRESSION_DEG or more down.

    Parameters
    ----------
    sun_enu : (3,) array
        Apparent direction of the body.
    depression_deg : float
        Depression of the Sun's true place, without refraction.
    atmosphere : Atmosphere or None
    height_m : float
        Height of the observer.
    sun_distance_au : float
    ground_albedo : float or (n,) array
        Albedo of the ground at :func:`nodes_nm`.
    horizon_deg : float
        Apparent altitude of the horizon, which is negative for an observer in the air.

    Raises
    ------
    GeneratorError
        The Sun is up.
    """
    if atmosphere is None or not atmosphere.scatters or depression_deg >= NIGHT_DEPRESSION_DEG:
        return black_sky()
    altitude = float(np.degrees(np.arcsin(sun_enu[2])))
    if altitude > horizon_deg:
        dip = f", which lies {-horizon_deg:.1f} deg below the horizontal," if horizon_deg < 0 else ""
        raise GeneratorError(
            f"the Sun is {altitude - horizon_deg:.1f} deg above the horizon{dip} at this time and place; choose a time "
            "between sunset and sunrise, or leave 'twilight' out of sky.components"
        )
    sun = star_spectra([SUN_V_MAG + 5 * np.log10(sun_distance_au)], [SUN_BV_MAG], [SUN_VI_MAG])[0]
    return light_from_below(sun_enu, depression_deg, sun, atmosphere, height_m, ground_albedo)


def light_from_below(
    body_enu: Floats,
    depression_deg: float,
    irradiance: Floats,
    atmosphere: Atmosphere,
    height_m: float,
    ground_albedo: ArrayLike = GROUND_ALBEDO,
) -> SkyTable:
    """Light of a body at or below the horizon, scattered by the air above the Earth's shadow.

    Parameters
    ----------
    body_enu : (3,) array
        Apparent direction of the body.
    depression_deg : float
        Depression of its true place, without refraction.
    irradiance : (n,) array
        Irradiance above the air, photons s^-1 m^-2 nm^-1 at GRID_NM.
    atmosphere : Atmosphere
    height_m : float
        Height of the observer.
    ground_albedo : float or (n,) array
        Albedo of the ground at :func:`nodes_nm`.
    """
    grid = sky_grid()
    rows = _ROWS
    light = twilight_field(
        max(depression_deg, 0.0), atmosphere, height_m / 1000, grid.altitude_deg[rows], _AZIMUTHS_DEG, ground_albedo
    )
    # At the zenith, all azimuths are the same direction.
    light[-1] = np.exp(np.log(light[-1]).mean(axis=0))
    maps, spectra = low_rank(light.reshape(-1, len(GRID_NM)), RANK)
    azimuth = float(np.degrees(np.arctan2(body_enu[0], body_enu[1])))
    relative = np.abs((grid.azimuth_deg - azimuth + 180) % 360 - 180)
    coarse = maps.reshape(RANK, len(rows), len(_AZIMUTHS_DEG))
    across = _azimuth_spline()(relative).T.astype(np.float32)
    down = CubicSpline(rows, coarse, axis=1)(np.arange(grid.shape[0])).astype(np.float32)
    return SkyTable(down, spectra * irradiance, across=across)
