"""Division of each star's exposure into moments, and the light that arrives at each of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from generator.device_arrays import aligned
from generator.plugins.camera import FLOAT64, NightSkyCamera
from generator.plugins.landscape import LandscapeTexture
from generator.plugins.star_paths import LitShares, Paths, Placed, relative_light
from generator.plugins.stars import StarEmitter

Floats = NDArray[np.float64]
Rows = NDArray[np.int64]

MOST_MOMENTS = 100_000
"""Largest number of moments of one star: limits memory if the camera turns many times during an exposure."""
MOMENTS_PER_PART = 2
"""Least moments in each part of a light curve."""
SHARE_STEP = 0.5e-3
"""Half the step, in exposures, of the finite difference of a star's motion across the rows."""
OWN_STEP = 1 / 16
"""Upper limit of that step, as a fraction of stars' own time spans."""
SLOWEST = 1e-3
"""Least fraction by which readout must outrun a star for the star to be drawn."""


@dataclass(frozen=True)
class Moments:
    """m moments, ordered by star and time.

    Attributes
    ----------
    star : (m,) array
        Index of the star.
    share : (m,) array
        Fraction of the exposure of the row on which it falls, 0 to 1.
    per_star : (m,) array
        Number of moments into which that star's time is divided, including dark ones.
    """

    star: Rows
    share: Floats
    per_star: Rows


def cut_exposure(paths: Paths, camera: NightSkyCamera, largest_step_px: Floats, lit: LitShares | None) -> Moments:
    """Divide the exposure of each star near the frame into moments between which it moves by at most a step (px, (n,)).

    If a star has its own time span, only that is divided, into moments of each part of its light curve.
    """
    steps = np.ceil(paths.longest_px * (paths.checks - 1) / largest_step_px[paths.star])
    count = np.clip(steps, 1, MOST_MOMENTS).astype(np.int64)
    if lit is not None:
        parts = lit.times.parts[paths.star]
        count = np.maximum(np.ceil(count / parts), MOMENTS_PER_PART).astype(np.int64) * parts
    first = np.repeat(np.cumsum(count) - count, count)
    per_star = np.repeat(count, count)
    star = np.repeat(paths.star, count)
    share = (np.arange(len(first)) - first + 0.5) / per_star
    if lit is None:
        return Moments(star, share, per_star)
    share = lit.share(star, share)
    if not camera.read_out_share:
        # Times are known before places, so dark moments, which are most of a strobe's time, are not followed. If all are
        # dark, the moments are kept.
        shining = np.flatnonzero(lit.times.light_at(star, share) > 0)
        if len(shining):
            star, share, per_star = star[shining], share[shining], per_star[shining]
    return Moments(star, share, per_star)


def moment_light(
    camera: NightSkyCamera, emitter: StarEmitter, moments: Moments, placed: Placed, lit: LitShares | None
) -> Floats:
    """Light of each moment, (m,) array, relative to that of the same star on the axis during a whole exposure.

    It includes lens, horizon, light curve and readout, but not the foreground.
    """
    above = np.array(placed.direction[2]) >= emitter.lowest_sine
    weight = np.where(above | (not emitter.behind_foreground), relative_light(camera, placed), 0.0) / moments.per_star
    if lit is not None:
        weight *= lit.length[moments.star] * lit.times.light_at(moments.star, placed.time)
    if camera.read_out_share:
        weight *= _dwell(camera, emitter, moments.star, placed.time)
    return weight


def behind_geometry(scene: Any, placed: Placed) -> NDArray[np.bool_]:
    """Whether the scene's shapes hide each moment's source, (m,) array."""
    ray = mi.Ray3f(mi.Point3f(0), mi.Vector3f(*(mi.Float(component) for component in placed.direction)))
    return np.array(scene.ray_test(ray))


def behind_landscape(landscape: LandscapeTexture, camera: NightSkyCamera, placed: Placed) -> Floats:
    """Fraction of each moment's source that a landscape hides, (m,) array: the mean over a pixel's width around it."""
    direction = mi.Vector3f(*(mi.Float(component) for component in placed.direction))
    return np.array(landscape.hidden(direction, 1 / camera.projection.f_px), dtype=np.float64)


def beside_moon(camera: NightSkyCamera, emitter: StarEmitter, moments: Moments, placed: Placed) -> Floats:
    """Fraction of each moment's light, (m,) array, that the Moon does not hide."""
    half = 0.5 * camera.exposure_share / moments.per_star
    return np.asarray(emitter.open_share(moments.star, placed.time - half, placed.time + half))


def _dwell(camera: NightSkyCamera, emitter: StarEmitter, star: Rows, time: Floats) -> Floats:
    """Time that a star spends per fraction of its row's exposure, relative to the exposure.

    It differs from 1 because the star moves with or against the readout. Its row v is read out at a time that grows by s
    per row. Since the star itself moves by dv/dt rows, it stays for 1 / (1 - s dv/dt) of the exposure.
    """
    index = mi.UInt32(aligned(star.astype(np.uint32)))
    step: Any = SHARE_STEP * camera.exposure_share
    start: Any = 0.0
    end: Any = 1.0
    if emitter.own is not None:
        # Outside its own time span a star stands still.
        start, end = emitter.own.start[star], emitter.own.end[star]
        step = np.minimum(step, OWN_STEP * emitter.own.length[star])
    before, after = np.clip(time - step, start, end), np.clip(time + step, start, end)
    placed = []
    for times in (before, after):
        moment = FLOAT64(aligned(times))
        _, v, _, valid = camera.project(*emitter.direction(index, moment), moment)
        placed.append((v, valid))
    dr.eval(placed)
    rows = [np.where(np.array(valid), np.array(v), np.nan) for v, valid in placed]
    within = after - before
    moved = np.nan_to_num(rows[1] - rows[0])
    rate = np.divide(moved, within, out=np.zeros_like(moved), where=within > 0)
    per_row = camera.read_out_share / max(camera.height - 1, 1) * (-1 if camera.reads_up else 1)
    stays = 1 - per_row * rate
    return np.divide(1, stays, out=np.zeros_like(stays), where=stays > SLOWEST)
