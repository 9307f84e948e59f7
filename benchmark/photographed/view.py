"""Directions of a fixed camera's pixels, and its dark pixels."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from benchmark.errors import PhotographError
from celnav.camera import Camera

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]

CORNER_PX = 50
"""Side of the squares in the frame's corners."""
BEYOND_CIRCLE = 1.25
"""Distance of a corner from the principal point, relative to the image circle's radius, from which it counts as dark."""
LEAST_CORNERS = 3


@dataclass(frozen=True, eq=False)
class View:
    """Directions of pixels, (height, width) each; NaN where the lens has no image.

    Attributes
    ----------
    altitude_deg, azimuth_deg : arrays
    """

    altitude_deg: Singles
    azimuth_deg: Singles


def view_of(camera: Camera, R_cam: Floats) -> View:
    """Apparent directions of all pixels of a camera with an attitude (ENU to camera)."""
    shape = (camera.height, camera.width)
    altitude, azimuth = np.empty(shape, np.float32), np.empty(shape, np.float32)
    u = np.arange(camera.width, dtype=np.float64)
    for v in range(camera.height):
        east, north, up = (camera.to_rays(np.column_stack((u, np.full(camera.width, v)))) @ R_cam).T
        altitude[v] = np.degrees(np.arcsin(np.clip(up, -1, 1)))
        azimuth[v] = np.degrees(np.arctan2(east, north)) % 360
    return View(altitude, azimuth)


def dark_plane(pixels: NDArray[np.floating], camera: Camera, circle_px: float | None, black_dn: float) -> Singles:
    """Level without light, (height, width) DN: a plane through the medians of the dark corners outside the image circle.

    Where fewer than three corners are dark it is `black_dn` everywhere. It includes stray light in the corners, so use it for
    a photograph and its twin alike.
    """
    height, width = pixels.shape
    flat = np.full((height, width), black_dn, dtype=np.float32)
    if circle_px is None:
        return flat
    rows, levels = [], []
    for v in (slice(0, CORNER_PX), slice(height - CORNER_PX, height)):
        for u in (slice(0, CORNER_PX), slice(width - CORNER_PX, width)):
            middle = ((u.start + u.stop - 1) / 2, (v.start + v.stop - 1) / 2)
            if np.hypot(middle[0] - camera.cx_px, middle[1] - camera.cy_px) > BEYOND_CIRCLE * circle_px:
                rows.append((1.0, *middle))
                levels.append(float(np.median(pixels[v, u])))
    if len(rows) < LEAST_CORNERS:
        return flat
    level, along_u, along_v = np.linalg.lstsq(np.array(rows), np.array(levels), rcond=None)[0]
    plane = level + along_u * np.arange(width)[None, :] + along_v * np.arange(height)[:, None]
    return np.asarray(plane, dtype=np.float32)


def on_mask(uv: Floats, mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Find which positions (n, 2), some possibly NaN or outside, are on pixels of a mask; (n,)."""
    height, width = mask.shape
    at = np.rint(np.where(np.isfinite(uv), uv, -1)).astype(np.int64)
    found = np.asarray((at >= 0).all(axis=1) & (at < np.array([width, height])).all(axis=1))
    found[found] = mask[at[found, 1], at[found, 0]]
    return found


def not_sky_of(path: Path, camera: Camera) -> NDArray[np.bool_]:
    """Read a mask picture of pixels that are not sky, (height, width): those darker than middle grey.

    Raises
    ------
    PhotographError
        The file is not a picture, or not of the camera's size.
    """
    try:
        with Image.open(path) as picture:
            if picture.size != (camera.width, camera.height):
                raise PhotographError(
                    f"{path}: has {picture.width} x {picture.height} pixels, the camera {camera.width} x {camera.height}"
                )
            return np.asarray(picture.convert("L")) < 128
    except (OSError, ValueError, Image.DecompressionBombError) as error:
        raise PhotographError(f"{path}: cannot be read as a picture ({error})") from None
