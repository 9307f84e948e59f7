"""Extinction by the atmosphere: Rayleigh scattering, aerosol and ozone, by wavelength and airmass."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

MAG_PER_OPTICAL_DEPTH = 2.5 / np.log(10)
STANDARD_PRESSURE_HPA = 1013.25
GEOPOTENTIAL_RADIUS_M = 6356766.0
SEA_LEVEL_HPA, SEA_LEVEL_C = 1010.0, 10.0
"""Default air at sea level, that of the tables of refraction."""
PRESSURE_TOLERANCE = 0.06
"""Largest relative deviation: weather changes the pressure at a place by up to 5 %; more than that means another height."""

Floats = NDArray[np.float64]

# Absorption coefficient of ozone, 1/(atm cm), base e. Source: Bird & Riordan 1986, J. Climate Appl. Meteor. 25, 87, table 1.
_OZONE_NM = [
    340, 345, 350, 360, 440, 450, 460, 470, 480, 490, 500, 510, 520, 530, 540, 550, 570, 593, 610, 630, 656, 667.6, 690,
    710, 718, 724.4, 740, 752.5, 757.5, 762.5, 767.5, 780,
]  # fmt: skip
_OZONE_PER_ATM_CM = [
    0.040, 0.019, 0.007, 0, 0, 0.003, 0.006, 0.009, 0.014, 0.021, 0.030, 0.040, 0.048, 0.063, 0.075, 0.085, 0.120, 0.119,
    0.120, 0.090, 0.065, 0.051, 0.028, 0.018, 0.015, 0.012, 0.010, 0.008, 0.007, 0.006, 0.005, 0,
]  # fmt: skip


@dataclass(frozen=True)
class Atmosphere:
    """The air that a vertical ray crosses.

    Attributes
    ----------
    pressure_hpa : float
        Pressure at the observer, which scales Rayleigh scattering.
    aerosol_tau_550 : float
        Vertical optical depth of aerosol at 550 nm.
    angstrom_exponent : float
        Aerosol optical depth is proportional to wavelength to the power of minus this.
    ozone_du : float
        Column of ozone, Dobson units (300 DU = 0.3 atm cm).
    water_cm : float
        Precipitable water, cm.
    """

    pressure_hpa: float
    aerosol_tau_550: float
    angstrom_exponent: float
    ozone_du: float
    water_cm: float = 0.0

    @property
    def scatters(self) -> bool:
        """Whether there is anything that scatters light: ozone and water vapour only absorb."""
        return self.pressure_hpa > 0 or self.aerosol_tau_550 > 0


def standard_pressure_hpa(height_m: ArrayLike) -> Floats:
    """Pressure of the standard atmosphere, hPa, at heights of -5 to 20 km. Source: U.S. Standard Atmosphere 1976, eq. 33."""
    height = np.asarray(height_m, float)
    geopotential = GEOPOTENTIAL_RADIUS_M * height / (GEOPOTENTIAL_RADIUS_M + height)
    below = STANDARD_PRESSURE_HPA * (1 - 0.0065 * np.minimum(geopotential, 11000) / 288.15) ** 5.25588
    return below * np.exp(-np.maximum(geopotential - 11000, 0) / 6341.62)


def usual_pressure_hpa(height_m: ArrayLike) -> Floats:
    """Default pressure, hPa: SEA_LEVEL_HPA at sea level, falling with height as in the standard atmosphere."""
    return SEA_LEVEL_HPA / STANDARD_PRESSURE_HPA * standard_pressure_hpa(height_m)


def usual_temperature_c(height_m: ArrayLike) -> Floats:
    """Default temperature, deg C: SEA_LEVEL_C minus the standard atmosphere's 6.5 K/km, up to 11 km."""
    return SEA_LEVEL_C - 0.0065 * np.minimum(np.asarray(height_m, float), 11000.0)


def pressure_contradicts(pressure_hpa: float, height_m: float) -> bool:
    """Whether a pressure above 0 cannot be that of a height."""
    return pressure_hpa > 0 and abs(pressure_hpa / float(standard_pressure_hpa(height_m)) - 1) > PRESSURE_TOLERANCE


def rayleigh_optical_depth(wavelength_nm: ArrayLike, pressure_hpa: float) -> Floats:
    """Vertical optical depth of Rayleigh scattering. Source: Hansen & Travis 1974, Space Sci. Rev. 16, 527, eq. 2.30."""
    inverse_square = (np.asarray(wavelength_nm, float) / 1000) ** -2.0
    sea_level = 0.008569 * inverse_square**2 * (1 + 0.0113 * inverse_square + 0.00013 * inverse_square**2)
    return sea_level * (pressure_hpa / STANDARD_PRESSURE_HPA)


def aerosol_optical_depth(wavelength_nm: ArrayLike, tau_550: float, angstrom_exponent: float) -> Floats:
    """Vertical optical depth of aerosol. Source: Angstrom 1929, Geografiska Annaler 11, 156."""
    return tau_550 * (np.asarray(wavelength_nm, float) / 550) ** -angstrom_exponent


def ozone_optical_depth(wavelength_nm: ArrayLike, ozone_du: float) -> Floats:
    """Vertical optical depth of ozone (Huggins and Chappuis bands). Source: Bird & Riordan 1986, table 1."""
    return ozone_du / 1000 * np.interp(np.asarray(wavelength_nm, float), _OZONE_NM, _OZONE_PER_ATM_CM)


def scattering_depth(wavelength_nm: ArrayLike, atmosphere: Atmosphere) -> Floats:
    """Vertical optical depth of what scatters light: air and aerosol, (n,) array."""
    return rayleigh_optical_depth(wavelength_nm, atmosphere.pressure_hpa) + aerosol_optical_depth(
        wavelength_nm, atmosphere.aerosol_tau_550, atmosphere.angstrom_exponent
    )


def optical_depth(wavelength_nm: ArrayLike, atmosphere: Atmosphere) -> Floats:
    """Vertical optical depth of the whole atmosphere.

    Parameters
    ----------
    wavelength_nm : (n,) array_like
    atmosphere : Atmosphere

    Returns
    -------
    (n,) array
        Optical depth; multiplied by 1.0857 it is in magnitudes per airmass. The bands of water vapour and oxygen, whose
        depth is not proportional to the path, are in :mod:`generator.light.molecular_bands`.
    """
    return scattering_depth(wavelength_nm, atmosphere) + ozone_optical_depth(wavelength_nm, atmosphere.ozone_du)


def airmass(apparent_altitude_deg: ArrayLike) -> Floats:
    """Relative optical airmass from the apparent altitude. Source: Kasten & Young 1989, Appl. Opt. 28, 4735.

    Below the horizon the value at the horizon (37.92) is returned.
    """
    altitude = np.maximum(np.asarray(apparent_altitude_deg, float), 0.0)
    return 1 / (np.sin(np.radians(altitude)) + 0.50572 * (altitude + 6.07995) ** -1.6364)
