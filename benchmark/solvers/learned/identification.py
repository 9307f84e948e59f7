"""From what the network names to an attitude: names that agree in their angles, and what they foretell of the other stars.

A network names every detection by itself, some of them wrongly. Names are believed where the angles between them are those
of the catalogue. The attitude of such a set is held against all detections, and is an answer if so many meet a star that
chance would hardly do it.
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
"""The most probable stars of a detection that are considered."""
LEAST_PROBABILITY = 0.02
ANGLE_TOLERANCE_PX = 2.0
ANGLE_TOLERANCE = 0.005
"""Of an angle itself, beside the pixels."""
SETS_TRIED = 12
FEWEST_NAMES = 3
MATCH_PX = (5.0, 3.0, 2.5)
"""How near to a star a detection lies that meets it, fit after fit."""
STARS_PER_DETECTION = 2
FEWEST_STARS = 40
FREE_MATCHES = 2
"""An attitude can be made to meet two stars."""
MOST_CHANCE = 1e-6
"""Probability that so many detections meet a star by chance."""


@dataclass(frozen=True)
class Sky:
    """Stars that an attitude is held against.

    Attributes
    ----------
    directions : ndarray, shape (n, 3)
        ICRS unit vectors, brightest star first.
    """

    directions: NDArray[np.float64]


@dataclass(frozen=True)
class Identified:
    """An attitude and the matches behind it.

    Attributes
    ----------
    rotation : ndarray, shape (3, 3)
        Takes ICRS directions to the camera frame.
    detections, stars : ndarray of int, shape (k,)
        Rows of the detections and of the sky.
    chance : float
        Probability of as many matches of a false attitude.
    """

    rotation: NDArray[np.float64]
    detections: NDArray[np.intp]
    stars: NDArray[np.intp]
    chance: float


def identify(
    view: PinholeView, probabilities: NDArray[np.float32], named: NDArray[np.float64], sky: Sky
) -> Identified | None:
    """The attitude that most of the detections agree with; None where none is sure.

    Parameters
    ----------
    view : PinholeView
        Shows the detections, in the order of `probabilities`.
    probabilities : ndarray, shape (n, m)
        Of each star that the network knows, for each detection.
    named : ndarray, shape (m, 3)
        ICRS unit vectors to those stars.
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
    """Which pairs of names have the angle of their stars, shape (c, c)."""
    rays, stars = view.rays[detections], named[classes]
    seen = np.arccos(np.clip(rays @ rays.T, -1.0, 1.0))
    true = np.arccos(np.clip(stars @ stars.T, -1.0, 1.0))
    near = np.abs(seen - true) < ANGLE_TOLERANCE_PX / view.f_px + ANGLE_TOLERANCE * true
    return near & (detections[:, None] != detections) & (classes[:, None] != classes)


def _sets(agree: NDArray[np.bool_], chances: NDArray[np.float64]) -> list[NDArray[np.intp]]:
    """Sets of names of which each agrees with each, grown from the best supported ones."""
    support = chances * (agree @ chances)
    grown: dict[tuple[int, ...], None] = {}
    for first in np.argsort(-support)[:SETS_TRIED]:
        members, open_ = [int(first)], agree[first].copy()
        while open_.any():
            # Of those that agree with all members, the one that most others of them support.
            rows = np.flatnonzero(open_)
            gain = chances[rows] * (agree[np.ix_(rows, rows)] @ chances[rows] + chances[rows])
            following = int(rows[np.argmax(gain)])
            members.append(following)
            open_ &= agree[following]
        if len(members) >= FEWEST_NAMES:
            grown.setdefault(tuple(sorted(members)))
    return [np.array(each, dtype=np.intp) for each in grown]


def _held_against(view: PinholeView, rotation: NDArray[np.float64], sky: Sky) -> Identified | None:
    """The attitude fitted to all detections that meet a star; None where chance could do as much."""
    n = len(view.rows)
    detections = stars = np.empty(0, dtype=np.intp)
    rows, xy = np.empty(0, dtype=np.intp), np.empty((0, 2))
    for radius in MATCH_PX:
        rows, xy = _in_view(view, rotation, sky, max(FEWEST_STARS, STARS_PER_DETECTION * n))
        if len(rows) == 0:
            return None
        away, nearest = (np.asarray(each) for each in cKDTree(xy).query(view.xy))
        # Of several detections at one star the nearest.
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
    """Rows and places of the brightest stars of the sky in the frame."""
    seen = sky.directions @ rotation.T
    front = seen[:, 2] > 0.1
    xy = view.f_px * seen[:, :2] / np.where(front, seen[:, 2], 1.0)[:, None]
    inside = front & (np.abs(xy) < np.array([view.width, view.height]) / 2.0).all(axis=1)
    rows = np.flatnonzero(inside)[:most]
    return rows, xy[rows]
