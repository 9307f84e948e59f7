"""Where stars move on the film during the exposure.

A star's exposure is cut into moments, so many that it moves less than a fraction of the point spread function's width between
two of them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from generator.plugins.camera import FLOAT64, NightSkyCamera
from generator.plugins.stars import StarEmitter

Floats = NDArray[np.float64]
COARSE_CHECKS = 33
MOST_MOMENTS = 100_000
FEW_SHARES: Floats = np.array([0.0, 0.5, 1.0])
PROBES = (32, 24)
"""Cells across and down the frame, in each of which one star shows how the others move."""
SAFETY = 1.15
"""More than the motion differs within a cell."""
FAR_PX = 200.0
LANES_AT_ONCE = 1_000_000
SHARE_STEP = 0.5e-3
SLOWEST = 1e-3
"""Least part by which readout must outrun a star for the star to be drawn."""
MOMENTS_PER_PART = 2


@dataclass(frozen=True)
class StarTracks:
    """Where the light of n stars falls, and when.

    Attributes
    ----------
    u_px, v_px : (n,) arrays
        Position when the row it falls on is half exposed; NaN outside the lens' range.
    start, end : (n, 2) arrays
        Position (u, v) when that row's exposure starts and ends; NaN outside the lens' range or far from the frame.
    centroid : (n, 2) array
        Mean position weighted by the light that arrives; NaN where none does.
    light : (n,) array
        Light that arrives over that of the same star on the axis during one exposure; far from the frame, at mid-exposure.
    visible_share : (n,) array
        Part of the star's light that geometry lets through, 0-1; 1 for stars far from the frame.
    star, u, v, weight : (m,) arrays
        The moments: index of the star, position, and light (as `light`, which is their sum per star).
    """

    u_px: Floats
    v_px: Floats
    start: Floats
    end: Floats
    centroid: Floats
    light: Floats
    visible_share: Floats
    star: NDArray[np.int64]
    u: Floats
    v: Floats
    weight: Floats


def _project(
    camera: NightSkyCamera, emitter: StarEmitter, star: NDArray[np.int64], share: Floats
) -> tuple[Floats, Floats, Floats, NDArray[np.bool_], Floats, Any]:
    """Positions u, v (NaN outside the range), cosine, validity, time, and directions of stars at shares of the exposure."""
    index = mi.UInt32(star.astype(np.uint32))
    u, v, cosine, valid, time = camera.project_source(lambda time: emitter.direction(index, time), FLOAT64(share))
    direction = emitter.direction(index, time)
    dr.eval(u, v, cosine, valid, time, direction)
    good = np.array(valid)
    place = [np.where(good, np.array(value, dtype=np.float64), np.nan) for value in (u, v)]
    return place[0], place[1], np.array(cosine), good, np.array(time), direction


def follow_stars(
    scene: Any, camera: NightSkyCamera, emitter: StarEmitter, reach_px: float, largest_step_px: Floats
) -> StarTracks:
    """Follow all stars of an emitter over the exposure.

    Parameters
    ----------
    scene : Scene
        Its shapes hide stars.
    camera, emitter
    reach_px : float
        How far beyond the frame a star's centre can be for its light to touch the frame.
    largest_step_px : (n,) array
        Longest step of each star between two moments.
    """
    count = emitter.count
    everyone = np.arange(count, dtype=np.int64)
    u_px, v_px, cosine, good, *_ = _project(camera, emitter, everyone, np.full(count, 0.5))
    middle_light = np.where(good, _relative_light(camera, u_px, v_px, cosine), 0.0)
    checks = max(2, camera.keyframes, emitter.keyframes)
    # Stars move together, so a few of them show how all do; flying objects each have a way of their own.
    together = emitter.light_curve is None and checks > len(FEW_SHARES)
    excursion, longest = np.zeros(count), np.zeros(count)
    if together:
        u, v = _tracks(camera, emitter, everyone, FEW_SHARES[::2])
        u, v = (np.insert(ends, 1, middle, axis=1) for ends, middle in ((u, u_px), (v, v_px)))
        excursion, longest = _probed(camera, emitter, u_px, v_px, checks, reach_px)
    else:
        u, v = _tracks(camera, emitter, everyone, np.linspace(0, 1, min(checks, COARSE_CHECKS)))
    steps, touching = _steps_by_the_frame(camera, u, v, reach_px + excursion[:, None])
    near = touching.any(axis=1)
    # Indices are taken several times as fast as masks.
    chosen = np.flatnonzero(near)
    start, end, centroid = (np.full((count, 2), np.nan) for _ in range(3))
    start[chosen] = np.stack([u[chosen, 0], v[chosen, 0]], axis=1)
    end[chosen] = np.stack([u[chosen, -1], v[chosen, -1]], axis=1)
    if together:
        longest = longest[chosen]
    elif len(chosen) and checks > u.shape[1]:
        longest = _longest_step(camera, emitter, chosen, checks, reach_px)
    else:
        longest = steps.max(axis=1, initial=0.0)[chosen]
    moments = np.clip(np.ceil(longest * (checks - 1) / largest_step_px[chosen]), 1, MOST_MOMENTS).astype(np.int64)
    if emitter.light_curve is not None:
        parts = emitter.light_curve.shape[1]
        moments = np.maximum(np.ceil(moments / parts), MOMENTS_PER_PART).astype(np.int64) * parts
    star = np.repeat(chosen, moments)
    first = np.repeat(np.cumsum(moments) - moments, moments)
    per_star = np.repeat(moments, moments)
    share = (np.arange(len(star)) - first + 0.5) / per_star
    visible_share = np.ones(count)
    if len(star) == 0:
        nothing = np.zeros(0)
        return StarTracks(
            u_px, v_px, start, end, centroid, middle_light, visible_share, star, nothing, nothing, nothing
        )
    u, v, cosine, good, time, direction = _project(camera, emitter, star, share)
    relative = _relative_light(camera, u, v, cosine)
    weight = np.where(good & (np.array(direction[2]) >= 0), relative, 0.0) / per_star
    if emitter.light_curve is not None:
        part = np.clip((time * parts).astype(np.int64), 0, parts - 1)
        weight *= emitter.light_curve[star, part]
    if camera.read_out_share:
        weight *= _dwell(camera, emitter, star, time)
    if scene.shapes():
        ray = mi.Ray3f(mi.Point3f(0), mi.Vector3f(*(mi.Float(component) for component in direction)))
        free = ~np.array(scene.ray_test(ray))
        whole = np.bincount(star, weight, count)
        weight = weight * free
        np.divide(np.bincount(star, weight, count), whole, out=visible_share, where=whole > 0)
    light = np.where(near, np.bincount(star, weight, count), middle_light)
    lit = np.flatnonzero(near & (light > 0))
    for axis, position in enumerate((u, v)):
        total = np.bincount(star, weight * np.where(weight > 0, position, 0), count)
        centroid[lit, axis] = total[lit] / light[lit]
    keep = np.flatnonzero(weight > 0)
    return StarTracks(
        u_px, v_px, start, end, centroid, light, visible_share, star[keep], u[keep], v[keep], weight[keep]
    )


def _relative_light(camera: NightSkyCamera, u: Floats, v: Floats, cosine: Floats) -> Floats:
    """The camera's relative light at positions; anything where they are NaN."""
    return np.array(camera.relative_light(FLOAT64(np.nan_to_num(u)), FLOAT64(np.nan_to_num(v)), FLOAT64(cosine)))


def _tracks(
    camera: NightSkyCamera, emitter: StarEmitter, star: NDArray[np.int64], shares: Floats
) -> tuple[Floats, Floats]:
    """Positions u and v, (stars, shares) arrays, at shares of the exposure."""
    u, v, *_ = _project(camera, emitter, np.repeat(star, len(shares)), np.tile(shares, len(star)))
    return u.reshape(len(star), -1), v.reshape(len(star), -1)


def _probed(
    camera: NightSkyCamera, emitter: StarEmitter, u_px: Floats, v_px: Floats, checks: int, reach_px: float
) -> tuple[Floats, Floats]:
    """How all stars move, by that of one star in every cell of the frame.

    Returns
    -------
    excursion : (n,) array
        How far the image leaves the rectangle around its positions at FEW_SHARES, px.
    longest : (n,) array
        Longest step, px, between two of `checks` evenly spaced shares of the exposure.
    """
    columns, rows = (
        np.clip(np.nan_to_num(position) * (cells / size), 0, cells - 1).astype(np.intp)
        for position, size, cells in ((u_px, camera.width, PROBES[0]), (v_px, camera.height, PROBES[1]))
    )
    # Images move fastest far out.
    distance = np.hypot(u_px - camera.width / 2, v_px - camera.height / 2)
    outermost = np.argsort(-np.nan_to_num(distance, nan=-1.0), kind="stable")
    _, first, cell = np.unique((rows * PROBES[0] + columns)[outermost], return_index=True, return_inverse=True)
    probes = outermost[first]
    u, v = _tracks(camera, emitter, probes, FEW_SHARES)
    low, high = (np.stack([f.reduce(u, axis=1), f.reduce(v, axis=1)]) for f in (np.fmin, np.fmax))
    excursion, longest = np.zeros(len(probes)), np.zeros(len(probes))
    block = max(1, LANES_AT_ONCE // max(len(probes), 1))
    for lower in range(0, checks - 1, block):
        shares = np.arange(lower, min(lower + block, checks - 1) + 1) / (checks - 1)
        u, v = _tracks(camera, emitter, probes, shares)
        steps, _ = _steps_by_the_frame(camera, u, v, reach_px + FAR_PX)
        longest = np.maximum(longest, steps.max(axis=1, initial=0.0))
        for axis, position in enumerate((u, v)):
            beyond = np.fmax(low[axis][:, None] - position, position - high[axis][:, None])
            excursion = np.fmax(excursion, np.nan_to_num(beyond).max(axis=1, initial=0.0))
    of_star = np.empty(len(u_px), np.intp)
    of_star[outermost] = cell.ravel()
    return SAFETY * excursion[of_star] + 1, SAFETY * longest[of_star]


def _steps_by_the_frame(
    camera: NightSkyCamera, u: Floats, v: Floats, reach_px: float | Floats
) -> tuple[Floats, NDArray[np.bool_]]:
    """Lengths, px, of the steps between successive positions (n, k), and whether their light can touch the frame.

    Steps that cannot count as 0: far outside the frame a rectilinear image moves without bound.
    """
    touching = np.ones((u.shape[0], u.shape[1] - 1), dtype=bool)
    for position, size in ((u, camera.width), (v, camera.height)):
        lowest, highest = np.fmin(position[:, 1:], position[:, :-1]), np.fmax(position[:, 1:], position[:, :-1])
        touching &= (highest > -reach_px - 1) & (lowest < size + reach_px)
    steps = np.nan_to_num(np.hypot(np.diff(u), np.diff(v)))
    return np.where(touching, steps, 0.0), touching


def _longest_step(
    camera: NightSkyCamera, emitter: StarEmitter, chosen: NDArray[np.int64], checks: int, reach_px: float
) -> Floats:
    """Longest step, px, of each chosen star between two of `checks` evenly spaced shares of the exposure."""
    longest = np.zeros(len(chosen))
    block = max(1, LANES_AT_ONCE // max(len(chosen), 1))
    for lower in range(0, checks - 1, block):
        shares = np.arange(lower, min(lower + block, checks - 1) + 1) / (checks - 1)
        steps, _ = _steps_by_the_frame(camera, *_tracks(camera, emitter, chosen, shares), reach_px)
        longest = np.maximum(longest, steps.max(axis=1, initial=0.0))
    return longest


def _dwell(camera: NightSkyCamera, emitter: StarEmitter, star: NDArray[np.int64], time: Floats) -> Floats:
    """Time that a star spends per share of its row's exposure, over the exposure: it follows the readout, or flees it.

    Its row v is read out at a time that grows by s per row; as the star itself moves by dv/dt rows, it stays for
    1 / (1 - s dv/dt) of the exposure.
    """
    index = mi.UInt32(star.astype(np.uint32))
    step = SHARE_STEP * camera.exposure_share
    placed = []
    for moment in (FLOAT64(time - step), FLOAT64(time + step)):
        _, v, _, valid = camera.project(*emitter.direction(index, moment), moment)
        placed.append((v, valid))
    dr.eval(placed)
    rows = [np.where(np.array(valid), np.array(v), np.nan) for v, valid in placed]
    within = np.clip(time + step, 0, 1) - np.clip(time - step, 0, 1)
    moved = np.nan_to_num(rows[1] - rows[0])
    rate = np.divide(moved, within, out=np.zeros_like(moved), where=within > 0)
    per_row = camera.read_out_share / max(camera.height - 1, 1) * (-1 if camera.reads_up else 1)
    stays = 1 - per_row * rate
    return np.divide(1, stays, out=np.zeros_like(stays), where=stays > SLOWEST)
