"""A tabulated point spread function in Dr.Jit: that of the nearest field node, bilinear between fine samples."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from generator.optics.psf import FINE_PER_PX

Floats = NDArray[np.float64]
MARGIN_PX = 256
"""Upper limit of the distance by which part of a stamp can be outside the table."""


class PsfAtlas:
    """Pixel-integrated point spread functions on a grid of field positions, for a few wavelength bands.

    Parameters
    ----------
    stamps : TensorXf
        (bands, rows, columns, FINE_PER_PX, FINE_PER_PX, k, k): fraction of the light that a pixel receives, by its
        distance from the star, every 1/FINE_PER_PX px from -radius - 0.5 to radius + 0.5, k = 2 radius + 2. Whole pixels
        vary fastest, so that a star's pixels are neighbours in memory.
    shift : (bands,) array
        Lateral chromatic shift away from the principal point at distance `corner_px` from it, px; linear in the distance.
    width, height : int
        Size of the frame; the outermost nodes are on its outer edges.
    cx_px, cy_px, corner_px : float
        Principal point and the corner's distance from it, px.
    """

    def __init__(
        self, stamps: Any, shift: Floats, width: int, height: int, cx_px: float, cy_px: float, corner_px: float
    ) -> None:
        self.bands, self.rows, self.columns = stamps.shape[:3]
        self.side = stamps.shape[-1]
        self.radius_px = self.side // 2 - 1
        self.values = stamps.array
        self.shifts, self.frame = shift, (width, height)
        self.cx_px, self.cy_px, self.corner_px = cx_px, cy_px, corner_px

    @property
    def shift_px(self) -> int:
        """Largest shift of any band, rounded up to whole pixels."""
        return int(np.ceil(np.abs(self.shifts).max()))

    @property
    def reach_px(self) -> int:
        """Distance in pixels from a star's own pixel within which its light falls in any band."""
        return self.radius_px + self.shift_px

    def node(self, u_px: Floats, v_px: Floats) -> NDArray[np.intp]:
        """Nearest field node (row by row) of stars, (n,) array."""
        column, row = (
            np.rint(np.clip((position + 0.5) / size, 0, 1) * (count - 1)).astype(np.intp)
            for position, size, count in ((u_px, self.frame[0], self.columns), (v_px, self.frame[1], self.rows))
        )
        return row * self.columns + column

    def shares(self, band: int, node: Any, du: Any, dv: Any, count: int) -> list[Any]:
        """Fractions of a band's light that fall on `count` pixels in a row, one Float each.

        Parameters
        ----------
        band : int
        node : UInt32
            From :meth:`node`.
        du, dv : Float
            Offset from the star (where its light of 550 nm falls, minus the band's shift) to the first pixel's centre, px.
        count : int
        """
        samples = (self.side - 1) * FINE_PER_PX
        lower, weight = [], []
        for distance in (du, dv):
            place = (distance + (self.radius_px + 0.5)) * FINE_PER_PX
            floor = dr.floor(place)
            # The margin keeps the following division from meeting negative numbers.
            lower.append(mi.Int32(floor) + MARGIN_PX * FINE_PER_PX)
            weight.append(place - floor)
        in_rows = (lower[1] >= MARGIN_PX * FINE_PER_PX) & (lower[1] < MARGIN_PX * FINE_PER_PX + samples)
        stamp = (mi.UInt32(node) + band * self.rows * self.columns) * FINE_PER_PX
        corners = []
        for down in (0, 1):
            row, row_phase = (lower[1] + down) // FINE_PER_PX - MARGIN_PX, (lower[1] + down) % FINE_PER_PX
            for right in (0, 1):
                column, phase = (lower[0] + right) // FINE_PER_PX - MARGIN_PX, (lower[0] + right) % FINE_PER_PX
                part = (mi.Int32(stamp) + row_phase) * FINE_PER_PX + phase
                corners.append((part * self.side + row) * self.side + column)
        first = lower[0] - MARGIN_PX * FINE_PER_PX
        shares = []
        for tap in range(count):
            place = first + tap * FINE_PER_PX
            inside = in_rows & (place >= 0) & (place < samples)
            above, above_right, below, below_right = (
                dr.gather(mi.Float, self.values, mi.UInt32(corner + tap), inside) for corner in corners
            )
            shares.append(
                dr.lerp(dr.lerp(above, above_right, weight[0]), dr.lerp(below, below_right, weight[0]), weight[1])
            )
        return shares
