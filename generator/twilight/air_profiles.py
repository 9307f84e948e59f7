"""Profiles of air, haze, ozone and stratospheric aerosol over a spherical Earth, whose curvature affects light paths."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from generator.light.atmosphere import GEOPOTENTIAL_RADIUS_M
from generator.light.bake_grids import BakedAir

Floats = NDArray[np.float64]

EARTH_RADIUS_KM = 6371.0
TOP_KM, STEP_KM = 100.0, 0.5
HEIGHTS_KM: Floats = np.arange(0.0, TOP_KM + STEP_KM / 2, STEP_KM)
"""Heights at which the profiles are tabulated; densities are exponential in between."""

# Layers of the standard atmosphere: geopotential height of the base (km), temperature there (K), lapse rate (K/km).
# Source: U.S. Standard Atmosphere 1976, table 4.
_BASE_KM = np.array([0.0, 11.0, 20.0, 32.0, 47.0, 51.0, 71.0])
_BASE_K = np.array([288.15, 216.65, 216.65, 228.65, 270.65, 270.65, 214.65])
_LAPSE_K_KM = np.array([-6.5, 0.0, 1.0, 2.8, 0.0, -2.8, -2.0])
_HYDROSTATIC_K_KM = 34.163195

# Number of ozone molecules, 1e10 cm^-3, every 2 km from 2 to 74 km; its column is scaled to the scenario's.
# Source: Krueger & Minzner 1976, J. Geophys. Res. 81, 4477 (middle latitudes).
_OZONE = [
    68, 58, 57, 65, 113, 202, 235, 295, 404, 477, 486, 454, 403, 324, 252, 203, 158, 122, 87.3, 60.7, 39.8, 27.4, 16.9, 10.3,
    6.64, 3.84, 2.55, 1.61, 1.12, 0.733, 0.481, 0.317, 0.172, 0.075, 0.054, 0.022, 0.017,
]  # fmt: skip
_OZONE_KM: Floats = np.arange(2.0, 75.0, 2.0)

# Extinction of background stratospheric aerosol at 550 nm, 1e-4 km^-1, mean of its two seasons; its column is scaled.
# Source: LOWTRAN 7 (Kneizys et al. 1988, AFGL-TR-88-0177), after Shettle & Fenn 1976.
_STRATOSPHERE_KM = np.array([*range(11, 26), 30, 35, 40, 45, 50, 70, 100], float)
_STRATOSPHERE = np.array([
    7.565, 6.525, 5.70, 5.435, 5.19, 5.115, 5.125, 5.41, 5.36, 5.06, 4.27, 3.575, 2.71, 1.94, 1.405,
    0.332, 0.164, 0.0799, 0.0401, 0.021, 0.0016, 9.31e-6,
])  # fmt: skip
_TROPOPAUSE_KM = 10.5


def air_density(height_km: ArrayLike) -> Floats:
    """Density of the standard atmosphere relative to that at sea level; isothermal above 84.9 km.

    Source: U.S. Standard Atmosphere 1976, eqs. 18, 33.
    """
    height = np.asarray(height_km, float)
    radius = GEOPOTENTIAL_RADIUS_M / 1000
    geopotential = radius * height / (radius + height)
    layer = np.clip(np.searchsorted(_BASE_KM, geopotential, side="right") - 1, 0, None)
    pressure = np.array([1.0])
    for k in range(len(_BASE_KM) - 1):
        pressure = np.append(pressure, pressure[-1] * _pressure_ratio(np.array([k]), _BASE_KM[k + 1 : k + 2])[0])
    capped = np.minimum(geopotential, 84.852)
    beyond = np.exp(-_HYDROSTATIC_K_KM * (geopotential - capped) / 186.946)
    temperature = _BASE_K[layer] + _LAPSE_K_KM[layer] * (capped - _BASE_KM[layer])
    return pressure[layer] * _pressure_ratio(layer, capped) * beyond * _BASE_K[0] / temperature


def _pressure_ratio(layer: NDArray[np.intp], geopotential_km: Floats) -> Floats:
    """Pressure relative to that at the base of the layer."""
    base, lapse = _BASE_K[layer], _LAPSE_K_KM[layer]
    above = geopotential_km - _BASE_KM[layer]
    steady = lapse == 0
    slope = np.where(steady, 1.0, lapse)
    power = (base / (base + slope * above)) ** (_HYDROSTATIC_K_KM / slope)
    return np.where(steady, np.exp(-_HYDROSTATIC_K_KM * above / base), power)


def column_densities(floor_km: float) -> Floats:
    """Densities of air, haze, ozone and the stratosphere's aerosol at HEIGHTS_KM, per km, (4, n) array.

    All but haze have a vertical column of 1 above sea level. Haze has a column of 1 above `floor_km`, decreases above it
    with the scale height of the bake, and is constant below, because a mountain's haze is measured above the mountain.
    """
    aerosol_height = BakedAir().aerosol_height_km
    air = air_density(HEIGHTS_KM)
    ozone = np.exp(np.interp(HEIGHTS_KM, _OZONE_KM, np.log(_OZONE)))
    # Above the table the density decreases as at its end.
    ozone = ozone * np.exp(-np.maximum(HEIGHTS_KM - _OZONE_KM[-1], 0) / 4.0)
    aerosol = np.exp(-np.maximum(HEIGHTS_KM - floor_km, 0) / aerosol_height) / aerosol_height
    stratosphere = np.exp(np.interp(HEIGHTS_KM, _STRATOSPHERE_KM, np.log(_STRATOSPHERE)))
    stratosphere = np.where(HEIGHTS_KM < _TROPOPAUSE_KM, 1e-9, stratosphere)
    return np.stack([air / _column(air), aerosol, ozone / _column(ozone), stratosphere / _column(stratosphere)])


def _column(density: Floats) -> float:
    """Integral over HEIGHTS_KM of a density that is exponential in between."""
    low, high = density[:-1], density[1:]
    return float(np.sum(STEP_KM * (low - high) / np.log(np.where(low == high, np.e, low / high)) * (low != high)
                        + STEP_KM * low * (low == high)))  # fmt: skip
