"""A tabulated point spread function in Dr.Jit: that of the nearest field node, bilinear between fine samples."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from generator.psf import FINE_PER_PX

Floats = NDArray[np.float64]


class PsfAtlas:
    """Pixel-integrated point spread functions on a grid of field positions, for a few wavelength bands.

    Parameters
    ----------
    stamps : TensorXf
        (bands, rows, columns, n, n): share of the light that a pixel receives, by its distance from the star, every
        1/FINE_PER_PX px from -radius - 0.5 to radius + 0.5; n = (2 radius + 1) FINE_PER_PX + 1.
    shift : (bands,) array
        Lateral chromatic shift away from the principal point at distance `corner_px` from it, px; linear in the distance.
    width, height : int
        Of the frame; the outermost nodes lie on its outer edges.
    cx_px, cy_px, corner_px : float
        Principal point and the corner's distance from it, px.
    """

    def __init__(
        self, stamps: Any, shift: Floats, width: int, height: int, cx_px: float, cy_px: float, corner_px: float
    ) -> None:
        self.bands, self.rows, self.columns, self.size = stamps.shape[:4]
        self.radius_px = ((self.size - 1) // FINE_PER_PX - 1) // 2
        self.values = stamps.array
        self.shifts, self.frame = shift, (width, height)
        self.cx_px, self.cy_px, self.corner_px = cx_px, cy_px, corner_px

    @property
    def shift_px(self) -> int:
        """Whole pixels by which any band is shifted at most."""
        return int(np.ceil(np.abs(self.shifts).max()))

    @property
    def reach_px(self) -> int:
        """Pixels from a star's own within which its light falls in any band."""
        return self.radius_px + self.shift_px

    def node(self, u_px: Floats, v_px: Floats) -> NDArray[np.intp]:
        """Nearest field node (row by row) of stars, (n,) array."""
        column, row = (
            np.rint(np.clip((position + 0.5) / size, 0, 1) * (count - 1)).astype(np.intp)
            for position, size, count in ((u_px, self.frame[0], self.columns), (v_px, self.frame[1], self.rows))
        )
        return row * self.columns + column

    def shares(self, band: int, node: Any, du: Any, dv: Any, count: int) -> list[Any]:
        """Shares of the light of a band that fall on `count` pixels in a row, a Float each.

        Parameters
        ----------
        band : int
        node : UInt32
            From :meth:`node`.
        du, dv : Float
            From the star (where its light of 550 nm falls, less the band's shift) to the first pixel's centre, px.
        count : int
        """
        lower, weight = [], []
        for distance in (du, dv):
            place = (distance + (self.radius_px + 0.5)) * FINE_PER_PX
            floor = dr.floor(place)
            lower.append(mi.Int32(floor))
            weight.append(place - floor)
        in_rows = (lower[1] >= 0) & (lower[1] < self.size - 1)
        first = (mi.UInt32(node) + band * self.rows * self.columns) * self.size**2
        first += mi.UInt32(lower[1]) * self.size
        shares = []
        for tap in range(count):
            column = lower[0] + tap * FINE_PER_PX
            inside = in_rows & (column >= 0) & (column < self.size - 1)
            index = first + mi.UInt32(column)
            above, above_right, below, below_right = (
                dr.gather(mi.Float, self.values, index + step, inside) for step in (0, 1, self.size, self.size + 1)
            )
            shares.append(
                dr.lerp(dr.lerp(above, above_right, weight[0]), dr.lerp(below, below_right, weight[0]), weight[1])
            )
        return shares
