"""The solver ``skybench``: hypotheses from bright detections, verified on the whole field, then one joint adjustment."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from celnav.adjustment import Adjusted, CameraPriors, adjust, predict, without_focal
from celnav.field_stars import Start, aberrated, describe, paired_at, pairing_radius, visible_stars
from celnav.fix import Estimate, Fix, Reason
from celnav.horizon import Place, distance_km, heading_contradicts, honest_place, horizontal_frame
from celnav.identification.effort import Effort
from celnav.identification.focal_lengths import identify_at_focal_lengths
from celnav.identification.neighbourhood import BELIEVED_SIGMAS
from celnav.identification.pairing import candidate_pairs, nowhere_far_off
from celnav.identification.prepared import LOWEST_ALTITUDE_DEG, Prepared, prepare
from celnav.identification.sky_index import sky_index_for
from celnav.identification.verification import Alignment
from celnav.matching.history import History
from celnav.position import refracting
from celnav.problem import Problem, Stopwatch
from celnav.sky.astrometry import celestial_to_terrestrial
from celnav.sky.earth_rotation import EarthOrientation, earth_orientation
from celnav.skybench_config import MOST_FOCAL_EFFORT, SkybenchConfig
from celnav.uncertainty.contradicted import (
    FREED_FOCAL,
    VERTICAL_DOUBT,
    doubt_deg,
    freed,
    lens_contradicted,
    unless_of_a_part,
    with_free_lens,
)
from celnav.uncertainty.field_errors import (
    FieldOfStars,
    NamedStars,
    measured_sigmas,
    shown_refraction,
    with_shared_errors,
)
from celnav.uncertainty.refraction_errors import RELATIVE_SIGMA
from celnav.uncertainty.turning_camera import at_mid_exposure, by_readout, fitted_readout, widened_by

F8 = NDArray[np.float64]

_USUAL_PRIORS = {"none": CameraPriors(), "auto": CameraPriors(focal=0.05)}
# Rounds of the fit of the readout time. Each round weighs the stars by their scatter after the shear has been removed.
_READOUT_ROUNDS = 2
# Factor on the initial noise where stars are streaks: their positions are far more accurate across the streak than along it,
# and the first orientation may be off by many standard deviations across it.
_STREAKS_SIGMA = 4.0


@dataclass(frozen=True)
class SkybenchSolver:
    """The solver ``skybench``; pass a configuration of your own to make a variant."""

    config: SkybenchConfig = field(default_factory=SkybenchConfig)

    def __call__(self, problem: Problem, history: History | None, clock: Stopwatch) -> Fix:
        """Solve; `history` is not used."""
        with clock.stage("prepare"):
            problem = at_mid_exposure(problem)
            orientation = earth_orientation(problem.utc, problem.dut1_s)
            to_terrestrial = celestial_to_terrestrial(problem.utc, orientation)
            prepared = prepare(problem, to_terrestrial, self.config.max_detections, self.config.single_star_sigma_deg)
            distinct = len(np.unique(prepared.uv.round(1), axis=0)) if len(prepared.uv) < 50 else len(prepared.uv)
        if distinct < self.config.min_stars:
            return _too_few(distinct, self.config.min_stars, problem.observation.rays)
        with clock.stage("identify"):
            factors = () if self.config.calibrate == "none" else self.config.focal_factors
            factors = problem.sigmas.focal_factors(factors, problem.observation.camera)
            effort = Effort(round(problem.effort * self.config.max_work), clock.started_s + self._time_limit_s(problem))
            found = identify_at_focal_lengths(
                prepared.question,
                sky_index_for(prepared.question.solid_angle_sr),
                self.config.search,
                factors,
                effort,
                min(self.config.focal_effort, MOST_FOCAL_EFFORT / max(len(factors), 1)),
            )
        alignment = found.alignment
        if alignment is None:
            return replace(_not_identified(effort), work=effort.work)
        if found.rival is not None:
            counts = f"{len(alignment.detection)} and {len(found.rival.detection)} of the bright ones"
            message = f"two orientations explain the detections about as well: {counts}"
            return replace(Fix.refusal(Reason.AMBIGUOUS, message, confidence=0.5), work=effort.work)
        with clock.stage("fix"):
            told = self._priors(problem)
            fix = self._fix(problem, prepared, orientation, to_terrestrial, alignment, told)
            if self.config.calibrate == "auto" and lens_contradicted(fix, problem.observation, problem.sigmas):
                freed_fixes, bent_fixes = (
                    self._freed(problem, prepared, orientation, to_terrestrial, alignment, told, distorted)
                    for distorted in (False, True)
                )
                fix = with_free_lens(fix, freed_fixes, bent_fixes, problem.observation, len(alignment.detection))
            elif self.config.calibrate == "full":
                fix = unless_of_a_part(fix, problem.observation, len(alignment.detection))
            return replace(fix, work=effort.work)

    def _freed(
        self,
        problem: Problem,
        prepared: Prepared,
        orientation: EarthOrientation,
        to_terrestrial: F8,
        alignment: Alignment,
        told: CameraPriors,
        distorted: bool,
    ) -> Iterator[Fix]:
        """Yield answers with the lens freed, from both starting points; with its radial terms too if `distorted`."""
        free = freed(told, problem.observation.camera, distorted=distorted)
        for kept in (False, True):
            yield self._fix(problem, prepared, orientation, to_terrestrial, alignment, free, kept=kept)

    def _time_limit_s(self, problem: Problem) -> float:
        """Return the shorter of the configuration's time limit and the caller's; infinity if neither is set."""
        limits = (self.config.time_limit_s, problem.time_limit_s)
        return min((limit for limit in limits if limit is not None), default=math.inf)

    def _fix(
        self,
        problem: Problem,
        prepared: Prepared,
        orientation: EarthOrientation,
        to_terrestrial: F8,
        alignment: Alignment,
        priors: CameraPriors,
        air: Estimate | None = None,
        kept: bool = False,
    ) -> Fix:
        """Match the whole field, adjust it and find the position; `air` is the error of the refraction shown by the stars.

        With `kept`, the adjustment starts from those stars alone that fit the camera as supplied. Where that is far off, they
        are few, but the others' pairs with wrong stars would outweigh them.
        """
        camera = problem.observation.camera
        identified = alignment
        alignment = replace(alignment, rotation=aberrated(alignment.rotation, camera, problem.utc))
        confidence = 1.0 - min(1.0, 10.0**alignment.log10_false_alarm)
        rotation = alignment.rotation @ to_terrestrial.T
        stars, dirs, limiting_mag, pairs = visible_stars(problem, prepared, orientation, to_terrestrial, alignment)
        given = prepared
        start = self._start(alignment, rotation, prepared)
        if kept and (held := self._adjust_given(problem, given, dirs, pairs, start, self._priors(problem))) is not None:
            fits = held.weight > 0.5
            start, pairs = Start.from_fit(held), (held.detection[fits], held.star[fits])
        adjusted, prepared, readout = self._adjust(problem, given, dirs, pairs, start, priors)
        misfit = Fix.refusal(Reason.INCONSISTENT, "the identified stars do not fit one orientation", confidence)
        if adjusted is None or not self._fits(adjusted):
            return misfit
        weather = problem.weather.pressure_hpa, problem.weather.temperature_c
        up = None if problem.weather.pressure_hpa == 0 else prepared.question.up
        told = math.hypot(RELATIVE_SIGMA, problem.sigmas.refraction(*weather)) if air is None else air.sigma
        seen = FieldOfStars(
            camera, prepared.uv, prepared.rays, prepared.relative_sigma, dirs, up, weather, told, prepared.whitening
        )
        named = NamedStars.of(seen, adjusted)
        if air is None and (shown := shown_refraction(named)) is not None:
            problem = replace(problem, weather=refracting(problem.weather, shown.value))
            corrected = prepare(problem, to_terrestrial, self.config.max_detections, self.config.single_star_sigma_deg)
            return self._fix(problem, corrected, orientation, to_terrestrial, identified, priors, shown, kept)
        widened, shared = with_shared_errors(named, priors, problem.attitude)
        # Residuals that neighbours share come from a wrong lens or moving air, and say nothing about the scatter of single
        # stars.
        if shared is None and (sigmas := measured_sigmas(seen, adjusted)) is not None:
            weighed = given.weighed(sigmas)
            # Orientation and camera belong together: with the camera as supplied, the stars would be elsewhere.
            anew, pairs = paired_at(camera, weighed, dirs, adjusted)
            again, moved, read = self._adjust(problem, weighed, dirs, pairs, anew, priors)
            if again is not None:
                if not self._fits(again):
                    return misfit
                adjusted, prepared, readout = again, moved, read
                seen = replace(seen, uv=prepared.uv, relative_sigma=sigmas, whitening=prepared.whitening)
                widened, shared = with_shared_errors(NamedStars.of(seen, again), priors, problem.attitude)
        scatter_cov = adjusted.cov[:3, :3]
        common = widened.cov[:3, :3] - scatter_cov + _by_camera(adjusted)
        adjusted = widened
        fix = describe(
            problem, prepared, stars, adjusted, alignment, limiting_mag, to_terrestrial, confidence, shared, air
        )
        fix = replace(fix, common_cov_rad2=common)
        if readout is not None:
            told_of_it = {"readout": readout.value, "readout_sigma": readout.sigma}
            fix = replace(fix, details={**fix.details, **told_of_it})
        if doubt := doubt_deg(adjusted, camera, problem.sigmas, self._priors(problem)):
            fix = replace(fix, details={**fix.details, VERTICAL_DOUBT: doubt})
        if adjusted.sigma_px > self.config.max_sigma_px:
            message = f"the stars scatter by {adjusted.sigma_px:.1f} px: check the camera"
            return replace(fix, reason=Reason.INCONSISTENT, message=message)
        if problem.attitude is None:
            return replace(
                fix,
                reason=Reason.VERTICAL_REQUIRED,
                message="the stars are identified and give R_icrs_to_camera; a position needs the vertical too: "
                "give Attitude.up",
            )
        place = honest_place(adjusted.rotation, adjusted.cov[:3, :3], problem.attitude, scatter_cov, doubt)
        place = replace(place, cov_km2=problem.sigmas.with_time(place.cov_km2, place.lat_deg))
        if refusal := self._contradiction(problem, place) or _below_horizon(problem, adjusted, dirs):
            return replace(fix, reason=Reason.INCONSISTENT, message=refusal)
        return replace(
            fix, ok=True, lat_deg=place.lat_deg, lon_deg=place.lon_deg, cov_km2=place.cov_km2,
            heading_off_deg=place.heading_off_deg,
        )  # fmt: skip

    def _fits(self, adjusted: Adjusted) -> bool:
        """Whether enough stars agree with the adjustment."""
        return int(np.count_nonzero(adjusted.weight > 0.5)) >= self.config.min_stars

    def _adjust(
        self,
        problem: Problem,
        prepared: Prepared,
        dirs: F8,
        pairs: tuple[NDArray[np.intp], NDArray[np.intp]],
        start: Start,
        priors: CameraPriors,
    ) -> tuple[Adjusted | None, Prepared, Estimate | None]:
        """Adjust the field; if the camera turned, also fit the readout time and subtract its shifts from the detections."""
        adjusted = self._adjust_given(problem, prepared, dirs, pairs, start, priors)
        camera, turn, sigma = problem.observation.camera, problem.turn_rad, self.config.readout_sigma
        if adjusted is None or turn is None or sigma == 0:
            return adjusted, prepared, None
        shift = by_readout(camera, prepared.uv, prepared.rays, turn)
        moved, readout, answer = prepared, Estimate(0.0, sigma), np.zeros(len(adjusted.cov))
        for _ in range(_READOUT_ROUNDS):
            seen = FieldOfStars(
                camera, moved.uv, moved.rays, moved.relative_sigma, dirs, None, (0.0, 0.0), 0.0, moved.whitening
            )
            before = readout.value
            readout, answer = fitted_readout(NamedStars.of(seen, adjusted), shift, priors, sigma, readout.value)
            moved = replace(moved, uv=prepared.uv - readout.value * shift)
            left = adjusted.residual_px - ((readout.value - before) * shift).take(adjusted.detection, axis=0)
            moved = moved.rebalanced(left, adjusted.detection, adjusted.weight)
            start, pairs = paired_at(camera, moved, dirs, adjusted)
            again = self._adjust_given(problem, moved, dirs, pairs, start, priors)
            if again is None or len(again.cov) != len(answer):
                return again, moved, readout
            adjusted = again
        return widened_by(adjusted, readout, answer), moved, readout

    def _adjust_given(
        self,
        problem: Problem,
        prepared: Prepared,
        dirs: F8,
        pairs: tuple[NDArray[np.intp], NDArray[np.intp]],
        start: Start,
        priors: CameraPriors,
    ) -> Adjusted | None:
        mode, camera, adjusted = self.config.calibrate, problem.observation.camera, None
        for _ in range(4):
            adjusted = adjust(
                camera, prepared.uv, prepared.relative_sigma, dirs, pairs, start.rotation, values=start.values,
                sigma_px=start.sigma_px, priors=priors, area_px=prepared.question.area_px, whitening=prepared.whitening,
            )  # fmt: skip
            if adjusted is None:
                return None
            if adjusted.sigma_px > self.config.max_sigma_px:
                break  # refused in any case: pairs farther apart would only scatter more
            # If pairs that the first guess left out stayed out, they would hold the solution near its starting point.
            after = predict(camera, dirs @ adjusted.rotation.T, adjusted.camera_values)
            apart = after - predict(camera, dirs @ start.rotation.T, start.values)
            moved = math.sqrt(float(np.fmax.reduce(np.einsum("ni,ni->n", apart, apart))))
            if start.radius_px >= 4 * adjusted.sigma_px + moved:
                break
            start = Start.from_fit(adjusted)
            detection, star, _ = candidate_pairs(prepared.uv, nowhere_far_off(after), start.radius_px)
            pairs = detection, star
        if mode != "auto" or problem.sigmas.focal > 0 or problem.sigmas.distortion > 0 or adjusted is None:
            return adjusted
        if priors.focal >= FREED_FOCAL:
            return adjusted
        clearly_off = abs(adjusted.camera_values[0]) > max(5 * adjusted.camera_sigmas[0], 3e-4)
        return adjusted if clearly_off else without_focal(adjusted)

    def _start(self, alignment: Alignment, rotation: F8, prepared: Prepared) -> Start:
        values = np.zeros(5)
        if self.config.calibrate != "none":
            values[0] = alignment.log_f
        sigma = max(alignment.sigma_px, 0.1) * (1.0 if prepared.whitening is None else _STREAKS_SIGMA)
        return Start(rotation, values, sigma, pairing_radius(alignment.sigma_px))

    def _priors(self, problem: Problem) -> CameraPriors:
        held, told = _USUAL_PRIORS.get(self.config.calibrate, self.config.priors), problem.sigmas
        if not told.focal and not told.centre_px and not told.distortion:
            return held
        return replace(
            held,
            focal=told.focal or held.focal,
            centre_px=told.centre_px or held.centre_px,
            distortion=told.distortion_at_corner(problem.observation.camera) or held.distortion,
        )

    def _contradiction(self, problem: Problem, place: Place) -> str:
        """Describe the contradiction between the position and the caller's inputs; empty if there is none."""
        assert problem.attitude is not None
        limit = self.config.heading_limit_deg(problem.attitude, problem.sigmas, problem.observation.camera)
        if heading_contradicts(place, limit):
            return f"the stars put the heading {place.heading_off_deg:.2f} deg from the one given"
        if problem.near is not None:
            distance = distance_km(place.lat_deg, place.lon_deg, problem.near.lat_deg, problem.near.lon_deg)
            uncertainty = BELIEVED_SIGMAS * math.sqrt(max(float(np.linalg.eigvalsh(place.cov_km2)[-1]), 0.0))
            if distance > problem.near.radius_km + uncertainty:
                return (
                    f"the stars put the place at {place.lat_deg:.2f}, {place.lon_deg:.2f} deg, {distance:.0f} km from the "
                    f"last known one, which near= holds within {problem.near.radius_km:g} km"
                )
        return ""


def _by_camera(adjusted: Adjusted) -> F8:
    """Contribution of the fitted camera parameters to the covariance of the rotation, rad^2, shape (3, 3)."""
    mixed = adjusted.cov[:3, 3:]
    return np.asarray(mixed @ np.linalg.solve(adjusted.cov[3:, 3:], mixed.T))


def _below_horizon(problem: Problem, adjusted: Adjusted, dirs: F8) -> str:
    """Describe how many identified stars are below the supplied horizon, if too many are for misidentification."""
    if problem.weather.pressure_hpa == 0:  # outside the atmosphere the horizon may be anywhere
        return ""
    assert problem.attitude is not None
    is_named = np.zeros(len(dirs), dtype=bool)
    is_named[adjusted.star[adjusted.weight > 0.5]] = True
    named = np.flatnonzero(is_named)
    sine = dirs[named] @ adjusted.rotation.T @ horizontal_frame(problem.attitude)[:, 2]
    lowest_deg = max(LOWEST_ALTITUDE_DEG - 3 * problem.attitude.tilt_deg, -90.0)
    below = int(np.sum(sine < math.sin(math.radians(lowest_deg))))
    if below <= max(3, 0.05 * len(named)):
        return ""
    return f"{below} of {len(named)} stars lie below the horizon: check the attitude"


def _too_few(distinct: int, wanted: int, rays: F8) -> Fix:
    """Return a refusal that says whether the camera leaves few detections; `rays` are NaN outside its image circle."""
    outside = int(np.count_nonzero(~np.isfinite(rays).all(axis=1)))
    message = f"{distinct} distinct detections are too few: at least {wanted} are needed"
    if outside > len(rays) / 2:
        message = f"{outside} of {len(rays)} detections lie outside the camera's image circle: is f_px in pixels?"
    return Fix.refusal(Reason.TOO_FEW_DETECTIONS, message)


def _not_identified(effort: Effort) -> Fix:
    """Return a refusal that says whether all hypotheses were tried."""
    tried = f"no orientation explains the detections better than chance ({effort.hypotheses} were tried)"
    confidence = 1.0 - min(1.0, 10.0**effort.best_log10_false_alarm)
    if not effort.spent:
        return Fix.refusal(Reason.NO_HYPOTHESIS, tried, confidence)
    if time.perf_counter() >= effort.deadline_s:
        message = f"{tried} before the time limit; allow more time_limit_s"
    else:
        message = f"{tried} within the effort allowed; SkybenchConfig.max_work = {effort.max_work} bounds it"
    return Fix.refusal(Reason.EFFORT_SPENT, message, confidence)
