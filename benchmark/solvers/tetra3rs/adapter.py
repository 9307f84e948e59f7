"""Adapter for tetra3rs: lost in space by hashed patterns of four stars; the vertical makes a position of its attitude."""

import math
from functools import lru_cache
from importlib.metadata import version
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmark.protocol import Answer, Detections, Observation
from benchmark.solvers.attitude_position import position_of_attitude
from benchmark.solvers.pinhole import undistorted
from benchmark.solvers.sep_detector import SEP_DETECTOR, detect_with_sep

FOV_MAX_ERROR_DEG = 5.0
"""How far the field of view may be from the camera's: the value that its users are advised for wide fields."""
DATABASE_STEP_DEG = 10.0


class Tetra3rs:
    """tetra3rs with a database generated for the camera's field of view."""

    name = "tetra3rs"
    detector = SEP_DETECTOR

    @property
    def version(self) -> str:
        """Of the installed package."""
        return version("tetra3rs")

    def detect(self, image: NDArray[np.uint16]) -> Detections:
        """Detect with sep."""
        return detect_with_sep(image)

    def solve(self, detections: Detections, observation: Observation) -> Answer:
        """Identify, and turn the attitude into a position."""
        import tetra3rs

        camera = observation.camera
        _, xy = undistorted(np.asarray(detections.uv), camera)
        fov_deg = float(np.degrees(2.0 * np.arctan(camera.width / 2.0 / camera.f_px)))
        reach_deg = DATABASE_STEP_DEG * math.ceil((fov_deg + FOV_MAX_ERROR_DEG) / DATABASE_STEP_DEG)
        found = _database(reach_deg).solve_from_centroids(
            xy, fov_estimate_deg=fov_deg, fov_max_error_deg=FOV_MAX_ERROR_DEG,
            image_width=camera.width, image_height=camera.height,
            camera_model=tetra3rs.CameraModel(camera.f_px, camera.width, camera.height),
        )  # fmt: skip
        if not found:
            return Answer(ok=False, reason=str(getattr(found, "status", "no_match")))
        lat, lon = position_of_attitude(
            np.asarray(found.rotation_matrix_icrs_to_camera), observation.R_cam[:, 2], observation.utc
        )
        return Answer(ok=True, lat_deg=lat, lon_deg=lon)


@lru_cache(maxsize=4)
def _database(max_fov_deg: float) -> Any:
    import tetra3rs

    return tetra3rs.SolverDatabase.generate_from_gaia(max_fov_deg=max_fov_deg)
