"""Sunlight scattered once towards an observer in the twilight, by quadrature along lines of sight over a spherical Earth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from generator.light.bake_grids import BakedAir
from generator.light.single_scattering import aerosol_phase, rayleigh_phase
from generator.twilight.air_profiles import EARTH_RADIUS_KM, HEIGHTS_KM, STEP_KM, TOP_KM, column_densities
from generator.twilight.solar_beam import (
    LEAST_DEG,
    STEP_DEG,
    ZENITH_DISTANCES_DEG,
    SolarBeam,
)  # fmt: skip

Floats = NDArray[np.float64]

STEPS = 144
MOST_COLUMN = 300.0
"""Limit of the column of air; larger ones than light can cross above the ground belong to places in the Earth's shadow."""


@dataclass(frozen=True)
class TwilightDepths:
    """Vertical optical depths that determine the light at some wavelengths, (w,) arrays.

    Attributes
    ----------
    rayleigh : array
        Depth above sea level of air that has the pressure of the real air at the observer.
    aerosol : array
        Depth above the observer, without the stratosphere's.
    ozone : array
    stratosphere : array or float
        Depth of the stratosphere's aerosol.
    """

    rayleigh: Floats
    aerosol: Floats
    ozone: Floats
    stratosphere: Floats | float = 0.0


@dataclass(frozen=True)
class ScatteredSunlight:
    """Light per unit solar irradiance above the air, and its mean path through ozone.

    Attributes
    ----------
    radiance : (w, views, azimuths) array
        Radiance, sr^-1.
    ozone_path : (w, views, azimuths) array
        Mean column of ozone that the light has crossed, relative to the vertical column.
    """

    radiance: Floats
    ozone_path: Floats


def sun_directions(depression_deg: float, relative_azimuth_deg: Floats) -> Floats:
    """Unit vectors to the Sun, (k, 3) array, for lines of sight in the plane of y (forwards) and z (up)."""
    turn, down = np.radians(relative_azimuth_deg), np.radians(depression_deg)
    flat = np.cos(down)
    return np.stack([flat * np.sin(turn), flat * np.cos(turn), np.full_like(turn, -np.sin(down))], axis=-1)


def looked_up(table: Floats, height_km: Floats, zenith_distance_deg: Floats) -> Floats:
    """Bilinear interpolation of a table (h, z, ...) of :class:`SolarBeam`."""
    row = np.clip(height_km / STEP_KM, 0, len(HEIGHTS_KM) - 1)
    column = np.clip((zenith_distance_deg - LEAST_DEG) / STEP_DEG, 0, len(ZENITH_DISTANCES_DEG) - 1)
    i = np.minimum(row.astype(np.intp), len(HEIGHTS_KM) - 2)
    j = np.minimum(column.astype(np.intp), len(ZENITH_DISTANCES_DEG) - 2)
    a, b = row - i, column - j
    flat = table.reshape(-1, *table.shape[2:])
    corner = i * len(ZENITH_DISTANCES_DEG) + j
    more = (...,) + (None,) * (table.ndim - 2)
    low = flat[corner] * (1 - b)[more] + flat[corner + 1] * b[more]
    corner = corner + len(ZENITH_DISTANCES_DEG)
    high = flat[corner] * (1 - b)[more] + flat[corner + 1] * b[more]
    return low * (1 - a)[more] + high * a[more]


def twilight_single(
    beam: SolarBeam,
    depths: TwilightDepths,
    observer_km: float,
    depression_deg: float,
    altitude_deg: Floats,
    relative_azimuth_deg: Floats,
    floor_km: float,
    air: BakedAir,
) -> ScatteredSunlight:
    """Sunlight scattered once by air and aerosol.

    Parameters
    ----------
    beam : SolarBeam
    depths : TwilightDepths
    observer_km : float
        Height above sea level.
    depression_deg : float
        Depression of the Sun's true place.
    altitude_deg, relative_azimuth_deg : (views,), (azimuths,) arrays
        Directions of the lines of sight, at or above the horizontal; azimuths are relative to the Sun's.
    floor_km : float
        Height below which the aerosol is constant; the same as the beam's.
    air : BakedAir
        Air with the aerosol's albedo.
    """
    sine = np.sin(np.radians(altitude_deg))[:, None]
    start = EARTH_RADIUS_KM + observer_km
    # Steps are even in the root of the height: short near the observer, where the air is dense.
    edge = observer_km + np.linspace(0, np.sqrt(TOP_KM - observer_km), STEPS + 1) ** 2
    middle = (edge[1:] + edge[:-1]) / 2
    along_edge, along = (_distance(start, sine, height) for height in (edge, middle))
    step = np.diff(along_edge, axis=1)
    cell = np.minimum((middle / STEP_KM).astype(np.intp), len(HEIGHTS_KM) - 2)
    logs = np.log(column_densities(floor_km))
    density = np.exp(logs[:, cell] + (middle / STEP_KM - cell) * (logs[:, cell + 1] - logs[:, cell]))
    part = density[:, None, :] * step
    columns = np.cumsum(part, axis=2) - part / 2
    sun = sun_directions(depression_deg, relative_azimuth_deg)
    flat = np.sqrt(1 - sine**2)
    towards = flat * sun[:, 1] + sine * sun[:, 2]
    radius = EARTH_RADIUS_KM + middle
    cosine = (along[:, None, :] * towards[:, :, None] + start * sun[:, 2][:, None]) / radius
    zenith_distance = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
    height = np.broadcast_to(middle, zenith_distance.shape)
    crossed = looked_up(beam.logs, height, zenith_distance)
    # Exponentials are computed only for places that the Sun lights.
    lit = crossed[..., 0] < np.log(MOST_COLUMN)
    view, _, point = np.nonzero(lit)
    crossed = crossed[lit]
    paths = np.exp(crossed[:, :4]) + columns[:, view, point].T
    stratosphere = np.broadcast_to(np.asarray(depths.stratosphere, float), depths.rayleigh.shape)
    depth = np.stack([depths.rayleigh, depths.aerosol, depths.ozone, stratosphere], axis=1)
    light = np.exp(crossed[:, 4] - depth @ paths.T) * step[view, point]
    of_each = [light * density[k, point] for k in (0, 1, 3)]
    shape = (len(altitude_deg), len(relative_azimuth_deg))
    owner = np.ravel_multi_index(np.nonzero(lit)[:2], shape)
    haze = aerosol_phase(towards)
    # Droplets of sulphuric acid absorb nothing.
    phases = rayleigh_phase(towards), air.aerosol_albedo * haze, haze
    radiance, weighted = np.zeros((2, len(depth), *shape))
    for amount, of, phase in zip((depths.rayleigh, depths.aerosol, stratosphere), of_each, phases, strict=True):
        for w, row in enumerate(of):
            scattered = amount[w] * phase
            radiance[w] += scattered * np.bincount(owner, row, shape[0] * shape[1]).reshape(shape)
            weighted[w] += scattered * np.bincount(owner, row * paths[:, 2], shape[0] * shape[1]).reshape(shape)
    return ScatteredSunlight(radiance, np.divide(weighted, radiance, out=np.zeros_like(radiance), where=radiance > 0))


def _distance(start: float, sine: Floats, height_km: Floats) -> Floats:
    """Distance at which lines of sight from a radius, at angles above the horizontal, reach heights, (views, h) array."""
    radius = EARTH_RADIUS_KM + height_km
    root = np.sqrt(np.maximum((start * sine) ** 2 + (radius - start) * (radius + start), 0))
    result: Floats = (radius - start) * (radius + start) / np.maximum(root + start * sine, 1e-12)
    return result
