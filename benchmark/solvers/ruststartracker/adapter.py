"""Adapter for ruststartracker: triangles of angles; the vertical makes a position of its attitude."""

from functools import lru_cache
from importlib.metadata import version
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from benchmark.protocol import Answer, Detections, Observation
from benchmark.solvers.attitude_position import position_of_attitude
from benchmark.solvers.pinhole import undistorted
from benchmark.solvers.sep_detector import SEP_DETECTOR, detect_with_sep

BRIGHTEST = 30
TOLERANCE_PX = 1.5
MIN_MATCHES = 10
TIMEOUT_S = 1.0
MAX_MAGNITUDE = 6.0
# Triangles of brighter stars only: with all, half of the solvable frames of wide fields run out of time.
LOOKUP_MAGNITUDE = 4.5
EPOCH_YEAR = 2020.0


class RustStarTracker:
    """ruststartracker on the 30 brightest detections, with its own Hipparcos catalogue to magnitude 6.

    Its other catalogue, Gaia's, lacks the brightest stars, which are those that are detected first.
    """

    name = "ruststartracker"
    detector = SEP_DETECTOR

    @property
    def version(self) -> str:
        """Of the installed package."""
        return version("ruststartracker")

    def detect(self, image: NDArray[np.uint16]) -> Detections:
        """Detect with sep."""
        return detect_with_sep(image)

    def solve(self, detections: Detections, observation: Observation) -> Answer:
        """Identify, and turn the attitude into a position."""
        from ruststartracker.star import StarTrackerError

        camera = observation.camera
        _, xy = undistorted(np.asarray(detections.uv)[:BRIGHTEST], camera)
        if len(xy) < 3:
            return Answer(ok=False, reason="fewer than 3 detections")
        rays = np.column_stack((xy / camera.f_px, np.ones(len(xy))))
        try:
            found = _tracker(camera.f_px, camera.width, camera.height).process_observation_vectors(
                rays / np.linalg.norm(rays, axis=1, keepdims=True)
            )
        except StarTrackerError as error:
            return Answer(ok=False, reason=str(error))
        # Its quaternion takes the camera frame to the sky.
        rotation = Rotation.from_quat(np.asarray(found.quat, dtype=np.float64)).as_matrix().T
        lat, lon = position_of_attitude(rotation, observation.R_cam[:, 2], observation.utc)
        return Answer(ok=True, lat_deg=lat, lon_deg=lon)


@lru_cache(maxsize=32)
def _tracker(f_px: float, width: int, height: int) -> Any:
    from ruststartracker.catalog import StarCatalog
    from ruststartracker.star import CameraParameters, StarTracker

    catalogue = StarCatalog.from_hipparcos(max_magnitude=MAX_MAGNITUDE)
    middle = (width - 1) / 2.0, (height - 1) / 2.0
    matrix = np.array([[f_px, 0.0, middle[0]], [0.0, f_px, middle[1]], [0.0, 0.0, 1.0]], dtype=np.float32)
    return StarTracker(
        catalogue.normalized_positions(epoch=EPOCH_YEAR), catalogue.magnitude,
        CameraParameters(matrix, (width, height), None),
        max_lookup_magnitude=LOOKUP_MAGNITUDE,
        inter_star_angle_tolerance=TOLERANCE_PX / f_px, n_minimum_matches=MIN_MATCHES, timeout_secs=TIMEOUT_S,
    )  # fmt: skip
