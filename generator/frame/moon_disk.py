"""The Moon's disk as points of light, so that a resolved Moon is drawn like the stars and its light is conserved."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from generator.places.ephemeris import MOON_RADIUS_KM

Floats = NDArray[np.float64]

FEWEST_ACROSS, MOST_ACROSS = 3, 120
"""Points across the disk: enough for a centroid where it is unresolved, few enough to draw where it is large."""
POINTS_PER_PIXEL = 2.0
"""Points across each pixel of the disk."""


def moon_points(
    moon_enu: Floats, sun_enu: Floats, distance_km: float, phase_angle_deg: float, f_px: float
) -> tuple[Floats, Floats]:
    """Points over the lit part of the Moon's disk.

    The lit part is uniform in brightness, as that of the full Moon nearly is (Lommel-Seeliger's law at small phase angles),
    and the terminator is where the Sun sets.

    Parameters
    ----------
    moon_enu, sun_enu : (3,) arrays
        Apparent unit vectors.
    distance_km : float
    phase_angle_deg : float
    f_px : float
        Pixels per radian at the image centre; the points are half a pixel apart.

    Returns
    -------
    enu : (n, 3) array
        Unit vectors.
    share : (n,) array
        Of the Moon's light; they add up to 1.
    """
    radius = math.asin(MOON_RADIUS_KM / distance_km)
    across = int(np.clip(math.ceil(2 * radius * f_px * POINTS_PER_PIXEL), FEWEST_ACROSS, MOST_ACROSS))
    axis = (np.arange(across) + 0.5) / across * 2 - 1
    x, y = (part.ravel() for part in np.meshgrid(axis, axis))
    on_disk = x**2 + y**2 < 1
    x, y = x[on_disk], y[on_disk]
    depth = np.sqrt(1 - x**2 - y**2)
    phase = math.radians(phase_angle_deg)
    lit = x * math.sin(phase) + depth * math.cos(phase) > 0
    if not lit.any():
        lit = x >= x.max()
    towards_sun = sun_enu - (sun_enu @ moon_enu) * moon_enu
    towards_sun /= np.linalg.norm(towards_sun)
    across_it = np.cross(moon_enu, towards_sun)
    points = moon_enu + math.tan(radius) * (x[lit, None] * towards_sun + y[lit, None] * across_it)
    return points / np.linalg.norm(points, axis=-1, keepdims=True), np.full(int(lit.sum()), 1 / lit.sum())
