"""tetra3rs with calibration: a solved frame gives a lens, and the frame is solved again with it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmark.protocol import Answer, Detections, Observation
from benchmark.solvers.pinhole import pinhole_view
from benchmark.solvers.tetra3rs.adapter import FOV_MAX_ERROR_DEG, Tetra3rs, answer_of, solve_frame

LENS_MODEL = "radial"
"""Of its two models, the one that its documentation recommends for few matches."""


@dataclass(frozen=True)
class Tetra3rsCalibrated(Tetra3rs):
    """tetra3rs that calibrates the camera on each frame that it has solved, and solves it again from the first attitude.

    `calibrate_camera` is meant for many frames of one camera. A contestant sees one frame at a time, so it is given this one.
    """

    name = "tetra3rs-calibrated"

    def solve(self, detections: Detections, observation: Observation) -> Answer:
        """Identify the stars, fit the lens, identify them again with it, and convert the attitude to a position."""
        found, rows, stars = solve_frame(detections, observation)
        if not found:
            return Answer(ok=False, reason=str(found.status))
        again = solved_again(found, stars, detections, observation)
        return answer_of(again or found, rows, stars, detections, observation)


def solved_again(found: Any, stars: Any, detections: Detections, observation: Observation) -> Any:
    """Solve a solved frame again with the lens that it gives; false where the lens cannot be fitted or does not solve."""
    import tetra3rs

    view = pinhole_view(np.asarray(detections.uv), observation.camera)
    seen = [tetra3rs.Centroid(float(x), float(y)) for x, y in view.xy]
    try:
        lens = stars.calibrate_camera(found, seen, view.width, view.height, model=LENS_MODEL).camera_model
    except (RuntimeError, ValueError):  # too few matches
        return None
    return stars.solve_from_centroids(
        view.xy, fov_max_error_deg=FOV_MAX_ERROR_DEG, camera_model=lens,
        attitude_hint=np.asarray(found.rotation_matrix_icrs_to_camera), strict_hint=True,
    )  # fmt: skip
