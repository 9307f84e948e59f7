"""Occultation of lights by the Moon."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from generator.frame.moon.path import moon_path, seen_through_air, site_of
from generator.frame.plan import FramePlan, refracting_air
from generator.light.points import PointLights
from generator.places.astrometry import unrefracted

Floats = NDArray[np.float64]

NEAR_DEG = 1.5
"""Distance from the Moon's centre beyond which no light is hidden: its radius, plus differences of refraction within it."""
FASTEST_DEG_S = 1.5 / 3600
"""Upper limit of the speed of the Moon among the stars, the observer's own motion included."""


def behind_moon(plan: FramePlan, lights: PointLights) -> PointLights:
    """Return the lights with the times between which the Moon hides them.

    A light is behind the Moon if its direction above the air is within the Moon's disk; both move along chords between
    the moments of the plan. It enters and leaves the disk at most once, because the disk is convex and the path nearly
    straight.
    """
    path = moon_path(plan)
    apparent = seen_through_air(plan, path.centre)
    near = np.radians(min(NEAR_DEG + FASTEST_DEG_S * plan.spec.shutter_s, 180.0))
    rows = np.flatnonzero(lights.directions[:, 0] @ apparent[0] > np.cos(near))
    if not len(rows):
        return lights
    directions = lights.directions[rows]
    flat = np.ascontiguousarray(directions.reshape(-1, 3).T)
    above_air = unrefracted(flat, site_of(plan), refracting_air(plan.spec.atmosphere)).T.reshape(directions.shape)
    span = times_inside(path.offsets(above_air))
    met = np.isfinite(span[:, 0])
    if not met.any():
        return lights
    hidden = lights.hidden.copy()
    hidden[rows[met]] = span[met]
    return dataclasses.replace(lights, hidden=hidden)


def times_inside(places: Floats) -> Floats:
    """Return the times at which paths are inside the unit circle.

    Parameters
    ----------
    places : (n, k, 2) array
        Places at k moments evenly spaced from 0 to 1; straight in between.

    Returns
    -------
    (n, 2) array
        First and last time inside; inf if there is none.
    """
    start, way = places[:, :-1], np.diff(places, axis=1)
    # |start + t way|^2 = 1, t from 0 to 1.
    square = np.einsum("nkx,nkx->nk", way, way)
    half = np.einsum("nkx,nkx->nk", start, way)
    beyond = np.einsum("nkx,nkx->nk", start, start) - 1
    root = half * half - square * beyond
    still = square < 1e-24
    with np.errstate(invalid="ignore", divide="ignore"):
        half_chord = np.sqrt(root)
        enters = np.where(still, 0.0, (-half - half_chord) / square)
        leaves = np.where(still, 1.0, (-half + half_chord) / square)
    meets = np.where(still, beyond < 0, (root > 0) & (enters < 1) & (leaves > 0))
    parts = way.shape[1]
    before = np.arange(parts)
    first = np.where(meets, (before + np.clip(enters, 0, 1)) / parts, np.inf).min(axis=1)
    last = np.where(meets, (before + np.clip(leaves, 0, 1)) / parts, -np.inf).max(axis=1)
    return np.where(np.isfinite(first)[:, None], np.stack([first, last], axis=1), np.inf)
