"""The path of a camera: smooth curves through knots of position and attitude, with their rates and accelerations.

The normal of the ellipsoid and the height above it are cubic splines of time, so that positions have no singularity at
the date line, and heights between distant knots do not fall below those of the knots. The attitude is a spline of
rotations with continuous angular acceleration (Kang & Park 1999, J. Mechanical Design 121, as scipy's ``RotationSpline``
implements it), relative to east, north and up at the moving position: between knots of equal azimuth, altitude and roll,
these stay constant.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, RotationSpline

from generator.places.wgs84 import (
    ROTATION_RAD_S,
    SEMI_MAJOR_M,
    SEMI_MINOR_M,
    curvature_radii_m,
    enu_axes,
    normal_gravity_m_s2,
    normal_vector,
    position_of_normal,
)

Floats = NDArray[np.float64]

SQUARED_AXES_M2 = np.array([SEMI_MAJOR_M**2, SEMI_MAJOR_M**2, SEMI_MINOR_M**2])
EARTH_RATE_RAD_S = np.array([0.0, 0.0, ROTATION_RAD_S])


@dataclass(frozen=True, eq=False)
class Knots:
    """Positions and attitudes through which a path passes; a single row applies to all times.

    Attributes
    ----------
    time_s : (k,) array
        Times, increasing.
    latitude_deg, longitude_deg, height_m : (k,) or (1,) arrays
        Positions, WGS84.
    R_cam : Rotation
        Attitudes, k or one, east-north-up to camera.
    """

    time_s: Floats
    latitude_deg: Floats
    longitude_deg: Floats
    height_m: Floats
    R_cam: Rotation


class Trajectory:
    """A path with two derivatives; all times (n) are seconds on the knots' own scale.

    Parameters
    ----------
    knots : Knots
    """

    def __init__(self, knots: Knots) -> None:
        normal = normal_vector(knots.latitude_deg, knots.longitude_deg)
        self._normal = _spline(knots.time_s, normal)
        self._height = _spline(knots.time_s, knots.height_m)
        times, rotations = _at_least_two(knots.time_s, knots.R_cam.inv().as_quat())
        self._enu_from_cam = RotationSpline(times, Rotation.from_quat(rotations))

    def position(self, time_s: Floats) -> tuple[Floats, Floats, Floats]:
        """Latitude and longitude, deg, and height, m."""
        latitude_deg, longitude_deg = position_of_normal(self._unit_normal(time_s))
        return latitude_deg, longitude_deg, self._height(time_s)

    def R_cam(self, time_s: Floats) -> Rotation:
        """Attitudes from east-north-up at each time's own position to camera."""
        return self._enu_from_cam(time_s).inv()

    def cam_from_ecef(self, time_s: Floats) -> Rotation:
        """Attitudes from Earth-fixed axes to camera."""
        return self.R_cam(time_s) * Rotation.from_matrix(enu_axes(self._unit_normal(time_s)))

    def displacement_enu_m(self, start_s: float, end_s: float) -> Floats:
        """East, north and up from the position at one time to that at another, along the axes there, (3,)."""
        times = np.array([start_s, end_s])
        start, end = self._ecef(times)[0]
        return np.asarray(enu_axes(self._unit_normal(times))[1] @ (end - start))

    def velocity_enu_m_s(self, time_s: Floats) -> Floats:
        """Velocity over the rotating Earth along east, north, up, (n, 3)."""
        _, velocity, _ = self._ecef(time_s)
        return np.einsum("nij,nj->ni", enu_axes(self._unit_normal(time_s)), velocity)

    def rate_rad_s(self, time_s: Floats) -> Floats:
        """Angular rate against inertial space about the camera's axes, (n, 3).

        It is the sum of the attitude's own rate, that of east-north-up along the path (transport rate), and the Earth's
        rotation.
        """
        latitude_deg, _, height_m = self.position(time_s)
        meridian_m, across_m = curvature_radii_m(latitude_deg)
        east, north, _ = self.velocity_enu_m_s(time_s).T
        transport = np.stack(
            [
                -north / (meridian_m + height_m),
                east / (across_m + height_m),
                east * np.tan(np.radians(latitude_deg)) / (across_m + height_m),
            ],
            axis=-1,
        )
        earth = enu_axes(self._unit_normal(time_s)) @ EARTH_RATE_RAD_S
        return self._enu_from_cam(time_s, 1) + self.R_cam(time_s).apply(transport + earth)

    def specific_force_m_s2(self, time_s: Floats) -> Floats:
        """Specific force (inertial acceleration minus gravitation) along the camera's axes, (n, 3).

        On the rotating Earth it is the acceleration over the ground, plus the Coriolis term, minus normal gravity. The
        latter is along the ellipsoid's normal, from which the plumb line departs by up to 0.01 mm/s^2 per 1.2 km of
        height.
        """
        _, velocity, acceleration = self._ecef(time_s)
        normal = self._unit_normal(time_s)
        latitude_deg, _, height_m = self.position(time_s)
        gravity = -normal_gravity_m_s2(latitude_deg, height_m)[:, None] * normal
        force = acceleration + 2 * np.cross(EARTH_RATE_RAD_S, velocity) - gravity
        return self.cam_from_ecef(time_s).apply(force)

    def _unit_normal(self, time_s: Floats) -> Floats:
        normal = self._normal(time_s)
        return np.asarray(normal / np.linalg.norm(normal, axis=-1, keepdims=True))

    def _ecef(self, time_s: Floats) -> tuple[Floats, Floats, Floats]:
        """Earth-fixed position, velocity and acceleration, (n, 3) each; m, s."""
        normal = [self._normal(time_s, order) for order in range(3)]
        height = [self._height(time_s, order)[:, None] for order in range(3)]
        foot = _scaled(normal, SQUARED_AXES_M2)
        up = _scaled(normal, np.ones(3))
        return (
            foot[0] + height[0] * up[0],
            foot[1] + height[1] * up[0] + height[0] * up[1],
            foot[2] + height[2] * up[0] + 2 * height[1] * up[1] + height[0] * up[2],
        )


def _scaled(vectors: Sequence[Floats], weight: Floats) -> tuple[Floats, Floats, Floats]:
    """W m / sqrt(m W m) and its first two time derivatives, for vectors (n, 3) with two derivatives and a diagonal W (3,).

    With W the squared semi-axes, this is the point of the ellipsoid whose normal is along m; with W = 1, m's unit vector.
    """
    m, m1, m2 = vectors

    def product(a: Floats, b: Floats) -> Floats:
        return np.sum(weight * a * b, axis=-1, keepdims=True)

    square, half_first = product(m, m), product(m, m1)
    half_second = product(m1, m1) + product(m, m2)
    scale = square**-0.5
    scale1 = -half_first * square**-1.5
    scale2 = -half_second * square**-1.5 + 3 * half_first**2 * square**-2.5
    return weight * m * scale, weight * (m1 * scale + m * scale1), weight * (m2 * scale + 2 * m1 * scale1 + m * scale2)


def _spline(time_s: Floats, values: Floats) -> CubicSpline:
    return CubicSpline(*_at_least_two(time_s, values))


def _at_least_two(time_s: Floats, values: Floats) -> tuple[Floats, Floats]:
    """Knots for a spline; a single row of values is repeated, which gives a constant."""
    if len(values) == 1:
        return np.array([0.0, 1.0]), np.repeat(values, 2, axis=0)
    return time_s, values
