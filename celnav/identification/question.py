"""What is asked of the search: detections, camera and attitude."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from celnav.camera import Camera
from celnav.identification.neighbourhood import Neighbourhood
from celnav.identification.sky_index import F4, F8
from celnav.identification.sparse import MOST_DETECTIONS, Sparse, ToldOrientation
from celnav.identification.verification import WHOLE_SKY, Region


@dataclass(frozen=True, eq=False)
class Question:
    """Detections, camera and attitude as the search needs them.

    Attributes
    ----------
    camera : Camera
        The camera.
    uv : ndarray, shape (n, 2)
        Detections, brightest first, refraction taken off where the vertical is known.
    rays : ndarray, shape (n, 3)
        The same as directions.
    ranked : bool
        Whether the order is one of brightness.
    solid_angle_sr, area_px : float
        Of the part of the sky, and of the frame, that the camera sees.
    local : ndarray, shape (3, 3), or None
        Terrestrial-horizon knowledge: R_cam where heading and tilt are known well; None otherwise.
    celestial_to_terrestrial : ndarray, shape (3, 3)
        At the instant.
    up : ndarray, shape (3,), or None
        Zenith in the camera frame.
    near : Neighbourhood or None
        What the last known position allows.
    region : Region
        Orientations that the attitude leaves open, were no position known.
    mag : ndarray, shape (n,), or None
        Magnitudes of the detections up to a common zero point, NaN where unknown; None without fluxes.
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

    def sparse(self, rows: NDArray[np.intp], v_mag: F4) -> Sparse | None:
        """What judges a few stars of magnitudes `v_mag` by the detections `rows`; None where there are many, or no fluxes."""
        if self.mag is None or len(self.uv) > MOST_DETECTIONS:
            return None
        told = None
        if self.local is not None and self.region.dimensions == 2:
            told = ToldOrientation(self.local, self.celestial_to_terrestrial)
        return Sparse(self.mag[rows], v_mag, self.area_px, told)
