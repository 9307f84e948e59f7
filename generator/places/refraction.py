"""Astronomical refraction from the true to the apparent direction, and back."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import erfa
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from generator.places.ray_bending import Layers, StandardAir, bending_deg, lowest_altitude_deg

Floats = NDArray[np.float64]

LOWEST_ALTITUDE_OF_SERIES_DEG = 15.0
LOWEST_TANGENT_OF_SERIES = math.tan(math.radians(LOWEST_ALTITUDE_OF_SERIES_DEG))
FADED_BY_DEG = 12.0
"""True altitude at which the difference between series and integral at the series' lowest altitude (0.02 arcsec) has faded
out."""
BELOW_SEA_M = 500.0
"""Distance below sea level, or below an observer who is lower, of the shell that the table's lowest ray touches."""
TABLE_ROWS = 240
CLEARANCE = 1e-3
"""Fraction of the table's range by which its highest ray is above LOWEST_ALTITUDE_OF_SERIES_DEG."""
NEWTON_STEPS = 2


def _series_deg(true_zenith_distance_rad: Floats, refa_rad: float, refb_rad: float) -> Floats:
    """Solve z_true = z_obs + A tan z_obs + B tan^3 z_obs for the refraction, deg, by Newton's method."""
    observed = true_zenith_distance_rad.copy()
    # Starting from the true zenith distance, two steps come within 1e-9 arcsec above 15 deg.
    for _ in range(NEWTON_STEPS):
        tangent = np.tan(observed)
        square = tangent * tangent
        excess = observed + (refa_rad + refb_rad * square) * tangent - true_zenith_distance_rad
        observed -= excess / (1 + (refa_rad + 3 * refb_rad * square) * (1 + square))
    return np.degrees(true_zenith_distance_rad - observed)


@dataclass(frozen=True)
class RefractionTable:
    """Refraction in a given air.

    Attributes
    ----------
    refa_rad, refb_rad : float
        Coefficients of the series, for true altitudes from LOWEST_ALTITUDE_OF_SERIES_DEG up.
    lowest_deg : float
        True altitude of the lowest ray; the refraction of lower ones, which the Earth hides, is that ray's.
    lift_deg : CubicSpline
        Refraction as a function of the true altitude from `lowest_deg` to the series.
    """

    refa_rad: float
    refb_rad: float
    lowest_deg: float
    lift_deg: CubicSpline

    def of_true(self, true_altitude_deg: Floats) -> Floats:
        """Refraction, deg, at true altitudes, (n,) arrays."""
        series_altitude = np.maximum(true_altitude_deg, LOWEST_ALTITUDE_OF_SERIES_DEG)
        lift = _series_deg(np.radians(90 - series_altitude), self.refa_rad, self.refb_rad)
        low = np.flatnonzero(true_altitude_deg < LOWEST_ALTITUDE_OF_SERIES_DEG)
        if len(low):
            lift[low] = self.lift_deg(np.maximum(true_altitude_deg[low], self.lowest_deg))
        return lift

    def lift_rad(self, level: Floats, up: Floats) -> Floats:
        """Refraction, rad, of true directions from their horizontal and upward components: :meth:`of_true`.

        Above the lowest altitude of the series it needs no trigonometric function: the tangent of a zenith distance minus
        a small angle follows from both tangents, and that of the small angle is a series of two terms, accurate to a
        relative 1e-12.
        """
        least = LOWEST_TANGENT_OF_SERIES * level
        low = np.flatnonzero(up < least)
        tangent = level / np.maximum(up, least)
        lift = np.zeros_like(tangent)
        for _ in range(NEWTON_STEPS):
            small = lift * (1 + lift * lift * (1 / 3))
            observed = (tangent - small) / (1 + tangent * small)
            square = observed * observed
            excess = (self.refa_rad + self.refb_rad * square) * observed - lift
            lift += excess / (1 + (self.refa_rad + 3 * self.refb_rad * square) * (1 + square))
        if len(low):
            lift[low] = np.radians(self.of_true(np.degrees(np.arctan2(up[low], level[low]))))
        return lift

    def slope_at(self, true_altitude_deg: Floats) -> Floats:
        """Derivative of the refraction with respect to the true altitude within the table; 0 elsewhere."""
        inside = (true_altitude_deg >= self.lowest_deg) & (true_altitude_deg < LOWEST_ALTITUDE_OF_SERIES_DEG)
        return np.where(inside, self.lift_deg(true_altitude_deg, 1), 0.0)

    def of_apparent(self, apparent_altitude_deg: Floats) -> Floats:
        """Refraction, deg, at apparent altitudes, (n,) arrays: the inverse of :meth:`of_true` to 1e-7 arcsec."""
        tangent = np.tan(np.radians(90 - np.maximum(apparent_altitude_deg, LOWEST_ALTITUDE_OF_SERIES_DEG)))
        lift = np.degrees(tangent * (self.refa_rad + self.refb_rad * tangent * tangent))
        low = np.flatnonzero(apparent_altitude_deg - lift < LOWEST_ALTITUDE_OF_SERIES_DEG)
        if len(low):
            apparent = apparent_altitude_deg[low]
            nodes = self.lift_deg.x
            true = np.interp(apparent, nodes + self.lift_deg(nodes), nodes)
            true += np.minimum(apparent - nodes[0] - self.lift_deg(nodes[0]), 0)
            for _ in range(NEWTON_STEPS + 1):
                true -= (true + self.of_true(true) - apparent) / (1 + self.slope_at(true))
            lift[low] = apparent - true
        return lift


@functools.lru_cache(maxsize=64)
def refraction_table(air: StandardAir) -> RefractionTable:
    """Tabulate the refraction of an air (pressure above 0), within 0.001 arcsec of the integral; takes a millisecond."""
    at_observer = (air.pressure_hpa, air.temperature_c, air.relative_humidity, air.wavelength_nm / 1000)
    refa, refb = (float(part) for part in erfa.refco(*at_observer))
    layers = Layers(air)
    bottom = lowest_altitude_deg(layers, min(air.height_m, 0.0) - BELOW_SEA_M)
    seam_zenith_distance = np.radians(90 - np.array([LOWEST_ALTITUDE_OF_SERIES_DEG]))
    seam_lift = float(_series_deg(seam_zenith_distance, refa, refb)[0])
    top = LOWEST_ALTITUDE_OF_SERIES_DEG + seam_lift
    # Nodes are denser at the bottom, where the refraction changes fastest.
    apparent = bottom + (1 + CLEARANCE) * (top - bottom) * np.linspace(0, 1, TABLE_ROWS) ** 1.5
    lift = bending_deg(layers, apparent)
    true = apparent - lift
    share = np.clip((true - FADED_BY_DEG) / (LOWEST_ALTITUDE_OF_SERIES_DEG - FADED_BY_DEG), 0, None)
    # A spline is linear in its values.
    both = CubicSpline(true, np.stack([lift, share], axis=1))
    gap = seam_lift - float(both(LOWEST_ALTITUDE_OF_SERIES_DEG)[0])
    joined = np.ascontiguousarray(both.c[:, :, 0] + gap * both.c[:, :, 1])
    return RefractionTable(refa, refb, float(true[0]), CubicSpline.construct_fast(joined, true))


def refraction_deg(true_altitude_deg: Floats, air: StandardAir) -> Floats:
    """Refraction, deg, to add to true altitudes, (n,) arrays.

    Above 15 deg this is ERFA's ``refco`` with its A tan z + B tan^3 z (good to some 0.05 arcsec there). Lower, it is the
    integral of :mod:`generator.places.ray_bending`, down to the ray that touches the ground at sea level, which for an
    observer in the air comes from below the horizontal. For directions that the Earth hides it is constant.
    """
    if air.pressure_hpa == 0:
        return np.zeros_like(true_altitude_deg)
    return refraction_table(air).of_true(true_altitude_deg)


def refraction_of_vectors_rad(level: Floats, up: Floats, air: StandardAir) -> Floats:
    """:func:`refraction_deg`, in rad, from the horizontal and upward components (n,) of true directions."""
    if air.pressure_hpa == 0:
        return np.zeros_like(level)
    return refraction_table(air).lift_rad(level, up)


def refraction_of_apparent_deg(apparent_altitude_deg: Floats, air: StandardAir) -> Floats:
    """Refraction, deg, to subtract from apparent altitudes, (n,) arrays: the inverse of :func:`refraction_deg`."""
    if air.pressure_hpa == 0:
        return np.zeros_like(apparent_altitude_deg)
    return refraction_table(air).of_apparent(apparent_altitude_deg)


def lowest_ray_deg(air: StandardAir) -> float:
    """True altitude, deg, from which the lowest ray arrives, that which touches the ground at sea level; -90 without air."""
    return -90.0 if air.pressure_hpa == 0 else refraction_table(air).lowest_deg
