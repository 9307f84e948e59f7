"""Adapter for zenith-fixer, which itself returns a position and an ellipse."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from datetime import datetime
from functools import lru_cache
from importlib.metadata import version
from typing import Any

import numpy as np
from numpy.typing import NDArray

import celnav
from benchmark.protocol import Answer, CameraRecord, Detections, Observation
from benchmark.solvers.detected_points import Points
from benchmark.solvers.pinhole import PERSPECTIVE, pinhole_view
from benchmark.solvers.told_errors import covariance_of_told
from celnav.sky.wgs84 import MEAN_RADIUS_KM

FISHEYE_K1 = 0.1
"""Coefficient of the law to which fisheyes are mapped; without one it derives the focal length from the image's size."""


@dataclass(frozen=True)
class ZenithFixer:
    """zenith-fixer with its bundled catalogue and its detector for point spread functions of 1 to 2 px.

    Attributes
    ----------
    most : int
        Largest number of detections.
    psf_sigma_px : float
        Width of the matched filter.
    """

    most: int = 60
    psf_sigma_px: float = 1.5
    name = "zenith-fixer"
    detector = "zenith.detect_centroids_matched"

    @property
    def version(self) -> str:
        """Version of the installed package."""
        return version("zenith-fixer")

    def detect(self, image: NDArray[np.uint16]) -> Detections:
        """Detect with its own detector."""
        import zenith

        found = np.array(zenith.detect_centroids_matched(np.ascontiguousarray(image), self.most, self.psf_sigma_px))
        found = found.reshape(-1, 3)
        return Points(found[:, :2], found[:, 2])

    def solve(self, detections: Detections, observation: Observation) -> Answer:
        """Determine the position."""
        import zenith

        camera = observation.camera
        brightness = np.ones(len(detections.uv)) if detections.flux is None else np.asarray(detections.flux)
        rows, xy, lens = _as_its_lens(np.asarray(detections.uv), camera)
        centroids = [(float(x), float(y), float(f)) for (x, y), f in zip(xy, brightness[rows], strict=True)]
        up = tuple(float(part) for part in observation.R_cam[:, 2])
        utc = datetime.fromisoformat(observation.utc.replace("Z", "+00:00"))
        try:
            fix = zenith.resolve_from_centroids(centroids, camera.f_px, 0.0, 0.0, up, utc, _catalogue(), **lens)
        except zenith.ZenithError as error:
            return Answer(ok=False, reason=str(error))
        # It names stars, but not the detections that they belong to.
        cov_km2 = position_covariance(fix.covariance, float(fix.latitude_deg), observation)
        return Answer(True, "", float(fix.latitude_deg), float(fix.longitude_deg), cov_km2)


def position_covariance(stated_rad2: Any, latitude_deg: float, told: Observation) -> NDArray[np.float64]:
    """East-north covariance of the position, km^2, from its own one and from the uncertainties of vertical and time.

    Its own covariance lists north before east, on a sphere, in radians squared. It assumes independent errors of half a pixel
    in each star's altitude, at least 1 arcmin, and takes vertical and time as exact.
    """
    (north, both), (_, east) = np.asarray(stated_rad2, dtype=np.float64)
    return MEAN_RADIUS_KM**2 * np.array([[east, both], [both, north]]) + covariance_of_told(latitude_deg, told)


def _as_its_lens(
    uv: NDArray[np.float64], camera: CameraRecord
) -> tuple[NDArray[np.intp], NDArray[np.float64], dict[str, float]]:
    """Detections that it receives, their positions under a lens that it supports, and the description of this lens.

    It supports pinholes, and fisheyes whose radius is a polynomial of the angle: every fisheye is mapped to one of these.
    """
    if camera.model in PERSPECTIVE:
        view = pinhole_view(uv, camera)
        return view.rows, view.xy, {}
    rays = celnav.Camera.from_dict(dataclasses.asdict(camera)).to_rays(uv)
    rows = np.flatnonzero(np.isfinite(rays).all(axis=1))
    across = np.hypot(rays[rows, 0], rays[rows, 1])
    angle = np.arctan2(across, rays[rows, 2])
    radius = camera.f_px * (angle + FISHEYE_K1 * angle**3)
    xy = rays[rows, :2] * (radius / np.maximum(across, 1e-12))[:, None]
    return rows, xy, {"fisheye_fov_deg": 180.0, "k1": FISHEYE_K1}


@lru_cache(maxsize=1)
def _catalogue() -> Any:
    import zenith

    return zenith.bundled_catalog()
