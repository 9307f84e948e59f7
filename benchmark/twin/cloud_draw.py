"""Which of the patterns that a cloud's statistics allow: the one whose gaps lie where the photograph's stars shine."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

from generator.frame.plan import through_clouds
from generator.places.earth import EQUATORIAL_RADIUS_KM
from generator.places.times import Instant
from generator.scenario.file import Scenario
from generator.sky.clouds import CloudField
from generator.sky.state import UnderClouds, drifted_clouds

Floats = NDArray[np.float64]

DRAWS = 64
"""Patterns that are tried: six bits, a number of the weather as its depth and its cover are."""
COVERS = np.array([0.3, 0.5, 0.7, 0.8, 0.9, 0.95, 0.98, 0.995])
DEPTHS = np.geomspace(0.1, 10.0, 21)
"""Mean depths and covers that each pattern is tried with."""
SCATTER = 0.3
"""Of a star's logarithm about a right cloud, beyond which it counts in proportion and no longer by its square."""


@dataclass(frozen=True)
class Drawn:
    """A chosen pattern.

    Attributes
    ----------
    draw : int
    mean_depth, cover : float
        With which it was chosen.
    miss : float
        Of the stars: soft_l1 of their logarithms' misses over `SCATTER`, mean.
    """

    draw: int
    mean_depth: float
    cover: float
    miss: float


def choose_draw(
    enu: Floats, passed: Floats, least: Floats, field_of: Callable[[int], CloudField], draws: int = DRAWS
) -> Drawn:
    """Find the pattern that dims each star as the photograph does.

    Parameters
    ----------
    enu : (n, 3) array
        Directions of stars above the horizon.
    passed, least : (n,) arrays
        Part of each star's light that passes the cloud, and the least part that would be seen; fainter ones have it.
    field_of : function
        Of a draw: its cloud, overcast.
    draws : int
        That are tried, from 0.
    """
    logs = np.log(np.maximum(passed, least))
    floor = np.log(least)
    best = Drawn(0, 1.0, 0.9, float("inf"))
    for draw in range(draws):
        field = field_of(draw)
        heights, slant = heights_of(field, enu)
        for cover in COVERS:
            threshold = ndtri(1 - cover)
            above = np.maximum(heights - threshold, 0) * slant
            # Mean of a standard Gaussian variable above the threshold.
            mean = np.exp(-0.5 * threshold**2) / np.sqrt(2 * np.pi) - threshold * ndtr(-threshold)
            for depth in DEPTHS:
                light = np.exp(-field.point_share * depth / mean * above).mean(axis=0)
                miss = (np.maximum(np.log(np.maximum(light, 1e-30)), floor) - logs) / SCATTER
                cost = float(np.mean(np.sqrt(1 + miss**2) - 1))
                if cost < best.miss:
                    best = Drawn(draw, float(depth), float(cover), cost)
    return best


def heights_of(field: CloudField, enu: Floats) -> tuple[Floats, Floats]:
    """The Gaussian field behind an overcast cloud over its deviation, at each moment, (moments, n), and slants, (n,)."""
    ratio = EQUATORIAL_RADIUS_KM / (EQUATORIAL_RADIUS_KM + field.altitude_km)
    slant = 1 / np.sqrt(1 - (np.hypot(enu[:, 0], enu[:, 1]) * ratio) ** 2)
    pattern = field.pattern
    plain = dataclasses.replace(field, pattern=dataclasses.replace(pattern, scale=1.0))
    depths = np.stack([still.slant_depth(enu) for still in plain.moments]) / slant
    sigma = float(np.hypot(pattern.coarse.std(), pattern.fine.std()))
    return (depths + pattern.threshold) / sigma, slant


def cloud_of(scenario: Scenario) -> CloudField:
    """The cloud of a scenario's first frame, as its camera sees it."""
    spec = scenario.frame(0)
    if spec.sky.clouds is None:
        raise ValueError("the scenario has no cloud")
    middle = Instant.parse(spec.time.utc_start).plus(spec.shutter_s / 2)
    return drifted_clouds(spec.sky.clouds, UnderClouds.since_midnight(middle), scenario.seed, through_clouds(spec))
