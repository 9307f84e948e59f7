"""Estimators evaluated along the random walks: light of lamps on the ground, and light of the Moon.

Sums are kept in 64-bit integers, so that they do not depend on the order of the threads.
"""

from __future__ import annotations

import math
from typing import Any

import drjit as dr
import numpy as np
from drjit.llvm import Float, UInt32, UInt64
from numpy.typing import NDArray

from generator.bake.walk import Air, Scattering, Vector, walk
from generator.light.bake_grids import CityGrid, GroundGrid, MoonGrid
from generator.light.emission import (
    DIRECT_SHARE,
    FRONTAL_AREA_INDEX,
    GARSTANG_NORMALISATION,
    PATTERNS,
    REFLECTED_SHARE,
    built_up_output,
)

Floats = NDArray[np.float64]
FIXED_POINT = 2.0**40


LEAST_SINE = 1e-3
"""Least sine of the directions sampled in addition to the path's own."""
PER_LOG = -math.log(LEAST_SINE)


def landed(air: Air, at: Scattering, direction: Vector) -> tuple[Any, Any, Any, Any]:
    """Return where a direction meets the ground, and its weight in combination with another sampling method.

    The other method is uniform in the logarithm of the angle's sine and in azimuth; the two are combined by the balance
    heuristic (Veach & Guibas 1995, SIGGRAPH 95, 419).

    Returns
    -------
    weight, x, y, sine : Float
        The weight is 0 for upward directions.
    """
    ux, uy, uz = direction
    sine = dr.maximum(-uz, 1e-6)
    cosine = at.came[0] * ux + at.came[1] * uy + at.came[2] * uz
    phase = air.phase(cosine, at.by_aerosol)
    other = dr.select(sine > LEAST_SINE, 1 / (2 * math.pi * PER_LOG * sine), 0)
    weight = dr.select(uz < 0, at.weight * dr.exp(-at.depth / sine) * phase / (phase + other), 0)
    length = at.height / sine
    return weight, dr.fma(ux, length, at.x), dr.fma(uy, length, at.y), sine


def glowing_ground(angle: Any, cosine: Any) -> tuple[Any, Any, Any]:
    """Radiance of ground covered with lamps in each of PATTERNS, for a zenith angle and its cosine: intensity over cosine."""
    horizon = GARSTANG_NORMALISATION / (2 * math.pi) * dr.square(dr.square(angle)) / cosine
    lambert = 1 / math.pi
    clear = dr.exp(-FRONTAL_AREA_INDEX * dr.sqrt(dr.maximum(1 - cosine * cosine, 0)) / cosine) / built_up_output()
    built_up = clear * (DIRECT_SHARE * horizon + REFLECTED_SHARE * (1 - DIRECT_SHARE) * lambert)
    return Float(lambert), horizon, built_up


def city_piece(air: Air, grid: CityGrid, view_altitude_deg: float, seed: int) -> tuple[Floats, Floats]:
    """Kernel of a lamp seen at one altitude, without light scattered once: mean over each part of each ring.

    Returns
    -------
    mean, relative_error : (patterns, distances, azimuths) arrays
        Radiance per photon output above the horizon, km^-2 sr^-1, in each of PATTERNS.
    """
    rings, parts = grid.edges
    cells = grid.distances * grid.azimuths
    area = np.diff(rings**2)[:, None] * np.diff(np.radians(parts))
    per_log = dr.opaque(Float, float(grid.distances / grid.scale(grid.farthest_km)))
    batches = []
    for batch in range(grid.batches):
        sums = [dr.zeros(UInt64, cells) for _ in PATTERNS]

        def tally(at: Scattering, sums: list[Any] = sums) -> None:
            if at.order == 1:
                return
            sine = dr.exp(-PER_LOG * at.random.next_float32())
            turn, along = 2 * math.pi * at.random.next_float32(), dr.sqrt(1 - sine * sine)
            for direction in (at.went, (along * dr.cos(turn), along * dr.sin(turn), -sine)):
                weight, x, y, sine_down = landed(air, at, direction)
                ring = UInt32(dr.log(1 + dr.sqrt(x * x + y * y) / grid.core_km) * per_log)
                part = dr.minimum(UInt32(dr.sqrt(dr.abs(dr.atan2(x, y)) / math.pi) * grid.azimuths), grid.azimuths - 1)
                counts = (weight > 0) & (ring < grid.distances)
                angle = dr.acos(dr.minimum(sine_down, 1))
                for total, radiance in zip(sums, glowing_ground(angle, sine_down), strict=True):
                    dr.scatter_add(total, UInt64(weight * radiance * FIXED_POINT), ring * grid.azimuths + part, counts)

        walk(air, view_altitude_deg, grid.paths, seed + batch, tally)
        batches.append([np.array(total, dtype=np.float64) for total in sums])
    light = np.array(batches).reshape(grid.batches, len(PATTERNS), *area.shape) / (FIXED_POINT * grid.paths * area)
    return mean_and_error(light)


def ground_piece(air: Air, grid: GroundGrid, view_altitude_deg: float, seed: int) -> tuple[Floats, Floats]:
    """Upward light of the ground, seen at one altitude in the air above a ground that reflects everything.

    Returns
    -------
    mean, relative_error : (1 + patterns * distances,) arrays
        First the radiance above an infinite, uniformly glowing ground, sr^-1 per light that leaves it, without further
        reflection. Then the radiance of light from lamps in each ring around the observer, in each of PATTERNS, that the
        ground has reflected once: km^-2 sr^-1 per light output.
    """
    city = CityGrid()
    rings, _ = city.edges
    area = np.pi * np.diff(rings**2)
    per_log = dr.opaque(Float, float(city.distances / city.scale(city.farthest_km)))
    batches = []
    for batch in range(grid.batches):
        glow = np.zeros(1)
        sums = [dr.zeros(UInt64, city.distances) for _ in PATTERNS]

        def tally(at: Scattering, glow: Floats = glow, sums: list[Any] = sums) -> None:
            straight = at.weight * dr.exp(-at.depth / dr.maximum(-at.went[2], 1e-6)) / math.pi
            seen = dr.select((at.went[2] < 0) & (at.bounces == 0), straight, 0)
            glow += int(dr.sum(UInt64(seen * FIXED_POINT))[0])
            sine = dr.exp(-PER_LOG * at.random.next_float32())
            turn, along = 2 * math.pi * at.random.next_float32(), dr.sqrt(1 - sine * sine)
            for direction in (at.went, (along * dr.cos(turn), along * dr.sin(turn), -sine)):
                weight, x, y, sine_down = landed(air, at, direction)
                ring = UInt32(dr.log(1 + dr.sqrt(x * x + y * y) / city.core_km) * per_log)
                counts = (weight > 0) & (ring < city.distances) & (at.bounces == 1)
                angle = dr.acos(dr.minimum(sine_down, 1))
                for total, radiance in zip(sums, glowing_ground(angle, sine_down), strict=True):
                    dr.scatter_add(total, UInt64(weight * radiance * FIXED_POINT), ring, counts)

        walk(air, view_altitude_deg, grid.paths, seed + batch, tally, most_bounces=1)
        lamps = np.array([np.array(total, dtype=np.float64) for total in sums]) / area
        batches.append(np.concatenate([glow, lamps.ravel()]))
    return mean_and_error(np.array(batches) / (FIXED_POINT * grid.paths))


def mean_and_error(batches: Floats) -> tuple[Floats, Floats]:
    """Mean over the first axis, and its relative standard error (infinite if the mean is 0)."""
    mean = batches.mean(axis=0)
    error = batches.std(axis=0, ddof=1) / np.sqrt(len(batches))
    return mean, np.where(mean > 0, error / np.where(mean > 0, mean, 1), np.inf)


def moon_piece(air: Air, grid: MoonGrid, view_altitude_deg: float, seed: int) -> tuple[Floats, Floats]:
    """Moonlight scattered more than once, or by the ground, seen at one altitude, per irradiance above the air, sr^-1.

    Returns
    -------
    mean, relative_error : (moon altitudes, azimuths) arrays
    """
    altitudes, azimuths = np.radians(grid.moon_altitude_deg), np.radians(grid.relative_azimuth_deg)
    slopes = [dr.opaque(Float, math.sin(a)) for a in altitudes]
    along = [dr.opaque(Float, math.cos(a)) for a in altitudes]
    towards = [(dr.opaque(Float, math.sin(a)), dr.opaque(Float, math.cos(a))) for a in azimuths]
    batches = []
    for batch in range(grid.batches):
        light = np.zeros((len(altitudes), len(azimuths)))

        def tally(at: Scattering, light: Floats = light) -> None:
            x, y, z = at.came
            sine = dr.maximum(-at.went[2], 1e-6)
            reflected = at.weight * dr.exp(-at.depth / sine) * (air.air.ground_albedo / math.pi)
            reflected = dr.select(at.went[2] < 0, reflected, 0)
            values = []
            for slope, flat in zip(slopes, along, strict=True):
                from_ground = reflected * slope * dr.exp(-air.whole / slope)
                arrives = at.weight * dr.exp(-(air.whole - at.depth) / slope)
                for east, north in towards:
                    radiance = from_ground
                    if at.order > 1:
                        phase = air.phase(flat * (x * east + y * north) + slope * z, at.by_aerosol)
                        radiance = dr.fma(arrives, phase, from_ground)
                    values.append(UInt64(radiance * FIXED_POINT))
            dr.eval(values)
            light += np.array([int(dr.sum(value)[0]) for value in values], dtype=np.float64).reshape(light.shape)

        walk(air, view_altitude_deg, grid.paths, seed + batch, tally)
        batches.append(light / (FIXED_POINT * grid.paths))
    return mean_and_error(np.array(batches))
