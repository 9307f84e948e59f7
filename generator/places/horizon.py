"""The horizon of an observer in the air, and the amount of air along rays from below the horizontal."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from generator.places.astrometry import Air, Site
from generator.places.ray_bending import (
    DRY_AIR_KG_KMOL,
    EARTH_RADIUS_M,
    GAS_CONSTANT,
    Layers,
    StandardAir,
    lowest_altitude_deg,
)

Floats = NDArray[np.float64]

ROWS = 48
"""Number of altitudes between the horizon and the horizontal."""
NODES = 24
VACUUM_HPA = 1e-6
"""Substitute for zero pressure: the ray is straight, and its fraction of air is still that of the standard profile."""
BISECTIONS = 60


@dataclass(frozen=True, eq=False)
class Horizon:
    """The sky below the horizontal.

    Attributes
    ----------
    altitude_deg : float
        Apparent altitude of the ground's horizon, 0 or less.
    dipping_deg : (n,) array
        Apparent altitudes from the horizon up to 0; empty if the horizon is not below the horizontal.
    further_airmass : (n,) array
        Air along a ray between its two crossings of the observer's height, relative to the vertical column above the
        observer. The rest of its path is that of the ray at the same angle above the horizontal.
    """

    altitude_deg: float
    dipping_deg: Floats
    further_airmass: Floats

    @property
    def dips(self) -> bool:
        """Whether there is sky below the horizontal."""
        return len(self.dipping_deg) > 0

    @property
    def sine(self) -> float:
        """Sine of the horizon's altitude."""
        return float(np.sin(np.radians(self.altitude_deg)))

    def further(self, apparent_altitude_deg: Floats) -> Floats:
        """`further_airmass` at altitudes (...); 0 above the horizontal, and the horizon's below the horizon."""
        if not self.dips:
            return np.zeros_like(apparent_altitude_deg)
        return np.interp(apparent_altitude_deg, self.dipping_deg, self.further_airmass)


LEVEL = Horizon(0.0, np.zeros(0), np.zeros(0))
"""The horizon of an observer on flat ground."""


@functools.lru_cache(maxsize=64)
def horizon_of(site: Site, air: Air, ground_height_m: float) -> Horizon:
    """Horizon of an observer above ground of a given height, m, from the rays of :mod:`generator.places.ray_bending`.

    Air without pressure does not bend rays: the dip is then the geometric one, arccos(R / (R + h)).
    """
    if ground_height_m >= site.height_m:
        return LEVEL
    pressure_hpa = max(air.pressure_hpa, VACUUM_HPA)
    humidity = air.relative_humidity if air.pressure_hpa > 0 else 0.0
    layers = Layers(StandardAir(pressure_hpa, air.temperature_c, humidity, site.height_m, site.latitude_deg))
    altitude = lowest_altitude_deg(layers, ground_height_m)
    # The spacing is finest at the ground, where the air is densest.
    dipping = altitude * np.linspace(1, 0, ROWS)
    column_m = GAS_CONSTANT * (air.temperature_c + 273.15) / (DRY_AIR_KG_KMOL * layers.gravity_m_s2)
    return Horizon(altitude, dipping, _further_m(layers, dipping) / column_m)


def _further_m(layers: Layers, altitude_deg: Floats) -> Floats:
    """Path, m, in air as dense as at the observer, between the two crossings of the observer's height, (n,) arrays."""
    start = layers.observer_m
    invariant = layers.index(start) * start * np.cos(np.radians(altitude_deg))
    low, high = np.full_like(invariant, EARTH_RADIUS_M - 2000.0), np.full_like(invariant, start)
    for _ in range(BISECTIONS):
        middle = (low + high) / 2
        beyond = (1 + _excess(layers, middle)) * middle > invariant
        low, high = np.where(beyond, low, middle), np.where(beyond, middle, high)
    lowest = high
    bend = np.clip(layers.tropopause_m, lowest, start)
    dense = float(_excess(layers, np.array([start]))[0])
    total = np.zeros_like(invariant)
    node, weight = np.polynomial.legendre.leggauss(NODES)
    for first, last in ((lowest, bend), (bend, np.full_like(lowest, start))):
        # As a function of the root of the height above the lowest point, the integrand is smooth there.
        u0, u1 = np.sqrt(np.maximum(first - lowest, 0)), np.sqrt(np.maximum(last - lowest, 0))
        half = (u1 - u0)[:, None] / 2
        u = (u1 + u0)[:, None] / 2 + half * node
        r = lowest[:, None] + u * u
        excess = _excess(layers, r)
        product, c = (1 + excess) * r, invariant[:, None]
        root = np.sqrt(np.maximum((product - c) * (product + c), 1e-6))
        total += np.sum(2 * excess / dense * product / root * 2 * u * half * weight, axis=1)
    return total


def _excess(layers: Layers, r_m: Floats) -> Floats:
    """Refractive index minus 1, which is proportional to the density of the air."""
    return np.where(r_m <= layers.tropopause_m, layers.troposphere(r_m)[0], layers.stratosphere(r_m)[0])
