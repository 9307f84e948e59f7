"""Detections, camera and attitude as the caller gave them, made ready for the search."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from celnav.camera import Camera
from celnav.horizon import horizontal_frame
from celnav.identification.neighbourhood import neighbourhood, open_region
from celnav.identification.question import Question
from celnav.problem import Problem
from celnav.sky.refraction import unrefract_rays

F8 = NDArray[np.float64]

# Below what any observer in the air sees: the horizon's dip is 3.2 deg at 10 km.
LOWEST_ALTITUDE_DEG = -5.0
_BELOW_HORIZON = math.sin(math.radians(LOWEST_ALTITUDE_DEG))


@dataclass(frozen=True, eq=False)
class Prepared:
    """Usable detections in the solver's order."""

    rows: NDArray[np.intp]
    uv: F8
    rays: F8
    relative_sigma: F8 | None
    question: Question


def prepare(problem: Problem, to_terrestrial: F8, max_detections: int, single_star_sigma_deg: float) -> Prepared:
    """Sort detections by brightness, take refraction off, and put together what the search needs.

    Parameters
    ----------
    problem : Problem
        As the caller gave it.
    to_terrestrial : ndarray, shape (3, 3)
        Celestial to terrestrial frame at the instant.
    max_detections : int
        Fainter detections beyond this many are left out.
    single_star_sigma_deg : float
        With a heading and a tilt better than this, hypotheses come from single stars.
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
            # No star is seen below the horizon. Where the vertical is wrong they can be named, and contradict it.
            below = rays @ up < _BELOW_HORIZON
            true[below] = rays[below]
            moved = camera.project(true)
            # At the very edge of a lens's range the unrefracted ray may have no image.
            usable = np.isfinite(moved[:, 0])
            rows, uv, rays = rows[usable], moved[usable], true[usable]
        if problem.near is not None:
            near = neighbourhood(problem.near, attitude, to_terrestrial, heading_known=local is not None)
    area = float(camera.width * camera.height)
    if camera.model not in ("pinhole", "brown_conrady"):
        area *= _seen_part(camera)
    relative = None if seen.sigma_px is None else seen.sigma_px[rows]
    mag = None if seen.flux is None else _magnitudes(seen.flux[rows])
    region = open_region(attitude, heading_known=local is not None)
    question = Question(
        camera, uv, rays, mag is not None, camera.solid_angle_sr, area, local, to_terrestrial, up, near, region, mag
    )
    return Prepared(rows, uv, rays, relative, question)


def _seen_part(camera: Camera) -> float:
    """Part of the frame's pixels inside the image circle."""
    u, v = np.meshgrid(np.linspace(0, camera.width - 1, 32), np.linspace(0, camera.height - 1, 32))
    return max(float(np.isfinite(camera.to_rays(np.column_stack((u.ravel(), v.ravel())))[:, 0]).mean()), 1e-3)


def _magnitudes(flux: F8) -> F8:
    """Magnitudes of fluxes up to a zero point, shape (n,); NaN where there is no light."""
    return np.asarray(-2.5 * np.log10(np.where(flux > 0, flux, np.nan)))
