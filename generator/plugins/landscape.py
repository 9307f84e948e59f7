"""A landscape around the camera: how much of the sky it hides in each direction, and the light that it sends."""

from __future__ import annotations

import math
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

PACKETS = (mi.Float, mi.Vector2f, mi.Vector3f, mi.Vector4f)
"""Types of one to four values."""
PIXEL_SAMPLES = (-0.25, 0.25)
"""Places along each axis, px from a pixel's middle, at which it is looked at."""


class LandscapeTexture:
    """Maps of alpha and of the light of each channel, over alpha, on equal steps of altitude and azimuth.

    Parameters
    ----------
    maps : (1 + channels, ny, nx) array
        As :class:`generator.ground.panorama.Panorama` has them: row 0 below `top_deg`, column 0 east of north.
    top_deg, bottom_deg : float
    first_column, whole_columns : int
        Where the maps are a part of the circle: their first column among so many; 0 for the whole circle.
    """

    def __init__(
        self,
        maps: NDArray[np.float32],
        top_deg: float,
        bottom_deg: float,
        first_column: int = 0,
        whole_columns: int = 0,
    ) -> None:
        self.planes, self.rows, self.columns = maps.shape
        self.whole = whole_columns or self.columns
        # Columns that the maps lack are equally far from both of their edges.
        self.margin = 0.5 * (self.whole - self.columns)
        self.first = first_column - self.margin
        self.top, self.span = math.radians(top_deg), math.radians(top_deg - bottom_deg)
        # Planes of a texel are read in packets, whose sizes are powers of two.
        self.packet = min(1 << (self.planes - 1).bit_length(), len(PACKETS))
        self.packets = math.ceil(self.planes / self.packet)
        texels = np.zeros((self.rows + 2, self.columns + 2, self.packets * self.packet), np.float32)
        inner = texels[..., : self.planes]
        inner[1:-1, 1:-1] = np.moveaxis(maps, 0, -1)
        if top_deg >= 90:
            inner[0] = inner[1]
        if bottom_deg <= -90:
            inner[-1] = inner[-2]
        before, after = (1, -2) if whole_columns else (-2, 1)
        inner[:, 0], inner[:, -1] = inner[:, before], inner[:, after]
        self.values = mi.Float(texels.ravel())

    def place(self, direction: Any) -> tuple[Any, Any]:
        """Row and column (Floats) of unit vectors (Vector3f, ENU), in texels from the middle of the first."""
        altitude = dr.asin(dr.clip(direction.z, -1, 1))
        turn = dr.atan2(direction.x, direction.y) * (0.5 / math.pi)
        row = (self.top - altitude) * (self.rows / self.span) - 0.5
        return row, self._within(turn * self.whole - self.first - 0.5 - self.margin)

    def _within(self, column: Any) -> Any:
        """A column of the circle, moved to the turn in which the maps are."""
        lowest = -self.margin - 0.5
        return column - self.whole * dr.floor((column - lowest) / self.whole)

    def at(self, row: Any, column: Any, planes: int) -> list[Any]:
        """The first `planes` maps at rows and columns (Floats, columns from -0.5 to `columns` - 0.5), bilinear."""
        row = dr.clip(row + 1, 0, self.rows + 1)
        column = dr.clip(column + 1, 0, self.columns + 1)
        r0 = dr.minimum(mi.UInt32(row), self.rows)
        c0 = dr.minimum(mi.UInt32(column), self.columns)
        wr, wc = row - mi.Float(r0), column - mi.Float(c0)
        first = r0 * (self.columns + 2) + c0
        below = first + (self.columns + 2)
        corners = (first, first + 1, below, below + 1)
        result: list[Any] = []
        while len(result) < planes:
            place, kind = len(result) // self.packet, PACKETS[self.packet - 1 if planes > 1 else 0]
            if planes == 1:
                read = [[dr.gather(mi.Float, self.values, corner * (self.packets * self.packet))] for corner in corners]
            else:
                read = [dr.gather(kind, self.values, corner * self.packets + place) for corner in corners]
            for a, b, c, d in zip(*read, strict=True):
                result.append(dr.lerp(dr.lerp(a, b, wc), dr.lerp(c, d, wc), wr))
        return result[:planes]

    def hidden(self, direction: Any, width_rad: float) -> Any:
        """Part of points of light (Float) that the landscape hides: the mean of alpha over a square of `width_rad`."""
        row, column = self.place(direction)
        level = dr.maximum(dr.sqrt(dr.square(direction.x) + dr.square(direction.y)), 1e-3)
        down = width_rad * self.rows / self.span
        across = dr.minimum(width_rad * self.whole / (2 * math.pi) / level, 0.5 * self.whole)
        total = mi.Float(0)
        for vertical in PIXEL_SAMPLES:
            for horizontal in PIXEL_SAMPLES:
                turned = self._within(column + horizontal * across)
                total += self.at(row + vertical * down, turned, 1)[0]
        return total / len(PIXEL_SAMPLES) ** 2


def texture(props: Any, name: str) -> LandscapeTexture | None:
    """A landscape of an integrator's properties, whose names begin with `name`; None without one."""
    if f"{name}_maps" not in props:
        return None
    maps = np.array(props[f"{name}_maps"])
    maps = maps[0] if maps.ndim == 4 else maps
    part = (int(props.get(f"{name}_first_column", 0)), int(props.get(f"{name}_whole_columns", 0)))
    return LandscapeTexture(maps, float(props[f"{name}_top_deg"]), float(props[f"{name}_bottom_deg"]), *part)
