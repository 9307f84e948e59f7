"""Sunlight in the air of a spherical Earth: the columns that it has crossed, and its spreading by refraction.

By Bouguer's law a ray conserves n r sin(angle from the vertical). Rays of all such invariants are followed from outside
through shells. At each height they give the columns that the light has crossed as a function of the Sun's true zenith
distance there, and the change of the irradiance across the ray: the square of n times d cos(apparent) / d cos(true zenith
distance). Source: Rozenberg 1966, "Twilight", chapter 2; Smart 1977, "Spherical Astronomy", section 36.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from generator.twilight.air_profiles import EARTH_RADIUS_KM, HEIGHTS_KM, STEP_KM, TOP_KM, column_densities

Floats = NDArray[np.float64]

SEA_LEVEL_REFRACTIVITY = 2.78e-4
"""Refractivity of the standard atmosphere at 550 nm. Source: Ciddor 1996, Appl. Opt. 35, 1566."""
LEAST_DEG, MOST_DEG, STEP_DEG = 80.0, 103.0, 0.05
ZENITH_DISTANCES_DEG: Floats = np.arange(LEAST_DEG, MOST_DEG + STEP_DEG / 2, STEP_DEG)
"""Sun's true zenith distances at the lit place; smaller ones use the columns of the first."""
OPAQUE = 1e4
"""Value of the column in the Earth's shadow."""
GAUSS_POINTS = 6
# Invariants of rays that end on the ground, as the lowest height, km, which is below the Earth's surface.
_SUNK_KM = np.concatenate([-np.geomspace(120.0, 0.02, 60)])


@dataclass(frozen=True)
class SolarBeam:
    """Sunlight as a function of height and the Sun's true zenith distance there, on HEIGHTS_KM x ZENITH_DISTANCES_DEG.

    Attributes
    ----------
    columns : (h, z, 4) array
        Columns of air, haze, ozone and stratospheric aerosol that the light has crossed, relative to their vertical
        columns; OPAQUE in the Earth's shadow.
    log_focus : (h, z) array
        Logarithm of the irradiance across the ray relative to that above the air, due to refraction alone.
    """

    columns: Floats
    log_focus: Floats

    @functools.cached_property
    def logs(self) -> Floats:
        """Logarithms of the columns and of the focus, (h, z, 5) array: nearly linear between the nodes."""
        return np.concatenate([np.log(np.maximum(self.columns, 1e-12)), self.log_focus[..., None]], axis=2)


@functools.lru_cache(maxsize=8)
def solar_beam(floor_km: float, refractivity: float = SEA_LEVEL_REFRACTIVITY) -> SolarBeam:
    """Follow the rays of the Sun; takes about a tenth of a second.

    Parameters
    ----------
    floor_km : float
        Height below which the aerosol is constant (see :func:`generator.twilight.air_profiles.column_densities`).
    refractivity : float
        n - 1 at sea level; it is proportional to the density of the air.
    """
    density = column_densities(floor_km)
    lowest = np.concatenate([_SUNK_KM, HEIGHTS_KM[:-1]])
    n_nodes = 1 + refractivity * density[0] / density[0, 0]
    index = 1 + refractivity * np.exp(np.interp(lowest, HEIGHTS_KM, np.log(density[0] / density[0, 0])))
    invariant = index * (EARTH_RADIUS_KM + lowest)
    angle, columns = _along_rays(lowest, invariant, density, refractivity)
    to_space = np.arcsin(np.minimum(invariant / (EARTH_RADIUS_KM + TOP_KM), 1))
    whole_angle, whole = angle[:, -1] + to_space, columns[:, :, -1]
    touches = lowest >= 0
    shape = (len(HEIGHTS_KM), len(ZENITH_DISTANCES_DEG))
    found, focus = np.full((*shape, len(density)), OPAQUE), np.zeros(shape)
    for k, height in enumerate(HEIGHTS_KM):
        below = lowest <= height
        # Before its lowest place a ray has less of its angle and columns behind it than after.
        after = np.flatnonzero(below & touches)[::-1]
        before = np.flatnonzero(below & (lowest < height))
        true = np.concatenate([(whole_angle - angle[:, k])[before], (whole_angle + angle[:, k])[after]])
        crossed = np.concatenate([(whole - columns[:, :, k])[before], (whole + columns[:, :, k])[after]])
        sine = np.minimum(invariant / (n_nodes[k] * (EARTH_RADIUS_KM + height)), 1.0)
        cosine = np.sqrt(1 - sine**2)
        apparent = np.concatenate([cosine[before], -cosine[after]])
        spread = np.log(n_nodes[k] ** 2 * np.gradient(apparent, np.cos(true)))
        degrees = np.degrees(true)
        lit = degrees[-1] >= ZENITH_DISTANCES_DEG
        for part in range(len(density)):
            found[k, lit, part] = np.interp(ZENITH_DISTANCES_DEG[lit], degrees, crossed[:, part])
        focus[k, lit] = np.interp(ZENITH_DISTANCES_DEG[lit], degrees, spread)
    return SolarBeam(found, focus)


def _along_rays(lowest: Floats, invariant: Floats, density: Floats, refractivity: float) -> tuple[Floats, Floats]:
    """Angle at the Earth's centre, and columns, from the lowest place of each ray (or the ground) up to HEIGHTS_KM.

    Returns
    -------
    angle : (rays, h) array
        Radians; 0 at heights that a ray does not reach.
    columns : (rays, parts, h) array
    """
    node, weight = np.polynomial.legendre.leggauss(GAUSS_POINTS)
    # As functions of the root of the height above the lowest place, the integrands are smooth where the ray is
    # horizontal.
    root = np.sqrt(np.maximum(HEIGHTS_KM - lowest[:, None], 0))
    middle, half = (root[:, 1:] + root[:, :-1]) / 2, np.diff(root) / 2
    y = middle[:, :, None] + half[:, :, None] * node
    height = np.clip(lowest[:, None, None] + y**2, 0, TOP_KM)
    place = height / STEP_KM
    cell = np.minimum(place.astype(np.intp), len(HEIGHTS_KM) - 2)
    logs = np.log(density)
    at = [np.exp(row[cell] + (place - cell) * np.diff(row)[cell]) for row in logs]
    radius = EARTH_RADIUS_KM + height
    index = 1 + refractivity * at[0] / density[0, 0]
    optical = index * radius
    b = invariant[:, None, None]
    slope = np.sqrt(np.maximum((optical - b) * (optical + b), 1e-9))
    per_root = 2 * y * half[:, :, None] * weight
    angle = np.sum(per_root * b / (radius * slope), axis=-1)
    columns = np.stack([np.sum(per_root * row * optical / slope, axis=-1) for row in at], axis=1)
    zero = np.zeros((len(lowest), 1))
    return (
        np.concatenate([zero, np.cumsum(angle, axis=1)], axis=1),
        np.concatenate([np.zeros((len(lowest), len(density), 1)), np.cumsum(columns, axis=2)], axis=2),
    )
