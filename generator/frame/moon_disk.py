"""The points of light of a frame.

The Moon's disk is made of points, so that a resolved Moon is drawn like the stars and its light is conserved.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from generator.frame.plan import LEAST_TRANSMISSION, FramePlan, PointLights, airmass_to, level_or_up
from generator.places.ephemeris import MOON_RADIUS_KM
from generator.sky.moon_irradiance import earthshine_over_moonlight, moon_colours

Floats = NDArray[np.float64]

FEWEST_ACROSS, MOST_ACROSS = 3, 120
"""Points across the disk: enough for a centroid where it is unresolved, few enough to draw where it is large."""
POINTS_PER_PIXEL = 2.0
"""Points across each pixel of the disk."""


def moon_points(
    moon_enu: Floats, sun_enu: Floats, distance_km: float, phase_angle_deg: float, f_px: float, earthshine: float = 0.0
) -> tuple[Floats, Floats]:
    """Points over the lit part of the Moon's disk, and over all of it where the Earth lights it.

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
    earthshine : float
        Light of the whole disk, lit by the Earth, over that of its part lit by the Sun.

    Returns
    -------
    enu : (n, 3) array
        Unit vectors.
    share : (n,) array
        Of the Moon's light; they add up to 1 plus earthshine.
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
    share = lit / lit.sum() + earthshine / len(lit)
    shown = share > 0
    points = moon_enu + math.tan(radius) * (x[shown, None] * towards_sun + y[shown, None] * across_it)
    return points / np.linalg.norm(points, axis=-1, keepdims=True), share[shown]


def point_lights(plan: FramePlan) -> PointLights:
    """Stars and planets of a frame, then the points of the Moon's disk, which is fixed at its mid-exposure position."""
    stars = PointLights(plan.directions, plan.dimmed_v_mag, plan.stars.bv_mag, plan.stars.vi_mag, plan.airmass)
    state, spec = plan.sky, plan.spec
    if "moonlight" not in spec.sky.active_components or state.moon_altitude_deg <= plan.horizon.altitude_deg:
        return stars
    phase = state.moon.phase_angle_deg
    enu, share = moon_points(
        state.moon_enu,
        state.sun_enu,
        state.moon.distance_km,
        phase,
        spec.camera.f_px,
        earthshine_over_moonlight(phase),
    )
    bv_mag, vi_mag = moon_colours(phase)
    passed = np.ones(len(enu)) if state.clouds is None else state.clouds.point_transmission(level_or_up(enu))
    altitude = np.array(state.moon_altitude_deg)
    path = float(airmass_to(plan.horizon, altitude)) if spec.atmosphere.extinction else 0.0
    return PointLights(
        np.concatenate([stars.directions, np.repeat(enu[:, None], plan.directions.shape[1], axis=1)]),
        np.concatenate(
            [stars.v_mag, state.moon_v_mag - 2.5 * np.log10(share * np.maximum(passed, LEAST_TRANSMISSION))]
        ),
        np.concatenate([stars.bv_mag, np.full(len(enu), bv_mag)]),
        np.concatenate([stars.vi_mag, np.full(len(enu), vi_mag)]),
        np.concatenate([stars.airmass, np.full(len(enu), path)]),
    )
