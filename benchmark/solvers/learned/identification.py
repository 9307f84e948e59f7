"""Attitude from a network's names: names whose angles agree, verified by the other stars that they predict.

The network names every detection separately, some of them wrongly. Names are accepted where the angles between them are those
of the catalogue. The attitude of such a set is compared with all detections; it is an answer if more detections match a star
than is plausible by chance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.stats import binom

from benchmark.solvers.attitude_position import best_rotation
from benchmark.solvers.pinhole import PinholeView

NAMES_EACH = 3
"""Number of the most probable stars of a detection that are considered."""
LEAST_PROBABILITY = 0.02
ANGLE_TOLERANCE_PX = 2.0
ANGLE_TOLERANCE = 0.005
"""Tolerance relative to the angle, in addition to the one in pixels."""
SETS_TRIED = 12
FEWEST_NAMES = 3
MATCH_PX = (5.0, 3.0, 2.5)
"""Largest distance of a detection from the star that it matches, for each successive fit."""
STARS_PER_DETECTION = 2
FEWEST_STARS = 40
FREE_MATCHES = 2
"""Matches that do not count as evidence, because an attitude can always be made to match two stars."""
MOST_CHANCE = 1e-6
"""Largest accepted probability that as many detections match a star by chance."""


@dataclass(frozen=True)
class Sky:
    """Stars with which an attitude is compared.

    Attributes
    ----------
    directions : ndarray, shape (n, 3)
        ICRS unit vectors, brightest star first.
    """

    directions: NDArray[np.float64]


@dataclass(frozen=True)
class Identified:
    """An attitude with its matches.

    Attributes
    ----------
    rotation : ndarray, shape (3, 3)
        Rotation from ICRS directions to the camera frame.
    detections, stars : ndarray of int, shape (k,)
        Indices of the detections and of the stars of the sky.
    chance : float
        Probability that a false attitude has as many matches.
    """

    rotation: NDArray[np.float64]
    detections: NDArray[np.intp]
    stars: NDArray[np.intp]
    chance: float


def identify(
    view: PinholeView, probabilities: NDArray[np.float32], named: NDArray[np.float64], sky: Sky
) -> Identified | None:
    """Find the attitude with which most detections agree; None where no attitude is certain.

    Parameters
    ----------
    view : PinholeView
        View with the detections, in the order of `probabilities`.
    probabilities : ndarray, shape (n, m)
        Probability of each star that the network knows, for each detection.
    named : ndarray, shape (m, 3)
        ICRS unit vectors of those stars.
    sky : Sky
    """
    detections, classes, chances = _candidates(probabilities)
    agree = _agreement(view, detections, classes, named)
    best: Identified | None = None
    for members in _sets(agree, chances):
        rotation = best_rotation(named[classes[members]], view.rays[detections[members]])
        found = _held_against(view, rotation, sky)
        if found is not None and (best is None or found.chance < best.chance):
            best = found
    return best


def _candidates(probabilities: NDArray[np.float32]) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.float64]]:
    """Detections, classes and probabilities of the names that are considered."""
    order = np.argsort(-probabilities, axis=1)[:, :NAMES_EACH]
    detections = np.repeat(np.arange(len(order)), order.shape[1])
    classes = order.ravel()
    chances = probabilities[detections, classes].astype(np.float64)
    kept = chances > LEAST_PROBABILITY
    return detections[kept], classes[kept], chances[kept]


def _agreement(
    view: PinholeView, detections: NDArray[np.intp], classes: NDArray[np.intp], named: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Which pairs of names have the same angle as their stars, shape (c, c)."""
    rays, stars = view.rays[detections], named[classes]
    seen = np.arccos(np.clip(rays @ rays.T, -1.0, 1.0))
    true = np.arccos(np.clip(stars @ stars.T, -1.0, 1.0))
    near = np.abs(seen - true) < ANGLE_TOLERANCE_PX / view.f_px + ANGLE_TOLERANCE * true
    return near & (detections[:, None] != detections) & (classes[:, None] != classes)


def _sets(agree: NDArray[np.bool_], chances: NDArray[np.float64]) -> list[NDArray[np.intp]]:
    """Sets of names that all agree with each other, grown from the names with the best support."""
    support = chances * (agree @ chances)
    grown: dict[tuple[int, ...], None] = {}
    for first in np.argsort(-support)[:SETS_TRIED]:
        members, open_ = [int(first)], agree[first].copy()
        while open_.any():
            # Of the names that agree with all members, take the one with the most support from the others.
            rows = np.flatnonzero(open_)
            gain = chances[rows] * (agree[np.ix_(rows, rows)] @ chances[rows] + chances[rows])
            following = int(rows[np.argmax(gain)])
            members.append(following)
            open_ &= agree[following]
        if len(members) >= FEWEST_NAMES:
            grown.setdefault(tuple(sorted(members)))
    return [np.array(each, dtype=np.intp) for each in grown]


def _held_against(view: PinholeView, rotation: NDArray[np.float64], sky: Sky) -> Identified | None:
    """Fit an attitude to all detections that match a star; None where chance could achieve as many matches."""
    n = len(view.rows)
    detections = stars = np.empty(0, dtype=np.intp)
    rows, xy = np.empty(0, dtype=np.intp), np.empty((0, 2))
    for radius in MATCH_PX:
        rows, xy = _in_view(view, rotation, sky, max(FEWEST_STARS, STARS_PER_DETECTION * n))
        if len(rows) == 0:
            return None
        away, nearest = (np.asarray(each) for each in cKDTree(xy).query(view.xy))
        # Of several detections at one star keep the nearest.
        order = np.argsort(away)
        _, first = np.unique(nearest[order], return_index=True)
        met = order[np.sort(first)]
        detections = met[away[met] < radius]
        stars = rows[nearest[detections]]
        if len(detections) < FEWEST_NAMES:
            return None
        rotation = best_rotation(sky.directions[stars], view.rays[detections])
    by_chance = len(rows) * np.pi * MATCH_PX[-1] ** 2 / (view.width * view.height)
    chance = float(binom.sf(len(detections) - FREE_MATCHES - 1, n - FREE_MATCHES, min(by_chance, 1.0)))
    return Identified(rotation, detections, stars, chance) if chance < MOST_CHANCE else None


def _in_view(
    view: PinholeView, rotation: NDArray[np.float64], sky: Sky, most: int
) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """Indices and positions of the brightest stars of the sky in the frame."""
    seen = sky.directions @ rotation.T
    front = seen[:, 2] > 0.1
    xy = view.f_px * seen[:, :2] / np.where(front, seen[:, 2], 1.0)[:, None]
    inside = front & (np.abs(xy) < np.array([view.width, view.height]) / 2.0).all(axis=1)
    rows = np.flatnonzero(inside)[:most]
    return rows, xy[rows]
