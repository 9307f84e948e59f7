"""The question put to a solver, and the protocol that solvers follow."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Protocol

from celnav.attitude import Attitude
from celnav.checking import bounded, check_fields, finite_number
from celnav.errors import ConfigError
from celnav.fix import Fix
from celnav.history import History
from celnav.matching.protocol import Observation
from celnav.position import Weather
from celnav.sky.utc import Utc

# Within so many standard deviations lies a position of two coordinates but for one case in a thousand.
_SURE_SIGMAS = math.sqrt(-2 * math.log(1e-3))


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
    """

    observation: Observation
    utc: Utc
    attitude: Attitude | None
    weather: Weather
    dut1_s: float | None
    near: LastKnown | None = None
    time_limit_s: float | None = None


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
