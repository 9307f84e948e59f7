"""Camera model: conversion between pixels and directions.

Pixel centres are at integers; x points right, y down and z along the boresight.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from celnav import projection
from celnav.checking import finite_number, real_array, real_rows, shown
from celnav.errors import CameraError
from celnav.lens.lens_uncertainty import LensUncertainty

PERSPECTIVE = ("pinhole", "brown_conrady")
FISHEYE = ("kannala_brandt", "equidistant", "equisolid", "stereographic", "orthographic")
MODELS = (*PERSPECTIVE, *FISHEYE)
MAX_SIDE_PX = 100_000
# No real lens is outside these limits, and within them no square overflows.
_FOCAL_PX, _LARGEST_CENTRE_PX, _LARGEST_COEFFICIENT = (0.01, 1e9), 1e7, 1e9
OUTSIDE_FRAME_PART = 0.05
"""Distance by which positions may lie outside the frame, as a fraction of its width."""
# Number of coefficients k that each model takes; models not listed take none.
_RADIAL = {"brown_conrady": 6, "kannala_brandt": 4}
_MOST_TILT_RAD = 0.5
_NAMES = ("model", "width", "height", "f_px", "fy_px", "cx_px", "cy_px", "k", "p", "s", "tilt_rad")


@dataclass(frozen=True)
class Camera:
    """A camera without its attitude.

    Attributes
    ----------
    model : str
        Projection: ``pinhole``; ``brown_conrady`` (k1..k6 as OpenCV); ``kannala_brandt`` (k1..k4 as OpenCV's ``fisheye``);
        ``equidistant``, ``equisolid``, ``stereographic``, ``orthographic``.
    width, height : int
        Size of the frame, pixels.
    f_px, fy_px : float
        Focal length along u and v, pixels; `fy_px` is `f_px` unless given.
    cx_px, cy_px : float
        Principal point, pixels; the centre of the frame, ((width - 1)/2, (height - 1)/2), unless given.
    k : tuple of float
        Radial distortion coefficients, as many as the model takes or fewer; empty for the ideal projections.
    p, s, tilt_rad : tuple of float
        For any model, as in OpenCV: decentring p1, p2; thin prism s1..s4; tilt of the sensor tau_x, tau_y, radians.
    uncertainty : LensUncertainty or None
        Uncertainty of the calibrated parameters; None: they are taken as exact. Comparisons of cameras ignore it.

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
    s: tuple[float, ...] = ()
    tilt_rad: tuple[float, ...] = ()
    uncertainty: LensUncertainty | None = field(default=None, compare=False, repr=False)

    def __post_init__(self) -> None:
        if self.model not in MODELS:
            raise CameraError(f"camera model {self.model!r} is not known; known: {', '.join(MODELS)}")
        for name in ("width", "height"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or not 1 <= value <= MAX_SIDE_PX:
                raise CameraError(
                    f"camera {name} = {shown(value)} must be a whole number of pixels from 1 to {MAX_SIDE_PX}"
                )
            object.__setattr__(self, name, int(value))
        defaults = {"f_px": math.nan, "fy_px": self.f_px, "cx_px": (self.width - 1) / 2, "cy_px": (self.height - 1) / 2}
        for name, default in defaults.items():
            object.__setattr__(self, name, _number(name, getattr(self, name), default))
        if not all(_FOCAL_PX[0] <= f_px <= _FOCAL_PX[1] for f_px in (self.f_px, self.fy_px)):
            limits = f"from {_FOCAL_PX[0]:g} to {_FOCAL_PX[1]:g}"
            raise CameraError(f"camera focal lengths f_px = {self.f_px}, fy_px = {self.fy_px} must be {limits} pixels")
        if max(abs(self.cx_px), abs(self.cy_px)) > _LARGEST_CENTRE_PX:
            raise CameraError(f"camera cx_px, cy_px must be within {_LARGEST_CENTRE_PX:g} pixels")
        radial = _RADIAL.get(self.model, 0)
        for name, most in (("k", radial), ("p", 2), ("s", 4), ("tilt_rad", 2)):
            object.__setattr__(self, name, _coefficients(self.model, name, getattr(self, name), most))
        if any(abs(angle) > _MOST_TILT_RAD for angle in self.tilt_rad):
            raise CameraError(f"camera tilt_rad = {list(self.tilt_rad)} must be within {_MOST_TILT_RAD} radians")

    @classmethod
    def pinhole(cls, width: int, height: int, hfov_deg: float) -> Camera:
        """Make a pinhole camera from its size and its horizontal field of view, edge to edge, in degrees.

        Raises
        ------
        CameraError
            When a pinhole camera cannot have this size or field of view.
        """
        hfov_deg = finite_number(hfov_deg, "hfov_deg", CameraError)
        if not 0 < hfov_deg < 180:
            raise CameraError(f"hfov_deg = {hfov_deg:g} must lie between 0 and 180 degrees for a pinhole")
        width_px = finite_number(width, "camera width", CameraError, 1, MAX_SIDE_PX)
        return cls("pinhole", width, height, f_px=width_px / 2 / math.tan(math.radians(hfov_deg) / 2))

    @classmethod
    def from_dict(cls, record: Mapping[str, Any]) -> Camera:
        """Make a camera from the keys of the frame record's ``camera`` object.

        Raises
        ------
        CameraError
            When a key is missing or unknown, or its value is not valid for a camera.
        """
        if missing := [name for name in _NAMES[:4] if name not in record]:
            raise CameraError(f"camera lacks {', '.join(missing)}; see docs/dataset_format.md")
        allowed = (*_NAMES, "uncertainty")
        if unknown := sorted(set(record) - set(allowed)):
            raise CameraError(f"camera has unknown keys {', '.join(unknown)}; allowed: {', '.join(allowed)}")
        known = {name: record[name] for name in _NAMES if record.get(name) is not None}
        if record.get("uncertainty") is not None:
            known["uncertainty"] = LensUncertainty.from_dict(record["uncertainty"])
        return cls(**known)

    @classmethod
    def from_json(cls, path: str | Path) -> Camera:
        """Read a camera from a JSON file: a bare camera object, or a frame record that holds it under ``camera``.

        Raises
        ------
        CameraError
            When the file cannot be read or holds no valid camera; the message names the key.
        """
        try:
            record = json.loads(Path(path).read_text(encoding="utf-8-sig"))
        except OSError as error:
            raise CameraError(f"cannot read camera file {path}: {error.strerror}") from None
        except (ValueError, RecursionError) as error:
            raise CameraError(f"camera file {path} is not JSON: {error}") from None
        if isinstance(record, dict) and "camera" in record:
            record = record["camera"]
        if not isinstance(record, dict):
            raise CameraError(f"camera file {path} must hold an object with model, width, height, f_px")
        return cls.from_dict(record)

    def to_dict(self) -> dict[str, Any]:
        """Return the frame record's ``camera`` object; coefficients that the lens does not have are left out."""
        values: dict[str, Any] = {name: getattr(self, name) for name in _NAMES}
        for name in ("k", "p", "s", "tilt_rad"):
            values[name] = list(values[name])
        kept = {name: value for name, value in values.items() if name not in ("p", "s", "tilt_rad") or value}
        return kept if self.uncertainty is None else kept | {"uncertainty": self.uncertainty.to_dict()}

    def to_json(self) -> str:
        """Return the camera as a JSON document; `from_json` restores it to the last bit."""
        return json.dumps(self.to_dict(), indent=1, allow_nan=False) + "\n"

    def to_rays(self, uv: ArrayLike) -> NDArray[np.float64]:
        """Unproject pixels.

        Parameters
        ----------
        uv : array_like, shape (n, 2)
            Pixel positions.

        Returns
        -------
        ndarray, shape (n, 3)
            Unit vectors in the camera frame; NaN outside the image circle of a fisheye, and where a distortion has no
            inverse.
        """
        uv = real_rows(uv, 2, "uv", CameraError)
        x, y = (uv[:, 0] - self.cx_px) / self.f_px, (uv[:, 1] - self.cy_px) / self.fy_px
        if self._tilt is not None:
            x, y = projection.onto(np.asarray(np.linalg.inv(self._tilt), np.float64), x, y)
        if self.model in PERSPECTIVE:
            if not self._undistorted:
                x, y = projection.undistort(x, y, self.k, self.p, self._limit, self.s)
            rays = np.ones((len(uv), 3))
            rays[:, 0], rays[:, 1] = x, y
            rays /= np.sqrt(x * x + y * y + 1.0)[:, None]
            return rays
        if any(self.p) or any(self.s):
            x, y = projection.recentre(x, y, self.p, self.s)
        radius = np.hypot(x, y)
        theta = projection.angle_of(self._law, radius, self.k, self._limit)
        # On the axis the radius is zero, so its direction does not matter.
        part = np.sin(theta) / np.where(radius > 0, radius, 1.0)
        return np.column_stack((x * part, y * part, np.cos(theta)))

    def project(self, dirs: ArrayLike) -> NDArray[np.float64]:
        """Project directions.

        Parameters
        ----------
        dirs : array_like, shape (n, 3)
            Directions in the camera frame, of any length.

        Returns
        -------
        ndarray, shape (n, 2)
            Pixel positions; NaN for directions that the camera cannot see: behind a perspective camera, or beyond the
            angle up to which the distortion is one to one.
        """
        dirs = real_rows(dirs, 3, "dirs", CameraError)
        if self.model in PERSPECTIVE:
            z = dirs[:, 2]
            if not (ahead := z > 0).all():
                z = np.where(ahead, z, np.nan)
            x, y = dirs[:, 0] / z, dirs[:, 1] / z
            if not self._undistorted:
                seen = x * x + y * y <= self._limit**2
                x, y = np.where(seen, x, np.nan), np.where(seen, y, np.nan)
                x, y = projection.distort(x, y, self.k, self.p, self.s)
        else:
            across = np.hypot(dirs[:, 0], dirs[:, 1])
            theta = np.arctan2(across, dirs[:, 2])
            radius = projection.radius_of(self._law, np.where(theta <= self._limit, theta, np.nan), self.k)
            part = radius / np.where(across > 0, across, 1.0)
            x, y = dirs[:, 0] * part, dirs[:, 1] * part
            if any(self.p) or any(self.s):
                x, y = projection.decentre(x, y, self.p, self.s)
        if self._tilt is not None:
            x, y = projection.onto(self._tilt, x, y)
        uv = np.empty((len(dirs), 2))
        uv[:, 0] = self.cx_px + self.f_px * x
        uv[:, 1] = self.cy_px + self.fy_px * y
        return uv

    def project_with_derivatives(self, dirs: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Project unit vectors, shape (n, 3); also return the derivatives by their components, shape (n, 2, 3)."""
        uv = self.project(dirs)
        by_direction = np.zeros((len(dirs), 2, 3))
        if self._plain:
            x, y, z = dirs.T
            inverse = 1.0 / np.where(z > 0, z, np.nan)
            by_direction[:, 0, 0], by_direction[:, 1, 1] = self.f_px * inverse, self.fy_px * inverse
            by_direction[:, 0, 2] = -self.f_px * x * inverse**2
            by_direction[:, 1, 2] = -self.fy_px * y * inverse**2
            return uv, by_direction
        h = 1e-6
        for axis in range(3):
            step = np.zeros(3)
            step[axis] = h
            by_direction[:, :, axis] = (self.project(dirs + step) - self.project(dirs - step)) / (2 * h)
        return uv, by_direction

    @property
    def _law(self) -> projection.Law:
        return cast("projection.Law", self.model)

    @cached_property
    def _undistorted(self) -> bool:
        """Whether this is a perspective lens without distortion and decentring; `brown_conrady` never counts as one."""
        return self.model == "pinhole" and not (any(self.p) or any(self.s))

    @cached_property
    def _plain(self) -> bool:
        """Whether image coordinates are those of an ideal pinhole camera."""
        return self._undistorted and self._tilt is None

    @cached_property
    def _tilt(self) -> NDArray[np.float64] | None:
        """Homography of the tilted sensor, shape (3, 3); None without tilt."""
        if not any(self.tilt_rad):
            return None
        tau_x, tau_y = (*self.tilt_rad, 0.0)[:2]
        return projection.tilted_sensor(tau_x, tau_y)

    @cached_property
    def _limit(self) -> float:
        """Limit up to which the projection is one to one: tangent of the angle (perspective) or angle (fisheye)."""
        if self.model == "brown_conrady":
            return projection.distortion_limit(self.k)
        return math.inf if self.model == "pinhole" else projection.largest_angle(self._law, self.k)

    def radians_per_px(self, uv: NDArray[np.float64]) -> NDArray[np.float64]:
        """Plate scale at pixel positions, shape (n,): the square root of the solid angle of a pixel there."""
        if self._plain:
            x, y = (uv[:, 0] - self.cx_px) / self.f_px, (uv[:, 1] - self.cy_px) / self.fy_px
            return np.asarray((1 + x * x + y * y) ** -0.75 / math.sqrt(self.f_px * self.fy_px))
        h = 0.25
        along_u = (self.to_rays(uv + np.array([h, 0])) - self.to_rays(uv - np.array([h, 0]))) / (2 * h)
        along_v = (self.to_rays(uv + np.array([0, h])) - self.to_rays(uv - np.array([0, h]))) / (2 * h)
        return np.asarray(np.sqrt(np.linalg.norm(np.cross(along_u, along_v), axis=1)))

    def in_frame(self, uv: NDArray[np.float64], margin_px: float = 0.0) -> NDArray[np.bool_]:
        """Return which positions, shape (n, 2), are in the frame widened by `margin_px`; shape (n,). NaN is outside."""
        u, v = uv[:, 0], uv[:, 1]
        inside_u = (u >= -0.5 - margin_px) & (u <= self.width - 0.5 + margin_px)
        return np.asarray(inside_u & (v >= -0.5 - margin_px) & (v <= self.height - 0.5 + margin_px))

    def check_positions(self, uv: NDArray[np.float64]) -> None:
        """Raise `CameraError` if a position, shape (n, 2), is far outside the frame."""
        outside = ~self.in_frame(uv, OUTSIDE_FRAME_PART * self.width)
        if outside.any():
            u, v = uv[np.flatnonzero(outside)[0]]
            raise CameraError(
                f"detection at ({u:.1f}, {v:.1f}) lies outside the camera's {self.width} x {self.height} pixels: "
                "is this the right camera?"
            )

    @cached_property
    def solid_angle_sr(self) -> float:
        """Solid angle of the frame in steradians.

        Each corner pyramid of a pinhole subtends atan(x y / sqrt(1 + x^2 + y^2)); other models are integrated over a
        grid of 64 x 64 points.
        """
        if not self._plain:
            u = (np.arange(64) + 0.5) / 64 * self.width - 0.5
            v = (np.arange(64) + 0.5) / 64 * self.height - 0.5
            scale = self.radians_per_px(np.column_stack([axis.ravel() for axis in np.meshgrid(u, v)]))
            return float(np.nansum(scale**2) * self.width * self.height / 64**2)
        right, left = (self.width - 0.5 - self.cx_px) / self.f_px, (self.cx_px + 0.5) / self.f_px
        down, up = (self.height - 0.5 - self.cy_px) / self.fy_px, (self.cy_px + 0.5) / self.fy_px

        def corner(x: float, y: float) -> float:
            return math.atan2(x * y, math.sqrt(1 + x * x + y * y))

        return corner(right, down) + corner(right, up) + corner(left, down) + corner(left, up)


def _coefficients(model: str, name: str, given: ArrayLike, most: int) -> tuple[float, ...]:
    """Return the coefficients as a tuple of at most `most` floats; zeros beyond `most` are dropped."""
    array = real_array(given, f"camera {name}", CameraError)
    if array.ndim != 1 or not (np.abs(array) <= _LARGEST_COEFFICIENT).all():
        raise CameraError(f"camera {name} must be a list of numbers, none of them above {_LARGEST_COEFFICIENT:g}")
    values = tuple(array.tolist())
    if any(values[most:]):
        takes = (
            f"at most {most} coefficients {name}" if most else f"no distortion coefficients {name}; leave {name} empty"
        )
        raise CameraError(f"camera model {model!r} takes {takes}")
    return values[:most]


def _number(name: str, value: object, default: float) -> float:
    """Return `value` as a finite float, or `default` where it is the marker NaN."""
    given = default if isinstance(value, (float, np.floating)) and math.isnan(value) else value
    return finite_number(given, f"camera {name}", CameraError)
