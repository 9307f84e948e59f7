"""The points of light of a frame, and their emitters: stars, planets, the aureoles of stars behind cloud, Moon, objects."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from generator.frame.dispersion import LEAST_PX, dispersion_parameters
from generator.frame.flying.objects import FlyingObjects
from generator.frame.moon.disk import drawing_of, is_drawn, moon_lights
from generator.frame.moon.occultation import behind_moon
from generator.frame.plan import FramePlan, dimming_atmosphere
from generator.light.cloud_phase import DIFFRACTION_DEPTHS, aureole_radii
from generator.light.molecular_bands import star_depths
from generator.light.photometry import GRID_NM
from generator.light.points import PointLights
from generator.light.star_colours import usual_vi
from generator.light.stellar_spectra import colour_grid, colour_place
from generator.plugins.scene_tensors import tensor
from generator.sky.clouds import LEAST_TRANSMISSION, level_or_up
from generator.sky.moonlit_cloud import DIFFRACTED

Floats = NDArray[np.float64]

AUREOLE_POINTS = ((6.0, 48), (8.5, 12), (np.inf, 4))
"""V magnitudes up to which an aureole consists of this many points."""
LEAST_IMAGE = 1e-15
"""Fraction of a star's light in its image below which its aureole is too faint to see."""
GOLDEN_TURN = math.pi * (3 - math.sqrt(5))
"""Angle between one point and the next, which spreads them evenly (Vogel 1979, Math. Biosci. 44, 179)."""


def star_lights(plan: FramePlan) -> PointLights:
    """The plan's stars and planets, with the times at which the Moon hides them."""
    stars = PointLights.in_the_open(
        plan.directions, plan.dimmed_v_mag, plan.stars.bv_mag, plan.stars.vi_mag, plan.airmass
    )
    return behind_moon(plan, stars) if is_drawn(plan) else stars


def faint_lights(plan: FramePlan) -> PointLights | None:
    """Points of light that are not in the truth: faint stars, and aureoles of all stars; None if there are none."""
    parts = [] if plan.unlisted is None else [behind_moon(plan, plan.unlisted) if is_drawn(plan) else plan.unlisted]
    clouds = plan.spec.sky.clouds
    if clouds is not None and clouds.star_aureoles and plan.sky.clouds is not None and plan.sky.clouds.particle_um > 0:
        parts += [aureoles(plan, lights) for lights in (star_lights(plan), *parts)]
    return functools.reduce(PointLights.joined, parts) if parts else None


def aureoles(plan: FramePlan, lights: PointLights) -> PointLights:
    """Light of stars that is diffracted by cloud particles, as points around each star.

    For a slant depth t it is exp(-t / 2) - exp(-t), averaged over the exposure: light that is not scattered otherwise,
    less light that is not diffracted either. Aureoles fainter than the faintest star of the scenario are left out.
    """
    clouds = plan.sky.clouds
    assert clouds is not None
    middle = lights.directions[:, 0] + lights.directions[:, -1]
    middle /= np.linalg.norm(middle, axis=-1, keepdims=True)
    above = level_or_up(middle)
    depths = [still.slant_depth(above) for still in clouds.moments]
    diffracted = np.mean([np.exp(-(1 - DIFFRACTED) * depth) - np.exp(-depth) for depth in depths], axis=0)
    # At depths that dim more than that nothing is visible, not even the aureole.
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


def stars_dict(plan: FramePlan, points: PointLights, dispersed_px: float = LEAST_PX) -> dict[str, Any]:
    """Points of light above the atmosphere, as an emitter; they are dispersed by the air from `dispersed_px` on."""
    return {
        "type": "skybench_stars",
        "horizon_sine": plan.horizon.sine,
        **dispersion_parameters(plan, points.directions, dispersed_px),
        "directions": tensor(points.directions),
        "v_mag": tensor(points.v_mag),
        "airmass": tensor(points.airmass),
        **({"hidden": tensor(points.hidden)} if np.isfinite(points.hidden).any() else {}),
        **colour_tensors(points.bv_mag, points.vi_mag),
        "optical_depth": tensor(_depth(plan)),
    }


def moon_dicts(plan: FramePlan) -> Iterator[dict[str, Any]]:
    """Yield emitters of the Moon's disk, one per block of its points, because a whole disk does not fit into a scene."""
    for points in moon_lights(plan):
        drawing = drawing_of(plan)
        block = stars_dict(plan, points, drawing.dispersed_px)
        yield block | {"id": "moon", "step_px": drawing.step_px}


def objects_dict(objects: FlyingObjects, horizon_sine: float) -> dict[str, Any]:
    """Flying objects as an emitter like that of the stars; their magnitudes are those at the ground."""
    return {
        "type": "skybench_stars",
        "horizon_sine": horizon_sine,
        "directions": tensor(objects.directions),
        "v_mag": tensor(objects.v_mag),
        "airmass": tensor(np.zeros(len(objects))),
        **colour_tensors(objects.bv_mag, usual_vi(objects.bv_mag, dwarf=True)),
        "optical_depth": tensor(np.zeros((1, len(GRID_NM)))),
        "lit": tensor(np.stack([objects.lit[:, 0], objects.lit[:, 1] - objects.lit[:, 0]], axis=1)),
        "parts": tensor(objects.parts),
        "light_curve": tensor(objects.light_curve),
    }


def _depth(plan: FramePlan) -> Floats:
    """Optical depth per airmass, for starlight."""
    atmosphere = dimming_atmosphere(plan.spec.atmosphere)
    return np.zeros((1, len(GRID_NM))) if atmosphere is None else star_depths(atmosphere, plan.horizon.dips)


def colour_tensors(bv_mag: Floats, vi_mag: Floats) -> dict[str, Any]:
    """Parameters of an emitter of points that describe their colours."""
    row, column = colour_place(bv_mag, vi_mag)
    return {
        "colour_row": tensor(row),
        "colour_column": tensor(column),
        "colour_table": tensor(colour_grid().spectra),
    }
