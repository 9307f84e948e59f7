"""From detections to the orientation of the camera: stages of ever more, and ever looser, hypotheses.

The first stages look at a few bright detections and expect half a pixel of noise; later ones take more detections
(clutter may be brighter than the stars) and more noise (or a focal length that is off). The first hypothesis whose
false-alarm bound passes ends the search.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from celnav.camera import Camera
from celnav.identification.search import (
    View,
    best_hypotheses,
    choose_pairs,
    enu_rotations,
    pair_hypotheses,
    polish,
    single_star_hypotheses,
)
from celnav.identification.sky_index import F4, F8, SkyIndex
from celnav.identification.verification import Alignment, field_cone, verify


@dataclass(frozen=True)
class Stage:
    """One stage of the search.

    Attributes
    ----------
    bright : int
        Hypotheses come from this many of the first detections.
    lags : tuple of int
        Pairs are made of detections whose ranks differ by so much, first and last.
    sigma_px : float
        Noise that pairs may have.
    tolerance_px : float
        How far off a detection may be from the star that explains it under a raw hypothesis.
    scored : int
        Detections that score a hypothesis.
    """

    bright: int
    lags: tuple[int, int]
    sigma_px: float
    tolerance_px: float
    scored: int = 150


# Detections that another orientation must explain, and how far apart two orientations are different ones.
LEAST_RIVAL, SAME_DEG = 8, 2.0
PAIRS_AT_ONCE, HYPOTHESES_AT_ONCE = 8, 12_000
FINE, COARSE = (0.8, 5.0), (4.5, 20.0)
PAIR_STAGES = (
    Stage(4, (1, 3), *FINE, scored=40),
    Stage(8, (1, 3), *FINE, scored=60),
    Stage(6, (1, 2), *COARSE, scored=60),
    Stage(24, (1, 3), *FINE),
    Stage(14, (1, 3), *COARSE),
    Stage(40, (1, 3), *FINE),
    Stage(30, (4, 8), *FINE),
    Stage(30, (1, 2), *COARSE),
    Stage(30, (9, 29), *FINE),
    Stage(20, (4, 8), *COARSE),
    Stage(60, (1, 8), *FINE),
)
# Without an order of brightness pairs are as good as one another: many narrow windows before wide ones.
UNORDERED_STAGES = (
    Stage(8, (1, 3), *FINE),
    Stage(30, (1, 3), *FINE),
    Stage(12, (1, 1), *COARSE),
    Stage(40, (1, 8), *FINE),
    Stage(60, (1, 3), *COARSE),
)
SINGLE_STAGES = (
    Stage(6, (0, 0), 0.8, 6.0, scored=60),
    Stage(16, (0, 0), 0.8, 6.0),
    Stage(10, (0, 0), *COARSE),
    Stage(60, (0, 0), 0.8, 6.0),
    Stage(60, (0, 0), *COARSE),
)


@dataclass(frozen=True)
class SearchConfig:
    """Choices of the search.

    Attributes
    ----------
    pair_stages, unordered_stages, single_stages : tuple of Stage
        Where the attitude to the horizon is not known; the same without an order of brightness; and where it is known.
    verified : int
        Detections that verify it.
    candidates : int
        Hypotheses of a stage that are verified.
    max_log10_false_alarm : float
        The bound that ends the search.
    max_lookups : int
        Effort after which the search gives up.
    rival_lookups : int
        Effort for another orientation, where the one found leaves half as many detections unexplained as it explains.
    """

    pair_stages: tuple[Stage, ...] = PAIR_STAGES
    unordered_stages: tuple[Stage, ...] = UNORDERED_STAGES
    single_stages: tuple[Stage, ...] = SINGLE_STAGES
    verified: int = 120
    candidates: int = 4
    max_log10_false_alarm: float = -8.0
    max_lookups: int = 7_000_000
    rival_lookups: int = 150_000


@dataclass(frozen=True, eq=False)
class Question:
    """What the search works on.

    Attributes
    ----------
    camera : Camera
        The camera.
    uv : ndarray, shape (n, 2)
        Detections, brightest first, refraction taken off where the vertical is known.
    rays : ndarray, shape (n, 3)
        The same as directions.
    ranked : bool
        Whether the order is one of brightness.
    solid_angle_sr, area_px : float
        Of the part of the sky, and of the frame, that the camera sees.
    local : ndarray, shape (3, 3), or None
        Terrestrial-horizon knowledge: R_cam where heading and tilt are known well; None otherwise.
    celestial_to_terrestrial : ndarray, shape (3, 3)
        At the instant.
    up : ndarray, shape (3,), or None
        Zenith in the camera frame.
    zenith_near : tuple of (ndarray, float), or None
        ICRS direction of the zenith of the last known position, and radius, radians.
    """

    camera: Camera
    uv: F8
    rays: F8
    ranked: bool
    solid_angle_sr: float
    area_px: float
    local: F8 | None
    celestial_to_terrestrial: F8
    up: F8 | None
    zenith_near: tuple[F8, float] | None


@dataclass
class Effort:
    """What the search has spent."""

    limit: int
    lookups: int = 0
    hypotheses: int = 0
    best_log10_false_alarm: float = field(default=0.0)


@dataclass(frozen=True, eq=False)
class Identified:
    """What the search found.

    Attributes
    ----------
    alignment : Alignment or None
        The orientation (ICRS to camera) that passes.
    rival : Alignment or None
        Another one that passes too, and explains half as many detections or more.
    effort : Effort
        What it took.
    """

    alignment: Alignment | None
    rival: Alignment | None
    effort: Effort


def identify(question: Question, index: SkyIndex, config: SearchConfig, before: Effort | None = None) -> Identified:
    """Find the orientation that explains the detections, and whether another does about as well.

    What was tried `before` counts in the bound of chance, and not in the effort that ends the search.
    """
    effort = Effort(config.max_lookups)
    if before is not None:
        effort.hypotheses, effort.best_log10_false_alarm = before.hypotheses, before.best_log10_false_alarm
    found, looked_at = _search(question, index, config, effort)
    if found is None:
        return Identified(None, None, effort)
    unexplained = np.zeros(len(question.uv), dtype=bool)
    unexplained[looked_at] = True
    unexplained[found.detection] = False
    rival = _rival(question, index, config, found, np.flatnonzero(unexplained), effort)
    if rival is not None and len(rival.detection) > 2 * len(found.detection):
        found, rival = rival, None
    return Identified(found, rival, effort)


def _search(
    question: Question, index: SkyIndex, config: SearchConfig, effort: Effort
) -> tuple[Alignment | None, NDArray[np.intp]]:
    """Go through the stages until a hypothesis passes or the effort is spent; also the detections that verified it."""
    orders = tuple(_orders(question))
    for number, (order, ranked) in enumerate(orders):
        # The order given is only a guess where there are no fluxes, and has a part of the effort.
        effort.limit = config.max_lookups // (3 if number < len(orders) - 1 else 1)
        for stage, rotations, view, log_stars in _hypotheses(question, index, config, order, ranked, effort):
            found = _judge(question, index, config, stage, rotations, view, order, ranked, log_stars, effort)
            if found is not None:
                # Rows of the detections, whatever the order in which they were tried.
                return replace(found, detection=order[found.detection]), order[: config.verified]
            if effort.lookups > effort.limit:
                break
    return None, orders[0][0][:0]


def _rival(
    question: Question,
    index: SkyIndex,
    config: SearchConfig,
    found: Alignment,
    rest: NDArray[np.intp],
    effort: Effort,
) -> Alignment | None:
    """Look for another orientation among the detections `rest` that the one found leaves unexplained, if they are many.

    Two exposures in one frame, a reflection, or a wrong hypothesis that passed would show here.
    """
    explained = len(found.detection)
    if len(rest) < max(LEAST_RIVAL, 0.5 * explained):
        return None
    others = replace(question, uv=question.uv[rest], rays=question.rays[rest])
    spent = Effort(config.rival_lookups)
    rival, _ = _search(others, index, replace(config, max_lookups=config.rival_lookups), spent)
    effort.lookups += spent.lookups
    effort.hypotheses += spent.hypotheses
    if rival is None or len(rival.detection) < max(LEAST_RIVAL, 0.5 * explained):
        return None
    cosine = (float(np.trace(rival.rotation @ found.rotation.T)) - 1) / 2
    # The same orientation again, of a camera whose distortion or focal length is not what it is said to be, is no rival.
    if cosine > math.cos(math.radians(SAME_DEG)):
        return None
    return replace(rival, detection=rest[rival.detection])


def _orders(question: Question) -> Iterator[tuple[NDArray[np.intp], bool]]:
    """Orders of the detections to try: as given (brightest first); without fluxes also one that spreads over all."""
    bright = np.arange(min(len(question.uv), 300))
    scale = question.camera.radians_per_px(question.uv[bright])
    # At the rim of some lenses a pixel is degrees wide, and says nothing.
    sharp = bright[scale <= 4 * np.nanmedian(scale)] if len(bright) else bright
    rows = np.concatenate((sharp, np.arange(len(bright), len(question.uv))))
    n = len(rows)
    yield rows, True
    if not question.ranked and n > 12:
        # A multiplicative step coprime to n visits every detection once, far from where it was.
        step = next(k for k in range(int(0.618 * n), n + 2) if math.gcd(k, n) == 1)
        yield rows[(np.arange(n) * step) % n], False


def _hypotheses(
    question: Question,
    index: SkyIndex,
    config: SearchConfig,
    order: NDArray[np.intp],
    ranked: bool,
    effort: Effort,
) -> Iterator[tuple[Stage, F4, View, float]]:
    """Yield stages with their hypotheses, the view that scores them, and how many stars of the sky compete with it."""
    per_field = 4 * math.pi / question.solid_angle_sr
    n = len(order)
    most = order[: max(stage.scored for stage in (*config.pair_stages, *config.single_stages))]
    rays = question.rays[most].astype(np.float32)
    scale = question.camera.radians_per_px(question.uv[most]).astype(np.float32)
    done: set[tuple[float, int, int]] = set()
    singles_done: dict[float, int] = {}
    by_pairs = config.pair_stages if ranked else config.unordered_stages
    stages = by_pairs if question.local is None else config.single_stages
    reach = 2 * field_cone(question.camera)[1]
    for stage in stages:
        view = View(rays[: stage.scored], scale[: stage.scored])
        scoring_stars = (2.2 * len(view.rays) if ranked else 1.2 * n) * per_field
        bright = min(stage.bright, len(view.rays))
        level = index.at_least((2.2 * bright if ranked else 1.1 * n) * per_field)
        if question.local is not None:
            before = singles_done.get(stage.sigma_px, 0)
            if bright > before:
                singles_done[stage.sigma_px] = bright
                yield (
                    stage,
                    _from_single_stars(question, view.rays[before:bright], index.xyz[: level.n]),
                    view,
                    scoring_stars,
                )
            continue
        widest = min(level.pair_limit_rad, reach)
        pairs = choose_pairs(view.rays, (0, bright), stage.lags, (0.12 * widest, widest))
        fresh = [(stage.sigma_px, int(i), int(j)) not in done for i, j in pairs]
        pairs = pairs[np.array(fresh, dtype=bool)]
        if not len(pairs):
            continue
        done.update((stage.sigma_px, int(i), int(j)) for i, j in pairs)
        # Without a vertical refraction is in the positions: up to 0.03 deg between stars above 20 deg.
        slack = 5e-5 if question.up is not None else 6e-4
        # Level by level more stars fit a pair; a few thousand hypotheses at a time are tried before the next.
        window = 14 * stage.sigma_px * float(view.radians_per_px[:bright].max())
        fitting = 2 * len(level.first) * min(1.0, window / level.pair_limit_rad)
        at_once = int(np.clip(HYPOTHESES_AT_ONCE / fitting, 1, PAIRS_AT_ONCE))
        for chunk in np.array_split(pairs, math.ceil(len(pairs) / at_once)):
            yield stage, pair_hypotheses(view, chunk, level, index.xyz, stage.sigma_px, slack), view, scoring_stars
            if effort.lookups > effort.limit:
                return


def _from_single_stars(question: Question, rays: F4, stars: F4) -> F4:
    assert question.local is not None
    to_terrestrial = question.celestial_to_terrestrial
    lat, lon, _ = single_star_hypotheses(rays.astype(np.float64) @ question.local, stars @ to_terrestrial.T)
    camera_from_sky = question.local @ enu_rotations(lat, lon) @ to_terrestrial
    return np.ascontiguousarray(np.swapaxes(camera_from_sky, 1, 2), dtype=np.float32)


def _judge(
    question: Question,
    index: SkyIndex,
    config: SearchConfig,
    stage: Stage,
    rotations: F4,
    view: View,
    order: NDArray[np.intp],
    ranked: bool,
    scoring_stars: float,
    effort: Effort,
) -> Alignment | None:
    """Score hypotheses, verify the best, and return one that passes."""
    if question.zenith_near is not None and question.up is not None:
        zenith, radius = question.zenith_near
        rotations = rotations[
            (rotations @ question.up.astype(np.float32)) @ zenith.astype(np.float32) > math.cos(radius)
        ]
    if not len(rotations):
        return None
    level = index.at_least(scoring_stars)
    tolerance = stage.tolerance_px
    # Single stars make few hypotheses, and each true detection only one: they get the longer look.
    first_look = 36 if question.local is None else 80
    best, scores, lookups = best_hypotheses(rotations, view, tolerance, level, index.xyz, config.candidates, first_look)
    effort.lookups += lookups
    effort.hypotheses += len(rotations)
    # What chance scores: half the probability that a star lies within the tolerance, for each detection.
    by_chance = float(np.sum(np.minimum(1.0, level.n * (tolerance * view.radians_per_px) ** 2 / 4))) / 2
    least = by_chance + 2.5 * math.sqrt(by_chance) + 1.0
    made_of = 2 if question.local is None else 1
    verified = order[: max(config.verified, len(view.rays))]
    per_field = 4 * math.pi / question.solid_angle_sr
    n_stars = int(min(max(1.6 * len(verified) if ranked else 1.2 * len(order), 30) * per_field, len(index.xyz)))
    for rotation, score in zip(best, scores, strict=True):
        if score < min(least, 0.5 * len(view.rays)):
            continue
        polished, after = polish(rotation, view, tolerance, level, index.xyz)
        if after < min(least + made_of, 0.5 * len(view.rays)):
            continue
        found = verify(
            question.camera,
            question.uv[verified],
            index.xyz[:n_stars].astype(np.float64),
            polished.T,
            tolerance,
            log10_tried=math.log10(effort.hypotheses),
            free_stars=made_of,
        )
        effort.best_log10_false_alarm = min(effort.best_log10_false_alarm, found.log10_false_alarm)
        if found.log10_false_alarm <= config.max_log10_false_alarm:
            return found
    return None
