"""Random walks from the observer through two exponential layers of air over a Lambert ground, with Dr.Jit.

The walk goes backwards, from the observer to the light. It is exact in the air's height (free paths are inverted, not
tracked), and one walk serves all places of the lamps and of the Moon: the air is horizontally uniform, so the point where
a path meets the ground is a lamp's place, and the path's direction there a direction of emission. No estimate contains
the inverse square of a distance, so the variance is finite, unlike that of Mitsuba's ``volpath`` for a small disk of
lamps. Lengths are in kilometres. The first scattering is drawn in proportion to the transmitted light.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np
from drjit.llvm import PCG32, Float, UInt32, UInt64
from numpy.typing import NDArray

from generator.light.atmosphere import aerosol_optical_depth, rayleigh_optical_depth
from generator.light.bake_grids import BakedAir
from generator.light.single_scattering import aerosol_phase

Floats = NDArray[np.float64]
Vector = tuple[Any, Any, Any]

MAX_ORDER = 30
SURVIVAL = 0.08
"""Paths that carry less than this fraction of the mean first weight are thinned out (Russian roulette)."""
TABLE = 4096
LEAST_SLOPE = 1e-5


class Air:
    """The air of one wavelength and aerosol depth, as the walk needs it."""

    def __init__(self, air: BakedAir, wavelength_nm: float, aerosol_tau_550: float) -> None:
        self.air = air
        self.depth_r = float(rayleigh_optical_depth(wavelength_nm, air.pressure_hpa))
        self.depth_a = float(aerosol_optical_depth(wavelength_nm, aerosol_tau_550, air.angstrom_exponent))
        self.total = self.depth_r + self.depth_a
        self.ratio = air.rayleigh_height_km / air.aerosol_height_km
        # y = exp(-h / Rayleigh's height) as a function of the optical depth below: smooth and monotonic from 1 to 0.
        y = np.linspace(1, 0, 200_001)
        depth = self.depth_r * (1 - y) + self.depth_a * (1 - y**self.ratio)
        self.table = Float(np.interp(np.linspace(0, self.total, TABLE + 1), depth, y).astype(np.float32))
        cosine, cumulative = phase_table()
        self.cosines = Float(np.interp(np.linspace(0, 1, TABLE + 1), cumulative, cosine).astype(np.float32))
        angle = np.radians(np.linspace(0, 180, TABLE + 1))
        self.aerosol = Float(aerosol_phase(np.cos(angle)).astype(np.float32))
        self.r, self.a, self.whole = (dr.opaque(Float, part) for part in (self.depth_r, self.depth_a, self.total))

    def height(self, depth: Any) -> Any:
        """Height below which there is a given optical depth, km."""
        y = lookup(self.table, depth / self.whole)
        return -self.air.rayleigh_height_km * dr.log(dr.maximum(y, 1e-6))

    def phase(self, cosine: Any, by_aerosol: Any) -> Any:
        """Phase function of the mixture of air and aerosol, sr^-1."""
        molecules = 3 / (16 * math.pi) * (1 + cosine * cosine)
        aerosol = lookup(self.aerosol, dr.acos(dr.clip(cosine, -1, 1)) / math.pi)
        return dr.fma(by_aerosol, aerosol - molecules, molecules)

    def scattering(self, height: Any) -> tuple[Any, Any]:
        """Single-scattering albedo, and the aerosol's fraction of the scattered light."""
        molecules = self.r / self.air.rayleigh_height_km * dr.exp(-height / self.air.rayleigh_height_km)
        aerosol = self.a / self.air.aerosol_height_km * dr.exp(-height / self.air.aerosol_height_km)
        scattered = molecules + self.air.aerosol_albedo * aerosol
        return scattered / (molecules + aerosol), self.air.aerosol_albedo * aerosol / scattered


def phase_table() -> tuple[Floats, Floats]:
    """Cosines of the aerosol's scattering angle, from -1 to 1, and the phase function's cumulative distribution there."""
    angle = np.radians(np.concatenate([np.linspace(180, 1, 40_000), np.linspace(1, 0, 10_001)[1:]]))
    cosine = np.cos(angle)
    density = 2 * np.pi * aerosol_phase(cosine)
    cumulative = np.concatenate([[0], np.cumsum((density[1:] + density[:-1]) / 2 * np.diff(cosine))])
    return cosine, cumulative / cumulative[-1]


def lookup(table: Any, x: Any) -> Any:
    """Linear interpolation of a table over 0..1."""
    place = dr.clip(x, 0, 1) * TABLE
    index = dr.minimum(UInt32(place), TABLE - 1)
    low = dr.gather(Float, table, index)
    return dr.fma(dr.gather(Float, table, index + 1) - low, place - Float(index), low)


def turned(direction: Vector, cosine: Any, turn: Any) -> Vector:
    """A direction at an angle to another (Duff et al. 2017, J. Comput. Graph. Tech. 6, 1)."""
    x, y, z = direction
    sign = dr.select(z >= 0, Float(1), Float(-1))
    a = -1 / (sign + z)
    b = x * y * a
    sine = dr.sqrt(dr.maximum(1 - cosine * cosine, 0))
    p, q = sine * dr.cos(turn), sine * dr.sin(turn)
    out = (
        p * (1 + sign * x * x * a) + q * b + cosine * x,
        p * sign * b + q * (sign + y * y * a) + cosine * y,
        -p * sign * x - q * y + cosine * z,
    )
    norm = dr.rsqrt(out[0] * out[0] + out[1] * out[1] + out[2] * out[2])
    return out[0] * norm, out[1] * norm, out[2] * norm


def rayleigh_cosine(xi: Any) -> Any:
    """Cosine of the scattering angle by Rayleigh's phase function (Frisvad 2011, J. Opt. Soc. Am. A 28, 2436)."""
    u = 4 * xi - 2
    root = dr.cbrt(u + dr.sqrt(u * u + 1))
    return dr.clip(root - 1 / root, -1, 1)


@dataclass(frozen=True)
class Scattering:
    """One scattering of every path that is still followed.

    Attributes
    ----------
    order : int
        Order of the scattering: 1 for the one next to the observer.
    weight : Float
        Weight of light that returns along the path.
    x, y, height : Float
        Place, km.
    depth : Float
        Vertical optical depth below it.
    came, went : three Floats
        Directions away from the observer, before and after.
    by_aerosol : Float
        The aerosol's fraction of the scattered light.
    random : PCG32
    bounces : Float
        Number of reflections of the path by the ground.
    """

    order: int
    weight: Any
    x: Any
    y: Any
    height: Any
    depth: Any
    came: Vector
    went: Vector
    by_aerosol: Any
    random: Any
    bounces: Any


Tally = Callable[[Scattering], None]


def random_numbers(count: int, seed: int, order: int) -> Any:
    """Independent generators for `count` paths."""
    state = np.random.SeedSequence([seed, order]).generate_state(2, np.uint64)
    return PCG32(count, *(dr.opaque(UInt64, int(word)) for word in state))


def walk(
    air: Air, view_altitude_deg: float, count: int, seed: int, tally: Tally, most_bounces: int = MAX_ORDER
) -> None:
    """Follow `count` paths seen at one altitude, towards azimuth 0 (the y axis), and call `tally` at each scattering.

    Paths that the ground has reflected more than `most_bounces` times end.
    """
    slope0 = math.sin(math.radians(view_altitude_deg))
    along0 = math.cos(math.radians(view_altitude_deg))
    rng = random_numbers(count, seed, 0)
    scattered = dr.opaque(Float, -math.expm1(-air.total / slope0))
    xi = (Float(dr.arange(UInt32, count)) + rng.next_float32()) / dr.opaque(Float, count)
    depth = -dr.log(1 - xi * scattered) * dr.opaque(Float, slope0)
    height = air.height(depth)
    albedo, _ = air.scattering(height)
    weight = albedo * scattered
    bounces = dr.zeros(Float, count)
    x, y = dr.zeros(Float, count), height * dr.opaque(Float, along0 / slope0)
    direction: Vector = (dr.zeros(Float, count), dr.opaque(Float, along0, count), dr.opaque(Float, slope0, count))
    threshold = SURVIVAL * scattered
    for order in range(1, MAX_ORDER):
        _, by_aerosol = air.scattering(height)
        xi = rng.next_float32()
        cosine = dr.select(rng.next_float32() < by_aerosol, lookup(air.cosines, xi), rayleigh_cosine(xi))
        ux, uy, uz = turned(direction, cosine, 2 * math.pi * rng.next_float32())
        uz = dr.select(uz >= 0, dr.maximum(uz, LEAST_SLOPE), dr.minimum(uz, -LEAST_SLOPE))
        tally(Scattering(order, weight, x, y, height, depth, direction, (ux, uy, uz), by_aerosol, rng, bounces))
        lands = (uz < 0) & (rng.next_float32() < dr.exp(-depth / dr.abs(uz)))
        x = dr.select(lands, x - ux * height / uz, x)
        y = dr.select(lands, y - uy * height / uz, y)
        rise = dr.maximum(dr.sqrt(rng.next_float32()), LEAST_SLOPE)
        turn, across = 2 * math.pi * rng.next_float32(), dr.sqrt(1 - rise * rise)
        ux = dr.select(lands, across * dr.cos(turn), ux)
        uy = dr.select(lands, across * dr.sin(turn), uy)
        uz = dr.select(lands, rise, uz)
        weight = dr.select(lands, weight * air.air.ground_albedo, weight)
        bounces = dr.select(lands, bounces + 1, bounces)
        depth, height = dr.select(lands, 0, depth), dr.select(lands, 0, height)
        # The next scattering is forced to occur: before the top of the air, or before the ground.
        ahead = dr.select(uz < 0, depth, air.whole - depth) / dr.abs(uz)
        reached = 1 - dr.exp(-ahead)
        weight = dr.select(uz < 0, weight, weight * reached)
        step = -dr.log(1 - rng.next_float32() * reached)
        new_depth = dr.clip(dr.fma(step, uz, depth), 0, air.whole)
        new_height = air.height(new_depth)
        length = (new_height - height) / uz
        x, y, depth, height = dr.fma(ux, length, x), dr.fma(uy, length, y), new_depth, new_height
        weight = weight * air.scattering(height)[0]
        keep = (rng.next_float32() * threshold < weight) & (bounces <= most_bounces)
        weight = dr.maximum(weight, threshold)
        dr.eval(x, y, depth, height, weight, ux, uy, uz, bounces, keep)
        alive: Any = dr.compress(keep)
        if len(alive) == 0:
            return
        state = (dr.gather(Float, part, alive) for part in (x, y, depth, height, weight, ux, uy, uz, bounces))
        x, y, depth, height, weight, ux, uy, uz, bounces = state
        direction = (ux, uy, uz)
        rng = random_numbers(len(alive), seed, order)
