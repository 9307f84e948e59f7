"""Refraction by a ray integral through a standard atmosphere of spherical shells.

The air is that of Hohenkerk & Sinclair 1985 (NAO Technical Note 63; Urban & Seidelmann 2013, Explanatory Supplement,
section 7.2.5): a troposphere whose temperature falls by LAPSE_K_M up to 11 km, with water vapour that falls as a power of
the temperature, and an isothermal stratosphere above. The integral is that of Auer & Standish 2000 (AJ 119, 2472): its
variable is the angle between the ray and the local vertical, in which the integrand is smooth at the horizon and below it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
_Layer = Callable[[Floats], tuple[Floats, Floats]]

GAS_CONSTANT = 8314.32
"""Gas constant, J kmol^-1 K^-1."""
DRY_AIR_KG_KMOL, WATER_KG_KMOL = 28.9644, 18.0152
EARTH_RADIUS_M = 6378120.0
LAPSE_K_M = 0.0065
VAPOUR_EXPONENT = 18.36
"""Exponent of the temperature in the pressure of water vapour."""
MIDDLE_LATITUDE_DEG = 45.0
REFERENCE_NM = 550.0
"""Wavelength of the places in the truth."""
TROPOPAUSE_M, TOP_M = 11000.0, 80000.0
WATER_REFRACTIVITY_K_HPA = 11.2684e-6
COLDEST_K = 100.0
NODES = 24
"""Gauss-Legendre nodes in each layer: the integral is within 0.001 arcsec of that with 200, at any altitude."""
NEWTON_STEPS = 5


@dataclass(frozen=True)
class StandardAir:
    """The air around an observer.

    Attributes
    ----------
    pressure_hpa, temperature_c, relative_humidity : float
        Values at the observer (hPa, 0 for no air; deg C; 0-1).
    height_m, latitude_deg : float
        Place of the observer, up to 70 km; the latitude sets gravity.
    wavelength_nm : float
    lapse_k_m : float
        Fall of the temperature with height in the troposphere, K/m.
    """

    pressure_hpa: float
    temperature_c: float
    relative_humidity: float
    height_m: float = 0.0
    latitude_deg: float = MIDDLE_LATITUDE_DEG
    wavelength_nm: float = REFERENCE_NM
    lapse_k_m: float = LAPSE_K_M


def saturation_hpa(temperature_c: float, pressure_hpa: float) -> float:
    """Pressure of saturated water vapour. Source: Gill 1982, as in Hohenkerk & Sinclair 1985."""
    exponent = (0.7859 + 0.03477 * temperature_c) / (1 + 0.00412 * temperature_c)
    return float(10**exponent * (1 + pressure_hpa * (4.5e-6 + 6e-10 * temperature_c**2)))


class Layers:
    """Refractive index of the troposphere and the stratosphere as a function of the distance from the Earth's centre."""

    def __init__(self, air: StandardAir) -> None:
        self.observer_m = EARTH_RADIUS_M + air.height_m
        self.tropopause_m = EARTH_RADIUS_M + TROPOPAUSE_M
        self.top_m = EARTH_RADIUS_M + TOP_M
        self.lapse_k_m = air.lapse_k_m
        gravity = 9.784 * (1 - 0.0026 * np.cos(np.radians(2 * air.latitude_deg)) - 2.8e-7 * air.height_m)
        self.gravity_m_s2 = float(gravity)
        weight = gravity * DRY_AIR_KG_KMOL / GAS_CONSTANT
        self.gamma = weight / self.lapse_k_m
        temperature_k = air.temperature_c + 273.15
        inverse_square = (1000 / air.wavelength_nm) ** 2
        dry = (287.6155 + (1.62887 + 0.01360 * inverse_square) * inverse_square) * 273.15e-6 / 1013.25
        pressure, vapour = air.pressure_hpa, 0.0
        # The troposphere's law holds from the reference height. For an observer above the tropopause, this is the
        # tropopause.
        self.reference_m = min(self.observer_m, self.tropopause_m)
        if self.observer_m > self.tropopause_m:
            pressure *= float(np.exp(weight / temperature_k * (self.observer_m - self.tropopause_m)))
        else:
            saturated = saturation_hpa(air.temperature_c, pressure)
            vapour = (
                air.relative_humidity * saturated / max(1 - (1 - air.relative_humidity) * saturated / pressure, 1e-3)
            )
            vapour = min(vapour, pressure)
        self.reference_k = temperature_k
        excess = vapour * (1 - WATER_KG_KMOL / DRY_AIR_KG_KMOL) * self.gamma / (VAPOUR_EXPONENT - self.gamma)
        self.dry = dry * (pressure + excess) / temperature_k
        self.wet = (dry * excess + WATER_REFRACTIVITY_K_HPA * vapour) / temperature_k
        self.stratosphere_k = float(self._temperature_k(np.array(self.tropopause_m)))
        self.decay_m = weight / self.stratosphere_k
        self.tropopause_excess = float(self.troposphere(np.array(self.tropopause_m))[0])

    def _temperature_k(self, r_m: Floats) -> Floats:
        return np.maximum(self.reference_k - self.lapse_k_m * (r_m - self.reference_m), COLDEST_K)

    def troposphere(self, r_m: Floats) -> tuple[Floats, Floats]:
        """Refractive index minus 1 in the troposphere, and its derivative with respect to the distance (1/m)."""
        log_ratio = np.log(self._temperature_k(r_m) / self.reference_k)
        dry = self.dry * np.exp((self.gamma - 1) * log_ratio)
        wet = self.wet * np.exp((VAPOUR_EXPONENT - 1) * log_ratio)
        slope = -self.lapse_k_m / self.reference_k * np.exp(-log_ratio)
        return dry - wet, ((self.gamma - 1) * dry - (VAPOUR_EXPONENT - 1) * wet) * slope

    def stratosphere(self, r_m: Floats) -> tuple[Floats, Floats]:
        """Refractive index minus 1 above the tropopause, and its derivative with respect to the distance (1/m)."""
        excess = self.tropopause_excess * np.exp(-self.decay_m * (r_m - self.tropopause_m))
        return excess, -self.decay_m * excess

    def index(self, r_m: float) -> float:
        """Refractive index at a distance from the Earth's centre."""
        layer = self.troposphere if r_m <= self.tropopause_m else self.stratosphere
        return 1 + float(layer(np.array(r_m))[0])


def lowest_altitude_deg(layers: Layers, grazed_m: float) -> float:
    """Apparent altitude of the ray that touches the shell at a height, deg; negative for a shell below the observer."""
    touched_m = EARTH_RADIUS_M + grazed_m
    cosine = layers.index(touched_m) * touched_m / (layers.index(layers.observer_m) * layers.observer_m)
    return -float(np.degrees(np.arccos(min(cosine, 1.0))))


def bending_deg(layers: Layers, apparent_altitude_deg: Floats) -> Floats:
    """Angle between a ray outside the air and at the observer, deg, at apparent altitudes, (n,) arrays."""
    at_observer = np.radians(90 - apparent_altitude_deg)
    invariant = layers.index(layers.observer_m) * layers.observer_m * np.sin(at_observer)
    top = _angle(invariant, layers.index(layers.top_m) * layers.top_m)
    at_tropopause = _angle(invariant, layers.index(layers.tropopause_m) * layers.tropopause_m)
    if layers.observer_m <= layers.tropopause_m:
        segments: tuple[tuple[_Layer, Floats, Floats], ...] = (
            (layers.stratosphere, top, at_tropopause),
            (layers.troposphere, at_tropopause, at_observer),
        )
    else:
        # A ray that dips below the tropopause crosses it twice; for other rays the middle segment is empty.
        dips = at_observer > np.pi / 2
        last = np.where(dips, np.pi - at_tropopause, at_observer)
        first = np.where(dips, at_tropopause, at_observer)
        last = np.minimum(last, at_observer)
        segments = (
            (layers.stratosphere, top, first),
            (layers.troposphere, first, last),
            (layers.stratosphere, last, at_observer),
        )
    total = np.zeros_like(at_observer)
    for layer, lower, upper in segments:
        total += _segment(layer, invariant, lower, upper)
    return np.degrees(total)


def _angle(invariant: Floats, index_times_r: float) -> Floats:
    """Angle between a ray and the vertical where it crosses a shell, 0 to pi/2; pi/2 for rays that stay above it."""
    return np.arcsin(np.minimum(invariant / index_times_r, 1.0))


_NODE, _WEIGHT = np.polynomial.legendre.leggauss(NODES)


def _segment(layer: _Layer, invariant: Floats, lower: Floats, upper: Floats) -> Floats:
    """Bending, rad, between two angles to the vertical within one layer, (n,) arrays."""
    half = (upper - lower)[:, None] / 2
    angle = (upper + lower)[:, None] / 2 + half * _NODE
    wanted = invariant[:, None] / np.sin(angle)
    r = wanted / (1 + layer(wanted)[0])
    for _ in range(NEWTON_STEPS):
        excess, slope = layer(r)
        r = r - ((1 + excess) * r - wanted) / (1 + excess + r * slope)
    excess, slope = layer(r)
    return np.sum(-r * slope / (1 + excess + r * slope) * half * _WEIGHT, axis=1)
