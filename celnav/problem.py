"""The problem that a solver receives, and the protocol that solvers implement."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from celnav.attitude import Attitude
from celnav.camera import Camera
from celnav.checking import bounded, check_fields, finite_number
from celnav.errors import ConfigError
from celnav.fix import Fix
from celnav.matching.history import History
from celnav.matching.protocol import Observation
from celnav.position import Weather
from celnav.sky.utc import Utc
from celnav.sky.wgs84 import ECCENTRICITY_SQUARED, ROTATION_RAD_S, SEMI_MAJOR_AXIS_KM

# A position of two coordinates is within this many standard deviations in 999 of 1,000 cases.
_SURE_SIGMAS = math.sqrt(-2 * math.log(1e-3))
# A search at the camera's focal length, or at a factor on it, tolerates an error of 6 % to both sides.
_REACH = 0.06
_COVERED_SIGMAS = 3.0


@dataclass(frozen=True)
class LastKnown:
    """A last known position: geodetic latitude and longitude, and a radius (km) that is certain to contain the answer.

    It limits the search and decides what is refused, but does not enter the position, so that fixes stay independent of it
    and of each other.
    """

    lat_deg: float = bounded(least=-90, most=90)
    lon_deg: float = bounded(least=-1e6, most=1e6)
    radius_km: float = bounded(least=1e-6, most=1e6)

    def __post_init__(self) -> None:
        check_fields(self)

    @classmethod
    def with_sigma(cls, lat_deg: float, lon_deg: float, sigma_km: float) -> LastKnown:
        """Make one from a standard deviation along each axis, km; the radius contains 999 of 1,000 such positions."""
        sigma_km = finite_number(sigma_km, "sigma_km", ConfigError, least=1e-6)
        return cls(lat_deg, lon_deg, _SURE_SIGMAS * sigma_km)


@dataclass(frozen=True)
class ToldSigmas:
    """Standard deviations of the values that a solver receives; 0 stands for exact or unknown.

    Attributes
    ----------
    utc_s : float
        Standard deviation of the time, seconds. An error of the time is an error of longitude that the stars cannot
        reveal, since it turns the Earth.
    focal : float
        Relative standard deviation of the focal length, common to both axes.
    centre_px : float
        Standard deviation of each coordinate of the principal point, pixels.
    pressure_hpa, temperature_c : float
        Standard deviations of the air's pressure and temperature.
    distortion : float
        Standard deviation of the lens's first radial term k1: stars move away from the principal point by k1 r^2 times
        their distance from it, with r the distance over the focal length.
    """

    utc_s: float = bounded(0.0, 0, 86400)
    focal: float = bounded(0.0, 0, 1)
    centre_px: float = bounded(0.0, 0, 1e4)
    pressure_hpa: float = bounded(0.0, 0, 500)
    temperature_c: float = bounded(0.0, 0, 100)
    distortion: float = bounded(0.0, 0, 1)

    def __post_init__(self) -> None:
        check_fields(self)

    def distortion_at_corner(self, camera: Camera) -> float:
        """Return the standard deviation of the distortion at half the frame's diagonal, relative to that distance."""
        return self.distortion * (math.hypot(camera.width, camera.height) / (2 * camera.f_px)) ** 2

    def focal_factors(self, usual: tuple[float, ...], camera: Camera) -> tuple[float, ...]:
        """Return factors on the focal length to search at, nearest first, so that three standard deviations are covered.

        Averaged over the frame, half of the distortion at its corner acts like a wrong focal length.
        """
        sigma = math.hypot(self.focal, self.distortion_at_corner(camera) / 2)
        if _COVERED_SIGMAS * sigma <= _REACH:
            return usual
        steps = math.ceil(round((_COVERED_SIGMAS * sigma - _REACH) / (2 * _REACH), 6))
        return tuple(math.exp(sign * 2 * _REACH * step) for step in range(1, steps + 1) for sign in (-1, 1))

    def loosened(self, attitude: Attitude, camera: Camera) -> Attitude:
        """Widen the attitude for a search, because a shifted principal point and a wrong time look like a rotation."""
        shift_deg, turn_deg = math.degrees(self.centre_px / camera.f_px), math.degrees(ROTATION_RAD_S * self.utc_s)
        if not (shift_deg or turn_deg):
            return attitude
        return replace(
            attitude,
            tilt_deg=math.hypot(attitude.tilt_deg, shift_deg, turn_deg),
            heading_deg=math.hypot(attitude.heading_deg, shift_deg),
        )

    def refraction(self, pressure_hpa: float, temperature_c: float) -> float:
        """Return the relative standard deviation of the refraction, which is proportional to pressure over temperature."""
        of_pressure = self.pressure_hpa / pressure_hpa if pressure_hpa > 0 else 0.0
        return math.hypot(of_pressure, self.temperature_c / (temperature_c + 273.15))

    def with_time(self, cov_km2: NDArray[np.float64], lat_deg: float) -> NDArray[np.float64]:
        """Add the uncertainty of the time to the covariance of a position, east-north, km^2, shape (2, 2)."""
        lat = math.radians(lat_deg)
        radius_km = SEMI_MAJOR_AXIS_KM / math.sqrt(1 - ECCENTRICITY_SQUARED * math.sin(lat) ** 2) * math.cos(lat)
        return np.asarray(cov_km2 + np.diag([(ROTATION_RAD_S * self.utc_s * radius_km) ** 2, 0.0]))


@dataclass(frozen=True, eq=False)
class Problem:
    """The validated problem of one frame.

    Attributes
    ----------
    observation : Observation
        Detections and camera.
    utc : Utc
        Middle of the exposure.
    attitude : Attitude or None
        What is known of the camera's orientation relative to the horizon.
    weather : Weather
        Air at the observer, for refraction.
    dut1_s : float or None
        UT1-UTC, seconds; None takes it from the IERS table.
    near : LastKnown or None
        A circle that contains the answer.
    time_limit_s : float or None
        Wall-clock time, counted from the start of the solver's `Stopwatch`, after which the caller prefers a refusal.
    sigmas : ToldSigmas
        Stated standard deviations of time, lens and air.
    turn_rad : ndarray, shape (3,), or None
        Rotation vector of the sky in the camera frame during the exposure, in either sense, if streaks reveal it.
    effort : float
        Fraction of the solver's bound on effort that this search may take, where the solver has one.
    """

    observation: Observation
    utc: Utc
    attitude: Attitude | None
    weather: Weather
    dut1_s: float | None
    near: LastKnown | None = None
    time_limit_s: float | None = None
    sigmas: ToldSigmas = field(default_factory=ToldSigmas)
    turn_rad: NDArray[np.float64] | None = None
    effort: float = 1.0


def check_time_limit(time_limit_s: float) -> None:
    """Raise `ConfigError` unless the time limit is a positive number of seconds."""
    finite_number(time_limit_s, "time_limit_s", ConfigError, least=1e-9)


class Solver(Protocol):
    """Turns a problem into a fix."""

    def __call__(self, problem: Problem, history: History | None, clock: Stopwatch) -> Fix:
        """Solve the problem; stages are timed with `clock`."""
        ...


@dataclass
class Stopwatch:
    """Times stages, in milliseconds.

    Attributes
    ----------
    started_s : float
        Value of `time.perf_counter` when the stopwatch was made.
    time_ms : dict of str to float
        Time of each stage.
    """

    started_s: float = field(default_factory=time.perf_counter)
    time_ms: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time the code in the ``with`` block under `name`."""
        start = time.perf_counter()
        try:
            yield
        finally:
            self.time_ms[name] = self.time_ms.get(name, 0.0) + 1000 * (time.perf_counter() - start)
