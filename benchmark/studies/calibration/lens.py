"""Projections of all lens models, written for the study: directions to pixels, and their derivatives.

The formulas are those documented for scenarios (`generator.scenario.projection`); the code is neither the renderer's nor the
solver's.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from generator.scenario.projection import Projection

F8 = NDArray[np.float64]
PERSPECTIVE = ("pinhole", "brown_conrady")
_WITH_K1 = {
    "pinhole": "brown_conrady",
    "brown_conrady": "brown_conrady",
    "equidistant": "kannala_brandt",
    "kannala_brandt": "kannala_brandt",
}
_STEP = 1e-6
_RADII: dict[str, Callable[[F8], F8]] = {
    "equidistant": lambda theta: theta,
    "equisolid": lambda theta: 2 * np.sin(theta / 2),
    "stereographic": lambda theta: 2 * np.tan(theta / 2),
    "orthographic": np.sin,
}


def project(rays: F8, lens: Projection) -> F8:
    """Project directions in the camera frame, shape (n, 3), to pixels, shape (n, 2); NaN where the lens has no image."""
    rays = np.asarray(rays, dtype=np.float64)
    limit = _limit(lens)
    if lens.model in PERSPECTIVE:
        z = np.where(rays[:, 2] > 0, rays[:, 2], np.nan)
        x, y = rays[:, 0] / z, rays[:, 1] / z
        q = x * x + y * y
        q = np.where(q <= limit**2, q, np.nan)
        k1, k2, k3, k4, k5, k6 = lens.full_k if lens.model == "brown_conrady" else (0.0,) * 6
        radial = (1 + q * (k1 + q * (k2 + q * k3))) / (1 + q * (k4 + q * (k5 + q * k6)))
        dx, dy = _decentring(x, y, lens)
        x, y = x * radial + dx, y * radial + dy
    else:
        across = np.hypot(rays[:, 0], rays[:, 1])
        theta = np.arctan2(across, rays[:, 2])
        theta = np.where(theta <= limit, theta, np.nan)
        if lens.model == "kannala_brandt":
            k1, k2, k3, k4 = lens.full_k
            q = theta**2
            radius = theta * (1 + q * (k1 + q * (k2 + q * (k3 + q * k4))))
        else:
            radius = _RADII[lens.model](theta)
        # On the axis the direction of the radius is irrelevant, because its length is zero.
        part = radius / np.where(across > 0, across, 1.0)
        x, y = rays[:, 0] * part, rays[:, 1] * part
        dx, dy = _decentring(x, y, lens)
        x, y = x + dx, y + dy
    if any(lens.tilt_rad):
        x, y = _on_tilted_sensor(x, y, *lens.full_tilt_rad)
    return np.column_stack((lens.cx_px + lens.f_px * x, lens.cy_px + lens.fy_px * y))


def _decentring(x: F8, y: F8, lens: Projection) -> tuple[F8, F8]:
    """Shift by the terms p1, p2 and s1..s4."""
    p1, p2 = lens.full_p or (0.0, 0.0)
    s1, s2, s3, s4 = lens.full_s or (0.0,) * 4
    q = x * x + y * y
    return (
        2 * p1 * x * y + p2 * (q + 2 * x * x) + s1 * q + s2 * q * q,
        p1 * (q + 2 * y * y) + 2 * p2 * x * y + s3 * q + s4 * q * q,
    )


def _on_tilted_sensor(x: F8, y: F8, tau_x: float, tau_y: float) -> tuple[F8, F8]:
    """Points of the plane at unit distance in the frame of a sensor tilted about u, then v, seen along the old axis."""
    turned = Rotation.from_euler("xy", [-tau_x, -tau_y]).apply(np.column_stack((x, y, np.ones_like(x))))
    axis = Rotation.from_euler("xy", [-tau_x, -tau_y]).apply([0.0, 0.0, 1.0])
    depth = np.where(turned[:, 2] > 0, turned[:, 2], np.nan)
    x, y = (axis[2] * turned[:, i] / depth - axis[i] for i in (0, 1))
    return x, y


def derivatives(rays: F8, lens: Projection) -> F8:
    """Derivatives of pixels with respect to the components of a direction, by central differences, shape (n, 2, 3)."""
    columns = []
    for axis in range(3):
        step = np.zeros(3)
        step[axis] = _STEP
        columns.append((project(rays + step, lens) - project(rays - step, lens)) / (2 * _STEP))
    return np.stack(columns, axis=2)


def with_k1(lens: Projection, k1: float) -> Projection | None:
    """Add to the lens's first distortion coefficient; None for a model outside the families with distortion."""
    model = _WITH_K1.get(lens.model)
    if model is None:
        return None
    first, *others = (*lens.k, 0.0) if not lens.k else lens.k
    return replace(lens, model=model, k=(first + k1, *others))


def field_deg(lens: Projection, width: int) -> float:
    """Angle between the left and the right edge of the frame through the principal point, deg, without tangential terms."""
    reach = lens.largest_radius
    sides = ((lens.cx_px + 0.5) / lens.f_px, (width - 0.5 - lens.cx_px) / lens.f_px)
    return sum(lens.axis_angle_deg(min(side, reach)) for side in sides)


def corner_shift_px(lens: Projection, other: Projection, corner_px: float) -> float:
    """Distance, px, by which `other` shifts a star that `lens` images at a given distance from the principal point, px."""
    angle = math.radians(lens.axis_angle_deg(min(corner_px / lens.f_px, lens.largest_radius)))
    ray = np.array([[math.sin(angle), 0.0, math.cos(angle)]])
    return float(np.linalg.norm(project(ray, other) - project(ray, lens)))


@functools.lru_cache(maxsize=256)
def _limit(lens: Projection) -> float:
    return lens.limit
