"""Which of the patterns that a cloud's statistics allow: the one whose gaps lie where the photograph's stars shine."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable
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

COVERS = np.array([0.3, 0.5, 0.7, 0.8, 0.9, 0.95, 0.98, 0.99, 0.995, 0.998])
DEPTHS = np.geomspace(0.15, 14.0, 14)
"""Mean depths and covers that each pattern is tried with."""
SCATTER = 0.2
"""Relative, of a star's light about a right cloud."""
SNR_IN_ORDER = 5.0
"""SNR below which stars are alike when they are put in order."""


@dataclass(frozen=True)
class Drawn:
    """A chosen pattern.

    Attributes
    ----------
    draw : int
    mean_depth, cover : float
        With which it was chosen.
    miss : float
        Of the stars, one by one and in the order of their light (:func:`choose_draw`).
    """

    draw: int
    mean_depth: float
    cover: float
    miss: float


def choose_draw(
    enu: Floats, snr: Floats, clear_snr: Floats, field_of: Callable[[int], CloudField], draws: Iterable[int]
) -> Drawn:
    """Find the pattern, the depth and the cover that dim each star as the photograph does.

    The miss is the sum of two means: over all stars, of soft_l1 of the difference over noise and `SCATTER`; over those that
    are seen, of the logarithm's difference of stars in the order of their SNR, with noise in both. The first tells where the
    gaps are. Alone it makes them too small where they lie beside the photograph's, since light in a wrong place costs twice.

    Parameters
    ----------
    enu : (n, 3) array
        Directions of stars above the horizon.
    snr, clear_snr : (n,) arrays
        Light of each star in the photograph over its noise there; what it would be without cloud.
    field_of : function
        Of a draw: its cloud, overcast.
    draws : of int
        That are tried.
    """
    order = in_order(snr)
    seen = max(int((order > SNR_IN_ORDER).sum()), 1)
    noise = np.random.default_rng(0).standard_normal(len(snr)).astype(np.float32)
    photographed, clear = snr.astype(np.float32), clear_snr.astype(np.float32)
    best = Drawn(-1, 1.0, 0.9, float("inf"))
    for draw in draws:
        field = field_of(draw)
        heights, slant = (part.astype(np.float32) for part in heights_of(field, enu))
        for cover in COVERS:
            threshold = ndtri(1 - cover)
            # Mean of a standard Gaussian variable above the threshold.
            mean = np.exp(-0.5 * threshold**2) / np.sqrt(2 * np.pi) - threshold * ndtr(-threshold)
            above = np.maximum(heights - np.float32(threshold), 0) * slant * np.float32(field.point_share / mean)
            for depth in DEPTHS:
                made = clear * np.exp(np.float32(-depth) * above).mean(axis=0)
                miss = (made - photographed) / np.sqrt(1 + (SCATTER * made) ** 2)
                cost = 2 * float(np.mean(np.sqrt(1 + miss**2) - 1))
                cost += float(np.abs(np.log(in_order(made + noise) / order)).sum()) / seen
                if cost < best.miss:
                    best = Drawn(draw, float(depth), float(cover), cost)
    return best


def in_order(snr: Floats) -> Floats:
    """SNR of stars in their order; all that are not seen are alike."""
    return np.sort(np.maximum(snr, SNR_IN_ORDER))


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
    cloud = drifted_clouds(spec.sky.clouds, UnderClouds.since_midnight(middle), scenario.seed, through_clouds(spec))
    assert cloud is not None  # over a camera on the ground
    return cloud
