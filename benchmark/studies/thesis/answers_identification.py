"""Answers about identification: H1, H3, H6."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from benchmark.stats.intervals import Estimate
from benchmark.stats.paired_tests import mcnemar_exact
from benchmark.studies.common.page_model import Answer, Cell, Comparison, Number, Outcome, Table, Verdict, family
from benchmark.studies.common.records import Rows, identified_test, near_test
from benchmark.studies.thesis import contestants as who
from benchmark.studies.thesis.hypotheses import CLAIMS
from benchmark.studies.thesis.rendered import PART

LIGHT_POLLUTED_MAG = 6.5
CENTROIDS = "centroids"


@dataclass(frozen=True)
class IdentifiedShares:
    """H1: shares of frames with identified stars, at labels up to `most_mag`.

    Attributes
    ----------
    most_mag : float
    adaptive, baseline, selection_alone, iteration_alone : Estimate
        In our reading; each of the last two changes one thing about the baseline.
    over_iteration_and_rejection : Outcome
        The adaptive variant compared with the fixed catalogue with iteration and polar rejection.
    """

    most_mag: float
    adaptive: Estimate
    baseline: Estimate
    selection_alone: Estimate
    iteration_alone: Estimate
    over_iteration_and_rejection: Outcome


@dataclass(frozen=True)
class BrightestRecalls:
    """H3: recalls of ``brightest-n`` and of the adaptive variant, on three kinds of frames."""

    brightest: Estimate
    adaptive: Estimate
    brightest_centroids: Estimate
    adaptive_centroids: Estimate
    brightest_hot_pixels: Estimate
    adaptive_hot_pixels: Estimate


@dataclass(frozen=True)
class TwoRecalls:
    """H6: the literal adaptive variant on centroids by both measures, and the test of their difference."""

    identified: Estimate
    near: Estimate
    test: Comparison


def h1(rows: Rows) -> Answer:
    """Compare adaptive with fixed, by true identification."""
    labels = sorted({row.depth_mag for row in rows.of(PART).rows if row.depth_mag <= LIGHT_POLLUTED_MAG}, reverse=True)
    ours = {name: rows.of(PART, name, labels) for name in who.OURS_IN_TABLE}
    tests = family(
        [
            (f"{a} against {b}", identified_test(ours[a], ours[b]))
            for a, b in (
                (who.ADAPTIVE, who.BASELINE),
                (who.CATALOGUE_ONLY, who.BASELINE),
                (who.BASELINE_SI, who.BASELINE),
                (who.ADAPTIVE, who.BASELINE_SI_PR),
            )
        ]
    )
    whole, selection, _, over_both = tests
    verdicts: list[tuple[str, Verdict | Outcome]] = [("", _yes_if(whole.outcome is Outcome.BETTER))]
    if whole.outcome is Outcome.BETTER:
        verdicts.append(("by selecting the catalogue alone", _yes_if(selection.outcome is Outcome.BETTER)))
    found = {name: one.id_recall() for name, one in ours.items()}
    return Answer(
        "H1",
        CLAIMS["H1"],
        tuple(verdicts),
        IdentifiedShares(
            LIGHT_POLLUTED_MAG,
            found[who.ADAPTIVE],
            found[who.BASELINE],
            found[who.CATALOGUE_ONLY],
            found[who.BASELINE_SI],
            over_both.outcome,
        ),
        (_identified_table(rows, labels),),
        tests,
    )


def _yes_if(holds: bool) -> Verdict:
    return Verdict.YES if holds else Verdict.NO


def _identified_table(rows: Rows, labels: Sequence[float]) -> Table:
    body: list[tuple[Cell, ...]] = []
    for label in labels:
        found = [rows.of(PART, name, (label,)).id_recall() for name in who.OURS_IN_TABLE]
        body.append((f"{label:g}", *(Number(one, "percent") for one in found), str(found[0].n)))
    return Table(
        "Frames whose stars are identified",
        "rendered frames",
        ("label, mag", *who.OURS_IN_TABLE, "frames"),
        tuple(body),
    )


def h3(rows: Rows) -> Answer:
    """Compare one deep catalogue and the brightest detections."""
    names = (who.ADAPTIVE, who.BRIGHTEST_N, who.DAI)
    found = {name: rows.of(PART, name) for name in names}
    shallow = {name: rows.of(CENTROIDS, name) for name in names}
    tests = family(
        [
            ("brightest-n against adaptive, rendered", near_test(found[names[1]], found[names[0]])),
            ("ddr-dai against adaptive, rendered", near_test(found[names[2]], found[names[0]])),
            ("brightest-n against adaptive, centroids", near_test(shallow[names[1]], shallow[names[0]])),
            ("ddr-dai against adaptive, centroids", near_test(shallow[names[2]], shallow[names[0]])),
        ]
    )
    table = Table(
        "Selecting a catalogue, or taking the brightest",
        f"{len(found[names[0]])} rendered frames; {len(shallow[names[0]])} centroid frames of all depths",
        ("variant", "rendered: recall", "median km", "median ms", "centroids: recall"),
        tuple(
            (
                name,
                Number(found[name].recall(), "percent"),
                Number(found[name].median_km()),
                Number(found[name].median_solve_ms()),
                Number(shallow[name].recall(), "percent"),
            )
            for name in names
        ),
    )

    hot_pixels = {name: rows.of("disturbed: 50 hot pixels", name).recall() for name in names[:2]}
    return Answer(
        "H3",
        CLAIMS["H3"],
        (("on rendered frames", tests[0].outcome), ("on centroids", tests[2].outcome)),
        BrightestRecalls(
            found[who.BRIGHTEST_N].recall(),
            found[who.ADAPTIVE].recall(),
            shallow[who.BRIGHTEST_N].recall(),
            shallow[who.ADAPTIVE].recall(),
            hot_pixels[who.BRIGHTEST_N],
            hot_pixels[who.ADAPTIVE],
        ),
        (table,),
        tests,
    )


def h6(rows: Rows) -> Answer:
    """Compare recall within 10 km with true identification."""
    parts = (
        ("rendered", PART, (who.BASELINE, who.ADAPTIVE, who.ADAPTIVE_ONE_STAR, who.LITERAL_ADAPTIVE)),
        (CENTROIDS, CENTROIDS, (who.ADAPTIVE, *who.LITERAL)),
    )
    body: list[tuple[Cell, ...]] = []
    tests = []
    for title, part, names in parts:
        for name in names:
            found = rows.of(part, name)
            lost = int(np.count_nonzero(found.identified & ~found.near))
            lucky = int(np.count_nonzero(~found.identified & found.near))
            body.append(
                (
                    f"{name}, {title}",
                    Number(found.id_recall(), "percent"),
                    Number(found.recall(), "percent"),
                    str(lost),
                    str(lucky),
                    str(len(found)),
                )
            )
            tests.append((f"{name}, {title}: identified against < 10 km", mcnemar_exact(found.identified, found.near)))
    compared = family(tests)
    table = Table(
        "Identified, and within 10 km",
        "rendered frames of all labels, centroid frames of all depths",
        (
            "variant",
            "stars identified",
            "error < 10 km",
            "identified but ≥ 10 km",
            "< 10 km but not identified",
            "frames",
        ),
        tuple(body),
        "Identified: more than half of the named stars are right; where one star is named, that star.",
    )
    letter = rows.of(CENTROIDS, who.LITERAL_ADAPTIVE)
    own = next(one for one in compared if one.name.startswith(f"{who.LITERAL_ADAPTIVE}, centroids"))
    return Answer(
        "H6",
        CLAIMS["H6"],
        (("", _yes_if(any(one.outcome is not Outcome.NO_DIFFERENCE for one in compared))),),
        TwoRecalls(letter.id_recall(), letter.recall(), own),
        (table,),
        compared,
    )
