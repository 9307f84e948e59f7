"""Preparation of the caller's detections, camera and attitude for the search."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from celnav.horizon import horizontal_frame
from celnav.identification.frame_grid import frame_grid
from celnav.identification.neighbourhood import neighbourhood, open_region
from celnav.identification.question import Question
from celnav.matching.protocol import Observation
from celnav.problem import Problem
from celnav.sky.refraction import unrefract_rays

F8 = NDArray[np.float64]

# For streaks: a squared residual counts as at most this many times the mean square, and the ratio of the stated standard
# deviations along and across is corrected by at most this factor.
_MOST_SQUARE, _MOST_RATIO = 9.0, 6.0
# Lower than any observer in the air can see: the dip of the horizon is 3.2 deg at 10 km.
LOWEST_ALTITUDE_DEG = -5.0
_BELOW_HORIZON = math.sin(math.radians(LOWEST_ALTITUDE_DEG))


@dataclass(frozen=True, eq=False)
class Prepared:
    """Usable detections in the solver's order; for streaks, `whitening` makes their errors isotropic."""

    rows: NDArray[np.intp]
    uv: F8
    rays: F8
    relative_sigma: F8 | None
    question: Question
    whitening: F8 | None = None

    def rebalanced(self, residual: F8, rows: NDArray[np.intp], weight: F8) -> Prepared:
        """Return a copy with standard deviations along and across streaks in the ratio of the residuals.

        Parameters
        ----------
        residual : ndarray, shape (m, 2)
            Measured minus predicted, px.
        rows : ndarray, shape (m,)
            Rows of their detections.
        weight : ndarray, shape (m,)
            Probabilities that the detections are those stars.
        """
        if self.whitening is None:
            return self
        white = (self.whitening.take(rows, axis=0) @ residual[:, :, None])[:, :, 0]
        along, across = np.sqrt(weight @ np.minimum(white**2, _MOST_SQUARE * (weight @ white**2 / weight.sum())))
        ratio = min(max(along / max(across, 1e-12), 1 / _MOST_RATIO), _MOST_RATIO)
        return replace(self, whitening=self.whitening * np.array([[ratio**-0.5], [ratio**0.5]]))

    def weighed(self, sigmas: F8) -> Prepared:
        """Return a copy with other relative standard deviations, shape (n,); streaks keep their ratio of along to across."""
        white = self.whitening
        if white is not None and self.relative_sigma is not None:
            ratio = self.relative_sigma / sigmas
            white = white * (ratio / np.median(ratio))[:, None, None]
        return replace(self, relative_sigma=sigmas, whitening=white)


def prepare(problem: Problem, to_terrestrial: F8, max_detections: int, single_star_sigma_deg: float) -> Prepared:
    """Sort detections by brightness, remove refraction, and assemble the inputs of the search.

    Parameters
    ----------
    problem : Problem
        The problem as posed by the caller.
    to_terrestrial : ndarray, shape (3, 3)
        Rotation from the celestial to the terrestrial frame at the instant.
    max_detections : int
        Largest number of detections; fainter ones are left out.
    single_star_sigma_deg : float
        If heading and tilt are known better than this, hypotheses come from single stars.
    """
    seen, attitude = problem.observation, problem.attitude
    camera = seen.camera
    rows = np.flatnonzero(np.isfinite(seen.rays[:, 0]))
    if seen.flux is not None:
        rows = rows[np.argsort(-seen.flux[rows], kind="stable")]
    rows = rows[:max_detections]
    uv, rays = seen.uv[rows], seen.rays[rows]
    up = local = near = None
    if attitude is not None:
        frame = horizontal_frame(attitude)
        up = frame[:, 2]
        attitude = problem.sigmas.loosened(attitude, camera)
        known = attitude.kind == "rotation" and max(attitude.tilt_deg, attitude.heading_deg) <= single_star_sigma_deg
        local = frame if known else None
        if problem.weather.pressure_hpa > 0:
            true = unrefract_rays(rays, up, problem.weather.pressure_hpa, problem.weather.temperature_c)
            # No star is visible below the horizon. If the vertical is wrong, these can be identified and then contradict it.
            below = rays @ up < _BELOW_HORIZON
            true[below] = rays[below]
            moved = camera.project(true)
            # At the very edge of a lens's range, the ray without refraction may have no image.
            usable = np.isfinite(moved[:, 0])
            rows, uv, rays = rows[usable], moved[usable], true[usable]
        if problem.near is not None:
            near = neighbourhood(problem.near, attitude, to_terrestrial, heading_known=local is not None)
    area = float(camera.width * camera.height)
    if camera.model not in ("pinhole", "brown_conrady"):
        area *= frame_grid(camera).seen_part
    relative = None if seen.sigma_px is None else seen.sigma_px[rows]
    mag = None if seen.flux is None else _magnitudes(seen.flux[rows])
    region = open_region(attitude, heading_known=local is not None)
    question = Question(
        camera,
        uv,
        rays,
        mag is not None,
        frame_grid(camera).solid_angle_sr,
        area,
        local,
        to_terrestrial,
        up,
        near,
        region,
        mag,
    )
    return Prepared(rows, uv, rays, relative, question, whitening(seen, rows))


def whitening(seen: Observation, rows: NDArray[np.intp]) -> F8 | None:
    """Return matrices, shape (n, 2, 2), that make the errors of detections isotropic and equal up to a common factor.

    Along a streak, a position is known less well than across it. None if no detection has a streak.
    """
    if seen.streak_px is None or seen.sigma_px is None or seen.sigma_across_px is None:
        return None
    sigma, across, streak = seen.sigma_px[rows], seen.sigma_across_px[rows], seen.streak_px[rows]
    length = np.hypot(*streak.T)
    unit = np.where(length[:, None] > 0, streak, [1.0, 0.0]) / np.where(length > 0, length, 1.0)[:, None]
    along = np.sqrt(np.maximum(2 * sigma**2 - across**2, across**2))
    beside = np.column_stack((-unit[:, 1], unit[:, 0]))
    return np.asarray(np.median(sigma) * np.stack((unit / along[:, None], beside / across[:, None]), axis=1))


def _magnitudes(flux: F8) -> F8:
    """Return the magnitudes of fluxes up to a zero point, shape (n,); NaN where the flux is not positive."""
    return np.asarray(-2.5 * np.log10(np.where(flux > 0, flux, np.nan)))
