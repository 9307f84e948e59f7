"""The scenario's ``path`` and ``imu`` sections: where the camera is over a sequence, and its inertial unit."""

from __future__ import annotations

import itertools
from typing import Annotated

from pydantic import BeforeValidator, Field, model_validator

from generator.scenario.strict import File, Strict, listed

HIGHEST_LATITUDE_DEG = 89.9
"""Highest latitude of a path: nearer to a pole, azimuths turn faster than any spline can follow."""
LEAST_STEP_S = 1e-6
"""Least time between two rows of a path: that to which times of frames are rounded, and which a spline can divide by."""
POSITION = ("latitude_deg", "longitude_deg", "height_m")
ATTITUDE = ("azimuth_deg", "altitude_deg", "roll_deg")

Bias = Annotated[float, Field(ge=-1e6, le=1e6)]
Biases = Annotated[tuple[Bias, Bias, Bias], BeforeValidator(listed)]
Noise = Annotated[float, Field(ge=0, le=1e6)]


class WaypointSpec(Strict):
    """A position, an attitude, or both, at one time."""

    t_s: Annotated[float, Field(ge=-86400, le=864000)]
    """Seconds after the start of the sequence's first exposure; a path may begin before it."""
    latitude_deg: Annotated[float, Field(ge=-HIGHEST_LATITUDE_DEG, le=HIGHEST_LATITUDE_DEG)] | None = None
    """Geodetic latitude, deg."""
    longitude_deg: Annotated[float, Field(ge=-180, le=360)] | None = None
    """Longitude, deg, east positive."""
    height_m: Annotated[float, Field(ge=-500, le=20000)] | None = None
    """Height above the ellipsoid, m."""
    azimuth_deg: Annotated[float, Field(ge=-360, le=360)] | None = None
    """Azimuth of the boresight, deg."""
    altitude_deg: Annotated[float, Field(ge=-90, le=90)] | None = None
    """Altitude of the boresight, deg."""
    roll_deg: Annotated[float, Field(ge=-360, le=360)] | None = None
    """Clockwise turn of the camera about its boresight, deg."""


class PathSpec(Strict):
    """Position, attitude, or both, over the time of a sequence; whatever a path omits stays constant as the scenario states.

    Splines run through the waypoints: cubic ones for the position, and one with continuous angular acceleration for the
    attitude, which turns the shorter way from one waypoint to the next.
    """

    file: File | None = None
    """CSV with t_s or utc, then latitude_deg, longitude_deg, height_m, or azimuth_deg, altitude_deg, roll_deg (or qx, qy, qz,
    qw of the rotation from east-north-up to the camera), or both groups."""
    waypoints: (
        Annotated[tuple[WaypointSpec, ...], Field(min_length=2, max_length=10000), BeforeValidator(listed)] | None
    ) = None
    """Waypoints; each has the same keys."""
    ground_height_m: Annotated[float, Field(ge=-500, le=9000)] | None = None
    """Height of the ground that makes the horizon, m, as in site.ground_height_m; at most the camera's at any time."""

    @model_validator(mode="after")
    def _one_of_two(self) -> PathSpec:
        if (self.file is None) == (self.waypoints is None):
            raise ValueError("give either file or waypoints")
        if self.waypoints is not None:
            self._check_waypoints(self.waypoints)
        return self

    @staticmethod
    def _check_waypoints(waypoints: tuple[WaypointSpec, ...]) -> None:
        times = [waypoint.t_s for waypoint in waypoints]
        if any(after - before < LEAST_STEP_S for before, after in itertools.pairwise(times)):
            raise ValueError(f"waypoints: t_s must increase, by at least {LEAST_STEP_S:g} s")
        given = 0
        for group in (POSITION, ATTITUDE):
            found = {key for key in group for waypoint in waypoints if getattr(waypoint, key) is not None}
            given += len(found)
            for place, waypoint in enumerate(waypoints):
                for key in group:
                    if found and getattr(waypoint, key) is None:
                        raise ValueError(f"waypoints.{place}.{key}: missing; every waypoint needs {', '.join(group)}")
        if not given:
            raise ValueError(f"waypoints: give {', '.join(POSITION)}, or {', '.join(ATTITUDE)}, or both")


class GyroSpec(Strict):
    """Errors of the three gyroscopes (IEEE Std 952), about the camera's axes; perfect unless given."""

    bias_deg_h: Biases = (0.0, 0.0, 0.0)
    """Constant bias about x, y, z, deg/h."""
    bias_sigma_deg_h: Noise = 0.0
    """Spread of a further constant bias, drawn once per sequence, deg/h."""
    angle_random_walk_deg_sqrt_h: Noise = 0.0
    """White noise N, deg per square root of an hour."""
    bias_instability_deg_h: Noise = 0.0
    """Flicker noise B, deg/h; the Allan deviation's floor is 0.664 B."""
    rate_random_walk_deg_h_sqrt_h: Noise = 0.0
    """Random walk of the bias K, deg/h per square root of an hour."""


class AccelerometerSpec(Strict):
    """Errors of the three accelerometers, along the camera's axes; perfect unless given. 1 ug is 9.80665e-6 m/s^2."""

    bias_ug: Biases = (0.0, 0.0, 0.0)
    """Constant bias along x, y, z, micro-g."""
    bias_sigma_ug: Noise = 0.0
    """Spread of a further constant bias, drawn once per sequence, micro-g."""
    velocity_random_walk_m_s_sqrt_h: Noise = 0.0
    """White noise N, m/s per square root of an hour."""
    bias_instability_ug: Noise = 0.0
    """Flicker noise B, micro-g; the Allan deviation's floor is 0.664 B."""
    acceleration_random_walk_ug_sqrt_h: Noise = 0.0
    """Random walk of the bias K, micro-g per square root of an hour."""


class InertialSpec(Strict):
    """An inertial unit at the camera, aligned with its axes; each sequence gets a table of its readings and their truth."""

    rate_hz: Annotated[float, Field(ge=0.1, le=1e4)] = 200.0
    """Readings per second."""
    gyro: GyroSpec = GyroSpec()
    accelerometer: AccelerometerSpec = AccelerometerSpec()
