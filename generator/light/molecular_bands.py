"""Absorption by water vapour and by oxygen, and the paths of rays through air, ozone and vapour.

The band model of SPCTRAL2: Bird & Riordan 1986 (J. Climate Appl. Meteor. 25, 87), table 1 and eqs. 8 to 11, after Leckner
1978 (Solar Energy 20, 143). Its wavelengths are as far apart as the bands are wide: sums over a filter's width are
accurate, but single wavelengths within a band are not resolved.
"""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import ArrayLike, NDArray

from generator.light.airmass_nodes import DIPPING_NODES, LEVEL_NODES, airmass_nodes
from generator.light.atmosphere import (
    STANDARD_PRESSURE_HPA,
    Atmosphere,
    aerosol_optical_depth,
    airmass,
    optical_depth,
    ozone_optical_depth,
    rayleigh_optical_depth,
)
from generator.light.photometry import GRID_NM

Floats = NDArray[np.float64]

_BANDS_NM = [
    570, 593, 610, 630, 656, 667.6, 690, 710, 718, 724.4, 740, 752.5, 757.5, 762.5, 767.5, 780, 800, 816, 823.7, 831.5, 840,
    860, 880, 905, 915, 925, 930, 937, 948, 965, 980, 993.5, 1040, 1070, 1100,
]  # fmt: skip
_WATER = [
    0, 0.075, 0, 0, 0, 0, 0.016, 0.0125, 1.8, 2.5, 0.061, 0.0008, 0.0001, 1e-5, 1e-5, 0.0006, 0.036, 1.6, 2.5, 0.5, 0.155,
    1e-5, 0.0026, 7.0, 5.0, 5.0, 27.0, 55.0, 45.0, 4.0, 1.48, 0.1, 1e-5, 0.001, 3.2,
]  # fmt: skip
"""Absorption coefficients of water vapour, 1/cm."""
_MIXED = [
    0, 0, 0, 0, 0, 0, 0.15, 0, 0, 0, 0, 0, 0, 4.0, 0.35, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0,
]  # fmt: skip
"""Absorption coefficients of the uniformly mixed gases; below 1000 nm this is oxygen."""
OZONE_HEIGHT_KM, EARTH_KM = 22.0, 6370.0


def precipitable_water_cm(temperature_c: float, relative_humidity: float) -> float:
    """Water vapour above a site, cm of liquid, from the air at the site: 0.493 (f/T) exp(26.23 - 5416/T).

    Source: Leckner 1978, eq. 10. Single nights differ from it by a factor of up to two.
    """
    kelvin = temperature_c + 273.15
    return 0.493 * relative_humidity / kelvin * float(np.exp(26.23 - 5416 / kelvin))


def ozone_airmass(apparent_altitude_deg: ArrayLike) -> Floats:
    """Path through a layer at 22 km relative to the vertical one. Source: Bird & Riordan 1986, eq. 10."""
    sine = np.sin(np.radians(np.maximum(np.asarray(apparent_altitude_deg, float), 0.0)))
    ratio = OZONE_HEIGHT_KM / EARTH_KM
    return (1 + ratio) / np.sqrt(sine * sine + 2 * ratio)


@functools.cache
def _altitudes() -> tuple[Floats, Floats]:
    """Return increasing airmass and the corresponding altitude, deg."""
    altitude = 90 * np.linspace(1, 0, 2000) ** 2
    return airmass(altitude), altitude


def band_depth(wavelength_nm: ArrayLike, atmosphere: Atmosphere, air_path: ArrayLike) -> Floats:
    """Optical depth of the bands of water vapour and oxygen along rays that pass m airmasses, (m, n) array.

    It grows more slowly than the path, because the centres of lines saturate.
    """
    wavelength, path = np.asarray(wavelength_nm, float), np.asarray(air_path, float)[:, None]
    water = np.interp(wavelength, _BANDS_NM, _WATER) * atmosphere.water_cm * path
    mixed = np.interp(wavelength, _BANDS_NM, _MIXED) * atmosphere.pressure_hpa / STANDARD_PRESSURE_HPA * path
    return 0.2385 * water / (1 + 20.07 * water) ** 0.45 + 1.41 * mixed / (1 + 118.93 * mixed) ** 0.45


def slant_depth(wavelength_nm: ArrayLike, atmosphere: Atmosphere, air_path: ArrayLike) -> Floats:
    """Optical depth of clear air along rays that pass m airmasses (0 or more), (m, n) array.

    It includes air, aerosol and vapour along the relative airmass of Kasten & Young, ozone along its own, and the bands.
    """
    path = np.asarray(air_path, float)
    scattered = rayleigh_optical_depth(wavelength_nm, atmosphere.pressure_hpa) + aerosol_optical_depth(
        wavelength_nm, atmosphere.aerosol_tau_550, atmosphere.angstrom_exponent
    )
    # There are no rays below one airmass, but tables begin at 0.
    through_ozone = ozone_airmass(np.interp(path, *_altitudes())) * np.minimum(path, 1.0)
    ozone = ozone_optical_depth(wavelength_nm, atmosphere.ozone_du)
    return path[:, None] * scattered + through_ozone[:, None] * ozone + band_depth(wavelength_nm, atmosphere, path)


def beam_depth(atmosphere: Atmosphere, apparent_altitude_deg: float) -> Floats:
    """Optical depth of clear air at GRID_NM along a ray from an apparent altitude, (n,) array."""
    return slant_depth(GRID_NM, atmosphere, airmass([apparent_altitude_deg]))[0]


def depth_per_airmass(wavelength_nm: ArrayLike, atmosphere: Atmosphere, air_path: ArrayLike) -> Floats:
    """:func:`slant_depth` divided by the airmass, and at 0 its limit without bands, (m, n) array."""
    path = np.asarray(air_path, float)
    along = slant_depth(wavelength_nm, atmosphere, path) / np.maximum(path, 1e-12)[:, None]
    return np.where(path[:, None] > 0, along, optical_depth(wavelength_nm, atmosphere))


@functools.lru_cache(maxsize=16)
def star_depths(atmosphere: Atmosphere, dipping: bool) -> Floats:
    """:func:`depth_per_airmass` at GRID_NM and the nodes of tables of starlight, (nodes, n) array."""
    return depth_per_airmass(GRID_NM, atmosphere, airmass_nodes(DIPPING_NODES if dipping else LEVEL_NODES))
