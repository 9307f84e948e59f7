"""Inputs that the stars contradict: a lens that has changed since its calibration, or a mount that has moved.

If the stars do not fit the supplied lens, its focal length and principal point are freed and fitted. The vertical came from
the same calibration, but stars cannot check it; its uncertainty is raised by as much as heading and lens proved to be off.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from celnav.adjustment import Adjusted, CameraPriors, design_of
from celnav.camera import Camera
from celnav.fix import Fix, Reason
from celnav.matching.protocol import Observation
from celnav.problem import ToldSigmas
from celnav.sky.wgs84 import MEAN_RADIUS_KM

FREED_FOCAL = 0.1
"""Standard deviation of the logarithm of the focal length where the supplied lens does not hold."""
FREED_CENTRE = 0.1
"""Standard deviation of the principal point there, in focal lengths (5.7 deg): the decentring that a usable lens may have."""
FREED_DISTORTION = 0.2
"""Standard deviation of the two radial terms there, as fractions at half the diagonal: a wide lens is taken for a pinhole."""
FEWEST_STARS = 12
"""Least number of stars identified with a freed lens, whose three additional parameters make chance fits easier."""
FEWEST_BENT = 40
"""The same where the radial terms are free as well."""
MOST_SCATTER_PX = 3.0
"""Largest root mean square residual of those stars, pixels; if they scatter more, something else is wrong."""
WIDE_SCATTER_PX = 0.8
"""Root mean square residual, pixels, above which the lens is put to the test."""
SHARED_PX = 0.6
"""Error that neighbouring stars share, pixels, above which the lens is put to the test."""
LEFT_SCATTER = 0.7
"""Fraction of the scatter that may remain with a freed lens; if the lens was right, nearly all of it remains."""
LEFT_STARS = 0.8
"""Fraction of the stars that must fit a freed lens: with a few parameters more, fewer stars always scatter less."""
LEAST_EXPLAINED = 0.2
"""Least fraction of the stars or of the detections, whichever are fewer, that a lens explains which is nearly right."""
LEAST_OF_FREE = 0.4
"""The same where the lens is free from the start: with more parameters it bends farther into a wrong place."""
CLEAR_SIGMAS = 5.0
VERTICAL_DOUBT = "vertical_doubt_deg"
"""Key of `Fix.details`: standard deviation about each axis by which the lens puts the vertical in doubt, degrees."""
_WORST_CONDITION = 1e10
_LEAST_CONTRADICTION = 11.34  # chi-squared of three degrees of freedom that chance exceeds in one frame of a hundred


def freed(told: CameraPriors, camera: Camera, *, distorted: bool = False) -> CameraPriors:
    """Free focal length and principal point, and on request the radial terms, as far as they are not free already."""
    centre_px = max(told.centre_px, FREED_CENTRE * camera.f_px)
    distortion = max(told.distortion, FREED_DISTORTION) if distorted else told.distortion
    return replace(told, focal=max(told.focal, FREED_FOCAL), centre_px=centre_px, distortion=distortion)


def lens_contradicted(fix: Fix, seen: Observation, sigmas: ToldSigmas) -> bool:
    """Return whether a fix calls for a solution with the lens freed.

    It does if its stars contradict the inputs, scatter widely, or share large errors with their neighbours. It also does if a
    principal point with a stated standard deviation is clearly off by more than that, according to a fit of rotation, focal
    length and principal point to the residuals.
    """
    if fix.reason is Reason.INCONSISTENT or fix.residual_rms_px > WIDE_SCATTER_PX:
        return True
    if float(fix.details.get("shared_px", 0.0)) > SHARED_PX:
        return True
    if not sigmas.centre_px or fix.residuals_px is None or len(fix.matches) < FEWEST_STARS:
        return False
    rays = seen.rays[fix.matches[:, 0]]
    design = design_of(seen.camera, rays, np.zeros(5), np.arange(3)).reshape(-1, 6)
    scale = np.linalg.norm(design, axis=0)
    normal = (design / scale).T @ (design / scale)
    if not np.isfinite(normal).all() or np.linalg.cond(normal) > _WORST_CONDITION:
        return False
    inverse = np.linalg.inv(normal)
    residual = fix.residuals_px.ravel()
    fitted = inverse @ ((design / scale).T @ residual)
    left = residual - (design / scale) @ fitted
    variance = float(left @ left) / (len(left) - design.shape[1])
    shift = (fitted / scale)[4:]
    shift += [0.0 if found is None else found.value for found in (fix.calibration.cx_px, fix.calibration.cy_px)]
    own = variance * (np.diag(inverse) / scale**2)[4:]
    return bool((np.abs(shift) > CLEAR_SIGMAS * np.sqrt(own + sigmas.centre_px**2)).any())


def with_free_lens(
    fix: Fix, freed_fixes: Iterable[Fix], bent_fixes: Iterable[Fix], seen: Observation, n_identifying: int
) -> Fix:
    """Return the answer where the lens is contradicted: one with the lens freed, or the fix as it is, with doubt or without.

    The doubt follows where the stars rule out the lens and no freed one gives a place. They do if they fit another lens that
    contradicts the attitude, if no freed lens lets them fit one orientation, or if hardly any of them fit: a lens that is far
    off fits in one part of the field, whose stars agree with each other.

    Parameters
    ----------
    fix : Fix
        The fix with the lens as supplied.
    freed_fixes : iterable of Fix
        Answers with the lens freed, from different starting points; they are taken until one is better.
    bent_fixes : iterable of Fix
        The same with the radial terms freed too, taken after those.
    seen : Observation
        The detections.
    n_identifying : int
        Number of bright stars that identified the field.
    """
    failed = []
    for tried, fewest in ((freed_fixes, FEWEST_STARS), (bent_fixes, FEWEST_BENT)):
        for again in tried:
            if len(again.matches) >= fewest and _is_better(again, fix) and not _of_a_part(again, seen):
                # Stars that fit another lens well, but not the attitude, show how little of what was supplied still holds.
                return _doubted(fix) if again.reason is Reason.INCONSISTENT else again
            if tried is freed_fixes:
                failed.append(again)
    if not fix.ok or fix.residual_rms_px <= WIDE_SCATTER_PX or n_identifying < FEWEST_STARS:
        return fix
    unfit = all(again.reason is Reason.INCONSISTENT for again in failed)
    return _doubted(fix) if unfit or _of_a_part(fix, seen) else fix


def unless_of_a_part(fix: Fix, seen: Observation, n_identifying: int) -> Fix:
    """The fix of a lens that was free; with doubt if that lens fits in one part of the field only."""
    if not fix.ok or n_identifying < FEWEST_STARS or not _of_a_part(fix, seen, LEAST_OF_FREE):
        return fix
    return _doubted(fix)


def _of_a_part(fix: Fix, seen: Observation, least: float = LEAST_EXPLAINED) -> bool:
    """Whether few of the stars and of the detections fit, as if a wrong lens held in one part of the field."""
    expected = min(len(seen.rays), float(fix.details["stars_to_limit"]))
    return fix.residual_rms_px > WIDE_SCATTER_PX and len(fix.matches) < least * expected


def _is_better(again: Fix, fix: Fix) -> bool:
    """Whether the stars fit the freed lens of an answer, which may be a refusal, better than the lens as supplied."""
    if again.residual_rms_px > MOST_SCATTER_PX:
        return False
    if fix.reason is Reason.INCONSISTENT:
        return again.reason is not Reason.INCONSISTENT
    stars_left = len(again.matches) >= LEFT_STARS * len(fix.matches)
    return stars_left and again.residual_rms_px < LEFT_SCATTER * fix.residual_rms_px


def _doubted(fix: Fix) -> Fix:
    """The fix with the vertical as uncertain as the axis of a lens that does not hold (`FREED_CENTRE`)."""
    if fix.cov_km2 is None:
        return fix
    doubt_km2 = (FREED_CENTRE * MEAN_RADIUS_KM) ** 2
    doubt = math.degrees(FREED_CENTRE)
    details = {**fix.details, "lens_doubt_deg": doubt, VERTICAL_DOUBT: math.hypot(doubt, vertical_doubt_deg(fix))}
    return replace(fix, cov_km2=fix.cov_km2 + doubt_km2 * np.eye(2), details=details)


def vertical_doubt_deg(fix: Fix) -> float:
    """Return the standard deviation about each axis by which the lens of a fix puts its vertical in doubt, degrees.

    `Fix.cov_km2` contains it; `Fix.rotation_cov_rad2` does not, since it is no error of the stars.
    """
    return float(fix.details.get(VERTICAL_DOUBT, 0.0))


def doubt_deg(adjusted: Adjusted, camera: Camera, told: ToldSigmas, held: CameraPriors) -> float:
    """Return by how much the lens exceeded its stated errors, degrees; the vertical may be off as much about each axis.

    The shift of the principal point counts, and, if the focal length has a stated standard deviation, the shift that its
    error causes at the corner. `held` are the priors of a camera that is not contradicted.
    """
    corner_px = math.hypot(camera.width, camera.height) / 2
    units = np.array([corner_px if told.focal else 0.0, 1.0, 1.0])
    off, own = adjusted.camera_values[:3] * units, adjusted.camera_sigmas[:3] * units
    excess = off @ off - _LEAST_CONTRADICTION * float(np.mean(own**2 + (held.sigmas[:3] * units) ** 2))
    return math.degrees(math.sqrt(max(float(excess), 0.0)) / camera.f_px)
