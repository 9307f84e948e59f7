"""Inputs that the stars contradict: a lens that has changed since its calibration, or a mount that has moved.

If the stars do not fit the supplied lens, its focal length and principal point are freed and fitted. The vertical came from
the same calibration, but stars cannot check it; its uncertainty is raised by as much as heading and lens proved to be off.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from celnav.adjustment import Adjusted, CameraPriors, design_of
from celnav.camera import Camera
from celnav.fix import Fix, Reason
from celnav.matching.protocol import Observation
from celnav.problem import ToldSigmas

FREED_FOCAL = 0.1
"""Standard deviation of the logarithm of the focal length where the supplied lens does not hold."""
FREED_CENTRE = 0.1
"""Standard deviation of the principal point there, in focal lengths (5.7 deg): the decentring that a usable lens may have."""
FEWEST_STARS = 12
"""Least number of stars identified with a freed lens, whose three additional parameters make chance fits easier."""
MOST_SCATTER_PX = 3.0
"""Largest root mean square residual of those stars, pixels; if they scatter more, something else is wrong."""
WIDE_SCATTER_PX = 1.5
LEFT_SCATTER = 0.7
"""Fraction of the scatter that may remain with a freed lens; if the lens was right, nearly all of it remains."""
CLEAR_SIGMAS = 5.0
_WORST_CONDITION = 1e10
_LEAST_CONTRADICTION = 11.34  # chi-squared of three degrees of freedom that chance exceeds in one frame of a hundred


def freed(told: CameraPriors, camera: Camera) -> CameraPriors:
    """Free focal length and principal point, as far as they are not free already."""
    centre_px = max(told.centre_px, FREED_CENTRE * camera.f_px)
    return replace(told, focal=max(told.focal, FREED_FOCAL), centre_px=centre_px)


def lens_contradicted(fix: Fix, seen: Observation, sigmas: ToldSigmas) -> bool:
    """Return whether a fix calls for a solution with the lens freed.

    It does if its stars contradict the inputs, or scatter widely. It also does if a principal point with a stated standard
    deviation is clearly off by more than that, according to a fit of rotation, focal length and principal point to the
    residuals.
    """
    if fix.reason is Reason.INCONSISTENT or fix.residual_rms_px > WIDE_SCATTER_PX:
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


def better(fix: Fix, with_free_lens: Fix) -> bool:
    """Return whether a fix with the lens freed is to replace the one with the lens as supplied."""
    again = with_free_lens
    stands = again.reason is not Reason.INCONSISTENT and len(again.matches) >= FEWEST_STARS
    if not stands or again.residual_rms_px > MOST_SCATTER_PX:
        return False
    return fix.reason is Reason.INCONSISTENT or again.residual_rms_px < LEFT_SCATTER * fix.residual_rms_px


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
