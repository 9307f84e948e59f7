"""`celnav.solve`, which turns detections, camera, time and attitude into a fix, and the registry of solvers."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from datetime import datetime
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike

from celnav.attitude import Attitude, as_attitude
from celnav.camera import Camera
from celnav.checking import shown
from celnav.detections import Detections, as_detections
from celnav.errors import CameraError, ConfigError
from celnav.fix import Fix, Reason
from celnav.matching import (
    BRIGHTEST_N,
    THESIS_ADAPTIVE,
    THESIS_BASELINE,
    THESIS_BASELINE_SI,
    THESIS_BASELINE_SI_PR,
    THESIS_CATALOGUE_ONLY,
    DaiMatcher,
    DdrConfig,
    DdrMatcher,
    Matcher,
    Observation,
)
from celnav.matching.history import History
from celnav.position import PositionConfig, Weather, fix_position
from celnav.problem import LastKnown, Problem, Solver, Stopwatch, ToldSigmas, check_time_limit
from celnav.sky.utc import Utc, parse_utc
from celnav.skybench_solver import SkybenchSolver


@dataclass(frozen=True)
class MatchThenFix:
    """A two-stage solver: a matcher identifies the stars, and a position is fitted to all its matches.

    Attributes
    ----------
    matcher : Matcher
        Frozen and hashable.
    position : PositionConfig
        Configuration of the position estimate.
    max_residual_px : float
        Largest accepted median distance between matched detections and predicted stars, pixels; a position with a
        larger one is refused.
    """

    matcher: Matcher
    position: PositionConfig = field(default_factory=PositionConfig)
    max_residual_px: float = 5.0

    def __call__(self, problem: Problem, history: History | None, clock: Stopwatch) -> Fix:
        """Solve a problem whose attitude is fully known; refuse any other."""
        if problem.time_limit_s is not None:
            raise ConfigError("time_limit_s: this solver has no time limit; skybench has")
        attitude = problem.attitude
        if not np.isfinite(problem.observation.rays).all():
            return Fix.refusal(Reason.INCONSISTENT, "detections outside the camera's image circle: remove them")
        if attitude is None or attitude.kind != "rotation":
            return Fix.refusal(
                Reason.ATTITUDE_REQUIRED, "this solver needs the whole attitude, heading included: give R_cam"
            )
        with clock.stage("identify"):
            found = self.matcher.identify(replace(problem.observation, R_cam=attitude.R_cam), history)
        if found.reason is not Reason.OK:
            refusal = Fix.refusal(found.reason, found.message, found.confidence)
            return replace(refusal, details=found.details)
        with clock.stage("fix"):
            fix = fix_position(
                problem.observation.uv[found.matches[:, 0]],
                found.matches[:, 1],
                problem.observation.camera,
                problem.utc,
                attitude,
                config=self.position,
                weather=problem.weather,
                dut1_s=problem.dut1_s,
            )
        if not fix.ok:
            return replace(fix, details=found.details, confidence=found.confidence)
        dropped = 1 - len(fix.matches) / len(found.matches)
        if fix.residual_rms_px > self.max_residual_px or dropped > 0.5:
            message = (
                f"the identified stars do not fit one position: {fix.residual_rms_px:.1f} px rms, "
                f"{dropped:.0%} of them dropped; check the attitude and the camera"
            )
            refusal = Fix.refusal(Reason.INCONSISTENT, message, found.confidence)
            return replace(refusal, details=found.details)
        # The fix holds indices of the matched positions; convert them to the caller's indices of detections.
        matches = np.column_stack((found.matches[fix.matches[:, 0], 0], fix.matches[:, 1]))
        cov = None if fix.cov_km2 is None else problem.sigmas.with_time(fix.cov_km2, fix.lat_deg)
        return replace(fix, matches=matches, confidence=found.confidence, details=found.details, cov_km2=cov)


def ddr_solver(config: DdrConfig, position: PositionConfig | None = None) -> MatchThenFix:
    """Make a solver of the thesis' family with your own configuration; pass it to `celnav.solve` as ``solver=``."""
    return MatchThenFix(DdrMatcher(config), PositionConfig() if position is None else position)


SOLVERS: MappingProxyType[str, Solver] = MappingProxyType(
    {
        "skybench": SkybenchSolver(),
        "thesis-baseline": ddr_solver(THESIS_BASELINE),
        "thesis-baseline+si": ddr_solver(THESIS_BASELINE_SI),
        "thesis-baseline+si+pr": ddr_solver(THESIS_BASELINE_SI_PR),
        "thesis-catalogue-only": ddr_solver(THESIS_CATALOGUE_ONLY),
        "thesis-adaptive": ddr_solver(THESIS_ADAPTIVE),
        "ddr-dai": MatchThenFix(DaiMatcher()),
        "brightest-n": ddr_solver(BRIGHTEST_N),
    }
)


_EXACT = ToldSigmas()
# What a solver refuses for these reasons it may solve with more stars.
_HELPED_BY_MORE = {Reason.TOO_FEW_DETECTIONS, Reason.NO_HYPOTHESIS, Reason.EFFORT_SPENT, Reason.AMBIGUOUS}
# Effort of that second search: it solves nearly all that it would solve with the whole (docs/solver.md, faint stars).
_EFFORT_WITH_MORE = 0.125


def solvers() -> tuple[str, ...]:
    """Return the names that `solve` accepts as ``solver``."""
    return tuple(SOLVERS)


def solve(
    detections: Detections | ArrayLike,
    camera: Camera,
    utc: str | datetime | Utc,
    attitude: Attitude | ArrayLike | None,
    solver: str | Solver = "skybench",
    history: History | None = None,
    *,
    flux: ArrayLike | None = None,
    pressure_hpa: float = 1010.0,
    temperature_c: float = 10.0,
    dut1_s: float | None = None,
    near: LastKnown | None = None,
    time_limit_s: float | None = None,
    sigmas: ToldSigmas | None = None,
) -> Fix:
    """Determine where a frame was taken.

    Parameters
    ----------
    detections : Detections or array_like, shape (n, 2)
        From `celnav.detect`, or bare pixel positions.
    camera : Camera
        The camera.
    utc : str, datetime or Utc
        Time of mid-exposure; a string is in ISO 8601 with a time zone.
    attitude : 3x3 array_like, Attitude or None
        `R_cam` (ENU to camera), an `Attitude` for one that is known only in part, or None if it is unknown.
    solver : str or callable
        One of `celnav.solvers()`, or a solver made with `ddr_solver` or `SkybenchSolver`.
    history : History, optional
        Memory of earlier frames, for solvers that use it. It is read and extended; without it, every frame is solved
        independently.
    flux : array_like, shape (n,), optional
        Brightness of bare positions, in any linear unit.
    pressure_hpa, temperature_c : float
        Pressure and temperature of the air at the observer, for refraction; a pressure of 0 means no refraction.
    dut1_s : float, optional
        UT1-UTC in seconds; taken from the IERS table unless given.
    near : LastKnown, optional
        A position and a radius known to contain the answer, so that fewer stars suffice. A solution outside it is
        refused as `Reason.INCONSISTENT`. Solvers of the thesis do not use it.
    time_limit_s : float, optional
        Wall-clock time in seconds after which the search for an identification is given up (`Reason.EFFORT_SPENT`).
        Only `skybench` supports it. Under a time limit the answer may differ from machine to machine;
        `SkybenchConfig.max_work` is a bound that gives the same answer everywhere.
    sigmas : ToldSigmas, optional
        Standard deviations of time, lens and air. That of the time enters every covariance. Only `skybench` uses the
        others: it adjusts the lens within its standard deviations, adds the uncertainty of the air to the covariance,
        and widens its search by both.

    Returns
    -------
    Fix
        A position, or a refusal with a reason.

    Raises
    ------
    CelnavError
        For malformed input; see `celnav.errors`.
    """
    clock = Stopwatch()
    with clock.stage("prepare"):
        chosen, name = _solver(solver)
        if not isinstance(camera, Camera):
            raise CameraError(f"camera must be a celnav.Camera, not {type(camera).__name__}")
        seen = as_detections(detections, flux)
        _check_fit(seen, camera)
        if time_limit_s is not None:
            check_time_limit(time_limit_s)
        if near is not None and not isinstance(near, LastKnown):
            raise ConfigError(f"near = {shown(near)} must be a celnav.LastKnown")
        if sigmas is not None and not isinstance(sigmas, ToldSigmas):
            raise ConfigError(f"sigmas = {shown(sigmas)} must be a celnav.ToldSigmas")
        if history is not None and not isinstance(history, History):
            raise ConfigError(f"history = {shown(history)} must be a celnav.History")
        told = Problem(
            _observed(seen.without_faint(), camera),
            parse_utc(utc),
            as_attitude(attitude),
            Weather(pressure_hpa, temperature_c),
            dut1_s,
            near,
            time_limit_s,
            _EXACT if sigmas is None else sigmas,
        )
    fix = chosen(told, history, clock)
    if seen.n_faint and fix.reason in _HELPED_BY_MORE:
        more = replace(told, observation=_observed(seen, camera), effort=_EFFORT_WITH_MORE)
        fix = _with_all(fix, chosen, more, history, clock)
    clock.time_ms["total"] = sum(clock.time_ms.values())
    return replace(fix, time_ms=clock.time_ms, solver=name)


def _observed(seen: Detections, camera: Camera) -> Observation:
    """Pair detections with their rays."""
    return Observation(
        seen.uv,
        camera.to_rays(seen.uv),
        seen.flux,
        camera,
        seen.sigma_px,
        streak_px=seen.streak_px,
        sigma_across_px=seen.sigma_across_px,
    )


def _with_all(refusal: Fix, solver: Solver, told: Problem, history: History | None, clock: Stopwatch) -> Fix:
    """Solve with the faint detections too, in the time that is left; return the first refusal where that is refused too."""
    if told.time_limit_s is not None:
        left_s = told.time_limit_s - sum(clock.time_ms.values()) / 1000
        if left_s <= 0:
            return refusal
        told = replace(told, time_limit_s=left_s)
    fix = solver(told, history, clock)
    return fix if fix.ok else refusal


def _solver(solver: str | Solver) -> tuple[Solver, str]:
    if not isinstance(solver, str):
        if not callable(solver):
            raise ConfigError(f"solver = {shown(solver)} must be a name or a solver")
        return solver, "custom"
    if solver not in SOLVERS:
        raise ConfigError(f"solver {solver!r} does not exist; there are: {', '.join(SOLVERS)}")
    return SOLVERS[solver], solver


def _check_fit(seen: Detections, camera: Camera) -> None:
    if seen.shape is not None and seen.shape != (camera.height, camera.width):
        raise CameraError(
            f"the camera is {camera.width} x {camera.height} pixels, but the image {seen.shape[1]} x {seen.shape[0]}"
        )
    camera.check_positions(seen.uv)
