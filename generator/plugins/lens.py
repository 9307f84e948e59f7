"""Lens models: the only code that maps directions to pixels and back, for rays and for star splats.

It is written with Dr.Jit functions on plain components, so that it works in single and double precision alike. Models,
parameters and sources are those of :mod:`generator.scenario.projection`. Inverses that have no closed form use Newton's
method inside a shrinking bracket (a step that leaves it is replaced by bisection), with a fixed number of steps. Outside
a model's valid range the mask is False.
"""

from __future__ import annotations

import copy
from typing import Any, Protocol

import drjit as dr
import numpy as np

from generator.scenario.lens.image_plane import displacement, displacement_slopes, through, tilt_matrix
from generator.scenario.projection import PINHOLE_LIKE, Projection

MINIMUM_COSINE = 1e-3
NEWTON_STEPS = 20
TANGENTIAL_STEPS = 6
TINY = 1e-12
Scale = tuple[Any, Any, Any, Any]
"""Focal lengths and principal point."""


class Lens(Protocol):
    """A projection. Pixel centres are at integers; the camera frame is x right, y down, z along the boresight."""

    def project(self, x: Any, y: Any, z: Any) -> tuple[Any, Any, Any]:
        """Pixel position (u, v) of a camera-frame direction, and whether it is in the model's valid range."""

    def unproject(self, u: Any, v: Any) -> tuple[Any, Any, Any, Any]:
        """Camera-frame unit vector of a pixel position, and whether it is in the model's valid range."""

    def solid_angle(self, x: Any, y: Any, z: Any) -> Any:
        """Solid angle, sr, of a pixel that looks along a camera-frame unit vector."""


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

    def unproject(self, u: Any, v: Any) -> tuple[Any, Any, Any, Any]:
        """Camera-frame unit vector of a pixel position."""
        x, y = (u - self.cx_px) / self.f_px, (v - self.cy_px) / self.fy_px
        norm = 1 / dr.sqrt(x * x + y * y + 1)
        return x * norm, y * norm, norm, norm > MINIMUM_COSINE

    def solid_angle(self, x: Any, y: Any, z: Any) -> Any:
        """Solid angle, sr: a pixel at angle t off axis covers cos^3 t / (f fy)."""
        del x, y
        return z * z * z / (self.f_px * self.fy_px)


class BrownConrady:
    """Pinhole with OpenCV's rational radial distortion, decentring and thin prism.

    Parameters
    ----------
    f_px, fy_px, cx_px, cy_px : float
    k : six floats
    p : two floats
    s : four floats, or none
    limit : float
        Largest undistorted radius (tangent) in the valid range.
    edge : float
        Its distorted radius.
    """

    def __init__(
        self,
        f_px: Any,
        fy_px: Any,
        cx_px: Any,
        cy_px: Any,
        k: list[Any],
        p: list[Any],
        s: list[Any],
        limit: Any,
        edge: Any,
    ) -> None:
        self.f_px, self.fy_px, self.cx_px, self.cy_px = f_px, fy_px, cx_px, cy_px
        self.k, self.p, self.s, self.limit, self.edge = k, p, s, limit, edge

    def _scale(self, q: Any) -> tuple[Any, Any]:
        """Radial factor at squared radius q, and its derivative by q."""
        k1, k2, k3, k4, k5, k6 = self.k
        above = dr.fma(q, dr.fma(q, dr.fma(q, k3, k2), k1), 1)
        below = dr.fma(q, dr.fma(q, dr.fma(q, k6, k5), k4), 1)
        above_slope = dr.fma(q, dr.fma(q, 3 * k3, 2 * k2), k1)
        below_slope = dr.fma(q, dr.fma(q, 3 * k6, 2 * k5), k4)
        return above / below, (above_slope * below - above * below_slope) / (below * below)

    def _distort(self, a: Any, b: Any) -> tuple[Any, Any, Any, Any, Any, Any]:
        """Distorted point and the matrix of derivatives (da'/da, da'/db, db'/da, db'/db)."""
        q = a * a + b * b
        scale, slope = self._scale(q)
        move_a, move_b = displacement(a, b, self.p, self.s)
        aa, ab, ba, bb = displacement_slopes(a, b, self.p, self.s)
        aa, bb = aa + scale + 2 * slope * a * a, bb + scale + 2 * slope * b * b
        return a * scale + move_a, b * scale + move_b, aa, ab + 2 * slope * a * b, ba + 2 * slope * a * b, bb

    def project(self, x: Any, y: Any, z: Any) -> tuple[Any, Any, Any]:
        """Pixel position; valid where the radial distortion increases and the mapping keeps its orientation."""
        ahead = z > MINIMUM_COSINE
        depth = dr.select(ahead, z, 1)
        a, b = x / depth, y / depth
        bent_a, bent_b, aa, ab, ba, bb = self._distort(a, b)
        valid = ahead & (a * a + b * b <= self.limit * self.limit) & (aa * bb - ab * ba > 0)
        return self.cx_px + self.f_px * bent_a, self.cy_px + self.fy_px * bent_b, valid

    def unproject(self, u: Any, v: Any) -> tuple[Any, Any, Any, Any]:
        """Camera-frame unit vector: the radial part by bracketed Newton, then both parts by Newton in two dimensions."""
        wanted_a, wanted_b = (u - self.cx_px) / self.f_px, (v - self.cy_px) / self.fy_px
        wanted = dr.sqrt(wanted_a * wanted_a + wanted_b * wanted_b)

        def radial(r: Any) -> tuple[Any, Any]:
            scale, slope = self._scale(r * r)
            return r * scale, scale + 2 * slope * r * r

        r = bracketed_newton(radial, dr.minimum(wanted, self.edge), self.limit)
        stretch = dr.select(wanted > TINY, r / dr.maximum(wanted, TINY), 1)
        a, b = wanted_a * stretch, wanted_b * stretch
        a, b = newton_2d(self._distort, wanted_a, wanted_b, a, b)
        bent_a, bent_b, aa, ab, ba, bb = self._distort(a, b)
        reached = dr.maximum(dr.abs(bent_a - wanted_a), dr.abs(bent_b - wanted_b)) < 1e-4 * (1 + wanted)
        valid = reached & (a * a + b * b <= self.limit * self.limit) & (aa * bb - ab * ba > 0)
        norm = 1 / dr.sqrt(a * a + b * b + 1)
        return a * norm, b * norm, norm, valid

    def solid_angle(self, x: Any, y: Any, z: Any) -> Any:
        """Solid angle, sr: that of a pinhole over the determinant of the distortion's derivatives."""
        depth = dr.maximum(z, MINIMUM_COSINE)
        _, _, aa, ab, ba, bb = self._distort(x / depth, y / depth)
        return z * z * z / (self.f_px * self.fy_px * dr.maximum(dr.abs(aa * bb - ab * ba), TINY))


class Fisheye:
    """Projection r = f g(theta) around the boresight, where theta is the angle from it.

    Parameters
    ----------
    model : str
        ``equidistant``, ``equisolid``, ``stereographic``, ``orthographic`` or ``kannala_brandt``.
    f_px, fy_px, cx_px, cy_px : float
    k : list of float
        kannala_brandt's four coefficients.
    limit : float
        Largest theta, rad.
    edge : float
        Value of g there.
    """

    def __init__(
        self, model: str, f_px: Any, fy_px: Any, cx_px: Any, cy_px: Any, k: list[Any], limit: Any, edge: Any
    ) -> None:
        self.model, self.k, self.limit, self.edge = model, k, limit, edge
        self.f_px, self.fy_px, self.cx_px, self.cy_px = f_px, fy_px, cx_px, cy_px

    def _radius(self, theta: Any) -> tuple[Any, Any]:
        """Distance from the principal point over the focal length, g(theta), and its derivative."""
        half = 0.5 * theta
        if self.model == "equidistant":
            return theta, dr.full(type(theta), 1.0)
        if self.model == "equisolid":
            return 2 * dr.sin(half), dr.cos(half)
        if self.model == "stereographic":
            return 2 * dr.tan(half), dr.rcp(dr.square(dr.cos(half)))
        if self.model == "orthographic":
            return dr.sin(theta), dr.cos(theta)
        k1, k2, k3, k4 = self.k
        q = theta * theta
        value = theta * dr.fma(q, dr.fma(q, dr.fma(q, dr.fma(q, k4, k3), k2), k1), 1)
        return value, dr.fma(q, dr.fma(q, dr.fma(q, dr.fma(q, 9 * k4, 7 * k3), 5 * k2), 3 * k1), 1)

    def _theta(self, radius: Any) -> Any:
        """Angle from the boresight, rad, at a distance from the principal point over the focal length."""
        if self.model == "equidistant":
            return radius
        if self.model == "equisolid":
            return 2 * dr.safe_asin(0.5 * radius)
        if self.model == "stereographic":
            return 2 * dr.atan(0.5 * radius)
        if self.model == "orthographic":
            return dr.safe_asin(radius)
        return bracketed_newton(self._radius, dr.minimum(radius, self.edge), self.limit)

    def project(self, x: Any, y: Any, z: Any) -> tuple[Any, Any, Any]:
        """Pixel position of a camera-frame unit vector."""
        across = dr.sqrt(x * x + y * y)
        theta = dr.atan2(across, z)
        radius, _ = self._radius(theta)
        stretch = dr.select(across > TINY, radius / dr.maximum(across, TINY), 1)
        return self.cx_px + self.f_px * stretch * x, self.cy_px + self.fy_px * stretch * y, theta <= self.limit

    def unproject(self, u: Any, v: Any) -> tuple[Any, Any, Any, Any]:
        """Camera-frame unit vector of a pixel position."""
        a, b = (u - self.cx_px) / self.f_px, (v - self.cy_px) / self.fy_px
        radius = dr.sqrt(a * a + b * b)
        valid = radius <= self.edge
        theta = self._theta(dr.minimum(radius, self.edge))
        sine, cosine = dr.sincos(theta)
        stretch = dr.select(radius > TINY, sine / dr.maximum(radius, TINY), 1)
        return a * stretch, b * stretch, cosine, valid

    def solid_angle(self, x: Any, y: Any, z: Any) -> Any:
        """Solid angle, sr: sin(theta) / (g g') over the product of the focal lengths."""
        across = dr.sqrt(x * x + y * y)
        theta = dr.atan2(across, z)
        radius, slope = self._radius(theta)
        near_axis = radius * slope < 1e-6
        return dr.select(near_axis, 1, across / dr.select(near_axis, 1, radius * slope)) / (self.f_px * self.fy_px)


class OffAxis:
    """A lens of unit focal length whose image is decentred and whose sensor is tilted.

    Parameters
    ----------
    base : Lens
        Lens with a focal length of 1 and the principal point (0, 0).
    f_px, fy_px, cx_px, cy_px : float
    p : two floats, or none
    s : four floats, or none
    tilt : two 3 x 3 matrices of floats, or None
        :func:`generator.scenario.lens.image_plane.tilt_matrix` and its inverse.
    """

    def __init__(
        self, base: Lens, f_px: Any, fy_px: Any, cx_px: Any, cy_px: Any, p: list[Any], s: list[Any], tilt: Any
    ) -> None:
        self.base, self.p, self.s, self.tilt = base, p, s, tilt
        self.f_px, self.fy_px, self.cx_px, self.cy_px = f_px, fy_px, cx_px, cy_px

    @property
    def k(self) -> list[Any]:
        """Radial coefficients of the lens."""
        return getattr(self.base, "k", [])

    @k.setter
    def k(self, values: list[Any]) -> None:
        changed: Any = copy.copy(self.base)
        changed.k = values
        self.base = changed

    def _move(self, a: Any, b: Any) -> tuple[Any, Any, Any, Any, Any, Any]:
        """Decentred point and the matrix of derivatives."""
        move_a, move_b = displacement(a, b, self.p, self.s)
        aa, ab, ba, bb = displacement_slopes(a, b, self.p, self.s)
        return a + move_a, b + move_b, 1 + aa, ab, ba, 1 + bb

    def _bend(self, a: Any, b: Any) -> tuple[Any, Any, Any]:
        """Point on the sensor, and the determinant of its derivatives: positive where the image is not folded."""
        determinant = a * 0 + 1
        if self.p:
            a, b, aa, ab, ba, bb = self._move(a, b)
            determinant = aa * bb - ab * ba
        if self.tilt is None:
            return a, b, determinant
        # The determinant of a homography's derivatives is that of its matrix over the cube of the third coordinate.
        a, b, third = through(self.tilt[0], a, b)
        return a, b, dr.select(third > 0, determinant * self.tilt[2] / (third * third * third), 0)

    def project(self, x: Any, y: Any, z: Any) -> tuple[Any, Any, Any]:
        """Pixel position; valid if the base's is and the image is not folded."""
        a, b, valid = self.base.project(x, y, z)
        a, b, determinant = self._bend(a, b)
        return self.cx_px + self.f_px * a, self.cy_px + self.fy_px * b, valid & (determinant > 0)

    def unproject(self, u: Any, v: Any) -> tuple[Any, Any, Any, Any]:
        """Camera-frame unit vector: the tilt in closed form, the decentring by Newton in two dimensions."""
        a, b = (u - self.cx_px) / self.f_px, (v - self.cy_px) / self.fy_px
        reached = a == a
        if self.tilt is not None:
            a, b, third = through(self.tilt[1], a, b)
            reached = third > 0
        if self.p:
            wanted_a, wanted_b = a, b
            a, b = newton_2d(self._move, wanted_a, wanted_b, a, b)
            bent_a, bent_b, aa, ab, ba, bb = self._move(a, b)
            size = 1 + dr.maximum(dr.abs(wanted_a), dr.abs(wanted_b))
            reached &= dr.maximum(dr.abs(bent_a - wanted_a), dr.abs(bent_b - wanted_b)) < 1e-4 * size
            reached &= aa * bb - ab * ba > 0
        x, y, z, valid = self.base.unproject(a, b)
        return x, y, z, valid & reached

    def solid_angle(self, x: Any, y: Any, z: Any) -> Any:
        """Solid angle, sr: the base's divided by the determinant of the subsequent mapping."""
        a, b, _ = self.base.project(x, y, z)
        _, _, determinant = self._bend(a, b)
        return self.base.solid_angle(x, y, z) / (self.f_px * self.fy_px * dr.maximum(dr.abs(determinant), TINY))


def newton_2d(function: Any, wanted_a: Any, wanted_b: Any, a: Any, b: Any) -> tuple[Any, Any]:
    """Solve function(a, b) = wanted from a nearby start; the function returns the value and the matrix of derivatives."""
    for _ in range(TANGENTIAL_STEPS):
        bent_a, bent_b, aa, ab, ba, bb = function(a, b)
        determinant = aa * bb - ab * ba
        inverse = dr.select(dr.abs(determinant) > TINY, dr.rcp(determinant), 0)
        miss_a, miss_b = wanted_a - bent_a, wanted_b - bent_b
        step_a, step_b = (bb * miss_a - ab * miss_b) * inverse, (aa * miss_b - ba * miss_a) * inverse
        allowed = 0.1 + 0.5 * dr.sqrt(a * a + b * b)
        shorten = dr.minimum(1, allowed / dr.maximum(dr.sqrt(step_a * step_a + step_b * step_b), TINY))
        a, b = a + step_a * shorten, b + step_b * shorten
    return a, b


def bracketed_newton(function: Any, wanted: Any, limit: Any) -> Any:
    """Solve function(r) = wanted for r in [0, limit], where the function increases from 0 and returns (value, derivative)."""
    low, high = dr.zeros(type(wanted), dr.width(wanted)), wanted * 0 + limit
    r = dr.minimum(wanted, high)
    for _ in range(NEWTON_STEPS):
        value, slope = function(r)
        below = value < wanted
        low, high = dr.select(below, r, low), dr.select(below, high, r)
        step = r - (value - wanted) / dr.select(dr.abs(slope) > TINY, slope, 1)
        inside = (step >= low) & (step <= high) & (dr.abs(slope) > TINY)
        r = dr.select(inside, step, 0.5 * (low + high))
    return r


def make_lens(projection: Projection, number: Any) -> Lens:
    """Build the lens of a projection; `number` converts a float to the arithmetic type of the computation (opaque)."""
    f_px, fy_px, cx_px, cy_px = (projection.f_px, projection.fy_px, projection.cx_px, projection.cy_px)
    scale: Scale = (number(f_px), number(fy_px), number(cx_px), number(cy_px))
    pinhole_like = projection.model in PINHOLE_LIKE
    tilt = None
    if any(projection.tilt_rad):
        matrix = tilt_matrix(*projection.full_tilt_rad)
        tilt = tuple(
            [[number(float(value)) for value in row] for row in part] for part in (matrix, np.linalg.inv(matrix))
        )
        tilt = (*tilt, number(float(np.linalg.det(matrix))))
    p = [number(value) for value in projection.full_p]
    s = [number(value) for value in projection.full_s if any(projection.s)]
    if s and not p:
        p = [number(0.0), number(0.0)]
    # The pinhole models apply decentring and thin prism themselves.
    decentred = any(projection.p) or any(projection.s)
    if tilt is None and (pinhole_like or not decentred):
        return _centred_lens(projection, scale, p, s, number)
    unit: Scale = (number(1.0), number(1.0), number(0.0), number(0.0))
    base = _centred_lens(projection, unit, p, s, number)
    inside = pinhole_like or not decentred
    return OffAxis(base, *scale, [] if inside else p, [] if inside else s, tilt)


def _centred_lens(projection: Projection, scale: Scale, p: list[Any], s: list[Any], number: Any) -> Lens:
    """Build the lens without tilt, and for fisheyes also without decentring."""
    if projection.model == "pinhole" and not (any(projection.p) or any(projection.s)):
        return Pinhole(*scale)
    limit = number(projection.limit)
    edge = number(float(np.nextafter(projection.largest_radius, 0)))
    if projection.model in PINHOLE_LIKE:
        k = [number(value) for value in projection.full_k] or [number(0.0)] * 6
        return BrownConrady(*scale, k, p, s, limit, edge)
    return Fisheye(projection.model, *scale, [number(value) for value in projection.full_k], limit, edge)
