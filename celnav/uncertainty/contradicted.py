"""What the stars contradict of what was told: a lens that has changed since its calibration, a mount that has moved.

A lens whose field does not fit as it was told is fitted with focal length and principal point let free. The vertical came
from the same calibration, and stars cannot check it: it is doubted by as much as heading and lens have proved to be off.
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
"""Standard deviation of the focal length's logarithm where the lens told does not hold."""
FREED_CENTRE = 0.1
"""Of the principal point, in focal lengths (5.7 deg): what a lens may be decentred by and still image the sky."""
FEWEST_STARS = 12
"""Stars that a lens let free must name: it has three parameters more to fit chance with."""
MOST_SCATTER_PX = 3.0
"""Root mean square distance of those stars: what scatters more is wrong in another way."""
WIDE_SCATTER_PX = 1.5
LEFT_SCATTER = 0.7
"""Part of the scatter that a lens let free may leave; of a right lens it leaves nearly all."""
CLEAR_SIGMAS = 5.0
_WORST_CONDITION = 1e10
_LEAST_CONTRADICTION = 11.34  # chi-squared of three degrees of freedom that chance exceeds in one frame of a hundred


def freed(told: CameraPriors, camera: Camera) -> CameraPriors:
    """Let focal length and principal point free, as far as they are not already."""
    centre_px = max(told.centre_px, FREED_CENTRE * camera.f_px)
    return replace(told, focal=max(told.focal, FREED_FOCAL), centre_px=centre_px)


def lens_contradicted(fix: Fix, seen: Observation, sigmas: ToldSigmas) -> bool:
    """Tell whether a fix calls for the lens to be let free.

    So it does where its stars contradict what was told, where they scatter widely, and where their residuals, held against
    derivatives by a turn, the focal length and the principal point, show a principal point clearly beyond its standard
    deviation, if one was told.
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
    """Tell whether a fix with the lens let free is to replace the one with the lens as it was told."""
    again = with_free_lens
    stands = again.reason is not Reason.INCONSISTENT and len(again.matches) >= FEWEST_STARS
    if not stands or again.residual_rms_px > MOST_SCATTER_PX:
        return False
    return fix.reason is Reason.INCONSISTENT or again.residual_rms_px < LEFT_SCATTER * fix.residual_rms_px


def doubt_deg(adjusted: Adjusted, camera: Camera, told: ToldSigmas, held: CameraPriors) -> float:
    """Return by how much the lens was off beyond what was told, degrees: as much, about each axis, the vertical may be.

    The principal point's shift counts, and the corner's by a focal length that was told with a standard deviation. `held` is
    what holds a camera that is not contradicted.
    """
    corner_px = math.hypot(camera.width, camera.height) / 2
    units = np.array([corner_px if told.focal else 0.0, 1.0, 1.0])
    off, own = adjusted.camera_values[:3] * units, adjusted.camera_sigmas[:3] * units
    excess = off @ off - _LEAST_CONTRADICTION * float(np.mean(own**2 + (held.sigmas[:3] * units) ** 2))
    return math.degrees(math.sqrt(max(float(excess), 0.0)) / camera.f_px)
