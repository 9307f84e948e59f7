"""Stars and planets of an identified field: which stars the frame is deep enough for, and which planets it shows."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from celnav.adjustment import PARAMETERS, Adjusted, predict
from celnav.camera import Camera
from celnav.fix import Calibration, Estimate, Fix, Reason
from celnav.horizon import horizontal_frame
from celnav.identification.pairing import candidate_pairs, first_of_each, nowhere_far_off
from celnav.identification.prepared import Prepared
from celnav.identification.verification import Alignment, field_cone, rotation_of
from celnav.problem import Problem
from celnav.sky.astrometry import DIURNAL_ABERRATION, earth_at, terrestrial_stars
from celnav.sky.catalog import StarCatalog, load_catalog
from celnav.sky.earth_rotation import EarthOrientation
from celnav.sky.planets import ACCURACY_RAD, planet_directions, planet_ids
from celnav.sky.utc import Utc
from celnav.uncertainty.shared_residuals import SharedField

F8 = NDArray[np.float64]

# Approximate limit on the pairs of a detection and a star that one adjustment weighs; a hundred thousand take a second.
# Only thousands of detections that scatter by many pixels come near it, and then fainter stars are left out.
MOST_PAIRS = 30_000
# Fainter stars are left out only as long as at least this many stars remain in the field.
FEWEST_STARS = 200
_NO_PLANETS = np.empty((0, 2), dtype=np.int64), np.empty((0, 2))
# Stars are left out where they are so faint that detections occur near them less than this many times as often as by
# chance: one in eight would be false.
_OVER_CHANCE = 8.0


def _with_diurnal_aberration(dirs: F8, zenith: F8) -> F8:
    """Shift terrestrial directions toward east by the observer's rotation with the Earth, at most 0.32 arcsec."""
    return np.asarray(dirs + DIURNAL_ABERRATION * np.array([-zenith[1], zenith[0], 0.0]))


def aberrated(rotation: F8, camera: Camera, utc: Utc) -> F8:
    """Convert an orientation found with positions free of aberration to one for apparent positions, shape (3, 3).

    Over a narrow field the annual aberration, up to 20.5 arcsec, is a single rotation; with a long lens it amounts to
    several pixels.
    """
    x, y, z = (rotation.T @ np.array(field_cone(camera)[0])).tolist()
    p, q, r = earth_at(utc).beta.tolist()
    turn = np.array([y * r - z * q, z * p - x * r, x * q - y * p])
    return np.asarray(rotation @ rotation_of(turn).T)


def visible_stars(
    problem: Problem,
    prepared: Prepared,
    orientation: EarthOrientation,
    to_terrestrial: F8,
    alignment: Alignment,
) -> tuple[StarCatalog, F8, float, tuple[NDArray[np.intp], NDArray[np.intp]]]:
    """Choose the stars of the field that the frame is deep enough to show.

    Returns
    -------
    StarCatalog, ndarray, float, tuple of two ndarrays
        The stars, their directions in the terrestrial frame, shape (n, 3), the magnitude that separates seen from unseen
        stars, and the pairs of detections and stars that may belong together.
    """
    camera = problem.observation.camera
    catalog = load_catalog()
    n = len(prepared.uv)
    radius = pairing_radius(alignment.sigma_px)
    in_field = min(
        1.25 * n + 30, max(MOST_PAIRS * prepared.question.area_px / (n * math.pi * radius**2), float(FEWEST_STARS))
    )
    deepest = int(min(len(catalog), in_field * 4 * math.pi / prepared.question.solid_angle_sr))
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
    predicted = nowhere_far_off(centre + math.exp(alignment.log_f) * (ideal - centre))
    detection, star, distance = candidate_pairs(prepared.uv, predicted, radius)
    near_radius = max(3.0 * alignment.sigma_px, 1.0)
    seen = np.zeros(len(rows), dtype=bool)
    seen[star[distance <= near_radius]] = True
    chance = 1 - math.exp(-n * math.pi * near_radius**2 / prepared.question.area_px)
    n_kept, limit = _depth(seen, stars.v_mag, chance)
    kept = star < n_kept
    return stars.take(slice(n_kept)), dirs[:n_kept], limit, (detection[kept], star[kept])


def pairing_radius(sigma_px: float) -> float:
    """Distance up to which a detection and a star may belong together, pixels."""
    return max(5.0 * sigma_px + 0.5, 1.5)


@dataclass(frozen=True, eq=False)
class Start:
    """Starting point of an adjustment: orientation and camera, which belong together, noise and pairing radius.

    Attributes
    ----------
    rotation : ndarray, shape (3, 3)
        Terrestrial frame to camera.
    values : ndarray, shape (5,)
        Changes of the camera, in the order of `PARAMETERS`.
    sigma_px : float
        Noise of the positions.
    radius_px : float
        Pairing radius.
    """

    rotation: F8
    values: F8
    sigma_px: float
    radius_px: float

    @classmethod
    def from_fit(cls, fit: Adjusted) -> Start:
        """Start where another adjustment ended."""
        return cls(fit.rotation, fit.camera_values, fit.sigma_px, pairing_radius(fit.sigma_px))


def paired_at(
    camera: Camera, prepared: Prepared, dirs: F8, adjusted: Adjusted
) -> tuple[Start, tuple[NDArray[np.intp], NDArray[np.intp]]]:
    """Return the start of an adjustment that follows another, and its pairs of detections and stars."""
    start = Start.from_fit(adjusted)
    predicted = nowhere_far_off(predict(camera, dirs @ start.rotation.T, start.values))
    detection, star, _ = candidate_pairs(prepared.uv, predicted, start.radius_px)
    return start, (detection, star)


def seen_planets(
    problem: Problem, prepared: Prepared, adjusted: Adjusted, inertial: F8, taken: NDArray[np.integer]
) -> tuple[NDArray[np.int64], F8]:
    """Identify planets among the detections that are brighter than most and are not stars; return pairs and residuals.

    `taken` holds the rows of `prepared` that are stars.
    """
    camera = problem.observation.camera
    n_bright = max(30, len(prepared.uv) // 10) if prepared.question.ranked else len(prepared.uv)
    is_free = np.ones(len(prepared.uv), dtype=bool)
    is_free[taken] = False
    free = np.flatnonzero(is_free[:n_bright])
    if not len(free):
        return _NO_PLANETS
    predicted = predict(camera, planet_directions(problem.utc) @ inertial.T, adjusted.camera_values)
    visible = np.flatnonzero(np.isfinite(predicted[:, 0]))
    scale = camera.radians_per_px(predicted[visible])
    # Far outside the frame the lens formula may give an image position but no plate scale.
    visible, scale = visible[np.isfinite(scale)], scale[np.isfinite(scale)]
    if not len(visible):
        return _NO_PLANETS
    radius = float(np.max(2 * ACCURACY_RAD / scale)) + 4 * adjusted.sigma_px
    seen, planet, distance = candidate_pairs(prepared.uv[free], predicted[visible], radius)
    order = np.argsort(distance, kind="stable")
    # Each planet gets its nearest detection; of planets in conjunction, the nearest gets their common detection.
    order = order[first_of_each(planet[order])]
    order = order[first_of_each(seen[order])]
    order = order[np.argsort(seen[order])]
    seen, planet = free[seen[order]], visible[planet[order]]
    pairs = np.column_stack((prepared.rows[seen], planet_ids()[planet])).astype(np.int64)
    return pairs, prepared.uv[seen] - predicted[planet]


def _inside(camera: Camera, log_f: float, ideal: F8, margin_px: float) -> NDArray[np.bool_]:
    """Return which ideal projections, shape (n, 2), fall into the frame with the focal length that was found."""
    centre = np.array([camera.cx_px, camera.cy_px])
    predicted = centre + math.exp(log_f) * (ideal - centre)
    return camera.in_frame(predicted, margin_px)


def _depth(seen: NDArray[np.bool_], v_mag: F8, chance: float) -> tuple[int, float]:
    """Return how many stars to look for, brightest first, and the magnitude that separates seen from unseen stars.

    That magnitude maximises a sum over the stars: a seen star adds as much as it is unlikely by chance, and an unseen one
    subtracts half of what bright stars add on average. Clouds with gaps hide bright stars and show fainter ones, so stars are
    looked for as deep as most of those seen are not due to chance.
    """
    if not len(seen):
        return 0, math.nan
    bright = seen[: max(20, len(seen) // 8)]
    share = max((float(bright.mean()) - chance) / max(1 - chance, 1e-3), 0.05)
    expected = chance + 0.5 * share * (1 - chance)
    limit = int(np.argmax(np.cumsum(seen - expected)))
    number = int(np.argmax(np.cumsum(seen - min(expected, _OVER_CHANCE * chance)))) + 1
    return max(number, limit + 1), float(v_mag[limit])


def describe(
    problem: Problem,
    prepared: Prepared,
    stars: StarCatalog,
    adjusted: Adjusted,
    alignment: Alignment,
    limiting_mag: float,
    to_terrestrial: F8,
    confidence: float,
    shared: SharedField | None,
    air: Estimate | None,
) -> Fix:
    """Make a fix without a position from the identification; `air` is the fitted relative error of the refraction."""
    # The probabilities are approximate where pairs form loops, as with double stars closer than the noise. A detection or a
    # star that is claimed twice goes to the most probable pair.
    likely = np.flatnonzero(adjusted.weight > 0.5)
    for claimed in (adjusted.star, adjusted.detection):
        if np.bincount(claimed[likely]).max(initial=0) > 1:
            likely = likely[np.argsort(-adjusted.weight[likely], kind="stable")]
            likely = likely[first_of_each(claimed[likely])]
    sure = np.sort(likely)
    residuals = adjusted.residual_px[sure]
    matches = np.column_stack((prepared.rows[adjusted.detection[sure]], stars.star_id[adjusted.star[sure]]))
    inertial = adjusted.rotation @ to_terrestrial
    planets, planet_residuals = seen_planets(problem, prepared, adjusted, inertial, adjusted.detection[sure])
    details: dict[str, float | int | str] = {
        "sigma_px": adjusted.sigma_px,
        "predicted_stars": len(stars),
        "stars_to_limit": int(np.count_nonzero(stars.v_mag <= limiting_mag)),
    }
    if shared is not None:
        details |= {"shared_px": shared.rms_px, "shared_length_px": shared.length_px, "shared_score": shared.score}
    if air is not None:
        details |= {"refraction": air.value, "refraction_sigma": air.sigma}
    calibration = Calibration(
        **{
            name: Estimate(float(value), float(sigma))
            for name, value, sigma in zip(PARAMETERS, adjusted.camera_values, adjusted.camera_sigmas, strict=True)
            if sigma > 0
        }
    )
    return Fix(
        ok=False,
        reason=Reason.OK,
        confidence=confidence,
        matches=np.concatenate((matches.astype(np.int64), planets)),
        residual_rms_px=math.sqrt(float(np.vdot(residuals, residuals)) / len(sure)) if len(sure) else math.nan,
        residuals_px=np.concatenate((residuals, planet_residuals)),
        R_icrs_to_camera=inertial,
        rotation_cov_rad2=adjusted.cov[:3, :3],
        limiting_mag=limiting_mag,
        log10_false_alarm=alignment.log10_false_alarm,
        calibration=calibration,
        details=details,
    )
