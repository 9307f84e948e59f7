"""The air of one wavelength in spherical shells, as random walks in the twilight need it, with Dr.Jit.

Lengths are kilometres. A place is described by its height, its direction from the Earth's centre and a direction there;
heights are updated from differences of squares, which are accurate to a metre in single precision.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np
from drjit.llvm import Float, UInt32
from numpy.typing import NDArray

from generator.bake.walk import TABLE, lookup, phase_table
from generator.light.bake_grids import BakedAir
from generator.light.single_scattering import aerosol_phase
from generator.twilight.air_profiles import EARTH_RADIUS_KM, HEIGHTS_KM, STEP_KM, TOP_KM, column_densities
from generator.twilight.solar_beam import (
    LEAST_DEG,
    OPAQUE,
    SEA_LEVEL_REFRACTIVITY,
    STEP_DEG,
    ZENITH_DISTANCES_DEG,
    solar_beam,
)  # fmt: skip

Floats = NDArray[np.float64]
SLOPES = 256
"""Number of steps of the tables of columns, even in the root of the cosine of the angle from the vertical."""
LEAST_LOG = -60.0
BISECTIONS = 18
GAUSS_POINTS = 6


@functools.lru_cache(maxsize=2)
def slant_columns(floor_km: float) -> Floats:
    """Columns of the parts of the air upwards along straight lines, (4, h, SLOPES + 1) array."""
    density = column_densities(floor_km)
    node, weight = np.polynomial.legendre.leggauss(GAUSS_POINTS)
    cosine = np.linspace(0, 1, SLOPES + 1) ** 2
    result = np.zeros((len(density), len(HEIGHTS_KM), SLOPES + 1))
    logs = np.log(density)
    for k, start in enumerate(HEIGHTS_KM[:-1]):
        root = np.sqrt(HEIGHTS_KM[k:] - start)
        y = ((root[1:] + root[:-1]) / 2)[:, None] + (np.diff(root) / 2)[:, None] * node
        height = start + y**2
        place = height / STEP_KM
        cell = np.minimum(place.astype(np.intp), len(HEIGHTS_KM) - 2)
        at = np.exp(logs[:, cell] + (place - cell) * (logs[:, cell + 1] - logs[:, cell]))
        radius, here = EARTH_RADIUS_KM + height, EARTH_RADIUS_KM + start
        per_root = 2 * y * radius * (np.diff(root) / 2)[:, None] * weight
        slope = np.sqrt(y[..., None] ** 2 * (radius + here)[..., None] + (here * cosine) ** 2)
        result[:, k] = np.einsum("khn,hnm->km", at * per_root, 1 / slope)
    return result


@dataclass(frozen=True)
class Ray:
    """A straight line through the air, up to its end at the top or on the ground.

    Attributes
    ----------
    height, slope : Float
        Height at which it starts, and the cosine of its angle from the vertical there.
    length : Float
    lands : Bool
    depth : Float
        Optical depth of the whole line, without ozone.
    start, turning : two pairs of Float
        Columns from the start upwards by the angle's modulus, and twice those from its lowest place: optical depth, ozone.
    """

    height: Any
    slope: Any
    length: Any
    lands: Any
    depth: Any
    start: tuple[Any, Any]
    turning: tuple[Any, Any]


class ShellAir:
    """Air of given optical depths; see :class:`generator.twilight.twilight_single.TwilightDepths`."""

    def __init__(
        self,
        air: BakedAir,
        rayleigh: float,
        aerosol: float,
        floor_km: float,
        refractivity: float = SEA_LEVEL_REFRACTIVITY,
        stratosphere: float = 0.0,
    ) -> None:
        self.air, self.floor_km = air, floor_km
        density = column_densities(floor_km)
        of_air, of_aerosol, of_ozone, of_layer = slant_columns(floor_km)
        extinction = rayleigh * of_air + aerosol * of_aerosol + stratosphere * of_layer
        beam = solar_beam(floor_km, refractivity)
        light = np.where(
            beam.columns[..., 0] < OPAQUE / 2,
            beam.log_focus - beam.columns[..., [0, 1, 3]] @ np.array([rayleigh, aerosol, stratosphere]),
            LEAST_LOG,
        )
        ozone = np.minimum(beam.columns[..., 2], 200.0)
        self.column, self.ozone_column = (_table(_log(part)) for part in (extinction, of_ozone))
        self.light, self.sun_ozone = _table(np.maximum(light, LEAST_LOG)), _table(ozone)
        self.air_density = _table(_log(rayleigh * density[0]))
        self.aerosol_density = _table(_log(aerosol * density[1]))
        self.layer_density = _table(_log(stratosphere * density[3]))
        cosine, cumulative = phase_table()
        self.cosines = Float(np.interp(np.linspace(0, 1, TABLE + 1), cumulative, cosine).astype(np.float32))
        angle = np.radians(np.linspace(0, 180, TABLE + 1))
        self.aerosol = Float(aerosol_phase(np.cos(angle)).astype(np.float32))

    def phase(self, cosine: Any, by_aerosol: Any) -> Any:
        """Phase function of the mixture of air and aerosol, sr^-1."""
        molecules = 3 / (16 * math.pi) * (1 + cosine * cosine)
        aerosol = lookup(self.aerosol, dr.acos(dr.clip(cosine, -1, 1)) / math.pi)
        return dr.fma(by_aerosol, aerosol - molecules, molecules)

    def scattering(self, height: Any) -> tuple[Any, Any, Any]:
        """Extinction without ozone, km^-1, its scattered fraction, and the aerosol's fraction of that."""
        place = dr.clip(height / STEP_KM, 0, len(HEIGHTS_KM) - 1.001)
        cell = UInt32(place)
        shift = place - Float(cell)
        densities = (self.air_density, self.aerosol_density, self.layer_density)
        molecules, haze, layer = (_exponential(logs, cell, shift) for logs in densities)
        extinction, by_aerosol = molecules + haze + layer, dr.fma(self.air.aerosol_albedo, haze, layer)
        scattered = molecules + by_aerosol
        return extinction, scattered / extinction, by_aerosol / scattered

    def columns(self, height: Any, slope: Any) -> tuple[Any, Any]:
        """Optical depth and ozone upwards from heights, at cosines of the angle from the vertical of 0 or more."""
        cells = _cells(height / STEP_KM, dr.sqrt(dr.maximum(slope, 0)) * SLOPES, len(HEIGHTS_KM), SLOPES + 1)
        return dr.exp(_bilinear(self.column, cells)), dr.exp(_bilinear(self.ozone_column, cells))

    def sunlight(self, height: Any, cosine: Any) -> tuple[Any, Any]:
        """Sunlight relative to that above the air, and the ozone crossed, for the cosine of the Sun's zenith distance."""
        degrees = dr.acos(dr.clip(cosine, -1, 1)) * (180 / math.pi)
        column = (degrees - LEAST_DEG) / STEP_DEG
        columns = len(ZENITH_DISTANCES_DEG)
        cells = _cells(height / STEP_KM, column, len(HEIGHTS_KM), columns)
        light = dr.exp(_bilinear(self.light, cells))
        return dr.select(column < columns - 1, light, 0), _bilinear(self.sun_ozone, cells)

    def ray(self, height: Any, slope: Any) -> Ray:
        """A line from heights at cosines of the angle from the vertical."""
        radius = EARTH_RADIUS_KM + height
        along = radius * slope
        flat2 = 1 - slope * slope
        above = height * (radius + EARTH_RADIUS_KM)
        root2 = along * along - above
        lands = (slope < 0) & (root2 > 0)
        to_ground = above / (dr.sqrt(dr.maximum(root2, 0)) - along)
        ahead = (TOP_KM - height) * (TOP_KM + EARTH_RADIUS_KM + radius)
        to_top = ahead / dr.maximum(dr.sqrt(dr.maximum(along * along + ahead, 0)) + along, 1e-6)
        # Downwards the sum above loses its precision, but the difference does not.
        to_top = dr.select(slope < 0, dr.sqrt(along * along + ahead) - along, to_top)
        start = self.columns(height, dr.abs(slope))
        # Height of the lowest place: radius (1 - sqrt(1 - slope^2)) below.
        lowest = dr.maximum(height - radius * slope * slope / (1 + dr.sqrt(flat2)), 0)
        lowest = dr.select(slope < 0, lowest, height)
        turning = tuple(2 * part for part in self.columns(lowest, dr.zeros(Float, dr.width(height))))
        length = dr.maximum(dr.select(lands, to_ground, to_top), 1e-4)
        ray = Ray(height, slope, length, lands, Float(0), start, (turning[0], turning[1]))
        depth = self.crossed(ray, length)[0]
        return Ray(height, slope, length, lands, dr.maximum(depth, 1e-7), start, ray.turning)

    def crossed(self, ray: Ray, distance: Any) -> tuple[Any, Any]:
        """Optical depth and ozone over a distance along a ray."""
        height, slope = moved(ray.height, ray.slope, distance)
        end = self.columns(height, dr.abs(slope))
        up, down = ray.slope >= 0, slope < 0
        depth, ozone = (
            dr.maximum(dr.select(up, a - b, dr.select(down, b - a, turn - a - b)), 0)
            for a, b, turn in zip(ray.start, end, ray.turning, strict=True)
        )
        return depth, ozone

    def reach(self, ray: Ray, depth: Any) -> Any:
        """Distance along a ray at which an optical depth is crossed."""
        near, far = dr.zeros(Float, dr.width(depth)), ray.length
        for _ in range(BISECTIONS):
            middle = (near + far) / 2
            short = self.crossed(ray, middle)[0] < depth
            near, far = dr.select(short, middle, near), dr.select(short, far, middle)
        return (near + far) / 2


@functools.lru_cache(maxsize=1)
def shell_air(air: BakedAir, rayleigh: float, aerosol: float, floor_km: float, stratosphere: float) -> ShellAir:
    """Return an air; the last one is cached, because its tables take half a second."""
    return ShellAir(air, rayleigh, aerosol, floor_km, stratosphere=stratosphere)


def moved(height: Any, slope: Any, distance: Any) -> tuple[Any, Any]:
    """Height and cosine of the angle from the vertical after a distance along a straight line."""
    radius = EARTH_RADIUS_KM + height
    gained = distance * dr.fma(2 * radius, slope, distance)
    end = dr.sqrt(radius * radius + gained)
    return dr.clip(height + gained / (radius + end), 0, TOP_KM), dr.clip((radius * slope + distance) / end, -1, 1)


def _exponential(logs: Any, cell: Any, shift: Any) -> Any:
    low = dr.gather(Float, logs, cell)
    return dr.exp(dr.fma(dr.gather(Float, logs, cell + 1) - low, shift, low))


def _log(values: Floats) -> Floats:
    return np.maximum(np.log(np.maximum(values, 1e-30)), LEAST_LOG)


def _table(values: Floats) -> Any:
    return Float(np.ascontiguousarray(values, np.float32).ravel())


def _cells(row: Any, column: Any, rows: int, columns: int) -> tuple[Any, Any, Any, int]:
    row, column = dr.clip(row, 0, rows - 1.001), dr.clip(column, 0, columns - 1.001)
    i, j = UInt32(row), UInt32(column)
    return i * columns + j, row - Float(i), column - Float(j), columns


def _bilinear(table: Any, cells: tuple[Any, Any, Any, int]) -> Any:
    corner, a, b, columns = cells
    one, two, three, four = (dr.gather(Float, table, corner + k) for k in (0, 1, columns, columns + 1))
    low, high = dr.fma(two - one, b, one), dr.fma(four - three, b, three)
    return dr.fma(high - low, a, low)
