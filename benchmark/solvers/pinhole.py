"""Input for peers that only support pinhole cameras: detections as an ideal pinhole of the same focal length sees them."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import celnav
from benchmark.protocol import CameraRecord

WIDEST_DEG = 120.0
"""Field of the widest pinhole; beyond it, the plate scale at the edge would be more than four times that in the middle."""
PERSPECTIVE = ("pinhole", "brown_conrady")
"""Camera models whose distortion-free form is a pinhole."""


@dataclass(frozen=True)
class PinholeView:
    """The part of a frame that an ideal pinhole shows, whatever the lens.

    Attributes
    ----------
    f_px : float
        Focal length.
    width, height : int
        Size of the pinhole's frame; its principal point is in the middle.
    rows : ndarray of int, shape (n,)
        Indices of the detections that it shows.
    xy : ndarray, shape (n, 2)
        Their offsets from the middle, px; x to the right, y down.
    """

    f_px: float
    width: int
    height: int
    rows: NDArray[np.intp]
    xy: NDArray[np.float64]

    @property
    def fov_deg(self) -> float:
        """Horizontal field of view."""
        return math.degrees(2.0 * math.atan(self.width / 2.0 / self.f_px))

    @property
    def rays(self) -> NDArray[np.float64]:
        """Unit vectors to the detections in the camera frame, shape (n, 3)."""
        rays = np.column_stack((self.xy / self.f_px, np.ones(len(self.xy))))
        return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))


def pinhole_view(uv: NDArray[np.float64], camera: CameraRecord) -> PinholeView:
    """Show detections as an ideal pinhole of focal length `camera.f_px` does.

    A perspective lens keeps the size of its frame. Of a fisheye's field, at most `WIDEST_DEG` is shown.

    Parameters
    ----------
    uv : ndarray, shape (n, 2)
        Pixels of the original camera.
    camera : CameraRecord
    """
    lens = celnav.Camera.from_dict(dataclasses.asdict(camera))
    width, height = camera.width, camera.height
    if camera.model not in PERSPECTIVE:
        ends = lens.to_rays(
            np.array(
                [[0.0, camera.cy_px], [width - 1.0, camera.cy_px], [camera.cx_px, 0.0], [camera.cx_px, height - 1.0]]
            )
        )
        width, height = (_side(ends[axis : axis + 2], camera.f_px) for axis in (0, 2))
    rays = lens.to_rays(np.asarray(uv, dtype=np.float64).reshape(-1, 2))
    front = np.nan_to_num(rays[:, 2], nan=-1.0) > math.cos(math.radians(85.0))
    xy = camera.f_px * rays[:, :2] / np.where(front, rays[:, 2], 1.0)[:, None]
    if camera.model not in PERSPECTIVE:
        front &= (np.abs(np.nan_to_num(xy, nan=math.inf)) <= np.array([width, height]) / 2.0).all(axis=1)
    rows = np.flatnonzero(front)
    return PinholeView(camera.f_px, width, height, rows, xy[rows])


def _side(ends: NDArray[np.float64], f_px: float) -> int:
    """Side of the pinhole's frame, px, between the rays of a fisheye's edges, shape (2, 3); NaN beyond its circle."""
    angles = np.arctan2(np.hypot(ends[:, 0], ends[:, 1]), ends[:, 2])
    half = min(float(np.nan_to_num(angles, nan=math.pi).max()), math.radians(WIDEST_DEG / 2.0))
    return math.ceil(2.0 * f_px * math.tan(half))
