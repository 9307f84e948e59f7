"""Lights near the horizon: windows, lamps and roofs crowd where the air leaves the fewest stars.

If detections are denser below 20 deg of altitude than above, the higher ones are first searched on their own.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from celnav.camera import Camera
from celnav.identification.frame_grid import frame_grid

F8 = NDArray[np.float64]

LOW_DEG = 20.0
# Least number of detections above and below; least ratio of the densities below and above; significance of the excess.
_FEWEST, _DENSER, _SIGMAS = 4, 2.0, 3.0


def high_detections(camera: Camera, rays: F8, up: F8 | None) -> NDArray[np.intp] | None:
    """Return the rows of the detections above the low sky if that is crowded; None if not, or if no vertical is known.

    Parameters
    ----------
    camera : Camera
        The camera.
    rays : ndarray, shape (n, 3)
        Directions of the detections.
    up : ndarray, shape (3,), or None
        The zenith in the camera frame.
    """
    if up is None or len(rays) < 2 * _FEWEST:
        return None
    limit = math.sin(math.radians(LOW_DEG))
    high = np.flatnonzero(rays @ up >= limit)
    n_low = len(rays) - len(high)
    if len(high) < _FEWEST or n_low < _FEWEST:
        return None
    grid = frame_grid(camera)
    above = grid.rays @ up >= limit
    area_high = float(grid.solid_angles_sr[above].sum())
    area_low = float(grid.solid_angles_sr[~above].sum())
    if not area_high > 0 or not area_low > 0:
        return None
    # Compare with the number expected from the density above, allowing for the Poisson scatter of both counts.
    expected = _DENSER * len(high) * area_low / area_high
    crowded = n_low - expected > _SIGMAS * math.sqrt(n_low + expected * expected / len(high))
    return high if crowded else None
