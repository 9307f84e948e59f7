"""The solver ``skybench``: hypotheses from bright detections, verification of the whole field, one adjustment of all."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from celnav.adjustment import PARAMETERS, Adjusted, CameraPriors, adjust, candidate_pairs, predict, without_focal
from celnav.astrometry import DIURNAL_ABERRATION, celestial_to_terrestrial, terrestrial_stars
from celnav.camera import Camera
from celnav.catalog import StarCatalog, load_catalog
from celnav.earth_rotation import EarthOrientation, earth_orientation
from celnav.errors import ConfigError
from celnav.fix import Fix, Reason
from celnav.history import History
from celnav.horizon import Place, horizontal_frame, place_from_rotation
from celnav.identification.focal_lengths import identify_at_focal_lengths
from celnav.identification.identify import Question, SearchConfig
from celnav.identification.sky_index import load_sky_index
from celnav.identification.verification import Alignment, field_cone
from celnav.planets import ACCURACY_RAD, planet_directions, planet_ids
from celnav.problem import Problem, Stopwatch
from celnav.refraction import unrefract_rays

F8 = NDArray[np.float64]

EARTH_RADIUS_KM = 6371.0


@dataclass(frozen=True)
class SkybenchConfig:
    """Choices of the solver.

    Attributes
    ----------
    search : SearchConfig
        Of the identification.
    calibrate : str
        ``auto``: fit the focal length too where the frame says clearly that it is off; ``none``: trust the camera;
        ``full``: fit what `priors` leave free.
    priors : CameraPriors
        Standard deviations for ``full``.
    focal_factors : tuple of float
        On the focal length, tried in turn where nothing fits the camera as it is given; not with ``none``. Each covers 6 %
        to both sides, and makes a refusal take as much longer.
    single_star_sigma_deg : float
        With a heading and a tilt better than this, hypotheses come from single stars.
    min_stars : int
        Fewer matched stars are no fix.
    max_sigma_px : float
        A frame whose residuals scatter more is refused.
    max_heading_off_deg : float
        A heading that the stars contradict by more (plus five standard deviations) is refused.
    """

    search: SearchConfig = field(default_factory=SearchConfig)
    calibrate: Literal["auto", "none", "full"] = "auto"
    priors: CameraPriors = field(default_factory=lambda: CameraPriors(focal=0.03, centre_px=3.0, distortion=0.02))
    focal_factors: tuple[float, ...] = (0.88, 1.13)
    single_star_sigma_deg: float = 0.3
    min_stars: int = 4
    max_sigma_px: float = 8.0
    max_heading_off_deg: float = 1.0

    def __post_init__(self) -> None:
        if self.calibrate not in ("auto", "none", "full"):
            raise ConfigError(f"calibrate = {self.calibrate!r} must be auto, none or full")
        if not all(0.2 <= factor <= 5 for factor in self.focal_factors):
            raise ConfigError(f"focal_factors = {self.focal_factors!r} must lie between 0.2 and 5")


@dataclass(frozen=True, eq=False)
class _Prepared:
    """Detections in the solver's order, without what cannot be used."""

    rows: NDArray[np.intp]
    uv: F8
    rays: F8
    relative_sigma: F8 | None
    question: Question


@dataclass(frozen=True)
class SkybenchSolver:
    """Solver ``skybench``; make a variant with a configuration of your own."""

    config: SkybenchConfig = field(default_factory=SkybenchConfig)

    def __call__(self, problem: Problem, history: History | None, clock: Stopwatch) -> Fix:
        """Solve; `history` is not used."""
        with clock.stage("prepare"):
            orientation = earth_orientation(problem.utc, problem.dut1_s)
            to_terrestrial = celestial_to_terrestrial(problem.utc, orientation)
            prepared = _prepare(problem, to_terrestrial, self.config)
            distinct = len(np.unique(prepared.uv.round(1), axis=0)) if len(prepared.uv) < 50 else len(prepared.uv)
        if distinct < self.config.min_stars:
            return Fix.refusal(
                Reason.TOO_FEW_DETECTIONS,
                f"{distinct} distinct detections are too few: at least {self.config.min_stars} are needed",
            )
        with clock.stage("identify"):
            factors = () if self.config.calibrate == "none" else self.config.focal_factors
            found = identify_at_focal_lengths(prepared.question, load_sky_index(), self.config.search, factors)
        alignment, effort = found.alignment, found.effort
        if alignment is None:
            chance = min(1.0, 10.0**effort.best_log10_false_alarm)
            return Fix.refusal(
                Reason.NO_HYPOTHESIS,
                f"no orientation explains the detections better than chance ({effort.hypotheses} were tried)",
                confidence=1.0 - chance,
            )
        if found.rival is not None:
            counts = f"{len(alignment.detection)} and {len(found.rival.detection)} of the bright ones"
            message = f"two orientations explain the detections about as well: {counts}"
            return Fix.refusal(Reason.AMBIGUOUS, message, confidence=0.5)
        with clock.stage("fix"):
            return self._fix(problem, prepared, orientation, to_terrestrial, alignment)

    def _fix(
        self,
        problem: Problem,
        prepared: _Prepared,
        orientation: EarthOrientation,
        to_terrestrial: F8,
        alignment: Alignment,
    ) -> Fix:
        """Match the whole field, adjust it, and find the place."""
        camera = problem.observation.camera
        confidence = 1.0 - min(1.0, 10.0**alignment.log10_false_alarm)
        rotation = alignment.rotation @ to_terrestrial.T
        stars, dirs, limiting_mag, pairs = _visible_stars(problem, prepared, orientation, to_terrestrial, alignment)
        adjusted = self._adjust(camera, prepared, dirs, pairs, rotation, alignment)
        if adjusted is None or float(adjusted.weight.sum()) < self.config.min_stars:
            return Fix.refusal(Reason.INCONSISTENT, "the identified stars do not fit one orientation", confidence)
        fix = _describe(problem, prepared, stars, adjusted, alignment, limiting_mag, to_terrestrial, confidence)
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
        place = place_from_rotation(adjusted.rotation, adjusted.cov[:3, :3], problem.attitude)
        if refusal := self._contradiction(problem, place):
            return replace(fix, reason=Reason.INCONSISTENT, message=refusal)
        covariance = place.cov_km2 * max(1.0, place.chi2 / 16.0)
        return replace(
            fix, ok=True, lat_deg=place.lat_deg, lon_deg=place.lon_deg, cov_km2=covariance,
            details=dict(fix.details) | _heading(place),
        )  # fmt: skip

    def _adjust(
        self,
        camera: Camera,
        prepared: _Prepared,
        dirs: F8,
        pairs: tuple[NDArray[np.intp], NDArray[np.intp]],
        rotation: F8,
        alignment: Alignment,
    ) -> Adjusted | None:
        start = np.zeros(5)
        mode = self.config.calibrate
        if mode != "none":
            start[0] = alignment.log_f
        priors = {"none": CameraPriors(), "auto": CameraPriors(focal=0.05), "full": self.config.priors}[mode]
        radius = _pairing_radius(alignment.sigma_px)
        sigma, turned = max(alignment.sigma_px, 0.1), rotation
        adjusted = None
        for _ in range(4):
            adjusted = adjust(
                camera, prepared.uv, prepared.relative_sigma, dirs, pairs, turned, values=start,
                sigma_px=sigma, priors=priors, area_px=prepared.question.area_px,
            )  # fmt: skip
            if adjusted is None:
                return None
            # Pairs that the first guess left out would hold the solution back where it was.
            before, after = predict(camera, dirs @ turned.T, start), predict(
                camera, dirs @ adjusted.rotation.T, adjusted.camera_values
            )  # fmt: skip
            moved = float(np.sqrt(np.nanmax(np.einsum("ni,ni->n", after - before, after - before))))
            if radius >= 4 * adjusted.sigma_px + moved:
                break
            turned, start, sigma = adjusted.rotation, adjusted.camera_values, adjusted.sigma_px
            radius = _pairing_radius(sigma)
            detection, star, _ = candidate_pairs(prepared.uv, np.nan_to_num(after, nan=-1e6), radius)
            pairs = detection, star
        if mode != "auto" or adjusted is None:
            return adjusted
        clearly_off = abs(adjusted.camera_values[0]) > max(5 * adjusted.camera_sigmas[0], 3e-4)
        return adjusted if clearly_off else without_focal(adjusted)

    def _contradiction(self, problem: Problem, place: Place) -> str:
        """Say what the position contradicts, or nothing."""
        assert problem.attitude is not None
        limit = self.config.max_heading_off_deg + 5 * problem.attitude.heading_deg
        if not math.isnan(place.heading_off_deg) and abs(place.heading_off_deg) > limit:
            return f"the stars put the heading {place.heading_off_deg:.2f} deg from the one given"
        if problem.near is not None:
            lat, lon = (
                np.radians([place.lat_deg, problem.near.lat_deg]),
                np.radians([place.lon_deg, problem.near.lon_deg]),
            )
            cosine = math.sin(lat[0]) * math.sin(lat[1]) + math.cos(lat[0]) * math.cos(lat[1]) * math.cos(
                lon[0] - lon[1]
            )
            distance = EARTH_RADIUS_KM * math.acos(max(-1.0, min(1.0, cosine)))
            if distance > problem.near.radius_km:
                return f"the position is {distance:.0f} km from the last known one"
        return ""


def _heading(place: Place) -> dict[str, float]:
    return {} if math.isnan(place.heading_off_deg) else {"heading_off_deg": place.heading_off_deg}


def _prepare(problem: Problem, to_terrestrial: F8, config: SkybenchConfig) -> _Prepared:
    """Sort detections by brightness, take refraction off, and put together what the search needs."""
    seen, attitude = problem.observation, problem.attitude
    camera = seen.camera
    rows = np.flatnonzero(np.isfinite(seen.rays[:, 0]))
    if seen.flux is not None:
        rows = rows[np.argsort(-seen.flux[rows], kind="stable")]
    uv, rays = seen.uv[rows], seen.rays[rows]
    up = local = zenith_near = None
    if attitude is not None:
        frame = horizontal_frame(attitude)
        up = frame[:, 2]
        known = (
            attitude.kind == "rotation" and max(attitude.tilt_deg, attitude.heading_deg) <= config.single_star_sigma_deg
        )
        local = frame if known else None
        if problem.weather.pressure_hpa > 0:
            true = unrefract_rays(rays, up, problem.weather.pressure_hpa, problem.weather.temperature_c)
            moved = camera.project(true)
            # At the very edge of a lens's range the unrefracted ray may have no image.
            usable = np.isfinite(moved[:, 0])
            rows, uv, rays = rows[usable], moved[usable], true[usable]
        if problem.near is not None:
            lat, lon = math.radians(problem.near.lat_deg), math.radians(problem.near.lon_deg)
            zenith = np.array([math.cos(lat) * math.cos(lon), math.cos(lat) * math.sin(lon), math.sin(lat)])
            radius = (problem.near.radius_km + 150.0) / EARTH_RADIUS_KM
            if radius < math.pi:
                zenith_near = (to_terrestrial.T @ zenith, radius)
    area = float(camera.width * camera.height)
    if camera.model not in ("pinhole", "brown_conrady"):
        area *= _seen_part(camera)
    relative = None if seen.sigma_px is None else seen.sigma_px[rows]
    question = Question(
        camera, uv, rays, seen.flux is not None, camera.solid_angle_sr, area, local, to_terrestrial, up, zenith_near
    )
    return _Prepared(rows, uv, rays, relative, question)


def _seen_part(camera: Camera) -> float:
    """Part of the frame's pixels inside the image circle."""
    u, v = np.meshgrid(np.linspace(0, camera.width - 1, 32), np.linspace(0, camera.height - 1, 32))
    return max(float(np.isfinite(camera.to_rays(np.column_stack((u.ravel(), v.ravel())))[:, 0]).mean()), 1e-3)


def _with_diurnal_aberration(dirs: F8, zenith: F8) -> F8:
    """Shift terrestrial directions toward east by the observer's rotation with the Earth, at most 0.32 arcsec."""
    return np.asarray(dirs + DIURNAL_ABERRATION * np.array([-zenith[1], zenith[0], 0.0]))


def _visible_stars(
    problem: Problem,
    prepared: _Prepared,
    orientation: EarthOrientation,
    to_terrestrial: F8,
    alignment: Alignment,
) -> tuple[StarCatalog, F8, float, tuple[NDArray[np.intp], NDArray[np.intp]]]:
    """Choose the stars of the field that the frame is deep enough for.

    Returns
    -------
    The stars, their directions in the terrestrial frame (n, 3), the estimated limiting magnitude, and the pairs of
    detections and stars that may belong together.
    """
    camera = problem.observation.camera
    catalog = load_catalog()
    n = len(prepared.uv)
    deepest = int(min(len(catalog), (1.25 * n + 30) * 4 * math.pi / prepared.question.solid_angle_sr))
    middle, reach = field_cone(camera)
    axis, reach = np.array(middle), min(reach * 1.04 * max(1.0, math.exp(-alignment.log_f)) + 0.02, math.pi)
    near = np.flatnonzero(catalog.vectors[:deepest] @ (alignment.rotation.T @ axis) > math.cos(reach))
    ideal = camera.project(catalog.vectors[near] @ alignment.rotation.T)
    rows = near[_inside(camera, alignment.log_f, ideal, 4.0)]
    stars = catalog.take(rows)
    dirs = terrestrial_stars(stars, problem.utc, orientation, to_terrestrial).dirs
    rotation = alignment.rotation @ to_terrestrial.T
    if problem.attitude is not None:
        dirs = _with_diurnal_aberration(dirs, rotation.T @ horizontal_frame(problem.attitude)[:, 2])
    ideal = camera.project(dirs @ rotation.T)
    centre = np.array([camera.cx_px, camera.cy_px])
    predicted = np.nan_to_num(centre + math.exp(alignment.log_f) * (ideal - centre), nan=-1e6)
    radius = _pairing_radius(alignment.sigma_px)
    detection, star, distance = candidate_pairs(prepared.uv, predicted, radius)
    near_radius = max(3.0 * alignment.sigma_px, 1.0)
    seen = np.zeros(len(rows), dtype=bool)
    seen[star[distance <= near_radius]] = True
    chance = 1 - math.exp(-n * math.pi * near_radius**2 / prepared.question.area_px)
    n_kept, limit = _depth(seen, stars.v_mag, chance)
    kept = star < n_kept
    return stars.take(slice(n_kept)), dirs[:n_kept], limit, (detection[kept], star[kept])


def _pairing_radius(sigma_px: float) -> float:
    """Distance up to which a detection and a star may belong together."""
    return max(5.0 * sigma_px + 0.5, 1.5)


def _seen_planets(
    problem: Problem, prepared: _Prepared, adjusted: Adjusted, inertial: F8, taken: NDArray[np.integer]
) -> tuple[NDArray[np.int64], F8]:
    """Name the detections, brighter than most, that stand where a planet does and are no star: pairs and residuals.

    `taken` are the rows of `prepared` that are stars.
    """
    camera = problem.observation.camera
    n_bright = max(30, len(prepared.uv) // 10) if prepared.question.ranked else len(prepared.uv)
    is_free = np.ones(len(prepared.uv), dtype=bool)
    is_free[taken] = False
    free = np.flatnonzero(is_free[:n_bright])
    predicted = predict(camera, planet_directions(problem.utc) @ inertial.T, adjusted.camera_values)
    visible = np.flatnonzero(np.isfinite(predicted[:, 0]))
    if not len(free) or not len(visible):
        return np.empty((0, 2), dtype=np.int64), np.empty((0, 2))
    scale = camera.radians_per_px(predicted[visible])
    radius = float(np.nanmax(2 * ACCURACY_RAD / scale)) + 4 * adjusted.sigma_px
    seen, planet, distance = candidate_pairs(prepared.uv[free], predicted[visible], radius)
    order = np.argsort(distance, kind="stable")
    # Each planet has its nearest detection, and of planets in conjunction the nearest has the one detection of both.
    order = order[np.sort(np.unique(planet[order], return_index=True)[1])]
    order = order[np.unique(seen[order], return_index=True)[1]]
    seen, planet = free[seen[order]], visible[planet[order]]
    pairs = np.column_stack((prepared.rows[seen], planet_ids()[planet])).astype(np.int64)
    return pairs, prepared.uv[seen] - predicted[planet]


def _inside(camera: Camera, log_f: float, ideal: F8, margin_px: float) -> NDArray[np.bool_]:
    """Tell which ideal projections, shape (n, 2), fall into the frame with the focal length that was found."""
    centre = np.array([camera.cx_px, camera.cy_px])
    predicted = centre + math.exp(log_f) * (ideal - centre)
    return np.isfinite(predicted[:, 0]) & camera.in_frame(np.nan_to_num(predicted, nan=-1e6), margin_px)


def _depth(seen: NDArray[np.bool_], v_mag: F8, chance: float) -> tuple[int, float]:
    """Return how many of the stars, brightest first, the frame shows, and the magnitude where it stops.

    The number that maximises the sum of what each star adds: a star that is seen adds as much as it is unlikely by
    chance, one that is not takes away half of what bright stars add on average.
    """
    if not len(seen):
        return 0, math.nan
    bright = seen[: max(20, len(seen) // 8)]
    share = max((float(bright.mean()) - chance) / max(1 - chance, 1e-3), 0.05)
    expected = chance + 0.5 * share * (1 - chance)
    gain = np.cumsum(seen - expected)
    n = int(np.argmax(gain)) + 1
    return n, float(v_mag[n - 1])


def _describe(
    problem: Problem,
    prepared: _Prepared,
    stars: StarCatalog,
    adjusted: Adjusted,
    alignment: Alignment,
    limiting_mag: float,
    to_terrestrial: F8,
    confidence: float,
) -> Fix:
    """Put the identification into a fix that has no position yet."""
    # More than half the probability: at most one star of a detection has it. Of two detections that claim one star
    # the likelier has it.
    likely = np.flatnonzero(adjusted.weight > 0.5)
    likely = likely[np.argsort(-adjusted.weight[likely], kind="stable")]
    sure = np.sort(likely[np.unique(adjusted.star[likely], return_index=True)[1]])
    residuals = adjusted.residual_px[sure]
    matches = np.column_stack((prepared.rows[adjusted.detection[sure]], stars.star_id[adjusted.star[sure]]))
    inertial = adjusted.rotation @ to_terrestrial
    planets, planet_residuals = _seen_planets(problem, prepared, adjusted, inertial, adjusted.detection[sure])
    details: dict[str, float | int | str] = {
        "sigma_px": adjusted.sigma_px,
        "predicted_stars": len(stars),
    }
    for name, value, sigma in zip(PARAMETERS, adjusted.camera_values, adjusted.camera_sigmas, strict=True):
        if sigma > 0:
            details[name], details[f"{name}_sigma"] = float(value), float(sigma)
    return Fix(
        ok=False,
        reason=Reason.OK,
        confidence=confidence,
        matches=np.concatenate((matches.astype(np.int64), planets)),
        residual_rms_px=float(np.sqrt(np.mean(np.sum(residuals**2, axis=1)))) if len(sure) else math.nan,
        residuals_px=np.concatenate((residuals, planet_residuals)),
        R_icrs_to_camera=inertial,
        limiting_mag=limiting_mag,
        log10_false_alarm=alignment.log10_false_alarm,
        details=details,
    )
