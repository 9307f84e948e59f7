"""Which of a solver's star identifications are true.

Definitions (docs/benchmark.md repeats them):

* A *truth star* of a frame is a row of its truth table with `snr` of at least `TRACE_SNR`: a star that leaves a trace.
* A *match* (detection, star id) is correct when the truth star of that id lies within `MATCH_RADIUS_PX` of the
  detection's position.
* A *detection of a star* is a detection with a truth star within the radius.
* Precision is correct matches over matches claimed, recall is detections of a star that are matched correctly over
  all detections of a star. Only frames with a fix claim matches; a refused frame counts in recall's denominator.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from benchmark.dataset import TruthStars

MATCH_RADIUS_PX = 3.0
TRACE_SNR = 3.0


@dataclass(frozen=True)
class StarScore:
    """Star identification in one frame.

    Attributes
    ----------
    n_detected_stars : int
        Detections of a star.
    n_matches, n_correct : int
        Matches claimed, and those that are correct.
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
    """Hold the matches of one frame against its truth.

    Parameters
    ----------
    uv : ndarray, shape (n, 2)
        Detections, px.
    matches : ndarray of int, shape (m, 2)
        Detection index and star id; each detection at most once.
    truth : TruthStars
        The frame's truth.
    radius_px : float
        How far a detection may lie from its star.

    Returns
    -------
    StarScore
    """
    seen = truth.snr >= TRACE_SNR
    star_uv, star_id = truth.uv[seen], truth.star_id[seen]
    if len(uv) and len(star_uv):
        nearest_px, _ = cKDTree(star_uv).query(uv)
        n_detected = int(np.count_nonzero(nearest_px <= radius_px))
    else:
        n_detected = 0
    position = {int(name): place for name, place in zip(star_id, star_uv, strict=True)}
    correct = np.array(
        [
            int(star) in position and bool(np.hypot(*(uv[detection] - position[int(star)])) <= radius_px)
            for detection, star in matches
        ],
        dtype=bool,
    )
    return StarScore(n_detected, len(matches), int(np.count_nonzero(correct)), correct)
