"""Random walks of sunlight in the twilight, from the observer through spherical shells of air, with Dr.Jit.

A walk serves all places of the Sun: the air is the same at all places of one height, so the sunlight at a place depends
only on its height and the Sun's zenith distance there (:mod:`generator.twilight.solar_beam`). At each scattering of a
path, and separately for each place of the Sun, a direction and a place along it are drawn at which sunlight is scattered
into the path. Most directions are towards the horizon below which the Sun is, from where the light of twilight comes; the
others follow the phase function. They are combined by the balance heuristic (Veach & Guibas 1995, SIGGRAPH 95, 419).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np
from drjit.llvm import Float, UInt32, UInt64
from numpy.typing import NDArray

from generator.bake.shell_air import Ray, ShellAir, moved
from generator.bake.tallies import mean_and_error
from generator.bake.twilight_setting import (
    JUDGED_AEROSOL,
    JUDGED_AZIMUTHS_DEG,
    JUDGED_DEPRESSIONS_DEG,
    JUDGED_RAYLEIGH,
    JUDGED_VIEWS_DEG,
)  # fmt: skip
from generator.bake.walk import Vector, lookup, random_numbers, rayleigh_cosine, turned
from generator.light.bake_grids import BakedAir, TwilightGrid
from generator.twilight.air_profiles import EARTH_RADIUS_KM, TOP_KM

Floats = NDArray[np.float64]

MAX_ORDER = 16
SURVIVAL = 0.05
TOWARDS_SUN, SPREAD = 0.8, 0.5
"""Fraction of the directions that are drawn towards the Sun, and their concentration in azimuth (1: uniform)."""
WALK_LOW_SINE, WALK_HIGH_SINE = -0.1, 0.5
"""Half of the directions of the walks themselves are uniformly distributed between these sines."""
SAMPLED_HEIGHT_KM = 15.0
"""Places on upward lines are drawn with heights that are exponential with this scale, or uniformly along the line; half of
the corners of paths are drawn in proportion to the transmitted light. This reaches the high air, which the Sun still
lights."""
FIXED_POINT = 2.0**34
FALL_PER_DEG = 1.0
"""Sums are multiplied by exp(this x depression), which roughly compensates the decrease of the light, before they become
integers."""


@dataclass(frozen=True)
class Corner:
    """Scatterings of paths, or their reflections by the ground.

    Attributes
    ----------
    weight : Float
        Weight of the light that leaves it along the path.
    height : Float
    upright, came : three Floats
        Direction from the Earth's centre, and direction of the path before, away from the observer.
    by_aerosol : Float
        The aerosol's fraction of the scattered light; -1 on the ground.
    ozone, grounded : Float
        Ozone between the place and the observer; and 1 if the path has met the ground.
    """

    weight: Any
    height: Any
    upright: Vector
    came: Vector
    by_aerosol: Any
    ozone: Any
    grounded: Any


def dot(a: Vector, b: Vector) -> Any:
    """Scalar product."""
    return dr.fma(a[0], b[0], dr.fma(a[1], b[1], a[2] * b[2]))


def chosen(which: Any, a: Vector, b: Vector) -> Vector:
    """Select the first vector where a condition holds, and the second elsewhere."""
    return dr.select(which, a[0], b[0]), dr.select(which, a[1], b[1]), dr.select(which, a[2], b[2])


def advanced(height: Any, upright: Vector, direction: Vector, distance: Any) -> tuple[Any, Vector]:
    """Height, and direction from the Earth's centre, after a distance."""
    new, _ = moved(height, dot(upright, direction), distance)
    radius = EARTH_RADIUS_KM + height
    x, y, z = (dr.fma(radius, up, distance * ahead) for up, ahead in zip(upright, direction, strict=True))
    norm = dr.rsqrt(dr.fma(x, x, dr.fma(y, y, z * z)))
    return new, (x * norm, y * norm, z * norm)


def lowest_sine(height: Any) -> Any:
    """Sine of the angle of the lowest directions that are drawn towards the Sun's horizon: a little below the ground's."""
    return -0.02 - 1.05 * dr.sqrt(2 / EARTH_RADIUS_KM * height)


def towards_horizon(upright: Vector, sun: Vector, lowest: Any, rng: Any) -> Vector:
    """A direction from the lowest to the vertical, mostly low, and near the Sun's azimuth."""
    sunward = _flat(sun, upright)
    side = _cross(upright, sunward)
    u = rng.next_float32()
    rise = dr.fma(1 - lowest, u * u * u, lowest)
    across = dr.sqrt(dr.maximum(1 - rise * rise, 0))
    turn = 2 * dr.atan(SPREAD * dr.tan((math.pi * 0.9999) * (rng.next_float32() - 0.5)))
    a, b = across * dr.cos(turn), across * dr.sin(turn)
    x, y, z = (
        dr.fma(rise, up, dr.fma(a, on, b * beside)) for up, on, beside in zip(upright, sunward, side, strict=True)
    )
    return x, y, z


def horizon_density(upright: Vector, sun: Vector, lowest: Any, direction: Vector) -> Any:
    """Density of the directions of :func:`towards_horizon`, sr^-1."""
    rise = dot(upright, direction)
    # The cube of a uniform number determines the sine.
    by_rise = 1 / (3 * dr.square(dr.cbrt(dr.maximum(rise - lowest, 1e-9))) * dr.cbrt(1 - lowest))
    cosine = dot(_flat(direction, upright), _flat(sun, upright))
    # Square of the tangent of half the azimuth from the Sun.
    tangent2 = (1 - cosine) / dr.maximum(1 + cosine, 1e-6)
    by_turn = SPREAD * (1 + tangent2) / (2 * math.pi * (SPREAD * SPREAD + tangent2))
    return dr.select(rise > lowest, by_rise * by_turn, 0)


def _flat(direction: Vector, upright: Vector) -> Vector:
    """Unit vector of the horizontal part of a direction."""
    rise = dot(direction, upright)
    x, y, z = (dr.fma(-rise, up, ahead) for ahead, up in zip(direction, upright, strict=True))
    norm = dr.rsqrt(dr.maximum(dr.fma(x, x, dr.fma(y, y, z * z)), 1e-12))
    return x * norm, y * norm, z * norm


def _cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def by_phase(air: ShellAir, at: Corner, rng: Any) -> Vector:
    """Draw a direction from the phase function, or up from the ground from Lambert's law."""
    xi, turn = rng.next_float32(), 2 * math.pi * rng.next_float32()
    cosine = dr.select(rng.next_float32() < at.by_aerosol, lookup(air.cosines, xi), rayleigh_cosine(xi))
    up = dr.sqrt(dr.maximum(xi, 1e-6))
    ground = at.by_aerosol < 0
    return turned(chosen(ground, at.upright, at.came), dr.select(ground, up, cosine), turn)


def phase_at(air: ShellAir, at: Corner, went: Vector) -> Any:
    """Phase function from the path's direction to another, or Lambert's law on the ground, sr^-1."""
    scattered = air.phase(dr.clip(dot(at.came, went), -1, 1), dr.maximum(at.by_aerosol, 0))
    return dr.select(at.by_aerosol < 0, dr.maximum(dot(at.upright, went), 0) / math.pi, scattered)


def place_along(ray: Ray, xi: Any, even: Any) -> Any:
    """Draw a distance along a ray: by exponential heights on upward rays, or uniformly."""
    climb = -SAMPLED_HEIGHT_KM * dr.log(1 - xi * _within_range(ray))
    radius = EARTH_RADIUS_KM + ray.height
    along, ahead = radius * ray.slope, climb * (2 * radius + climb)
    by_height = ahead / dr.maximum(dr.sqrt(dr.maximum(dr.fma(along, along, ahead), 0)) + along, 1e-6)
    return dr.clip(dr.select((ray.slope > 0) & ~even, by_height, ray.length * xi), 1e-4, ray.length)


def place_density(ray: Ray, distance: Any) -> Any:
    """Density of the distances of :func:`place_along` if half of them are uniform, km^-1."""
    height, slope = moved(ray.height, ray.slope, distance)
    fall = dr.exp(-(height - ray.height) / SAMPLED_HEIGHT_KM)
    by_height = fall / (SAMPLED_HEIGHT_KM * _within_range(ray)) * slope
    return dr.select(ray.slope > 0, 0.5 * by_height + 0.5 / ray.length, 1 / ray.length)


def _within_range(ray: Ray) -> Any:
    """Fraction of the exponential heights below the top of the air."""
    return 1 - dr.exp(-dr.maximum(TOP_KM - ray.height, 0.01) / SAMPLED_HEIGHT_KM)


class SunTally:
    """Sums over paths for all places of the Sun: light at three ozone depths, and its part from the ground."""

    def __init__(self, air: ShellAir, grid: TwilightGrid) -> None:
        self.air, self.grid = air, grid
        depression, azimuth = np.meshgrid(grid.depression_deg, grid.relative_azimuth_deg, indexing="ij")
        down, turn = np.radians(depression.ravel()), np.radians(azimuth.ravel())
        sun = np.stack([np.cos(down) * np.sin(turn), np.cos(down) * np.cos(turn), -np.sin(down)])
        self.suns = sun.shape[1]
        self.sun = [Float(axis.astype(np.float32)) for axis in sun]
        self.scale = FIXED_POINT * np.exp(FALL_PER_DEG * depression.ravel())
        self.scales = Float(self.scale.astype(np.float32))
        self.sums = np.zeros((len(grid.ozone_tau) + 1, self.suns))

    def add(self, at: Corner, seed: int, order: int) -> None:
        """Add sunlight that is scattered once and then at given corners, or that falls on those on the ground."""
        parts = (at.weight, at.height, *at.upright, *at.came, at.by_aerosol, at.ozone, at.grounded)
        dr.eval(*parts)
        count = dr.width(at.weight)
        lane = dr.arange(UInt32, count * self.suns)
        which = lane // dr.opaque(UInt32, count)
        path = lane - which * dr.opaque(UInt32, count)
        weight, height, ux, uy, uz, cx, cy, cz, haze, ozone, grounded = (dr.gather(Float, p, path) for p in parts)
        x, y, z, scale = (dr.gather(Float, p, which) for p in (*self.sun, self.scales))
        at = Corner(weight, height, (ux, uy, uz), (cx, cy, cz), haze, ozone, grounded)
        scattered, crossed = self._scattered(at, (x, y, z), random_numbers(count * self.suns, seed, MAX_ORDER + order))
        straight, straight_ozone = self._on_ground(at, (x, y, z))
        values = [
            UInt64(scale * (scattered * dr.exp(-tau * crossed) + straight * dr.exp(-tau * straight_ozone)))
            for tau in self.grid.ozone_tau
        ]
        values.append(UInt64(Float(values[1]) * at.grounded))
        sums = [dr.block_sum(value, count) for value in values]
        dr.eval(*sums)
        self.sums += np.array([np.array(each, dtype=np.float64) for each in sums])

    def _scattered(self, at: Corner, sun: Vector, rng: Any) -> tuple[Any, Any]:
        """Sunlight scattered once into the corners, and the total ozone that it crosses."""
        air = self.air
        sunward = rng.next_float32() < TOWARDS_SUN
        lowest = lowest_sine(at.height)
        went = chosen(sunward, towards_horizon(at.upright, sun, lowest, rng), by_phase(air, at, rng))
        phase = phase_at(air, at, went)
        ratio = phase / (TOWARDS_SUN * horizon_density(at.upright, sun, lowest, went) + (1 - TOWARDS_SUN) * phase)
        ray = air.ray(at.height, dr.clip(dot(at.upright, went), -1, 1))
        distance = place_along(ray, rng.next_float32(), rng.next_float32() < 0.5)
        density = place_density(ray, distance)
        depth, crossed = air.crossed(ray, distance)
        place, outwards = advanced(at.height, at.upright, went, distance)
        extinction, albedo, by_aerosol = air.scattering(place)
        light, sun_ozone = air.sunlight(place, dot(outwards, sun))
        source = extinction * albedo * air.phase(dr.clip(dot(went, sun), -1, 1), by_aerosol) * light
        value = at.weight * ratio * source * dr.exp(-depth) / density
        return dr.select(dr.isfinite(value), value, 0), at.ozone + crossed + sun_ozone

    def _on_ground(self, at: Corner, sun: Vector) -> tuple[Any, Any]:
        """Sunlight that falls on the corners on the ground, and the total ozone that it crosses."""
        up = dot(at.upright, sun)
        light, sun_ozone = self.air.sunlight(at.height, up)
        lit = (at.by_aerosol < 0) & (up > 0)
        return dr.select(lit, at.weight * light * up / math.pi, 0), at.ozone + sun_ozone

    def means(self, paths: int) -> Floats:
        """Mean over the paths, (4, depressions, azimuths) array."""
        shape = (-1, len(self.grid.depression_deg), len(self.grid.relative_azimuth_deg))
        return (self.sums / self.scale / paths).reshape(shape)


def onward(air: ShellAir, at: Corner, rng: Any) -> tuple[Vector, Any]:
    """The direction in which the walk continues, and the phase function divided by its density."""
    rise = dr.fma(rng.next_float32(), WALK_HIGH_SINE - WALK_LOW_SINE, WALK_LOW_SINE)
    low = turned(at.upright, rise, 2 * math.pi * rng.next_float32())
    drawn = by_phase(air, at, rng)
    went = chosen((rng.next_float32() < 0.5) | (at.by_aerosol < 0), drawn, low)
    phase, rise = phase_at(air, at, went), dot(at.upright, went)
    even = 1 / (2 * math.pi * (WALK_HIGH_SINE - WALK_LOW_SINE))
    other = dr.select((rise > WALK_LOW_SINE) & (rise < WALK_HIGH_SINE), even, 0)
    return went, dr.select(at.by_aerosol < 0, 1, 2 * phase / (phase + other))


def walk_twilight(
    air: ShellAir, view_altitude_deg: float, count: int, seed: int, tally: SunTally, corners: int = MAX_ORDER
) -> None:
    """Follow `count` paths of up to `corners` corners, seen at one altitude from the air's floor towards azimuth 0 (y)."""
    altitude = math.radians(view_altitude_deg)
    rng = random_numbers(count, seed, 0)
    zeros = dr.zeros(Float, count)
    height = dr.opaque(Float, air.floor_km, count)
    upright: Vector = (zeros, zeros, dr.opaque(Float, 1.0, count))
    looking: Vector = (
        zeros, dr.opaque(Float, math.cos(altitude), count), dr.opaque(Float, math.sin(altitude), count),
    )  # fmt: skip
    weight, ozone, grounded = dr.full(Float, 1.0, count), zeros, zeros
    threshold = 0.0
    for order in range(1, corners + 1):
        ray = air.ray(height, dr.clip(dot(upright, looking), -1, 1))
        xi = rng.next_float32()
        passed = 1 - dr.exp(-ray.depth)
        lands = ray.lands & (rng.next_float32() >= passed)
        by_depth = air.reach(ray, -dr.log(1 - dr.minimum(xi, 0.999999) * passed))
        anywhere = place_along(ray, rng.next_float32(), rng.next_float32() < 0.5)
        inside = dr.select(rng.next_float32() < 0.5, by_depth, anywhere)
        density = place_density(ray, inside)
        distance = dr.select(lands, ray.length, inside)
        depth, crossed = air.crossed(ray, distance)
        ozone = ozone + crossed
        height, upright = advanced(height, upright, looking, distance)
        height = dr.select(lands, 0, height)
        extinction, albedo, by_aerosol = air.scattering(height)
        arrives = extinction * dr.exp(-depth)
        drawn = 0.5 * arrives / passed + 0.5 * density
        kept = dr.select(lands, air.air.ground_albedo, albedo * arrives / drawn / dr.select(ray.lands, passed, 1))
        grounded = dr.select(lands, 1, grounded)
        at = Corner(weight * kept, height, upright, looking, dr.select(lands, -1, by_aerosol), ozone, grounded)
        tally.add(at, seed, order)
        looking, ratio = onward(air, at, rng)
        weight = at.weight * ratio
        if order == 1:
            threshold = SURVIVAL * float(dr.mean(weight)[0])
        keep = rng.next_float32() * threshold < weight
        weight = dr.maximum(weight, threshold)
        state = (height, *upright, *looking, weight, ozone, grounded)
        dr.eval(*state, keep)
        alive: Any = dr.compress(keep)
        if len(alive) == 0:
            return
        height, ux, uy, uz, lx, ly, lz, weight, ozone, grounded = (dr.gather(Float, part, alive) for part in state)
        upright, looking = (ux, uy, uz), (lx, ly, lz)
        rng = random_numbers(len(alive), seed, order)


def twilight_piece(air: ShellAir, grid: TwilightGrid, view_altitude_deg: float, seed: int) -> tuple[Floats, Floats]:
    """Light scattered more than once, or by the ground, per irradiance above the air, sr^-1, seen at one altitude.

    Returns
    -------
    mean, relative_error : (4, depressions, azimuths) arrays
        Light at the three ozone depths, and at the second the part that the ground has reflected.
    """
    batches = []
    for batch in range(grid.batches):
        tally = SunTally(air, grid)
        walk_twilight(air, view_altitude_deg, grid.paths, seed + batch, tally)
        batches.append(tally.means(grid.paths))
    return mean_and_error(np.array(batches))


def scattered_twice(paths: int = 65_536) -> tuple[Floats, Floats]:
    """Light scattered twice, without refraction, ozone and ground, for comparison with quadrature.

    Returns
    -------
    mean, relative_error : (views, depressions, azimuths) arrays
        Values at the JUDGED directions and places of the Sun.
    """
    air = ShellAir(BakedAir(ground_albedo=0.0), JUDGED_RAYLEIGH, JUDGED_AEROSOL, 0.0, refractivity=0.0)
    grid = TwilightGrid(depression_deg=JUDGED_DEPRESSIONS_DEG, relative_azimuth_deg=JUDGED_AZIMUTHS_DEG)
    means, errors = [], []
    for view, altitude in enumerate(JUDGED_VIEWS_DEG):
        batches = []
        for batch in range(16):
            tally = SunTally(air, grid)
            walk_twilight(air, altitude, paths // 16, 100 * view + batch, tally, corners=1)
            batches.append(tally.means(paths // 16)[0])
        mean, error = mean_and_error(np.array(batches))
        means.append(mean)
        errors.append(error)
    return np.array(means), np.array(errors)
