"""Whether stars that nobody could name are a mirror image of the sky: rows of a FITS file from the bottom up, most often."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from celnav.camera import Camera
from celnav.detection import Detections
from celnav.fix import Fix, Reason
from celnav.solver import solve

UNNAMED = (Reason.NO_HYPOTHESIS, Reason.EFFORT_SPENT)
FEWEST = 12
"""Detections of which a mirror image is worth a second search."""
HINT = (
    "the stars are those of a mirrored picture: turn it over, rows from the bottom up (as programs that write FITS files may "
    "have them) or columns from the right"
)


def with_hint(fix: Fix, detections: Detections, camera: Camera, utc: str) -> Fix:
    """Say so where the picture's mirror image is identified.

    Parameters
    ----------
    fix : Fix
        Any answer; all but those that name no star come back as they are.
    detections : Detections
        From an image, with its shape.
    camera : Camera
    utc : str
        Middle of the exposure.
    """
    if fix.reason not in UNNAMED or detections.shape is None or len(detections) < FEWEST:
        return fix
    last = detections.shape[0] - 1
    turned = replace(
        detections,
        uv=np.column_stack((detections.uv[:, 0], last - detections.uv[:, 1])),
        streak_px=None if detections.streak_px is None else detections.streak_px * [1, -1],
    )
    # Without a vertical: whatever the attitude of the mirrored camera, its stars have names or none.
    named = solve(turned, replace(camera, cy_px=last - camera.cy_px), utc, None)
    return replace(fix, message=f"{fix.message}; {HINT}") if named.reason is Reason.VERTICAL_REQUIRED else fix
