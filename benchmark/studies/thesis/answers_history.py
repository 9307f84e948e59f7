"""The answer about the history that the adaptive algorithm carries from frame to frame: H2."""

from __future__ import annotations

from dataclasses import dataclass

from benchmark.stats.intervals import Estimate
from benchmark.studies.common.page_model import Answer, Number, Outcome, Table, Verdict, family
from benchmark.studies.common.records import Rows, near_test
from benchmark.studies.thesis import contestants as who
from benchmark.studies.thesis.hypotheses import CLAIMS
from benchmark.studies.thesis.rendered import HISTORY_ORDERS, PART

LITERAL_ORDERS = ("reset", "carried, one depth", "carried, shuffled")


@dataclass(frozen=True)
class HistoryEffects:
    """H2: recalls with the history reset and carried, in our reading and in the literal one.

    Attributes
    ----------
    reset, baseline : Estimate
        In our reading.
    carried_shuffled : Outcome
        Our reading, carried through shuffled frames, compared with reset.
    literal_reset, literal_baseline, literal_one_depth, literal_shuffled : Estimate
    literal_carried_one_depth, literal_carried_shuffled : Outcome
        Compared with reset.
    """

    reset: Estimate
    baseline: Estimate
    carried_shuffled: Outcome
    literal_reset: Estimate
    literal_baseline: Estimate
    literal_one_depth: Estimate
    literal_shuffled: Estimate
    literal_carried_one_depth: Outcome
    literal_carried_shuffled: Outcome


def h2(rows: Rows) -> Answer:
    """Compare history reset with history carried."""
    baseline = rows.of(PART, who.BASELINE)
    baseline = Rows(tuple(sorted(baseline.rows, key=lambda row: row.frame_id)))
    ours = tuple(rows.of("history", order) for order in HISTORY_ORDERS)
    literal = tuple(rows.of("literal history", order) for order in LITERAL_ORDERS)
    (reset, in_turn, shuffled), (literal_reset, one_depth, literal_shuffled) = ours, literal
    literal_baseline = rows.of("centroids", who.LITERAL_BASELINE, {row.depth_mag for row in literal_reset.rows})
    tests = family(
        [
            (name, near_test(first, second))
            for name, first, second in (
                ("our adaptive, history reset, against baseline", reset, baseline),
                ("our adaptive: carried set by set against reset", in_turn, reset),
                ("our adaptive: carried shuffled against reset", shuffled, reset),
                ("literal adaptive, reset, against literal baseline", literal_reset, literal_baseline),
                ("literal adaptive: carried at one depth against reset", one_depth, literal_reset),
                ("literal adaptive: carried shuffled against reset", literal_shuffled, literal_reset),
            )
        ]
    )
    gains = [tests[place].outcome is Outcome.BETTER for place in (0, 3)]
    verdict = Verdict.YES if all(gains) else Verdict.IN_PART if any(gains) else Verdict.NO
    return Answer(
        "H2",
        CLAIMS["H2"],
        (("", verdict),),
        HistoryEffects(
            reset.recall(),
            baseline.recall(),
            tests[2].outcome,
            literal_reset.recall(),
            literal_baseline.recall(),
            one_depth.recall(),
            literal_shuffled.recall(),
            tests[4].outcome,
            tests[5].outcome,
        ),
        (_recall_table((baseline, *ours), (literal_baseline, *literal)),),
        tests,
    )


def _recall_table(ours: tuple[Rows, ...], literal: tuple[Rows, ...]) -> Table:
    """Baseline, reset and both ways of carrying, in our reading and in the literal one."""
    depths = sorted({row.depth_mag for row in literal[0].rows})
    return Table(
        "Recall (< 10 km) with the history in three orders",
        f"{len(ours[0])} rendered and {len(literal[0])} centroid frames",
        ("", "baseline", "adaptive, reset", "carried, one set after the other", "carried, shuffled"),
        (
            ("our reading, rendered frames", *(Number(found.recall(), "percent") for found in ours)),
            (
                f"to the letter, centroids to mag {depths[0]:g}–{depths[-1]:g}",
                *(Number(found.recall(), "percent") for found in literal),
            ),
            ("median ms, our reading", *(Number(found.median_solve_ms()) for found in ours)),
        ),
        "The literal baseline is tested on the same centroid frames. Carried, one set after the other: the literal "
        "variant starts a new history at each depth, ours keeps one through the sets from dark to bright.",
    )
