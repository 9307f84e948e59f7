"""Choice among the patterns that a cloud's statistics allow: the one with gaps where the photograph's stars shine."""

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
"""Mean depths and covers with which each pattern is tried."""
SCATTER = 0.2
"""Relative scatter of a star's light about a correct cloud."""
SNR_IN_ORDER = 5.0
"""SNR below which stars count as equal when they are sorted."""


@dataclass(frozen=True)
class Drawn:
    """A chosen pattern.

    Attributes
    ----------
    draw : int
    mean_depth, cover : float
        Values with which the pattern was chosen.
    miss : float
        Deviation of the stars, one by one and sorted by their light (:func:`choose_draw`).
    """

    draw: int
    mean_depth: float
    cover: float
    miss: float


def choose_draw(
    enu: Floats, snr: Floats, clear_snr: Floats, field_of: Callable[[int], CloudField], draws: Iterable[int]
) -> Drawn:
    """Find the pattern, the depth and the cover that dim each star as in the photograph.

    The miss is the sum of two terms. The first is the mean of soft_l1, over all stars, of the difference over noise and
    `SCATTER`. The second is the mean, over the stars that are seen, of the difference of logarithms after sorting stars by
    SNR, with noise in both. The first term determines where the gaps are. By itself it makes them too small where they are
    next to the photograph's gaps, since light in a wrong place counts twice.

    Parameters
    ----------
    enu : (n, 3) array
        Directions of stars above the horizon.
    snr, clear_snr : (n,) arrays
        Light of each star in the photograph over its noise there, and the same as it would be without cloud.
    field_of : function
        Maps a draw to its overcast cloud.
    draws : of int
        The draws that are tried.
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
            # Mean of the excess of a standard Gaussian variable over the threshold.
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
    """Sort stars by SNR; all that are not seen count as equal."""
    return np.sort(np.maximum(snr, SNR_IN_ORDER))


def heights_of(field: CloudField, enu: Floats) -> tuple[Floats, Floats]:
    """Gaussian field of an overcast cloud in units of its deviation, at each moment, (moments, n), and slants, (n,)."""
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
    assert cloud is not None  # the camera is on the ground
    return cloud
