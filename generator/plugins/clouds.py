"""Cloud for the sky's emitter: the optical depth of :mod:`generator.sky.clouds`, ray by ray."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import ArrayLike

from generator.places.earth import EQUATORIAL_RADIUS_KM
from generator.sky.clouds import (
    ASYMMETRY,
    COARSE_CELL_KM,
    FINE_CELL_KM,
    LEAST_MOON_SINE,
    CloudField,
)  # fmt: skip


def cloud_numbers(clouds: CloudField) -> list[float]:
    """Altitude, threshold, scale, share for points; for each moment the way of each tile, north and east, in its period."""
    pattern = clouds.pattern
    periods = [COARSE_CELL_KM * len(pattern.coarse), FINE_CELL_KM * len(pattern.fine)]
    carried = [way % period for at in clouds.moments for period in periods for way in (at.north_km, at.east_km)]
    return [clouds.altitude_km, pattern.threshold, pattern.scale, clouds.point_share, *carried]


class CloudTexture:
    """A cloud field on the device.

    Parameters
    ----------
    coarse, fine : (n, n) tensors
    numbers : tensor
        Of :func:`cloud_numbers`.
    """

    def __init__(self, coarse: Any, fine: Any, numbers: Any) -> None:
        self.tiles = [(mi.Float(tile.array), tile.shape[0]) for tile in (mi.TensorXf(coarse), mi.TensorXf(fine))]
        values = mi.Float(mi.TensorXf(numbers).array)
        self.numbers = [dr.gather(mi.Float, values, mi.UInt32(k)) for k in range(dr.width(values))]

    def slant_depths(self, direction: Any) -> list[Any]:
        """Optical depth along unit vectors (Vector3f, ENU) above the horizon, at each moment of the exposure."""
        altitude, threshold, scale, _, *carried = self.numbers
        ratio = EQUATORIAL_RADIUS_KM / (EQUATORIAL_RADIUS_KM + altitude)
        rest = altitude / (EQUATORIAL_RADIUS_KM + altitude)
        horizontal = dr.maximum(dr.sqrt(direction.x * direction.x + direction.y * direction.y), 1e-6)
        cosine = dr.sqrt(dr.maximum(1 - dr.square(ratio * horizontal), 1e-6))
        turned = horizontal * rest * (1 + ratio) / (cosine + ratio * direction.z)
        away = EQUATORIAL_RADIUS_KM * dr.asin(dr.minimum(turned, 1)) / horizontal
        north, east = direction.y * away, direction.x * away
        depths = []
        for first in range(0, len(carried), 4):
            field = -threshold
            for (tile, cells), cell_km, k in zip(self.tiles, (COARSE_CELL_KM, FINE_CELL_KM), (0, 2), strict=True):
                way_north, way_east = carried[first + k], carried[first + k + 1]
                field += periodic(tile, cells, (north - way_north) / cell_km, (east - way_east) / cell_km)
            depths.append(scale * dr.maximum(field, 0) / cosine)
        return depths

    def veil(self, depths: list[Any], moon_sine: Any) -> Any:
        """The factor of :class:`generator.sky.clouds.CloudVeil`, mean over the moments."""
        total = mi.Float(0)
        for depth in depths:
            total += veil(depth, moon_sine, self.numbers[3])
        return total / len(depths)


def periodic(tile: Any, cells: int, row: Any, column: Any) -> Any:
    """Bilinear look-up in a periodic square tile."""
    row, column = row - dr.floor(row / cells) * cells, column - dr.floor(column / cells) * cells
    r0, c0 = mi.UInt32(row) % cells, mi.UInt32(column) % cells
    r1, c1 = (r0 + 1) % cells, (c0 + 1) % cells
    wr, wc = row - dr.floor(row), column - dr.floor(column)
    near = dr.lerp(dr.gather(mi.Float, tile, r0 * cells + c0), dr.gather(mi.Float, tile, r0 * cells + c1), wc)
    far = dr.lerp(dr.gather(mi.Float, tile, r1 * cells + c0), dr.gather(mi.Float, tile, r1 * cells + c1), wc)
    return dr.lerp(near, far, wr)


def veil(depth: Any, moon_sine: Any, point_share: Any) -> Any:
    """The factor of :class:`generator.sky.clouds.CloudVeil` for an optical depth along the line of sight."""
    path = depth / dr.select(moon_sine > 0, dr.maximum(moon_sine, LEAST_MOON_SINE), 1)
    passed = dr.rcp(1 + 0.75 * (1 - ASYMMETRY) * path)
    return dr.select(moon_sine > 0, dr.maximum(passed - dr.exp(-point_share * path), 0), passed)


def moon_sines(values: ArrayLike) -> list[Any]:
    """The veils' sines of the Moon's altitude, one opaque Float each."""
    return [dr.opaque(mi.Float, float(value)) for value in np.atleast_1d(np.asarray(values, dtype=np.float64))]
