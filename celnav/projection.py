"""Projections of camera models: normalised image coordinates from directions, and back.

Normalised coordinates are pixels from the principal point over the focal length; x right, y down, z along the
boresight. Sources: Brown 1966 and Conrady 1919 in the form of OpenCV's ``projectPoints`` (rational radial term);
Kannala & Brandt 2006, IEEE TPAMI 28(8) 1335, in the form of ``cv2.fisheye``; the four ideal fisheye laws as in
Ray 2002, Applied Photographic Optics.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

F8 = NDArray[np.float64]
Law = Literal["equidistant", "equisolid", "stereographic", "orthographic", "kannala_brandt"]

_NEWTON_ROUNDS = 60
_CONVERGED = 1e-14
_SEARCH_STEPS = 4000


def distort(x: F8, y: F8, k: tuple[float, ...], p: tuple[float, ...]) -> tuple[F8, F8]:
    """Apply Brown-Conrady distortion to normalised coordinates; k1..k6 (rational) and p1, p2 as OpenCV orders them."""
    k1, k2, k3, k4, k5, k6 = (*k, *([0.0] * (6 - len(k))))
    p1, p2 = (*p, *([0.0] * (2 - len(p))))
    r2 = x * x + y * y
    radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    return (
        x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
        y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
    )


def undistort(xd: F8, yd: F8, k: tuple[float, ...], p: tuple[float, ...], r_max: float) -> tuple[F8, F8]:
    """Invert `distort` by Newton's method; NaN where no radius up to `r_max` gives the position."""
    x, y = xd.copy(), yd.copy()
    h = 1e-6
    for _ in range(_NEWTON_ROUNDS):
        fx, fy = distort(x, y, k, p)
        ax, ay = distort(x + h, y, k, p)
        bx, by = distort(x, y + h, k, p)
        a, b, c, d = (ax - fx) / h, (bx - fx) / h, (ay - fy) / h, (by - fy) / h
        determinant = a * d - b * c
        determinant = np.where(np.abs(determinant) < 1e-6, 1e-6, determinant)
        ex, ey = xd - fx, yd - fy
        step_x, step_y = (d * ex - b * ey) / determinant, (a * ey - c * ex) / determinant
        # A step of more than half the radius leaves the branch that holds the optical axis.
        length = np.hypot(step_x, step_y)
        limit = np.minimum(1.0, (0.25 + 0.5 * np.hypot(x, y)) / np.maximum(length, 1e-100))
        x, y = x + step_x * limit, y + step_y * limit
        if not length.size or float(np.nanmax(length, initial=0.0)) < _CONVERGED:
            break
    fx, fy = distort(x, y, k, p)
    bad = ~((np.hypot(fx - xd, fy - yd) < 1e-9) & (np.hypot(x, y) <= r_max))
    return np.where(bad, np.nan, x), np.where(bad, np.nan, y)


def distortion_limit(k: tuple[float, ...]) -> float:
    """Radius up to which the Brown-Conrady radial term grows: beyond it two directions would share a pixel."""
    r = np.linspace(0.0, 20.0, _SEARCH_STEPS)
    image, _ = distort(r, np.zeros_like(r), k, ())
    falling = np.flatnonzero(~(np.diff(image) > 0))
    return float(r[falling[0]]) if len(falling) else float("inf")


def theta_polynomial(theta: F8, k: tuple[float, ...]) -> F8:
    """Kannala-Brandt radius of an angle: theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8)."""
    k1, k2, k3, k4 = (*k, *([0.0] * (4 - len(k))))
    t2 = theta * theta
    return np.asarray(theta * (1 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4)))))


def largest_angle(law: Law, k: tuple[float, ...]) -> float:
    """Angle from the axis, radians, up to which the law is one to one."""
    if law == "orthographic":
        return np.pi / 2
    if law == "stereographic":
        return np.pi - 1e-3  # the antipode lies at infinity
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
    """Angle from the axis of a normalised image radius, radians; NaN beyond the image circle."""
    if law == "equidistant":
        theta = radius
    elif law == "equisolid":
        theta = 2 * np.arcsin(np.where(radius <= 2, radius / 2, np.nan))
    elif law == "stereographic":
        theta = 2 * np.arctan(radius / 2)
    elif law == "orthographic":
        theta = np.arcsin(np.where(radius <= 1, radius, np.nan))
    else:
        # The polynomial grows on [0, theta_max], so a bracket holds the root and Newton's method polishes it.
        grid = np.linspace(0.0, theta_max, 2000)
        theta = np.interp(radius, theta_polynomial(grid, k), grid)
        for _ in range(4):
            slope = (theta_polynomial(theta + 1e-6, k) - theta_polynomial(theta - 1e-6, k)) / 2e-6
            theta = theta - (theta_polynomial(theta, k) - radius) / np.where(np.abs(slope) < 1e-9, np.inf, slope)
        theta = np.where(np.abs(theta_polynomial(theta, k) - radius) < 1e-9, theta, np.nan)
    return np.where(theta <= theta_max * (1 + 1e-12), theta, np.nan)
