"""Adapter for tetra3rs, lost in space by hashed patterns of four stars; the vertical converts its attitude to a position."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib.metadata import version
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmark.protocol import Answer, Detections, Observation
from benchmark.solvers.attitude_position import covariance_of_attitude, position_of_attitude, rays_of_fit
from benchmark.solvers.detected_points import Points
from benchmark.solvers.pinhole import pinhole_view
from benchmark.solvers.star_naming import EPOCH_JYEAR, named_matches
from celnav.sky.catalog import unit_vectors

FOV_MAX_ERROR_DEG = 5.0
"""Largest error of the supplied field of view: the value that its users are advised to take for wide fields."""
DATABASE_STEP_DEG = 10.0
EXTRACTION: Mapping[str, Any] = MappingProxyType({"matched_filter_sigma": None})
"""Settings of its detector that differ from the defaults; docs/rivals.md reports the trials."""


@dataclass(frozen=True)
class Tetra3rs:
    """tetra3rs with a database generated for the camera's field of view.

    Attributes
    ----------
    extraction : mapping
        Arguments of `tetra3rs.extract_centroids` besides the image.
    """

    extraction: Mapping[str, Any] = field(default_factory=lambda: EXTRACTION)
    name = "tetra3rs"
    detector = "tetra3rs.extract_centroids"

    @property
    def version(self) -> str:
        """Version of the installed package."""
        return version("tetra3rs")

    def detect(self, image: NDArray[np.uint16]) -> Detections:
        """Detect with its own detector, which counts from the middle of the image."""
        import tetra3rs

        found = tetra3rs.extract_centroids(np.ascontiguousarray(image), threads=1, **self.extraction).centroids
        height, width = image.shape
        middle = np.array([(width - 1) / 2.0, (height - 1) / 2.0])
        uv = middle + np.array([[each.x, each.y] for each in found]).reshape(-1, 2)
        return Points(uv, np.array([each.brightness for each in found]))

    def solve(self, detections: Detections, observation: Observation) -> Answer:
        """Identify the stars, and convert the attitude to a position."""
        found, rows, stars = solve_frame(detections, observation)
        if not found:
            return Answer(ok=False, reason=str(found.status))
        return answer_of(found, rows, stars, detections, observation)


def solve_frame(detections: Detections, observation: Observation) -> tuple[Any, NDArray[np.intp], Any]:
    """Solve, and return its result, the indices of the detections that it received, and its database."""
    import tetra3rs

    view = pinhole_view(np.asarray(detections.uv), observation.camera)
    reach_deg = DATABASE_STEP_DEG * math.ceil((view.fov_deg + FOV_MAX_ERROR_DEG) / DATABASE_STEP_DEG)
    stars = database(reach_deg)
    found = stars.solve_from_centroids(
        view.xy, fov_estimate_deg=view.fov_deg, fov_max_error_deg=FOV_MAX_ERROR_DEG,
        image_width=view.width, image_height=view.height,
        camera_model=tetra3rs.CameraModel(view.f_px, view.width, view.height),
    )  # fmt: skip
    return found, view.rows, stars


def answer_of(
    found: Any, rows: NDArray[np.intp], stars: Any, detections: Detections, observation: Observation
) -> Answer:
    """Convert a result of tetra3rs to the benchmark's terms.

    Its probability is that of a false match. Its covariance is that of roll and of the boresight's displacements east and
    north.
    """
    rotation = np.asarray(found.rotation_matrix_icrs_to_camera, dtype=np.float64)
    matched = rows[np.asarray(found.matched_centroids, dtype=np.intp)]
    up = observation.R_cam[:, 2]
    seen = rays_of_fit(observation.camera, np.asarray(detections.uv)[matched], up)
    place = position_of_attitude(
        rotation, up, observation.utc, seen, observation.pressure_hpa, observation.temperature_c
    )
    named = [stars.get_star_by_id(int(each)) for each in found.matched_catalog_ids]
    directions = unit_vectors(*np.radians([[star.ra_deg, star.dec_deg] for star in named]).reshape(-1, 2).T)
    return Answer(
        True, "", *place, _position_covariance(found, rotation, place, observation),
        confidence=min(max(1.0 - float(found.probability), 0.0), 1.0),
        matches=named_matches(matched, directions),
    )  # fmt: skip


def _position_covariance(
    found: Any, rotation: NDArray[np.float64], place: tuple[float, float], observation: Observation
) -> NDArray[np.float64] | None:
    """Covariance from that of the stated attitude; None where it states that the fit is not constrained."""
    stated = np.asarray(found.attitude_cov_rad2, dtype=np.float64)
    if not np.isfinite(stated).all():
        return None
    boresight = rotation[2]
    east = np.cross([0.0, 0.0, 1.0], boresight)
    east /= np.linalg.norm(east)
    # A boresight that moves east rotates the camera about north, one that moves north rotates it about west.
    axes = rotation @ np.column_stack((boresight, np.cross(boresight, east), -east))
    return covariance_of_attitude(axes @ stated @ axes.T, rotation, place, observation)


@cache
def database(max_fov_deg: float) -> Any:
    """Database of patterns for fields of view up to this one, generated from the catalogue that comes with it.

    All that a process needs are kept: the seventeen steps to 170 deg hold 200 MiB together.
    """
    import tetra3rs

    return tetra3rs.SolverDatabase.generate_from_gaia(max_fov_deg=max_fov_deg, epoch_proper_motion_year=EPOCH_JYEAR)
