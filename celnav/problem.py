"""The question put to a solver, and the protocol that solvers follow."""

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
from celnav.history import History
from celnav.matching.protocol import Observation
from celnav.position import Weather
from celnav.sky.utc import Utc
from celnav.sky.wgs84 import ECCENTRICITY_SQUARED, ROTATION_RAD_S, SEMI_MAJOR_AXIS_KM

# Within so many standard deviations lies a position of two coordinates but for one case in a thousand.
_SURE_SIGMAS = math.sqrt(-2 * math.log(1e-3))
# A search at the camera's focal length, and at each factor on it, finds what is off by 6 % to both sides.
_REACH = 0.06
_COVERED_SIGMAS = 3.0


@dataclass(frozen=True)
class LastKnown:
    """A position known from before: geodetic latitude and longitude, and the radius (km) that surely holds the answer.

    It says where to look and what to refuse; it does not enter the position, so that fixes stay independent of it and of
    each other.
    """

    lat_deg: float = bounded(least=-90, most=90)
    lon_deg: float = bounded(least=-1e6, most=1e6)
    radius_km: float = bounded(least=1e-6, most=1e6)

    def __post_init__(self) -> None:
        check_fields(self)

    @classmethod
    def with_sigma(cls, lat_deg: float, lon_deg: float, sigma_km: float) -> LastKnown:
        """Position with a standard deviation along each axis, km; the radius holds 999 of 1,000 such positions."""
        sigma_km = finite_number(sigma_km, "sigma_km", ConfigError, least=1e-6)
        return cls(lat_deg, lon_deg, _SURE_SIGMAS * sigma_km)


@dataclass(frozen=True)
class ToldSigmas:
    """Standard deviations of what a solver is told; 0: exact, or not known.

    Attributes
    ----------
    utc_s : float
        Of the time, seconds. It turns the Earth: an error of longitude that no star shows.
    focal : float
        Of the focal length, relative; both axes together.
    centre_px : float
        Of each of the principal point's coordinates.
    pressure_hpa, temperature_c : float
        Of the air's.
    distortion : float
        Of the lens's first radial term k1: stars move from the principal point by k1 r^2 of their distance, r being the
        distance over the focal length.
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
        """Return the standard deviation of the distortion at half the frame's diagonal, relative to the distance."""
        return self.distortion * (math.hypot(camera.width, camera.height) / (2 * camera.f_px)) ** 2

    def focal_factors(self, usual: tuple[float, ...], camera: Camera) -> tuple[float, ...]:
        """Return factors on the focal length to search at, nearest first, so that three standard deviations are covered.

        Over the frame, half of the distortion at its corner acts like a wrong focal length.
        """
        sigma = math.hypot(self.focal, self.distortion_at_corner(camera) / 2)
        if _COVERED_SIGMAS * sigma <= _REACH:
            return usual
        steps = math.ceil(round((_COVERED_SIGMAS * sigma - _REACH) / (2 * _REACH), 6))
        return tuple(math.exp(sign * 2 * _REACH * step) for step in range(1, steps + 1) for sign in (-1, 1))

    def loosened(self, attitude: Attitude, camera: Camera) -> Attitude:
        """Return the attitude as a search may take it: a shifted principal point and a wrong time look like a turn."""
        shift_deg, turn_deg = math.degrees(self.centre_px / camera.f_px), math.degrees(ROTATION_RAD_S * self.utc_s)
        if not (shift_deg or turn_deg):
            return attitude
        return replace(
            attitude,
            tilt_deg=math.hypot(attitude.tilt_deg, shift_deg, turn_deg),
            heading_deg=math.hypot(attitude.heading_deg, shift_deg),
        )

    def refraction(self, pressure_hpa: float, temperature_c: float) -> float:
        """Return the relative standard deviation of the refraction, which goes with the pressure over the temperature."""
        of_pressure = self.pressure_hpa / pressure_hpa if pressure_hpa > 0 else 0.0
        return math.hypot(of_pressure, self.temperature_c / (temperature_c + 273.15))

    def with_time(self, cov_km2: NDArray[np.float64], lat_deg: float) -> NDArray[np.float64]:
        """Add the time's error to the covariance of a position, east-north, km^2, shape (2, 2)."""
        lat = math.radians(lat_deg)
        radius_km = SEMI_MAJOR_AXIS_KM / math.sqrt(1 - ECCENTRICITY_SQUARED * math.sin(lat) ** 2) * math.cos(lat)
        return np.asarray(cov_km2 + np.diag([(ROTATION_RAD_S * self.utc_s * radius_km) ** 2, 0.0]))


@dataclass(frozen=True, eq=False)
class Problem:
    """One frame's question, validated.

    Attributes
    ----------
    observation : Observation
        Detections and camera.
    utc : Utc
        Middle of the exposure.
    attitude : Attitude or None
        Knowledge of the camera's orientation to the horizon.
    weather : Weather
        For refraction.
    dut1_s : float or None
        UT1-UTC, seconds; None takes it from the IERS table.
    near : LastKnown or None
        Where the answer lies.
    time_limit_s : float or None
        Time by the clock after which the caller would rather have a refusal, from the start of the solver's `Stopwatch`.
    sigmas : ToldSigmas
        Standard deviations of time, lens and air as they are told.
    turn_rad : ndarray, shape (3,), or None
        Rotation vector of the sky in the camera frame during the exposure, in either sense, where streaks tell it.
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


def check_time_limit(time_limit_s: float) -> None:
    """Raise `ConfigError` unless the limit is a positive number of seconds."""
    finite_number(time_limit_s, "time_limit_s", ConfigError, least=1e-9)


class Solver(Protocol):
    """Turns a problem into a fix."""

    def __call__(self, problem: Problem, history: History | None, clock: Stopwatch) -> Fix:
        """Solve; stages are timed with `clock`."""
        ...


@dataclass
class Stopwatch:
    """Times stages, in milliseconds.

    Attributes
    ----------
    started_s : float
        Value of `time.perf_counter` when it was made.
    time_ms : dict of str to float
        Time of each stage.
    """

    started_s: float = field(default_factory=time.perf_counter)
    time_ms: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time what runs inside under `name`."""
        start = time.perf_counter()
        try:
            yield
        finally:
            self.time_ms[name] = self.time_ms.get(name, 0.0) + 1000 * (time.perf_counter() - start)
