"""Projections of camera models: normalised image coordinates from directions, and back.

Normalised coordinates are pixels from the principal point over the focal length; x right, y down, z along the
boresight. Sources: Brown 1966 and Conrady 1919 in the form of OpenCV's ``projectPoints`` (rational radial term);
Kannala & Brandt 2006, IEEE TPAMI 28(8) 1335, in the form of ``cv2.fisheye``; the four ideal fisheye laws as in
Ray 2002, Applied Photographic Optics. Decentring, thin prism (Weng, Cohen & Herniou 1992, IEEE TPAMI 14(10) 965) and a
tilted sensor (Louhichi et al. 2007, Meas. Sci. Technol. 18(8) 2616) in the form of OpenCV's ``projectPoints``; for a
fisheye, they act on the coordinates that its law gives.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Literal

import numpy as np
from numpy.typing import NDArray

F8 = NDArray[np.float64]
Law = Literal["equidistant", "equisolid", "stereographic", "orthographic", "kannala_brandt"]

_NEWTON_ROUNDS = 60
_CONVERGED = 1e-14
_SEARCH_STEPS = 4000


def _off_axis_shift(x: F8, y: F8, r2: F8, p: tuple[float, ...], s: tuple[float, ...]) -> tuple[F8, F8]:
    """Shift by decentring p1, p2 and thin prism s1..s4 at normalised coordinates; r2 = x^2 + y^2, missing terms are 0."""
    p1, p2 = (*p, *([0.0] * (2 - len(p))))
    dx, dy = 2 * p1 * x * y + p2 * (r2 + 2 * x * x), p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    if s:
        s1, s2, s3, s4 = (*s, *([0.0] * (4 - len(s))))
        dx, dy = dx + s1 * r2 + s2 * r2 * r2, dy + s3 * r2 + s4 * r2 * r2
    return dx, dy


def distort(x: F8, y: F8, k: tuple[float, ...], p: tuple[float, ...], s: tuple[float, ...] = ()) -> tuple[F8, F8]:
    """Apply Brown-Conrady distortion to normalised coordinates; k1..k6 (rational), p1, p2 and s1..s4 as in OpenCV."""
    k1, k2, k3, k4, k5, k6 = (*k, *([0.0] * (6 - len(k))))
    r2 = x * x + y * y
    radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    dx, dy = _off_axis_shift(x, y, r2, p, s)
    return x * radial + dx, y * radial + dy


def decentre(x: F8, y: F8, p: tuple[float, ...], s: tuple[float, ...]) -> tuple[F8, F8]:
    """Apply decentring and thin prism to the coordinates that a fisheye's law gives."""
    dx, dy = _off_axis_shift(x, y, x * x + y * y, p, s)
    return x + dx, y + dy


def undistort(
    xd: F8, yd: F8, k: tuple[float, ...], p: tuple[float, ...], r_max: float, s: tuple[float, ...] = ()
) -> tuple[F8, F8]:
    """Invert `distort` by Newton's method; NaN where no radius up to `r_max` gives the position."""
    return _invert(lambda x, y: distort(x, y, k, p, s), xd, yd, r_max)


def recentre(xd: F8, yd: F8, p: tuple[float, ...], s: tuple[float, ...]) -> tuple[F8, F8]:
    """Invert `decentre` by Newton's method; NaN where it has no inverse."""
    return _invert(lambda x, y: decentre(x, y, p, s), xd, yd, math.inf)


def _invert(mapping: Callable[[F8, F8], tuple[F8, F8]], xd: F8, yd: F8, r_max: float) -> tuple[F8, F8]:
    """Solve mapping(x, y) = (xd, yd) near (xd, yd); NaN where there is no solution within `r_max` of the origin."""
    x, y = xd.copy(), yd.copy()
    h = 1e-6
    for _ in range(_NEWTON_ROUNDS):
        fx, fy = mapping(x, y)
        ax, ay = mapping(x + h, y)
        bx, by = mapping(x, y + h)
        a, b, c, d = (ax - fx) / h, (bx - fx) / h, (ay - fy) / h, (by - fy) / h
        determinant = a * d - b * c
        determinant = np.where(np.abs(determinant) < 1e-6, 1e-6, determinant)
        ex, ey = xd - fx, yd - fy
        step_x, step_y = (d * ex - b * ey) / determinant, (a * ey - c * ex) / determinant
        # A step of more than half the radius would leave the branch that contains the optical axis.
        length = np.hypot(step_x, step_y)
        limit = np.minimum(1.0, (0.25 + 0.5 * np.hypot(x, y)) / np.maximum(length, 1e-100))
        x, y = x + step_x * limit, y + step_y * limit
        if not length.size or float(np.nanmax(length, initial=0.0)) < _CONVERGED:
            break
    fx, fy = mapping(x, y)
    bad = ~((np.hypot(fx - xd, fy - yd) < 1e-9) & (np.hypot(x, y) <= r_max))
    return np.where(bad, np.nan, x), np.where(bad, np.nan, y)


def tilted_sensor(tau_x: float, tau_y: float) -> F8:
    """Homography, shape (3, 3), of normalised coordinates onto a sensor tilted by `tau_x` about u and `tau_y` about v (rad).

    The rays of the tilted frame are intersected with the plane at unit distance along the old axis.
    """
    sin_x, cos_x, sin_y, cos_y = math.sin(tau_x), math.cos(tau_x), math.sin(tau_y), math.cos(tau_y)
    turn = np.array(
        [
            [cos_y, sin_x * sin_y, -cos_x * sin_y],
            [0.0, cos_x, sin_x],
            [sin_y, -sin_x * cos_y, cos_x * cos_y],
        ]
    )
    scaled = turn[2, 2] * turn[:2] - turn[:2, 2:] * turn[2]
    return np.vstack((scaled, turn[2]))


def onto(homography: F8, x: F8, y: F8) -> tuple[F8, F8]:
    """Map points by a homography; NaN for points that fall behind the camera."""
    x1, y1, w = (row[0] * x + row[1] * y + row[2] for row in homography)
    w = np.where(w > 0, w, np.nan)
    return x1 / w, y1 / w


def distortion_limit(k: tuple[float, ...]) -> float:
    """Radius up to which the Brown-Conrady radial term increases; beyond it, two directions would share a pixel."""
    r = np.linspace(0.0, 20.0, _SEARCH_STEPS)
    image, _ = distort(r, np.zeros_like(r), k, ())
    falling = np.flatnonzero(~(np.diff(image) > 0))
    return float(r[falling[0]]) if len(falling) else float("inf")


def theta_polynomial(theta: F8, k: tuple[float, ...]) -> F8:
    """Kannala-Brandt radius at an angle: theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8)."""
    k1, k2, k3, k4 = (*k, *([0.0] * (4 - len(k))))
    t2 = theta * theta
    return np.asarray(theta * (1 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4)))))


def largest_angle(law: Law, k: tuple[float, ...]) -> float:
    """Angle from the axis, radians, up to which the law is one to one."""
    if law == "orthographic":
        return np.pi / 2
    if law == "stereographic":
        return np.pi - 1e-3  # the antipode is at infinity
    if law != "kannala_brandt":
        return np.pi
    theta = np.linspace(0.0, np.pi, _SEARCH_STEPS)
    falling = np.flatnonzero(~(np.diff(theta_polynomial(theta, k)) > 0))
    return float(theta[falling[0]]) if len(falling) else np.pi


def radius_of(law: Law, theta: F8, k: tuple[float, ...]) -> F8:
    """Normalised image radius at an angle from the axis, radians."""
    if law == "kannala_brandt":
        return theta_polynomial(theta, k)
    if law == "equidistant":
        return theta
    if law == "equisolid":
        return np.asarray(2 * np.sin(theta / 2))
    if law == "stereographic":
        return np.asarray(2 * np.tan(theta / 2))
    return np.asarray(np.sin(theta))


def angle_of(law: Law, radius: F8, k: tuple[float, ...], theta_max: float) -> F8:
    """Angle from the axis for a normalised image radius, radians; NaN beyond the image circle."""
    if law == "equidistant":
        theta = radius
    elif law == "equisolid":
        theta = 2 * np.arcsin(np.where(radius <= 2, radius / 2, np.nan))
    elif law == "stereographic":
        theta = 2 * np.arctan(radius / 2)
    elif law == "orthographic":
        theta = np.arcsin(np.where(radius <= 1, radius, np.nan))
    else:
        # The polynomial increases on [0, theta_max], so the grid brackets the root, and Newton's method refines it.
        grid = np.linspace(0.0, theta_max, 2000)
        theta = np.interp(radius, theta_polynomial(grid, k), grid)
        for _ in range(4):
            slope = (theta_polynomial(theta + 1e-6, k) - theta_polynomial(theta - 1e-6, k)) / 2e-6
            theta = theta - (theta_polynomial(theta, k) - radius) / np.where(np.abs(slope) < 1e-9, np.inf, slope)
        theta = np.where(np.abs(theta_polynomial(theta, k) - radius) < 1e-9, theta, np.nan)
    return np.where(theta <= theta_max * (1 + 1e-12), theta, np.nan)
