"""The answer about the magnitude label of a set of frames."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from benchmark.stats.intervals import Estimate
from benchmark.studies.common.page_model import Answer, Verdict
from benchmark.studies.common.records import Rows
from benchmark.studies.thesis import contestants as who
from benchmark.studies.thesis.centroids import DEPTHS_MAG
from benchmark.studies.thesis.hypotheses import CLAIMS
from benchmark.studies.thesis.rendered import Depth

SAME_MAG = 0.25
"""A label counts as true where at least half of the stars are detected down to this close to it."""


@dataclass(frozen=True)
class LabelDepth:
    """Magnitude labels compared with the depth of frames.

    Attributes
    ----------
    true_to_mag : float
        Faintest label that is true; NaN if none is.
    camera_mag, camera_label_mag, detections : float
        Depth, label and median number of detections of the set with the faintest label.
    best_mag, most_mag : float
        Depths of centroid frames at which the literal baseline is best, and the greatest depth.
    at_best, at_most : Estimate
        Its recalls there.
    """

    true_to_mag: float
    camera_mag: float
    camera_label_mag: float
    detections: float
    best_mag: float
    most_mag: float
    at_best: Estimate
    at_most: Estimate


def label_answer(rows: Rows, depths: Sequence[Depth]) -> Answer:
    """Whether the magnitude label is the depth of a frame."""
    faintest = max(depths, key=lambda depth: depth.label_mag)
    true_labels = [depth.label_mag for depth in depths if abs(depth.half_mag - depth.label_mag) <= SAME_MAG]
    recalls = {depth: rows.of("centroids", who.LITERAL_BASELINE, (depth,)).recall() for depth in DEPTHS_MAG}
    best, most = max(recalls, key=lambda depth: recalls[depth].value), max(DEPTHS_MAG)
    return Answer(
        "Label",
        CLAIMS["Label"],
        (("", Verdict.YES if len(true_labels) == len(depths) else Verdict.NO),),
        LabelDepth(
            max(true_labels, default=math.nan),
            faintest.half_mag,
            faintest.label_mag,
            faintest.detections,
            best,
            most,
            recalls[best],
            recalls[most],
        ),
    )
