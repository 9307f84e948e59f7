"""Cloud for the sky's emitter: the optical depth of :mod:`generator.sky.clouds`, ray by ray."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from generator.places.earth import EQUATORIAL_RADIUS_KM
from generator.sky.clouds import COARSE_CELL_KM, FINE_CELL_KM, CloudField
from generator.sky.moonlit_cloud import DIFFRACTED, MoonVeil


def cloud_numbers(clouds: CloudField) -> list[float]:
    """Numbers that describe a field, with each tile's displacement north and east at each moment, modulo its period.

    Altitude, threshold, scale, fraction for points, and mean cosine of the scattering angle come first.
    """
    pattern = clouds.pattern
    periods = [COARSE_CELL_KM * len(pattern.coarse), FINE_CELL_KM * len(pattern.fine)]
    carried = [way % period for at in clouds.moments for period in periods for way in (at.north_km, at.east_km)]
    return [clouds.altitude_km, pattern.threshold, pattern.scale, clouds.point_share, clouds.asymmetry, *carried]


class CloudTexture:
    """A cloud field on the device.

    Parameters
    ----------
    coarse, fine : (n, n) tensors
    numbers : tensor
        Numbers from :func:`cloud_numbers`.
    """

    def __init__(self, coarse: Any, fine: Any, numbers: Any) -> None:
        self.tiles = [(mi.Float(tile.array), tile.shape[0]) for tile in (mi.TensorXf(coarse), mi.TensorXf(fine))]
        values = mi.Float(mi.TensorXf(numbers).array)
        self.numbers = [dr.gather(mi.Float, values, mi.UInt32(k)) for k in range(dr.width(values))]

    def slant_depths(self, direction: Any) -> list[Any]:
        """Optical depth along unit vectors (Vector3f, ENU) above the horizon, at each moment of the exposure."""
        altitude, threshold, scale, _, _, *carried = self.numbers
        ratio = EQUATORIAL_RADIUS_KM / (EQUATORIAL_RADIUS_KM + altitude)
        rest = altitude / (EQUATORIAL_RADIUS_KM + altitude)
        horizontal = dr.maximum(dr.sqrt(direction.x * direction.x + direction.y * direction.y), 1e-6)
        cosine = self.cosine(direction)
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

    def cosine(self, direction: Any) -> Any:
        """Cosine between directions and the vertical where they meet the layer."""
        ratio = EQUATORIAL_RADIUS_KM / (EQUATORIAL_RADIUS_KM + self.numbers[0])
        across = direction.x * direction.x + direction.y * direction.y
        return dr.sqrt(dr.maximum(1 - dr.square(ratio) * across, 1e-6))

    def transmission(self, depths: list[Any]) -> Any:
        """The factor of :class:`generator.sky.clouds.CloudVeil`, mean over the moments."""
        total = mi.Float(0)
        for depth in depths:
            total += dr.rcp(1 + 0.75 * (1 - self.numbers[4]) * depth)
        return total / len(depths)


class MoonTexture:
    """A :class:`MoonVeil` on the device.

    Parameters
    ----------
    moon : tensor
        Numbers from :func:`moon_numbers`.
    angles : (2, n) tensor
        Phase function and aureole.
    more : (d, c, t) tensor
        Light scattered more than once.
    """

    def __init__(self, moon: Any, angles: Any, more: Any) -> None:
        numbers = mi.Float(mi.TensorXf(moon).array)
        self.east, self.north, self.up, self.cosine = (dr.gather(mi.Float, numbers, mi.UInt32(k)) for k in range(4))
        angles, more = mi.TensorXf(angles), mi.TensorXf(more)
        self.angles, self.nodes = mi.Float(angles.array), angles.shape[1]
        self.more, self.shape = mi.Float(more.array), more.shape

    def radiance(self, clouds: CloudTexture, depths: list[Any], direction: Any, aureole: bool = True) -> Any:
        """Radiance in the direction of unit vectors relative to the Moon's irradiance, mean over the moments."""
        apart = direction - mi.Vector3f(self.east, self.north, self.up)
        place = dr.sqrt(dr.minimum(0.5 * dr.norm(apart), 1)) * (self.nodes - 1)
        first = dr.minimum(mi.UInt32(place), self.nodes - 2)
        weight = place - mi.Float(first)
        phase, halo = (
            dr.lerp(*(dr.gather(mi.Float, self.angles, row * self.nodes + first + k) for k in (0, 1)), weight)
            for row in (0, 1)
        )
        cosine = clouds.cosine(direction)
        level = dr.sqrt((direction.x**2 + direction.y**2) * (self.east**2 + self.north**2))
        along = direction.x * self.east + direction.y * self.north
        turn = dr.acos(dr.clip(along / dr.maximum(level, 1e-12), -1, 1)) * (1 / dr.pi)
        total = mi.Float(0)
        for whole in depths:
            slant = (1 - DIFFRACTED) * whole
            depth = slant * cosine
            through = depth / self.cosine
            total += phase * scattered_once(slant, through)
            total += self._more((depth / (1 + depth), cosine, turn))
            if aureole:
                image = dr.exp(clouds.numbers[3] * (-1 / (1 - DIFFRACTED)) * through)
                total += halo * dr.maximum(dr.exp(-through) - image, 0)
        return total / len(depths)

    def _more(self, shares: tuple[Any, Any, Any]) -> Any:
        """Trilinear look-up at places from 0 to 1 along the three axes."""
        cells, weights = [], []
        for share, count in zip(shares, self.shape, strict=True):
            place = dr.clip(share, 0, 1) * (count - 1)
            cells.append(dr.minimum(mi.UInt32(place), count - 2))
            weights.append(place - mi.Float(cells[-1]))
        _, columns, turns = self.shape
        start = (cells[0] * columns + cells[1]) * turns + cells[2]

        def edge(offset: int) -> Any:
            low, high = (dr.gather(mi.Float, self.more, start + offset + k) for k in (0, 1))
            return dr.lerp(low, high, weights[2])

        near, far = (dr.lerp(edge(k), edge(k + turns), weights[1]) for k in (0, columns * turns))
        return dr.lerp(near, far, weights[0])


def moon_numbers(veil: MoonVeil) -> list[float]:
    """Direction of the Moon, east, north and up, and the cosine of its zenith angle at the layer."""
    return [*(float(part) for part in veil.moon_enu), veil.moon_cosine]


def scattered_once(view: Any, source: Any) -> Any:
    """The same function as in :mod:`generator.sky.cloud_layer`."""
    gap = dr.abs(view - source)
    # Below this, single precision leaves nothing of the difference of exponentials.
    small = gap < 1e-2
    mean = dr.select(small, 1 - gap * (0.5 - gap / 6), (1 - dr.exp(-gap)) / dr.select(small, 1, gap))
    return view * dr.exp(-dr.minimum(view, source)) * mean


def periodic(tile: Any, cells: int, row: Any, column: Any) -> Any:
    """Bilinear look-up in a periodic square tile."""
    row, column = row - dr.floor(row / cells) * cells, column - dr.floor(column / cells) * cells
    r0, c0 = mi.UInt32(row) % cells, mi.UInt32(column) % cells
    r1, c1 = (r0 + 1) % cells, (c0 + 1) % cells
    wr, wc = row - dr.floor(row), column - dr.floor(column)
    near = dr.lerp(dr.gather(mi.Float, tile, r0 * cells + c0), dr.gather(mi.Float, tile, r0 * cells + c1), wc)
    far = dr.lerp(dr.gather(mi.Float, tile, r1 * cells + c0), dr.gather(mi.Float, tile, r1 * cells + c1), wc)
    return dr.lerp(near, far, wr)
