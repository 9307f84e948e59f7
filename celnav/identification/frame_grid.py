"""A grid over the frame: the solid angle of the sky that it shows, and where in it that sky is."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from celnav.camera import Camera
from celnav.identification.sky_index import F8

# Cells along each side of the frame: the solid angle, which tells how many stars to expect, follows to 1 %.
_SIDE = 48


@dataclass(frozen=True, eq=False)
class FrameGrid:
    """The cells of a frame that show the sky.

    Attributes
    ----------
    rays : ndarray, shape (n, 3)
        Directions of their centres in the camera frame.
    solid_angles_sr : ndarray, shape (n,)
        Their solid angles.
    seen_part : float
        Part of all cells that they are, above 0: less than 1 where an image circle does not fill the frame.
    """

    rays: F8
    solid_angles_sr: F8
    seen_part: float

    @property
    def solid_angle_sr(self) -> float:
        """Solid angle of the frame."""
        return float(self.solid_angles_sr.sum())


@lru_cache(maxsize=32)
def frame_grid(camera: Camera) -> FrameGrid:
    """Return the grid of a camera's frame."""
    places = (np.arange(_SIDE) + 0.5) / _SIDE
    u, v = np.meshgrid(places * camera.width - 0.5, places * camera.height - 0.5)
    uv = np.column_stack((u.ravel(), v.ravel()))
    rays, scale = camera.to_rays(uv), camera.radians_per_px(uv)
    seen = np.isfinite(rays[:, 0]) & np.isfinite(scale)
    cell_px = camera.width * camera.height / _SIDE**2
    return FrameGrid(rays[seen], scale[seen] ** 2 * cell_px, max(float(seen.mean()), 1 / _SIDE**2))
