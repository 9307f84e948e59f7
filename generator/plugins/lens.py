"""Lens models: the one piece of code that maps directions to pixels and back, for rays and for star splats.

Written with Dr.Jit functions on plain components, so that it serves single and double precision alike.
"""

from __future__ import annotations

from typing import Any, Protocol

import drjit as dr

MINIMUM_COSINE = 1e-3


class Lens(Protocol):
    """A projection. Pixel centres are at integers; the camera frame is x right, y down, z along the boresight."""

    def project(self, x: Any, y: Any, z: Any) -> tuple[Any, Any, Any]:
        """Pixel position (u, v) of a camera-frame direction, and whether it lies in the model's valid range."""

    def unproject(self, u: Any, v: Any) -> tuple[Any, Any, Any]:
        """Camera-frame unit vector of a pixel position."""

    def solid_angle(self, u: Any, v: Any) -> Any:
        """Solid angle, sr, of a pixel at a position."""

    def pupil(self, cosine: Any) -> Any:
        """Projected area of the entrance pupil over its area, for a direction at this cosine from the boresight."""


class Pinhole:
    """Rectilinear projection: u = cx + f x/z, v = cy + fy y/z.

    Parameters
    ----------
    f_px, fy_px : float
        Focal lengths along u and v, px.
    cx_px, cy_px : float
        Principal point, px.
    """

    def __init__(self, f_px: Any, fy_px: Any, cx_px: Any, cy_px: Any) -> None:
        self.f_px, self.fy_px, self.cx_px, self.cy_px = f_px, fy_px, cx_px, cy_px

    def project(self, x: Any, y: Any, z: Any) -> tuple[Any, Any, Any]:
        """Pixel position of a camera-frame direction; valid in front of the camera."""
        valid = z > MINIMUM_COSINE
        depth = dr.select(valid, z, 1)
        return self.cx_px + self.f_px * x / depth, self.cy_px + self.fy_px * y / depth, valid

    def unproject(self, u: Any, v: Any) -> tuple[Any, Any, Any]:
        """Camera-frame unit vector of a pixel position."""
        x, y = (u - self.cx_px) / self.f_px, (v - self.cy_px) / self.fy_px
        norm = dr.rsqrt(x * x + y * y + 1)
        return x * norm, y * norm, norm

    def solid_angle(self, u: Any, v: Any) -> Any:
        """Solid angle, sr: a pixel at angle t off axis covers cos^3 t / (f fy)."""
        _, _, cosine = self.unproject(u, v)
        return cosine * cosine * cosine / (self.f_px * self.fy_px)

    def pupil(self, cosine: Any) -> Any:
        """Cosine of the angle off axis: a thin lens; with the solid angle it makes the cos^4 law for the sky."""
        return dr.maximum(cosine, 0)
