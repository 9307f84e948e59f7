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
    stamps : (bands, rows, columns, n, n) array
        Share of the light that a pixel receives, by its distance from the star, every 1/FINE_PER_PX px from -radius - 0.5 to
        radius + 0.5; n = (2 radius + 1) FINE_PER_PX + 1.
    shift : (bands,) array
        Lateral chromatic shift away from the principal point at distance `corner_px` from it, px; linear in the distance.
    width, height : int
        Of the frame; the outermost nodes lie on its outer edges.
    cx_px, cy_px, corner_px : float
        Principal point and the corner's distance from it, px.
    """

    def __init__(
        self, stamps: Floats, shift: Floats, width: int, height: int, cx_px: float, cy_px: float, corner_px: float
    ) -> None:
        self.bands, self.rows, self.columns, self.size = stamps.shape[:4]
        self.radius_px = ((self.size - 1) // FINE_PER_PX - 1) // 2
        self.values = [mi.Float(np.ascontiguousarray(band, dtype=np.float32).ravel()) for band in stamps]
        self.shifts, self.frame = shift, (width, height)
        self.cx_px, self.cy_px, self.corner_px = cx_px, cy_px, corner_px

    def shift(self, band: int, u: Floats, v: Floats) -> tuple[Floats, Floats]:
        """Lateral chromatic displacement of stars at (u, v) in a band, px."""
        factor = self.shifts[band] / self.corner_px
        return factor * (u - self.cx_px), factor * (v - self.cy_px)

    def taps(self, band: int, u: Any, v: Any, owner: Any, offset: Any) -> Any:
        """Share of the light (Float) that falls on the pixel `offset` of the stamp around stars at (u, v)."""
        side = 2 * self.radius_px + 1
        taps = (offset % side, offset // side)
        phases = [mi.Float((dr.round(position) - position + 0.5) * FINE_PER_PX) for position in (u, v)]
        node = [
            mi.UInt32(dr.round(dr.clip((position + 0.5) / size, 0, 1) * (count - 1)))
            for position, size, count in ((u, self.frame[0], self.columns), (v, self.frame[1], self.rows))
        ]
        stamp = (node[1] * self.columns + node[0]) * (self.size * self.size)
        dr.eval(phases, stamp)
        fine, weight = [], []
        for phase, tap in zip(phases, taps, strict=True):
            own = dr.gather(mi.Float, phase, owner)
            lower = dr.minimum(mi.UInt32(own), FINE_PER_PX - 1)
            fine.append(tap * FINE_PER_PX + lower)
            weight.append(own - mi.Float(lower))
        index = dr.gather(mi.UInt32, stamp, owner) + fine[1] * self.size + fine[0]
        corners = [dr.gather(mi.Float, self.values[band], index + j * self.size + i) for j in (0, 1) for i in (0, 1)]
        return dr.lerp(
            dr.lerp(corners[0], corners[1], weight[0]), dr.lerp(corners[2], corners[3], weight[0]), weight[1]
        )
