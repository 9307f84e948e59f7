"""The answer about confidence: H8."""

from __future__ import annotations

import math

import numpy as np
from scipy import stats

from benchmark.stats.confidence import expected_calibration_error
from benchmark.stats.intervals import proportion
from benchmark.studies.common.page_model import Answer, Cell, Number, Table
from benchmark.studies.common.records import Rows
from benchmark.studies.thesis import contestants as who
from benchmark.studies.thesis.rendered import PART


def h8(rows: Rows) -> Answer:
    """Whether confidence says how likely a fix is right."""
    body: list[tuple[Cell, ...]] = []
    texts = []
    misses = []
    for part, title, name in (
        (PART, "rendered", who.ADAPTIVE),
        ("centroids", "centroids", who.ADAPTIVE),
        ("centroids", "centroids", who.LITERAL_ADAPTIVE),
        ("centroids", "centroids", who.LITERAL_BASELINE),
    ):
        kept = Rows(tuple(row for row in rows.of(part, name).rows if row.status == "fix"))
        right = kept.identified
        good, bad = kept.confidence[right], kept.confidence[~right]
        auc, p = math.nan, math.nan
        if len(good) and len(bad):
            test = stats.mannwhitneyu(good, bad, alternative="two-sided")
            auc, p = float(test.statistic) / (len(good) * len(bad)), float(test.pvalue)
        error = expected_calibration_error(kept.confidence, right)
        misses.append(error)
        confident = kept.confidence >= np.median(kept.confidence) if len(kept) else np.empty(0, bool)
        body.append(
            (
                f"{name}, {title}",
                str(len(kept)),
                Number(proportion(~right), "percent"),
                Number(proportion(~right[confident]), "percent"),
                f"{error:.2f}",
                "no wrong fix" if math.isnan(auc) else f"{auc:.2f} (p = {p:.2g})",
            )
        )
        texts.append(f"{name} on {title}: off by {error:.2f} on average")
    table = Table(
        "Confidence of fixes",
        "rendered frames of all labels, centroid frames of all depths",
        ("variant", "fixes", "wrong stars", "wrong stars, more confident half", "calibration error", "AUC"),
        tuple(body),
        "Right means identified. Calibration error: expected distance between confidence and share of right fixes, ten "
        "bins. AUC: chance that a right fix has more confidence than a wrong one (Mann-Whitney).",
    )
    return Answer(
        "H8",
        "Confidence (normalised votes) is calibrated.",
        "no" if max(misses) > 0.1 else "yes",
        (
            "; ".join(texts)
            + ". A vote share is not a probability: it ranks fixes to some degree where many are wrong, "
            "and says nothing where none is.",
            "The thesis calls the relation strong; its own three upper bins do not differ (failures of 33.8, "
            "24.0 and 29.2 % "
            "in 71, 104 and 24 frames).",
        ),
        (table,),
    )
