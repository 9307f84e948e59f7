"""The answer about confidence: H8."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import stats

from benchmark.stats.confidence import expected_calibration_error
from benchmark.stats.intervals import proportion
from benchmark.studies.common.page_model import Answer, Cell, Number, Table, Verdict
from benchmark.studies.common.records import Rows
from benchmark.studies.thesis import contestants as who
from benchmark.studies.thesis.hypotheses import CLAIMS
from benchmark.studies.thesis.rendered import PART

CALIBRATED = 0.1
"""Largest calibration error for which a confidence counts as calibrated."""


@dataclass(frozen=True)
class CalibrationError:
    """Expected calibration error of a variant on a kind of frames."""

    variant: str
    frames: str
    error: float


@dataclass(frozen=True)
class CalibrationErrors:
    """H8: the calibration errors of all variants."""

    of_variants: tuple[CalibrationError, ...]


def h8(rows: Rows) -> Answer:
    """Whether confidence is the probability that a fix is right."""
    body: list[tuple[Cell, ...]] = []
    errors = []
    for part, frames, name in (
        (PART, "rendered frames", who.ADAPTIVE),
        ("centroids", "centroids", who.ADAPTIVE),
        ("centroids", "centroids", who.LITERAL_ADAPTIVE),
        ("centroids", "centroids", who.LITERAL_BASELINE),
    ):
        kept = Rows(tuple(row for row in rows.of(part, name).rows if row.status == "fix"))
        right = kept.identified
        error = expected_calibration_error(kept.confidence, right)
        errors.append(CalibrationError(name, frames, error))
        confident = kept.confidence >= np.median(kept.confidence) if len(kept) else np.empty(0, bool)
        body.append(
            (
                f"{name}, {frames}",
                str(len(kept)),
                Number(proportion(~right), "percent"),
                Number(proportion(~right[confident]), "percent"),
                f"{error:.2f}",
                _auc_text(kept),
            )
        )
    table = Table(
        "Confidence of fixes",
        "rendered frames of all labels, centroid frames of all depths",
        ("variant", "fixes", "wrong stars", "wrong stars, more confident half", "calibration error", "AUC"),
        tuple(body),
        "A fix is right when its stars are identified. Calibration error: expected distance between confidence and share "
        "of right fixes, ten bins. AUC: probability that a right fix has more confidence than a wrong one (Mann-Whitney).",
    )
    known = [one.error for one in errors if math.isfinite(one.error)]
    verdict = Verdict.NOT_SHOWN if not known else Verdict.YES if max(known) <= CALIBRATED else Verdict.NO
    return Answer(
        "H8",
        CLAIMS["H8"],
        (("", verdict),),
        CalibrationErrors(tuple(errors)),
        (table,),
    )


def _auc_text(kept: Rows) -> str:
    good, bad = kept.confidence[kept.identified], kept.confidence[~kept.identified]
    if not len(good) or not len(bad):
        return "no wrong fix" if len(good) else "no right fix"
    test = stats.mannwhitneyu(good, bad, alternative="two-sided")
    return f"{float(test.statistic) / (len(good) * len(bad)):.2f} (p = {float(test.pvalue):.2g})"
