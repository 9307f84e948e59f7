"""Adapter for zenith-fixer: it answers with a position and an ellipse by itself."""

from datetime import datetime
from functools import lru_cache
from importlib.metadata import version
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmark.protocol import Answer, Detections, Observation
from benchmark.solvers.pinhole import undistorted
from benchmark.solvers.sep_detector import SEP_DETECTOR, detect_with_sep

EARTH_RADIUS_KM = 6371.0


class ZenithFixer:
    """zenith-fixer with its bundled catalogue."""

    name = "zenith-fixer"
    detector = SEP_DETECTOR

    @property
    def version(self) -> str:
        """Of the installed package."""
        return version("zenith-fixer")

    def detect(self, image: NDArray[np.uint16]) -> Detections:
        """Detect with sep."""
        return detect_with_sep(image)

    def solve(self, detections: Detections, observation: Observation) -> Answer:
        """Resolve the position."""
        import zenith

        camera = observation.camera
        rows, xy = undistorted(np.asarray(detections.uv), camera)
        brightness = np.ones(len(detections.uv)) if detections.flux is None else np.asarray(detections.flux)
        flux = brightness[rows]
        centroids = [(float(x), float(y), float(f)) for (x, y), f in zip(xy, flux, strict=True)]
        up = tuple(float(part) for part in observation.R_cam[:, 2])
        utc = datetime.fromisoformat(observation.utc.replace("Z", "+00:00"))
        try:
            fix = zenith.resolve_from_centroids(centroids, camera.f_px, 0.0, 0.0, up, utc, _catalogue())
        except zenith.ZenithError as error:
            return Answer(ok=False, reason=str(error))
        # Its covariance is north before east, in radians squared.
        (north, both), (_, east) = np.asarray(fix.covariance, dtype=np.float64)
        cov_km2 = EARTH_RADIUS_KM**2 * np.array([[east, both], [both, north]])
        return Answer(True, "", float(fix.latitude_deg), float(fix.longitude_deg), cov_km2)


@lru_cache(maxsize=1)
def _catalogue() -> Any:
    import zenith

    return zenith.bundled_catalog()
