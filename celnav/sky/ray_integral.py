"""Refraction at low altitudes, as an integral over the heights that a ray passes.

The air follows the standard atmosphere: the temperature falls by 6.5 K/km up to 11 km and is constant above; water vapour
falls as a power of the temperature. With r the distance from the Earth's centre, n the refractive index and c = n r sin z the
invariant, a ray bends by dn/n tan z, tan z = c / sqrt(n^2 r^2 - c^2), in each step (Green 1985, Spherical Astronomy, section
4.4). Where the ray is horizontal, the root vanishes; in the variable u = sqrt(r - r_0), the integrand has no pole there.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

F8 = NDArray[np.float64]
Shell = Callable[[F8], tuple[F8, F8]]

EARTH_RADIUS_KM = 6378.12
TROPOPAUSE_KM = 11.0
TOP_KM = 80.0
LAPSE_K_KM = 6.5
LEAST_K = 90.0
# g M / R of dry air at 45 deg of latitude (Hohenkerk & Sinclair 1985, NAO Technical Note 63), K/km.
HYDROSTATIC_K_KM = 9.784 * 28.9644 / 8.31432
LIGHTER_VAPOUR = 1 - 18.0152 / 28.9644
VAPOUR_POWER = 18.36
NODES = 20
# U.S. Standard Atmosphere 1976 at sea level.
SEA_LEVEL_HPA, SEA_LEVEL_K = 1013.25, 288.15
TROPOPAUSE_HPA = 226.32
SCALE_ABOVE_KM = 6.3416
GEOPOTENTIAL_RADIUS_KM = 6356.766


def standard_height_km(pressure_hpa: float) -> float:
    """Return the height, km, from -1 to 60, at which the standard atmosphere has a given pressure."""
    if pressure_hpa > TROPOPAUSE_HPA:
        height = SEA_LEVEL_K / LAPSE_K_KM * (1 - (pressure_hpa / SEA_LEVEL_HPA) ** (1 / 5.25588))
    else:
        height = TROPOPAUSE_KM + SCALE_ABOVE_KM * math.log(TROPOPAUSE_HPA / max(pressure_hpa, 1e-3))
    # Heights of the standard atmosphere are geopotential.
    height *= GEOPOTENTIAL_RADIUS_KM / (GEOPOTENTIAL_RADIUS_KM - height)
    return min(max(height, -1.0), 60.0)


def standard_pressure_hpa(height_km: float) -> float:
    """Return the pressure of the standard atmosphere at a height up to 60 km; the inverse of `standard_height_km`."""
    geopotential = GEOPOTENTIAL_RADIUS_KM * height_km / (GEOPOTENTIAL_RADIUS_KM + height_km)
    if geopotential < TROPOPAUSE_KM:
        return float(SEA_LEVEL_HPA * (1 - LAPSE_K_KM * geopotential / SEA_LEVEL_K) ** 5.25588)
    return TROPOPAUSE_HPA * math.exp((TROPOPAUSE_KM - geopotential) / SCALE_ABOVE_KM)


class Air:
    """Refractive index as a function of the distance from the Earth's centre, for an observer.

    Parameters
    ----------
    pressure_hpa, temperature_c, relative_humidity : float
        Air at the observer; the pressure is above 0. The height is that of the standard atmosphere at this pressure.
    wavelength_um : float
        Wavelength, micrometres.
    """

    def __init__(
        self, pressure_hpa: float, temperature_c: float, relative_humidity: float, wavelength_um: float
    ) -> None:
        height_km = standard_height_km(pressure_hpa)
        self.observer_km = EARTH_RADIUS_KM + height_km
        self.bend_km = EARTH_RADIUS_KM + TROPOPAUSE_KM
        self.top_km = EARTH_RADIUS_KM + TOP_KM
        hydrostatic = HYDROSTATIC_K_KM * (1 - 2.8e-4 * height_km)
        self.power = hydrostatic / LAPSE_K_KM
        kelvin = temperature_c + 273.15
        # Refractivity of dry air per pressure over temperature, K/hPa (Hohenkerk & Sinclair 1985 after the IAG's
        # recommendation of 1963).
        per_hpa = 273.15e-6 / 1013.25 * (287.6155 + 1.62887 / wavelength_um**2 + 0.01360 / wavelength_um**4)
        self.base_km, vapour = self.observer_km, 0.0
        if height_km > TROPOPAUSE_KM:
            self.base_km = self.bend_km
            pressure_hpa *= math.exp(hydrostatic / kelvin * (height_km - TROPOPAUSE_KM))
        else:
            # Saturation vapour pressure over water: Gill 1982, Atmosphere-Ocean Dynamics, appendix 4.
            saturated = 10 ** ((0.7859 + 0.03477 * temperature_c) / (1 + 0.00412 * temperature_c))
            saturated *= 1 + pressure_hpa * 1e-6 * (4.5 + 6e-4 * temperature_c**2)
            vapour = min(
                relative_humidity * saturated / max(1 - (1 - relative_humidity) * saturated / pressure_hpa, 1e-3),
                pressure_hpa,
            )
        self.kelvin = kelvin
        # In hydrostatic equilibrium, the dry pressure gains what the lighter vapour takes away (Sinclair 1982).
        added = LIGHTER_VAPOUR * vapour * self.power / (VAPOUR_POWER - self.power)
        self.dry = per_hpa * (pressure_hpa + added) / kelvin
        self.wet = (per_hpa * added + 11.2684e-6 * vapour) / kelvin
        self.bend_excess = 0.0
        excess, _ = self.below(np.array([self.bend_km]))
        self.bend_excess = float(excess[0])
        top_k = max(kelvin - LAPSE_K_KM * (self.bend_km - self.base_km), LEAST_K)
        self.fall_per_km = hydrostatic / top_k

    def below(self, r_km: F8) -> tuple[F8, F8]:
        """Return n - 1 and dn/dr (1/km) of the troposphere."""
        ratio = np.maximum(self.kelvin - LAPSE_K_KM * (r_km - self.base_km), LEAST_K) / self.kelvin
        dry = self.dry * ratio ** (self.power - 1)
        wet = self.wet * ratio ** (VAPOUR_POWER - 1)
        slope = ((VAPOUR_POWER - 1) * wet - (self.power - 1) * dry) * LAPSE_K_KM / self.kelvin / ratio
        return dry - wet, slope

    def above(self, r_km: F8) -> tuple[F8, F8]:
        """Return n - 1 and dn/dr (1/km) of the stratosphere."""
        excess = self.bend_excess * np.exp(self.fall_per_km * (self.bend_km - r_km))
        return excess, -self.fall_per_km * excess

    def index(self, r_km: float) -> float:
        """Return the refractive index n at a distance."""
        return 1.0 + float((self.below if r_km <= self.bend_km else self.above)(np.array(r_km))[0])

    @property
    def invariant_km(self) -> float:
        """The invariant of a horizontal ray at the observer."""
        return self.index(self.observer_km) * self.observer_km


@lru_cache(maxsize=8)
def air_at(pressure_hpa: float, temperature_c: float, relative_humidity: float, wavelength_um: float) -> Air:
    """Return the air for these values, cached for the next call."""
    return Air(pressure_hpa, temperature_c, relative_humidity, wavelength_um)


def horizon_dip_rad(air: Air) -> float:
    """Return the dip of the sea horizon below the horizontal, 0 for an observer at sea level."""
    if air.observer_km <= EARTH_RADIUS_KM:
        return 0.0
    return math.acos(min(1.0, air.index(EARTH_RADIUS_KM) * EARTH_RADIUS_KM / air.invariant_km))


def ray_bending_rad(apparent_altitude_rad: F8, air: Air) -> F8:
    """Return the refraction at apparent altitudes, shape (n,), up to 20 deg, radians.

    A ray from below the horizontal is symmetric about its lowest point: its refraction is that of the ray at the same angle
    above the horizontal, plus twice the bending between the lowest point and the observer. Altitudes below the sea horizon
    get the refraction of the horizon.
    """
    altitude = np.maximum(apparent_altitude_rad, -horizon_dip_rad(air) - 1e-3)
    upward = np.abs(altitude)
    invariant = air.invariant_km * np.cos(upward)
    # Start from the lowest point of the ray if the air below the observer were uniform.
    start = air.observer_km * np.cos(upward)
    total = np.zeros_like(upward)
    for shell, lower, upper in (
        (air.below, air.observer_km, max(air.bend_km, air.observer_km)),
        (air.above, max(air.bend_km, air.observer_km), air.top_km),
    ):
        if upper > lower:
            total += _bent(shell, invariant, start, np.full_like(start, lower), upper)
    dips = np.flatnonzero(altitude < 0)
    if len(dips):
        total[dips] += 2 * _bent_below(air, invariant[dips])
    return total


def _bent_below(air: Air, invariant: F8) -> F8:
    """Return the bending between the lowest point of rays and the observer, radians."""
    lowest = np.full_like(invariant, air.observer_km)
    for _ in range(30):
        excess, slope = _mixed(air, lowest)
        lowest -= ((1 + excess) * lowest - invariant) / (1 + excess + lowest * slope)
    lowest = np.minimum(lowest, air.observer_km)
    if air.observer_km <= air.bend_km:
        return _bent(air.below, invariant, lowest, lowest, air.observer_km)
    first = np.maximum(lowest, air.bend_km)
    bent = _bent(air.above, invariant, lowest, first, air.observer_km)
    deep = np.flatnonzero(lowest < air.bend_km)
    bent[deep] += _bent(air.below, invariant[deep], lowest[deep], lowest[deep], air.bend_km)
    return bent


def _mixed(air: Air, r_km: F8) -> tuple[F8, F8]:
    """Return `Air.below` or `Air.above`, depending on the distance."""
    low, high = air.below(r_km), air.above(r_km)
    inside = r_km <= air.bend_km
    return np.where(inside, low[0], high[0]), np.where(inside, low[1], high[1])


_NODE, _WEIGHT = np.polynomial.legendre.leggauss(NODES)


def _bent(shell: Shell, invariant: F8, start_km: F8, lower_km: F8, upper_km: float) -> F8:
    """Return the bending, rad, between two distances, by Gauss-Legendre quadrature in u = sqrt(r - start)."""
    first, last = np.sqrt(lower_km - start_km), np.sqrt(upper_km - start_km)
    half = ((last - first) / 2)[:, None]
    u = ((last + first) / 2)[:, None] + half * _NODE
    r = start_km[:, None] + u * u
    excess, slope = shell(r)
    n = 1 + excess
    c = invariant[:, None]
    root = np.sqrt(np.maximum((n * r - c) * (n * r + c), 1e-12))
    return np.asarray(np.sum(-slope / n * c / root * 2 * u * half * _WEIGHT, axis=1))
