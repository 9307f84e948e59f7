"""The lens of a platepar, the calibration file of the Global Meteor Network's program RMS.

RMS maps a pixel to the plane of an equidistant lens: pixel plus correction, over `F_scale` pixels per degree. The correction
is a cubic with radial terms for each axis (`poly3+radial`, `+radial3`, `+radial5`), or a polynomial of the distance from a
centre (`radial3-all` to `radial5-all`, `radial3-odd` to `radial9-odd`) with an aspect and an asymmetry. celnav's lenses map
in the other direction and have other terms, so a sufficiently general one is fitted to the map, and the residual is stated.

Source: RMS (Vida et al. 2021, MNRAS 506, 5046) and its file format (github.com/CroatianMeteorNetwork/RMS).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from celnav.camera import Camera
from celnav.checking import finite_number
from celnav.errors import CameraError

F8 = NDArray[np.float64]

# Radial coefficients of each type: the powers of the distance that they belong to.
_POWERS = {
    "radial3-all": (2, 3),
    "radial4-all": (2, 3, 4),
    "radial5-all": (2, 3, 4, 5),
    "radial3-odd": (3,),
    "radial5-odd": (3, 5),
    "radial7-odd": (3, 5, 7),
    "radial9-odd": (3, 5, 7, 9),
}
# Powers of the distance in the terms of each polynomial in addition to its cubic, which has twelve numbers with x r and y r.
_FURTHER = {"poly3+radial": (), "poly3+radial3": (3,), "poly3+radial5": (3, 5)}
TYPES = (*_FURTHER, *_POWERS)
_CUBIC = 12
# The lens is fitted on a grid of this many points, up to this angle from the axis, where the map is one to one.
_GRID, _WIDEST_DEG, _LEAST_STRETCH = (24, 36), 95.0, 0.05
_FEWEST_POINTS = 60
# Parameters of the fit in the plane: f, aspect, centre, four radial terms, decentring, thin prism, sensor tilt, rotation.
_PARAMETERS = 19


@dataclass(frozen=True)
class FittedLens:
    """A lens, and its residuals from the platepar's map.

    Attributes
    ----------
    camera : Camera
        The lens.
    rms_px, largest_px : float
        Distances between the two over the frame, pixels: root mean square, and largest.
    """

    camera: Camera
    rms_px: float
    largest_px: float


def plane_of_platepar(record: Mapping[str, Any], uv: F8) -> F8:
    """Map pixels to the plane of an equidistant lens, degrees from the axis, as RMS does; shapes (n, 2).

    Raises
    ------
    CameraError
        For a type of distortion that RMS does not have, or missing coefficients.
    """
    width, height = (_number(record, key) for key in ("X_res", "Y_res"))
    kind = str(record.get("distortion_type") or "poly3+radial")
    if kind not in TYPES:
        raise CameraError(f"distortion_type {kind[:40]!r} is not known; known: {', '.join(TYPES)}")
    x, y = uv[:, 0] - width / 2, uv[:, 1] - height / 2
    moved = _radial(record, kind, x, y, width, height) if kind in _POWERS else _polynomial(record, kind, x, y)
    return np.column_stack(moved) / _number(record, "F_scale")


def lens_of_platepar(record: Mapping[str, Any]) -> FittedLens:
    """Fit a Kannala-Brandt lens with aspect, decentring, thin prism and tilt to the map of a platepar.

    The axis of the fitted lens may be rotated relative to that of the platepar, whose pointing is not read.

    Raises
    ------
    CameraError
        When a value is missing or out of range, or no lens follows the map.
    """
    from scipy.optimize import least_squares

    width, height, scale = (_number(record, key) for key in ("X_res", "Y_res", "F_scale"))
    if width != int(width) or height != int(height) or min(width, height) < 8:
        raise CameraError("X_res and Y_res must be whole numbers of pixels, 8 or more")
    if not scale > 0:
        raise CameraError(f"F_scale = {scale:g} must be positive, in pixels per degree")
    uv, rays = _map_on_grid(record, width, height)
    size = np.array([width, height])
    f_px = math.degrees(scale)

    def camera_and_turn(values: F8) -> tuple[Camera, F8]:
        own = f_px * (1 + float(values[0]))
        cx, cy = ((size - 1) / 2 + values[2:4] * f_px).tolist()
        k, p, prism, tilt = (tuple(values[a:b].tolist()) for a, b in ((4, 8), (8, 10), (10, 14), (14, 16)))
        other = own * (1 + float(values[1]))
        camera = Camera("kannala_brandt", int(width), int(height), own, other, cx, cy, k, p, prism, tilt)
        return camera, values[16:]

    def residuals(values: F8) -> F8:
        try:
            camera, turn = camera_and_turn(values)
        except CameraError:
            return np.full(2 * len(uv) + _PARAMETERS, 1e6)
        off = np.nan_to_num(camera.project(_turned(rays, turn)) - uv, nan=1e3)
        # Keep terms small that can compensate each other.
        return np.concatenate((off.ravel(), 1e-3 * values))

    with np.errstate(all="ignore"):
        found = least_squares(residuals, np.zeros(_PARAMETERS), x_scale="jac", max_nfev=200)
        camera, turn = camera_and_turn(found.x)
        off = np.hypot(*(camera.project(_turned(rays, turn)) - uv).T)
    if not np.isfinite(off).all():
        raise CameraError("the distortion of this platepar is not one to one over its frame: calibrate from the stars")
    return FittedLens(camera, float(np.sqrt(np.mean(off**2))), float(off.max()))


def _map_on_grid(record: Mapping[str, Any], width: float, height: float) -> tuple[F8, F8]:
    """Return points of the frame where the map is one to one, shape (n, 2), and their directions, shape (n, 3)."""
    rows, columns = _GRID
    v, u = np.meshgrid(np.linspace(0, height - 1, rows), np.linspace(0, width - 1, columns), indexing="ij")
    uv = np.column_stack((u.ravel(), v.ravel()))
    plane = plane_of_platepar(record, uv)
    along_u, along_v = (
        (plane_of_platepar(record, uv + step) - plane_of_platepar(record, uv - step)) for step in np.eye(2) / 2
    )
    stretch = along_u[:, 0] * along_v[:, 1] - along_u[:, 1] * along_v[:, 0]
    angle = np.hypot(*plane.T)
    good = np.isfinite(plane).all(axis=1) & (angle < _WIDEST_DEG)
    good &= stretch * _number(record, "F_scale") ** 2 > _LEAST_STRETCH
    if good.sum() < _FEWEST_POINTS:
        raise CameraError("the distortion of this platepar is not one to one over its frame: calibrate from the stars")
    plane, angle = plane[good], np.radians(angle[good])
    part = np.sinc(angle / np.pi) * np.pi / 180
    return uv[good], np.column_stack((plane[:, 0] * part, plane[:, 1] * part, np.cos(angle)))


def _turned(rays: F8, turn: F8) -> F8:
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_rotvec(turn).apply(rays))


def _radial(record: Mapping[str, Any], kind: str, x: F8, y: F8, width: float, height: float) -> tuple[F8, F8]:
    """Correct pixels by a polynomial of the distance from the centre, in units of half the width."""
    coefficients = iter(_coefficients(record, "x").tolist())
    x0, y0, xy, amount, phase = 0.5, 0.5, 0.0, 0.0, 0.0
    if not record.get("force_distortion_centre", False):
        x0, y0 = next(coefficients, 0.0) * width / 2, next(coefficients, 0.0) * height / 2
    # RMS wraps offsets into the image.
    x0, y0 = (x0 + width / 2) % width - width / 2, (y0 + height / 2) % height - height / 2
    if not record.get("equal_aspect", False):
        xy = next(coefficients, 0.0)
    if record.get("asymmetry_corr", False):
        amount, phase = next(coefficients, 0.0), 2 * math.pi * next(coefficients, 0.0)
    x, y = x - x0, (1 + xy) * (y - y0)
    r = (np.hypot(x, y) + amount * (y * math.cos(phase) - x * math.sin(phase))) * 2 / width
    part = np.ones_like(r)
    for power in _POWERS[kind]:
        part += next(coefficients, 0.0) * r ** (power - 1)
    return x * part, y * part


def _polynomial(record: Mapping[str, Any], kind: str, x: F8, y: F8) -> tuple[F8, F8]:
    """Correct pixels by cubics of the coordinates with radial terms."""
    number = _CUBIC + len(_FURTHER[kind])
    of_x, of_y = (np.append(_coefficients(record, axis), np.zeros(number))[:number] for axis in "xy")
    r = np.hypot(x - of_x[0], y - of_y[0])
    terms = [np.ones_like(x), x, y, x * x, x * y, y * y, x**3, x * x * y, x * y * y, y**3]
    moved = []
    for own, other, coefficients in ((x, y, of_x), (y, x, of_y)):
        # The terms with r start with the axis' own coordinate.
        radial = [own * r, other * r, *(own * r**power for power in _FURTHER[kind])]
        moved.append(own + coefficients @ np.stack([*terms, *radial]))
    return moved[0], moved[1]


def has_distortion(record: Mapping[str, Any]) -> bool:
    """Return whether a platepar states its distortion, and not only the scale."""
    return any(key in record for key in ("x_poly_fwd", "x_poly"))


def _coefficients(record: Mapping[str, Any], axis: str) -> F8:
    """Return the forward polynomial of an axis; the first version of the format has one polynomial for both directions."""
    key = next((key for key in (f"{axis}_poly_fwd", f"{axis}_poly") if key in record), "")
    if not key:
        raise CameraError(f"the platepar lacks {axis}_poly_fwd")
    value = record[key]
    if not isinstance(value, list) or not 1 <= len(value) <= 64:
        raise CameraError(f"{key} must be a list of numbers")
    return np.array([finite_number(each, key, CameraError) for each in value])


def _number(record: Mapping[str, Any], key: str) -> float:
    return finite_number(record.get(key), key, CameraError, -1e9, 1e9)
