"""The points of light of a frame.

The Moon's disk is made of points, so that a resolved Moon is drawn like the stars and its light is conserved. So are the
aureoles of stars behind cloud.
"""

from __future__ import annotations

import dataclasses
import functools
import math

import numpy as np
from numpy.typing import NDArray

from generator.frame.plan import LEAST_TRANSMISSION, FramePlan, PointLights, airmass_to, level_or_up
from generator.light.cloud_phase import DIFFRACTION_DEPTHS, aureole_radii
from generator.places.ephemeris import MOON_RADIUS_KM
from generator.sky.moon_irradiance import earthshine_over_moonlight, moon_colours
from generator.sky.moonlit_cloud import DIFFRACTED

Floats = NDArray[np.float64]

FEWEST_ACROSS, MOST_ACROSS = 3, 120
"""Points across the disk: enough for a centroid where it is unresolved, few enough to draw where it is large."""
POINTS_PER_PIXEL = 2.0
"""Points across each pixel of the disk."""
AUREOLE_POINTS = ((6.0, 48), (8.5, 12), (np.inf, 4))
"""V up to which an aureole is of so many points."""
LEAST_IMAGE = 1e-15
"""Part of a star's light in its image below which its aureole is too faint to see."""
GOLDEN_TURN = math.pi * (3 - math.sqrt(5))
"""Between one point and the next, which spreads them evenly (Vogel 1979, Math. Biosci. 44, 179)."""


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
    stars = _stars(plan)
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
    moon = PointLights(
        np.repeat(enu[:, None], plan.directions.shape[1], axis=1),
        state.moon_v_mag - 2.5 * np.log10(share * np.maximum(passed, LEAST_TRANSMISSION)),
        np.full(len(enu), bv_mag),
        np.full(len(enu), vi_mag),
        np.full(len(enu), path),
    )
    return stars.joined(moon)


def _stars(plan: FramePlan) -> PointLights:
    return PointLights(plan.directions, plan.dimmed_v_mag, plan.stars.bv_mag, plan.stars.vi_mag, plan.airmass)


def faint_lights(plan: FramePlan) -> PointLights | None:
    """Points of light that are not in the truth: faint stars, and aureoles of all; None without any."""
    parts = [] if plan.unlisted is None else [plan.unlisted]
    clouds = plan.spec.sky.clouds
    if clouds is not None and clouds.star_aureoles and plan.sky.clouds is not None and plan.sky.clouds.particle_um > 0:
        parts += [aureoles(plan, lights) for lights in (_stars(plan), *parts)]
    return functools.reduce(PointLights.joined, parts) if parts else None


def aureoles(plan: FramePlan, lights: PointLights) -> PointLights:
    """Light of stars that the particles of cloud diffract, as points around each.

    Of a slant depth t it is exp(-t / 2) - exp(-t), mean over the exposure: what is not scattered otherwise, less what is not
    diffracted. Those fainter than the faintest star of the scenario are left out.
    """
    clouds = plan.sky.clouds
    assert clouds is not None
    middle = lights.directions[:, 0] + lights.directions[:, -1]
    middle /= np.linalg.norm(middle, axis=-1, keepdims=True)
    above = level_or_up(middle)
    depths = [still.slant_depth(above) for still in clouds.moments]
    diffracted = np.mean([np.exp(-(1 - DIFFRACTED) * depth) - np.exp(-depth) for depth in depths], axis=0)
    # Of depths that dim more than that nothing is seen, the aureole neither.
    over_image = diffracted / np.maximum(clouds.point_transmission(above), LEAST_IMAGE)
    v_mag = lights.v_mag - 2.5 * np.log10(np.maximum(over_image, LEAST_TRANSMISSION))
    depth = DIFFRACTED * np.mean(depths, axis=0)
    across, along = _at_right_angles(middle)
    made = lights[np.zeros(0, dtype=np.intp)]
    brightest = -np.inf
    for faintest, points in AUREOLE_POINTS:
        rows = np.flatnonzero((v_mag > brightest) & (v_mag <= min(faintest, plan.spec.stars.limiting_magnitude)))
        brightest = faintest
        table = aureole_radii(clouds.particle_um, points)
        radius = np.tan([np.interp(depth[rows], DIFFRACTION_DEPTHS, column) for column in table.T]).T
        turn = GOLDEN_TURN * (np.arange(points) + rows[:, None])
        shift = (radius * np.cos(turn))[..., None] * across[rows, None]
        shift += (radius * np.sin(turn))[..., None] * along[rows, None]
        each = np.repeat(rows, points)
        directions = lights.directions[each] + shift.reshape(-1, 1, 3)
        directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
        around = dataclasses.replace(lights[each], directions=directions, v_mag=v_mag[each] + 2.5 * math.log10(points))
        made = made.joined(around)
    return made


def _at_right_angles(directions: Floats) -> tuple[Floats, Floats]:
    """Two unit vectors at right angles to each direction and to each other, (n, 3) each."""
    level = np.column_stack((-directions[:, 1], directions[:, 0], np.zeros(len(directions))))
    level[np.hypot(level[:, 0], level[:, 1]) < 1e-9] = (1.0, 0.0, 0.0)
    level /= np.linalg.norm(level, axis=-1, keepdims=True)
    return level, np.cross(directions, level)
