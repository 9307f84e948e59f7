"""Lens models: the one piece of code that maps directions to pixels and back, for rays and for star splats.

Written with Dr.Jit functions on plain components, so that it serves single and double precision alike. Models, numbers and
sources are those of :mod:`generator.scenario.projection`. Inverses that have no closed form are Newton's method inside a
shrinking bracket (a step that leaves it is replaced by bisection), with a fixed number of steps. Outside a model's valid
range the mask is False.
"""

from __future__ import annotations

from typing import Any, Protocol

import drjit as dr
import numpy as np

from generator.scenario.projection import Projection

MINIMUM_COSINE = 1e-3
NEWTON_STEPS = 20
TANGENTIAL_STEPS = 6
TINY = 1e-12


class Lens(Protocol):
    """A projection. Pixel centres are at integers; the camera frame is x right, y down, z along the boresight."""

    def project(self, x: Any, y: Any, z: Any) -> tuple[Any, Any, Any]:
        """Pixel position (u, v) of a camera-frame direction, and whether it lies in the model's valid range."""

    def unproject(self, u: Any, v: Any) -> tuple[Any, Any, Any, Any]:
        """Camera-frame unit vector of a pixel position, and whether it lies in the model's valid range."""

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
        norm = dr.rsqrt(x * x + y * y + 1)
        return x * norm, y * norm, norm, norm > MINIMUM_COSINE

    def solid_angle(self, x: Any, y: Any, z: Any) -> Any:
        """Solid angle, sr: a pixel at angle t off axis covers cos^3 t / (f fy)."""
        del x, y
        return z * z * z / (self.f_px * self.fy_px)


class BrownConrady:
    """Pinhole with OpenCV's rational radial and tangential distortion.

    Parameters
    ----------
    f_px, fy_px, cx_px, cy_px : float
    k : six floats
    p : two floats
    limit : float
        Largest undistorted radius (tangent) in the valid range.
    edge : float
        Its distorted radius.
    """

    def __init__(
        self, f_px: Any, fy_px: Any, cx_px: Any, cy_px: Any, k: list[Any], p: list[Any], limit: Any, edge: Any
    ) -> None:
        self.f_px, self.fy_px, self.cx_px, self.cy_px = f_px, fy_px, cx_px, cy_px
        self.k, self.p, self.limit, self.edge = k, p, limit, edge

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
        p1, p2 = self.p
        q = a * a + b * b
        scale, slope = self._scale(q)
        bent_a = a * scale + 2 * p1 * a * b + p2 * (q + 2 * a * a)
        bent_b = b * scale + p1 * (q + 2 * b * b) + 2 * p2 * a * b
        aa = scale + 2 * slope * a * a + 2 * p1 * b + 6 * p2 * a
        ab = 2 * slope * a * b + 2 * p1 * a + 2 * p2 * b
        bb = scale + 2 * slope * b * b + 6 * p1 * b + 2 * p2 * a
        return bent_a, bent_b, aa, ab, ab, bb

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
        for _ in range(TANGENTIAL_STEPS):
            bent_a, bent_b, aa, ab, ba, bb = self._distort(a, b)
            determinant = aa * bb - ab * ba
            inverse = dr.select(dr.abs(determinant) > TINY, dr.rcp(determinant), 0)
            miss_a, miss_b = wanted_a - bent_a, wanted_b - bent_b
            step_a, step_b = (bb * miss_a - ab * miss_b) * inverse, (aa * miss_b - ba * miss_a) * inverse
            allowed = 0.1 + 0.5 * dr.sqrt(a * a + b * b)
            shorten = dr.minimum(1, allowed / dr.maximum(dr.sqrt(step_a * step_a + step_b * step_b), TINY))
            a, b = a + step_a * shorten, b + step_b * shorten
        bent_a, bent_b, aa, ab, ba, bb = self._distort(a, b)
        reached = dr.maximum(dr.abs(bent_a - wanted_a), dr.abs(bent_b - wanted_b)) < 1e-4 * (1 + wanted)
        valid = reached & (a * a + b * b <= self.limit * self.limit) & (aa * bb - ab * ba > 0)
        norm = dr.rsqrt(a * a + b * b + 1)
        return a * norm, b * norm, norm, valid

    def solid_angle(self, x: Any, y: Any, z: Any) -> Any:
        """Solid angle, sr: that of a pinhole over the determinant of the distortion's derivatives."""
        depth = dr.maximum(z, MINIMUM_COSINE)
        _, _, aa, ab, ba, bb = self._distort(x / depth, y / depth)
        return z * z * z / (self.f_px * self.fy_px * dr.maximum(dr.abs(aa * bb - ab * ba), TINY))


class Fisheye:
    """r = f g(theta) around the boresight, theta the angle from it.

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
        g there.
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


def bracketed_newton(function: Any, wanted: Any, limit: Any) -> Any:
    """Solve function(r) = wanted for r in [0, limit], where the function increases from 0; it returns (value, derivative)."""
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
    """Build the lens of a projection; `number` turns a float into the arithmetic type to compute in (opaque)."""
    basic = [number(value) for value in (projection.f_px, projection.fy_px, projection.cx_px, projection.cy_px)]
    if projection.model == "pinhole":
        return Pinhole(*basic)
    limit = number(projection.limit)
    edge = number(float(np.nextafter(projection.largest_radius, 0)))
    k, p = [number(value) for value in projection.full_k], [number(value) for value in projection.full_p]
    f_px, fy_px, cx_px, cy_px = basic
    if projection.model == "brown_conrady":
        return BrownConrady(f_px, fy_px, cx_px, cy_px, k, p, limit, edge)
    return Fisheye(projection.model, f_px, fy_px, cx_px, cy_px, k, limit, edge)
