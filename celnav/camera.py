"""Camera: pixels to directions and back. Pixel centres are at integers; x right, y down, z along the boresight."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from celnav.errors import CameraError

MODELS = ("pinhole",)


@dataclass(frozen=True)
class Camera:
    """A camera without its attitude.

    Attributes
    ----------
    model : str
        Projection; ``pinhole``.
    width, height : int
        Size of the frame, pixels.
    f_px, fy_px : float
        Focal length along u and v, pixels; `fy_px` is `f_px` unless given.
    cx_px, cy_px : float
        Principal point, pixels; the middle ((width - 1)/2, (height - 1)/2) unless given.
    k, p : tuple of float
        Distortion coefficients; empty for a pinhole.

    Raises
    ------
    CameraError
        When a value is out of range or the model is unknown.
    """

    model: str
    width: int
    height: int
    f_px: float
    fy_px: float = field(default=math.nan)
    cx_px: float = field(default=math.nan)
    cy_px: float = field(default=math.nan)
    k: tuple[float, ...] = ()
    p: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if self.model not in MODELS:
            raise CameraError(f"camera model {self.model!r} is not known; known: {', '.join(MODELS)}")
        for name in ("width", "height"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or not 1 <= value <= 100_000:
                raise CameraError(f"camera {name} = {value!r} must be a whole number of pixels from 1 to 100000")
            object.__setattr__(self, name, int(value))
        defaults = {"f_px": math.nan, "fy_px": self.f_px, "cx_px": (self.width - 1) / 2, "cy_px": (self.height - 1) / 2}
        for name, default in defaults.items():
            object.__setattr__(self, name, _number(name, getattr(self, name), default))
        if self.f_px <= 0 or self.fy_px <= 0:
            raise CameraError(f"camera focal lengths f_px = {self.f_px}, fy_px = {self.fy_px} must be positive pixels")
        for name in ("k", "p"):
            try:
                values = tuple(float(value) for value in getattr(self, name))
            except (TypeError, ValueError):
                raise CameraError(f"camera {name} must be a list of numbers") from None
            object.__setattr__(self, name, values)
        if self.model == "pinhole" and any((*self.k, *self.p)):
            raise CameraError("camera model 'pinhole' takes no distortion coefficients; leave k and p empty")

    @classmethod
    def pinhole(cls, width: int, height: int, hfov_deg: float) -> Camera:
        """Make a pinhole camera from its size and its horizontal field of view, edge to edge, in degrees."""
        if not (isinstance(hfov_deg, (int, float, np.number)) and 0 < hfov_deg < 180):
            raise CameraError(f"hfov_deg = {hfov_deg!r} must lie between 0 and 180 degrees for a pinhole")
        return cls("pinhole", width, height, f_px=float(width / 2 / math.tan(math.radians(float(hfov_deg)) / 2)))

    @classmethod
    def from_dict(cls, record: Mapping[str, Any]) -> Camera:
        """Make a camera from the keys of the frame record's ``camera`` object."""
        names = ("model", "width", "height", "f_px", "fy_px", "cx_px", "cy_px", "k", "p")
        if missing := [name for name in names[:4] if name not in record]:
            raise CameraError(f"camera lacks {', '.join(missing)}; see docs/dataset_format.md")
        if unknown := sorted(set(record) - set(names)):
            raise CameraError(f"camera has unknown keys {', '.join(unknown)}; allowed: {', '.join(names)}")
        return cls(**{name: record[name] for name in names if record.get(name) is not None})

    @classmethod
    def from_json(cls, path: str | Path) -> Camera:
        """Read a camera from a JSON file: a bare camera object, or a frame record that holds it under ``camera``."""
        try:
            record = json.loads(Path(path).read_text(encoding="utf-8"))
        except OSError as error:
            raise CameraError(f"cannot read camera file {path}: {error.strerror}") from None
        except ValueError as error:
            raise CameraError(f"camera file {path} is not JSON: {error}") from None
        if isinstance(record, dict) and "camera" in record:
            record = record["camera"]
        if not isinstance(record, dict):
            raise CameraError(f"camera file {path} must hold an object with model, width, height, f_px")
        return cls.from_dict(record)

    def to_rays(self, uv: ArrayLike) -> NDArray[np.float64]:
        """Unproject pixels.

        Parameters
        ----------
        uv : array_like, shape (n, 2)
            Pixel positions.

        Returns
        -------
        ndarray, shape (n, 3)
            Unit vectors in the camera frame.
        """
        uv = np.asarray(uv, dtype=np.float64).reshape(-1, 2)
        rays = np.ones((len(uv), 3))
        rays[:, 0] = (uv[:, 0] - self.cx_px) / self.f_px
        rays[:, 1] = (uv[:, 1] - self.cy_px) / self.fy_px
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        return rays

    def project(self, dirs: ArrayLike) -> NDArray[np.float64]:
        """Project directions.

        Parameters
        ----------
        dirs : array_like, shape (n, 3)
            Directions in the camera frame, of any length.

        Returns
        -------
        ndarray, shape (n, 2)
            Pixel positions; NaN where the direction is behind the camera.
        """
        dirs = np.asarray(dirs, dtype=np.float64).reshape(-1, 3)
        z = np.where(dirs[:, 2] > 0, dirs[:, 2], np.nan)
        return np.column_stack((self.cx_px + self.f_px * dirs[:, 0] / z, self.cy_px + self.fy_px * dirs[:, 1] / z))

    def in_frame(self, uv: NDArray[np.float64], margin_px: float = 0.0) -> NDArray[np.bool_]:
        """Tell which positions, shape (n, 2), lie in the frame widened by `margin_px`; shape (n,)."""
        u, v = uv[:, 0], uv[:, 1]
        inside_u = (u >= -0.5 - margin_px) & (u <= self.width - 0.5 + margin_px)
        return np.asarray(inside_u & (v >= -0.5 - margin_px) & (v <= self.height - 0.5 + margin_px))

    @property
    def solid_angle_sr(self) -> float:
        """Solid angle of the frame in steradians: each corner pyramid of a pinhole subtends asin(sin a sin b)."""
        right, left = (self.width - 0.5 - self.cx_px) / self.f_px, (self.cx_px + 0.5) / self.f_px
        down, up = (self.height - 0.5 - self.cy_px) / self.fy_px, (self.cy_px + 0.5) / self.fy_px

        def corner(x: float, y: float) -> float:
            return math.atan2(x * y, math.sqrt(1 + x * x + y * y))

        return corner(right, down) + corner(right, up) + corner(left, down) + corner(left, up)


def _number(name: str, value: object, default: float) -> float:
    """Return `value` as a finite float, or `default` where it is the marker NaN."""
    if isinstance(value, bool) or not isinstance(value, (int, float, np.number)):
        raise CameraError(f"camera {name} = {value!r} must be a number of pixels")
    number = float(np.real(value))
    number = default if math.isnan(number) else number
    if not math.isfinite(number):
        raise CameraError(f"camera {name} must be a finite number of pixels")
    return number
