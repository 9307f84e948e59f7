"""Input of the search: detections, camera and attitude."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from celnav.camera import Camera
from celnav.identification.neighbourhood import Neighbourhood
from celnav.identification.sky_index import F4, F8
from celnav.identification.sparse import MOST_DETECTIONS, Sparse, ToldOrientation
from celnav.identification.verification import SEARCHES, WHOLE_SKY, Region

# Plate scales are kept for this many detections; a search rarely looks at fainter ones.
_MOST_SCALES = 400


@dataclass(frozen=True, eq=False)
class Question:
    """Detections, camera and attitude as the search needs them.

    Attributes
    ----------
    camera : Camera
        The camera.
    uv : ndarray, shape (n, 2)
        Detections, brightest first, with refraction removed if the vertical is known.
    rays : ndarray, shape (n, 3)
        The same as directions.
    ranked : bool
        Whether the order is one of brightness.
    solid_angle_sr, area_px : float
        Solid angle of the sky, and area of the frame, that the camera sees.
    local : ndarray, shape (3, 3), or None
        Orientation relative to the horizon: R_cam if heading and tilt are well known, else None.
    celestial_to_terrestrial : ndarray, shape (3, 3)
        Rotation between these frames at the instant.
    up : ndarray, shape (3,), or None
        Zenith in the camera frame.
    near : Neighbourhood or None
        Constraints from the last known position.
    region : Region
        Orientations that the attitude alone allows, without a last known position.
    mag : ndarray, shape (n,), or None
        Magnitudes of the detections up to a common zero point, NaN where unknown; None without fluxes.
    searches : int
        Number of searches that share the allowed false alarms.
    """

    camera: Camera
    uv: F8
    rays: F8
    ranked: bool
    solid_angle_sr: float
    area_px: float
    local: F8 | None
    celestial_to_terrestrial: F8
    up: F8 | None
    near: Neighbourhood | None
    region: Region = WHOLE_SKY
    mag: F8 | None = None
    searches: int = SEARCHES

    def radians_per_px(self, rows: NDArray[np.intp]) -> F8:
        """Plate scale (`Camera.radians_per_px`) at the detections `rows`, shape (n,)."""
        scales = self._scales
        if len(rows) and rows.max() >= len(scales):
            return self.camera.radians_per_px(self.uv[rows])
        return scales[rows]

    @cached_property
    def _scales(self) -> F8:
        """Plate scales at the first detections, which take as long as a verification if the lens has distortion."""
        return self.camera.radians_per_px(self.uv[:_MOST_SCALES])

    def sparse(self, rows: NDArray[np.intp], v_mag: F4) -> Sparse | None:
        """Return the test for few stars of magnitudes `v_mag` and detections `rows`; None if many, or without fluxes."""
        if self.mag is None or len(self.uv) > MOST_DETECTIONS:
            return None
        told = None
        if self.local is not None and self.region.dimensions == 2:
            told = ToldOrientation(self.local, self.celestial_to_terrestrial)
        return Sparse(self.mag[rows], v_mag, self.area_px, told)
