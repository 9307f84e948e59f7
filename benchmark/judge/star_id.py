"""Judgement of a solver's star identifications.

Definitions (docs/benchmark.md repeats them):

* A *truth star* of a frame is a row of its truth table with `snr` of at least `TRACE_SNR`: a star that leaves a trace.
* The place of a truth star is the centroid of its light (`light_u_px`, `light_v_px`): coma and lateral colour shift a
  detection, and a detector cannot know of them. Tables without these columns give the geometric place at mid-exposure.
* A *match* (detection, star id) is correct when the truth star of that id is within `MATCH_RADIUS_PX` of the detection's
  position, and either is the nearest such truth star, or gives at least `BLEND_SHARE` of the electrons of the brightest of
  them. For a faint star next to a bright one the nearest is meant, for a bright star in a crowd the brightest, and a blend of
  equals may be named after any of them. For photographs whose electrons are unknown, V decides which is the brightest.
* A star counts once in a frame: of several matches that may have its id the first is correct, and the others are wrong.
* In a photograph whose stars nobody can identify, no match counts, neither as correct nor as wrong.
* A *detection of a star* is a detection with a truth star within the radius.
* Precision is the number of correct matches over that of claimed matches. Recall is the number of detections of a star that
  are matched correctly over that of all detections of a star. Only frames with a fix claim matches; a refused frame counts in
  the denominator of recall.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from benchmark.frames.dataset import TruthStars

MATCH_RADIUS_PX = 3.0
TRACE_SNR = 3.0
BLEND_SHARE = 0.5


@dataclass(frozen=True)
class StarScore:
    """Star identification in one frame.

    Attributes
    ----------
    n_detected_stars : int
        Detections of a star.
    n_matches, n_correct : int
        Matches claimed, and the correct ones among them.
    correct : ndarray of bool, shape (n_matches,)
    """

    n_detected_stars: int
    n_matches: int
    n_correct: int
    correct: NDArray[np.bool_]


def score_matches(
    uv: NDArray[np.float64],
    matches: NDArray[np.int64],
    truth: TruthStars,
    radius_px: float = MATCH_RADIUS_PX,
) -> StarScore:
    """Judge the matches of one frame by its truth.

    Parameters
    ----------
    uv : ndarray, shape (n, 2)
        Detections, px.
    matches : ndarray of int, shape (m, 2)
        Detection index and star id; each detection at most once.
    truth : TruthStars
        The frame's truth.
    radius_px : float
        Largest distance of a detection from its star.

    Returns
    -------
    StarScore
    """
    seen = truth.snr >= TRACE_SNR
    star_uv, star_id, electrons = truth.detected_uv[seen], truth.star_id[seen], truth.brightness[seen]
    correct = np.zeros(len(matches), dtype=bool)
    if not truth.named:
        return StarScore(0, 0, 0, correct)
    if not len(uv) or not len(star_uv):
        return StarScore(0, len(matches), 0, correct)
    tree = cKDTree(star_uv)
    nearest_px, _ = tree.query(uv)
    n_detected = int(np.count_nonzero(nearest_px <= radius_px))
    if len(matches):
        correct = _are_correct(uv[matches[:, 0]], matches[:, 1], tree, star_id, electrons, radius_px)
        correct = _first_of_each(matches[:, 1], correct)
    return StarScore(n_detected, len(matches), int(np.count_nonzero(correct)), correct)


def _first_of_each(named: NDArray[np.int64], counted: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Which of the counted ids, shape (m,), are the first of their kind."""
    places = np.flatnonzero(counted)
    first = np.zeros(len(named), dtype=bool)
    first[places[np.unique(named[places], return_index=True)[1]]] = True
    return first


def _are_correct(
    places: NDArray[np.float64],
    named: NDArray[np.int64],
    tree: cKDTree,
    star_id: NDArray[np.int64],
    electrons: NDArray[np.float64],
    radius_px: float,
) -> NDArray[np.bool_]:
    """Whether detections at `places`, shape (m, 2), may have the ids that they were given, shape (m,)."""
    pairs = cKDTree(places).sparse_distance_matrix(tree, radius_px, output_type="ndarray")
    match, star, distance_px = pairs["i"], pairs["j"], pairs["v"]
    nearest_px, brightest = np.full(len(places), np.inf), np.zeros(len(places))
    np.minimum.at(nearest_px, match, distance_px)
    np.maximum.at(brightest, match, electrons[star])
    allowed = (distance_px == nearest_px[match]) | (electrons[star] >= BLEND_SHARE * brightest[match])
    correct = np.zeros(len(places), dtype=bool)
    correct[match[allowed & (star_id[star] == named[match])]] = True
    return correct
