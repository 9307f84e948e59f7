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
        (bands, rows, columns, n, n): share of the light that a pixel receives, by its distance from the star, every 1/FINE_PER_PX px from -radius - 0.5 to
        radius + 0.5; n = (2 radius + 1) FINE_PER_PX + 1.
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
    def reach_px(self) -> int:
        """Pixels from a star's own within which its light falls in any band."""
        return self.radius_px + int(np.ceil(np.abs(self.shifts).max()))

    def node(self, u: Any, v: Any) -> Any:
        """Nearest field node (row by row) of stars at (u, v)."""
        column, row = (
            mi.UInt32(dr.round(dr.clip((position + 0.5) / size, 0, 1) * (count - 1)))
            for position, size, count in ((u, self.frame[0], self.columns), (v, self.frame[1], self.rows))
        )
        return row * self.columns + column

    def share(self, band: int, stamp: Any, du: Any, dv: Any) -> Any:
        """Share of the light of a band (Float) that falls on a pixel.

        Parameters
        ----------
        band : int
        stamp : UInt32
            Where the stamp of the star's node starts in a band's table.
        du, dv : Float
            From the star (where its light of 550 nm falls) to the pixel's centre, px.
        """
        fine, weight = [], []
        inside = dr.mask_t(du)(True)
        for distance in (du, dv):
            place = (distance + (self.radius_px + 0.5)) * FINE_PER_PX
            inside &= (place >= 0) & (place <= self.size - 1)
            lower = dr.minimum(mi.UInt32(dr.maximum(place, 0)), self.size - 2)
            fine.append(lower)
            weight.append(place - mi.Float(lower))
        index = band * self.rows * self.columns * self.size**2 + stamp + fine[1] * self.size + fine[0]
        corners = [
            dr.gather(mi.Float, self.values, index + j * self.size + i, inside) for j in (0, 1) for i in (0, 1)
        ]
        value = dr.lerp(
            dr.lerp(corners[0], corners[1], weight[0]), dr.lerp(corners[2], corners[3], weight[0]), weight[1]
        )
        return dr.select(inside, value, 0)
