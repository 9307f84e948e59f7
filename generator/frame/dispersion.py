"""Selection of the points of light in a frame that the air disperses visibly, and the amount of dispersion."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from generator.frame.plan import FramePlan, refracting_air
from generator.frame.star_truth import StarTruth
from generator.light.photometry import GRID_START_NM, GRID_STOP_NM
from generator.places.astrometry import Site
from generator.places.dispersion import dispersion_deg, may_disperse
from generator.plugins.scene_tensors import tensor

Floats = NDArray[np.float64]

BANDS = 12
"""Number of equal bands of the spectral range, 54 nm each; a multiple of the number of bands of every point spread
function."""
LEAST_PX = 0.1
"""Dispersion of a star from 350 to 1000 nm below which it is not drawn. The centroids of blue and red stars then differ by
about 0.01 px, because a sensor's electrons come from a part of the range and their mean wavelengths differ by a tenth of
it."""


def dispersion_parameters(plan: FramePlan, directions: Floats, least_px: float = LEAST_PX) -> dict[str, Any]:
    """Return the stars' parameter ``dispersion_rad`` for apparent directions (n, k, 3); empty if the air disperses no light.

    Dispersion below `least_px` counts as zero.
    """
    if not math.isfinite(least_px):
        return {}
    place, f_px = plan.spec.site, plan.spec.camera.f_px
    site = Site(place.latitude_deg, place.longitude_deg, place.height_m)
    air = refracting_air(plan.spec.atmosphere)
    middle = directions[:, directions.shape[1] // 2]
    altitude_deg = np.degrees(np.arcsin(np.clip(middle[:, 2], -1, 1)))
    rows = np.flatnonzero(may_disperse(altitude_deg, float(np.degrees(least_px / f_px)), site, air))
    if not len(rows):
        return {}
    edges = np.linspace(GRID_START_NM, GRID_STOP_NM, BANDS + 1)
    lift = np.radians(dispersion_deg(altitude_deg[rows], (edges[1:] + edges[:-1]) / 2, site, air))
    seen = np.ptp(lift, axis=1) * f_px > least_px
    if not seen.any():
        return {}
    result = np.zeros((len(directions), BANDS))
    result[rows[seen]] = lift[seen]
    return {"dispersion_rad": tensor(result)}


def with_dispersion(truth: StarTruth, shift_px: Floats) -> StarTruth:
    """Return the truth with centroids of the light shifted by the mean shift (n, 2) that dispersion causes."""
    return replace(truth, light_px=truth.light_px + shift_px)
