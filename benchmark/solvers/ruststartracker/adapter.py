"""Adapter for ruststartracker, which compares triangles of angles; the vertical converts its attitude to a position."""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from importlib.metadata import version
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from benchmark.protocol import Answer, Detections, Observation
from benchmark.solvers.attitude_position import position_of_attitude, rays_of_fit
from benchmark.solvers.detected_points import Points
from benchmark.solvers.pinhole import pinhole_view
from benchmark.solvers.star_naming import EPOCH_JYEAR, named_matches

TOLERANCE_PX = 1.5
SEARCHES_S = (0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 4.5, 6.0, 8.0)
"""Search limits to choose from. Each needs its own tracker, whose table of angles takes up to a second and 65 MB."""
MAKING_S = 1.2
"""Part of a frame's time that is reserved for a tracker that does not exist yet, and for the answer."""
STARS_TO_LOOK_UP = 40.0
"""Expected number of stars in the field among those whose triangles are looked up."""
LOOKUP_MAGNITUDES = (4.5, 5.0, 5.5, 6.0, 6.5, 7.0)
"""Magnitude limits to choose from.

Triangles are of bright stars only: with all, half of the solvable wide fields time out.
"""
FAINTER_BY = 1.5
"""Difference in magnitude between the faintest stars that verify and the faintest that are looked up."""
FAINTEST = 7.0
"""Magnitude at which its Hipparcos catalogue ends."""
EXTRACTION: Mapping[str, Any] = MappingProxyType({"min_star_area": 3, "max_star_area": 100})
"""Settings of its detector that differ from the defaults; docs/rivals.md reports the trials."""
STARS_TO_MAGNITUDE_0 = 4.8
"""Stars in the whole sky to V 0; each magnitude multiplies their number by 10 to the power 0.5: 4,800 to V 6."""


@dataclass(frozen=True)
class RustStarTracker:
    """ruststartracker on the brightest detections, with its own Hipparcos catalogue to a magnitude that fits the field.

    Its other catalogue, from Gaia, lacks the brightest stars, which are the first to be detected.

    Attributes
    ----------
    candidates : int
        Number of the brightest detections that it receives.
    min_matches : int
        With fewer matches it refuses.
    brightest_quantile : float
        Quantile of the image's pixels that becomes 255 in the 8-bit image for its detector; the median becomes 0.
    threshold_quantile : float
        Quantile of those bytes that serves as the threshold of its detector.
    extraction : mapping
        Settings of its detector that differ from the defaults.
    ends_s : float, optional
        Reading of `time.perf_counter` at which it should have answered; without one, its longest search limit applies.
    """

    candidates: int = 30
    min_matches: int = 10
    brightest_quantile: float = 0.9999
    threshold_quantile: float = 0.995
    extraction: Mapping[str, Any] = field(default_factory=lambda: EXTRACTION)
    ends_s: float | None = None
    name = "ruststartracker"
    detector = "ruststartracker.StarTracker.get_centroids"

    @property
    def version(self) -> str:
        """Version of the installed package."""
        return version("ruststartracker")

    def within(self, time_limit_s: float) -> RustStarTracker:
        """Return the same solver with a time limit that starts now."""
        return dataclasses.replace(self, ends_s=time.perf_counter() + time_limit_s)

    def detect(self, image: NDArray[np.uint16]) -> Detections:
        """Detect with its own detector, in 8 bits from the sky level upwards."""
        from ruststartracker.libruststartracker import get_threshold_from_histogram
        from ruststartracker.star import StarTrackerError

        sky, top = np.quantile(image, (0.5, self.brightest_quantile))
        bytes_ = np.clip(255.0 * (image - sky) / max(top - sky, 1.0), 0.0, 255.0).astype(np.uint8)
        height, width = image.shape
        try:
            # It sorts by brightness but does not return it. Any focal length will do: it only checks the size of the image.
            # The threshold is computed here with its own function, because the code that would otherwise call that function
            # does not run with OpenCV 5.
            threshold = get_threshold_from_histogram(bytes_, fraction=self.threshold_quantile)
            uv = tracker(float(width), width, height, self.min_matches, SEARCHES_S[0]).get_centroids(
                bytes_, n_candidates=self.candidates, threshold=threshold, **self.extraction
            )
        except StarTrackerError:  # fewer than three
            uv = np.empty((0, 2))
        return Points(np.asarray(uv, dtype=np.float64).reshape(-1, 2), None)

    def solve(self, detections: Detections, observation: Observation) -> Answer:
        """Identify the stars, and convert the attitude to a position."""
        from ruststartracker.star import StarTrackerError

        uv = np.asarray(detections.uv)[: self.candidates]
        view = pinhole_view(uv, observation.camera)
        if len(view.rows) < 3:
            return Answer(ok=False, reason="fewer than 3 detections")
        asked = tracker(view.f_px, view.width, view.height, self.min_matches, search_time_s(self.ends_s))
        try:
            found = asked.process_observation_vectors(view.rays)
        except StarTrackerError as error:
            return Answer(ok=False, reason=str(error))
        # Its quaternion rotates from the camera frame to the sky.
        rotation = Rotation.from_quat(np.asarray(found.quat, dtype=np.float64)).as_matrix().T
        matched = view.rows[np.asarray(found.obs_indices, dtype=np.intp)]
        up = observation.R_cam[:, 2]
        seen = rays_of_fit(observation.camera, uv[matched], up)
        lat, lon = position_of_attitude(
            rotation, up, observation.utc, seen, observation.pressure_hpa, observation.temperature_c
        )
        places = _stars(magnitudes_for(view.f_px, view.width, view.height)[1])[0][
            np.asarray(found.match_ids, dtype=np.intp)
        ]
        return Answer(ok=True, lat_deg=lat, lon_deg=lon, matches=named_matches(matched, places.astype(np.float64)))


def magnitudes_for(f_px: float, width: int, height: int) -> tuple[float, float]:
    """Magnitude limits in a field, of the stars that are looked up and of those that verify."""
    x, y = width / 2.0 / f_px, height / 2.0 / f_px
    share = math.atan(x * y / math.sqrt(1.0 + x * x + y * y)) / math.pi
    expected = [share * STARS_TO_MAGNITUDE_0 * 10.0 ** (0.5 * limit) for limit in LOOKUP_MAGNITUDES]
    enough = [limit for limit, stars in zip(LOOKUP_MAGNITUDES, expected, strict=True) if stars >= STARS_TO_LOOK_UP]
    lookup = enough[0] if enough else LOOKUP_MAGNITUDES[-1]
    return lookup, min(lookup + FAINTER_BY, FAINTEST)


def search_time_s(ends_s: float | None) -> float:
    """Search limit for a search that should end at a reading of `time.perf_counter`."""
    if ends_s is None:
        return SEARCHES_S[-1]
    left_s = ends_s - time.perf_counter() - MAKING_S
    return max((each for each in SEARCHES_S if each <= left_s), default=SEARCHES_S[0])


@lru_cache(maxsize=16)
def tracker(f_px: float, width: int, height: int, min_matches: int, search_s: float) -> Any:
    """Build a tracker for a pinhole; its table of angles fits the field."""
    from ruststartracker.star import CameraParameters, StarTracker

    lookup, faintest = magnitudes_for(f_px, width, height)
    places, magnitudes = _stars(faintest)
    middle = (width - 1) / 2.0, (height - 1) / 2.0
    matrix = np.array([[f_px, 0.0, middle[0]], [0.0, f_px, middle[1]], [0.0, 0.0, 1.0]], dtype=np.float32)
    return StarTracker(
        places, magnitudes, CameraParameters(matrix, (width, height), None),
        max_lookup_magnitude=lookup, inter_star_angle_tolerance=TOLERANCE_PX / f_px,
        n_minimum_matches=min_matches, timeout_secs=search_s,
    )  # fmt: skip


@lru_cache(maxsize=8)
def _stars(faintest: float) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Directions and magnitudes of its catalogue."""
    from ruststartracker.catalog import StarCatalog

    catalogue = StarCatalog.from_hipparcos(max_magnitude=faintest)
    return catalogue.normalized_positions(epoch=EPOCH_JYEAR), catalogue.magnitude
