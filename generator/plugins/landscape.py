"""A landscape around the camera: the fraction of the sky that it hides in each direction, and the light that it emits."""

from __future__ import annotations

import math
from typing import Any

import drjit as dr
import mitsuba as mi

from generator.ground.surface import CELL_DEG, CELLS, REFLECTING, SURFACES, grown_cells
from generator.plugins.filter_array import Pattern, choose
from generator.plugins.scene_tensors import array

PACKET = 4
"""Numbers read at once."""
PIXEL_SAMPLES = ((-0.25, -0.25), (0.25, 0.25), (0.25, -0.25), (-0.25, 0.25))
"""Offsets, px, from a pixel's centre at which the landscape is sampled."""
TERM_PLANES = 1 + SURFACES
MARGIN_TEXELS = 2.0
"""Margin around the centres of texels, as far as interpolation between them reaches."""


class LandscapeTexture:
    """Maps on equal steps of altitude and azimuth, and their light.

    Parameters
    ----------
    props : Properties
        Properties of the integrator; see there.
    name : str
        Prefix of the landscape's parameters.
    """

    def __init__(self, props: Any, name: str) -> None:
        def number(key: str) -> float:
            return float(props[f"{name}_{key}"])

        self.rows, self.columns, self.channels = (int(number(key)) for key in ("rows", "columns", "channels"))
        self.values = mi.TensorXf(props[f"{name}_maps"]).array
        self.planes, self.shines = int(number("planes")), bool(props[f"{name}_shines"])
        self.terms = mi.TensorXf(props[f"{name}_terms"]).array
        self.cells = array(props[f"{name}_cells"], 1).reshape(CELLS) > 0
        self.azimuths = dr.width(self.terms) // (self.channels * TERM_PLANES)
        whole = int(number("whole_columns"))
        self.whole = whole or self.columns
        # Columns that the maps lack are at equal distances from both edges.
        self.margin = 0.5 * (self.whole - self.columns)
        self.first = number("first_column") - self.margin
        top_deg, bottom_deg = number("top_deg"), number("bottom_deg")
        self.top, self.span = math.radians(top_deg), math.radians(top_deg - bottom_deg)

    def place(self, direction: Any) -> tuple[Any, Any]:
        """Row and column (Floats) of unit vectors (Vector3f, ENU), in texels from the centre of the first."""
        altitude = dr.asin(dr.clip(direction.z, -1, 1))
        row = (self.top - altitude) * (self.rows / self.span) - 0.5
        return row, self._within(_turn(direction) * self.whole - self.first - 0.5 - self.margin)

    def _within(self, column: Any) -> Any:
        """Shift a column of the circle to the turn that contains the maps."""
        lowest = -self.margin - 0.5
        return column - self.whole * dr.floor((column - lowest) / self.whole)

    def alpha(self, direction: Any) -> Any:
        """Fraction of the light from unit vectors (Vector3f, ENU) that the landscape hides (Float)."""
        return self._alpha(*self.place(direction))

    def at(self, direction: Any) -> list[Any]:
        """Contents along unit vectors (Vector3f, ENU): alpha, each surface, and own light by channel (Floats)."""
        corners, across, down = self._corners(*self.place(direction))
        texels = [self._texel(corner) for corner in corners]
        return [_between(values, across, down) for values in zip(*texels, strict=True)]

    def hidden(self, direction: Any, width_rad: float) -> Any:
        """Fraction of points of light (Float) that the landscape hides: the mean of alpha over a square of `width_rad`."""
        row, column = self.place(direction)
        level = dr.maximum(dr.sqrt(dr.square(direction.x) + dr.square(direction.y)), 1e-3)
        down = width_rad * self.rows / self.span
        across = dr.minimum(width_rad * self.whole / (2 * math.pi) / level, 0.5 * self.whole)
        total = mi.Float(0)
        for horizontal, vertical in PIXEL_SAMPLES:
            turned = self._within(column + horizontal * across)
            total += self._alpha(row + vertical * down, turned)
        return total / len(PIXEL_SAMPLES)

    def _corners(self, row: Any, column: Any) -> tuple[list[Any], Any, Any]:
        """The four texels (UInt32) around rows and columns (Floats, columns from -0.5 to `columns` - 0.5), and weights.

        The weights are those of the second column and of the second row.
        """
        row = dr.clip(row + 1, 0, self.rows + 1)
        column = dr.clip(column + 1, 0, self.columns + 1)
        r0 = dr.minimum(mi.UInt32(row), self.rows)
        c0 = dr.minimum(mi.UInt32(column), self.columns)
        first = r0 * (self.columns + 2) + c0
        below = first + (self.columns + 2)
        return [first, first + 1, below, below + 1], column - mi.Float(c0), row - mi.Float(r0)

    def _alpha(self, row: Any, column: Any) -> Any:
        corners, across, down = self._corners(row, column)
        values = [dr.abs(dr.gather(mi.Float, self.values, corner * self.planes)) for corner in corners]
        return _between(values, across, down)

    def _texel(self, place: Any) -> list[Any]:
        """Contents of texels (UInt32), as :meth:`at`."""
        count = REFLECTING + self.shines * self.channels
        packets = self.planes // PACKET
        read = [
            value
            for part in range(math.ceil(count / PACKET))
            for value in dr.gather(mi.Vector4f, self.values, place * packets + part)
        ]
        alpha, *colours = read[: REFLECTING - 1]
        level = dr.reinterpret_array(mi.Int32, alpha) < 0
        return [
            dr.abs(alpha),
            *(dr.select(level, 0, colour) for colour in colours),
            *(dr.select(level, colour, 0) for colour in colours),
            *read[REFLECTING - 1 : count],
        ]

    def light(self, found: list[Any], direction: Any, seen: tuple[Pattern, Any, Any] | None = None) -> list[Any]:
        """Signal by channel, or of the channel that each pixel records, of the contents `found` by :meth:`at`."""
        turn = _turn(direction)
        place = (turn - dr.floor(turn)) * self.azimuths
        before = dr.minimum(mi.UInt32(place), self.azimuths - 1)
        weight = place - mi.Float(before)
        after = dr.select(before + 1 < self.azimuths, before + 1, 0)
        own = found[TERM_PLANES:]
        if seen is None:
            channels = [mi.UInt32(channel) for channel in range(self.channels)]
        else:
            channels = [choose(seen[0], [mi.UInt32(channel) for channel in range(self.channels)], *seen[1:])]
            own = [choose(seen[0], own, *seen[1:])] if own else own
        signals = []
        for number, channel in enumerate(channels):
            total = own[number] if own else mi.Float(0)
            for half in range(2):
                low, high = (
                    dr.gather(mi.Vector4f, self.terms, 2 * (channel * self.azimuths + azimuth) + half)
                    for azimuth in (before, after)
                )
                for k in range(4):
                    if half or k:
                        total = dr.fma(found[4 * half + k], dr.lerp(low[k], high[k], weight), total)
            signals.append(total)
        return signals

    def around(self, reach_rad: float) -> Any:
        """Grid of CELL_DEG that marks directions near some part of the landscape: 1 or 0 (Float), row by row.

        Parameters
        ----------
        reach_rad : float
            Largest distance.
        """
        margin_deg = MARGIN_TEXELS * max(math.degrees(self.span) / self.rows, 360 / self.whole)
        grown = grown_cells(self.cells, math.degrees(reach_rad) + margin_deg)
        return mi.Float(grown.astype("float32").ravel())

    @staticmethod
    def cell(direction: Any) -> Any:
        """Index (UInt32) of unit vectors (Vector3f, ENU) in the grid of :meth:`around`."""
        rows, columns = CELLS
        altitude = dr.asin(dr.clip(direction.z, -1, 1)) * (180 / math.pi)
        turn = _turn(direction)
        row = dr.minimum(mi.UInt32((90 - altitude) / CELL_DEG), rows - 1)
        return row * columns + dr.minimum(mi.UInt32((turn - dr.floor(turn)) * columns), columns - 1)


def _turn(direction: Any) -> Any:
    """Azimuth of unit vectors, turns from -0.5 to 0.5."""
    return dr.atan2(direction.x, direction.y) * (0.5 / math.pi)


def _between(corners: Any, across: Any, down: Any) -> Any:
    """Interpolate the values of four texels: first the upper two, then the lower two."""
    a, b, c, d = corners
    return dr.lerp(dr.lerp(a, b, across), dr.lerp(c, d, across), down)


def texture(props: Any, name: str) -> LandscapeTexture | None:
    """Return the landscape of an integrator's properties whose names begin with `name`; None without one."""
    return LandscapeTexture(props, name) if f"{name}_maps" in props else None
