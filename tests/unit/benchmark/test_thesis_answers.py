"""Answers of the replication: verdicts and numbers from rows made by hand, and the words that the page makes of them."""

import html
import math
import re

import numpy as np
import pytest

from benchmark.stats.intervals import Estimate
from benchmark.studies.common.page_model import Answer, Outcome, Verdict, plain
from benchmark.studies.common.records import Row, Rows
from benchmark.studies.thesis import answers_history
from benchmark.studies.thesis import answers_identification as identification
from benchmark.studies.thesis import answers_position as position
from benchmark.studies.thesis import contestants as who
from benchmark.studies.thesis import published as thesis
from benchmark.studies.thesis.answers_confidence import h8
from benchmark.studies.thesis.answers_disturbed import SETTINGS_OF_LIGHT, h10
from benchmark.studies.thesis.answers_label import label_answer
from benchmark.studies.thesis.answers_projection import h5, swap_error_km
from benchmark.studies.thesis.answers_time import h11, speeds
from benchmark.studies.thesis.centroids import (
    ATTITUDE_ERRORS_DEG,
    CHOICES,
    DEPTHS_MAG,
    NOISES_PX,
    ONE_STAR_DEPTHS_MAG,
    CentroidPart,
    OneStar,
    TrueStarFix,
)
from benchmark.studies.thesis.disturbed import CLEAR, FEW_STARS, NAMES, SETTINGS, part_of
from benchmark.studies.thesis.hypotheses import CLAIMS
from benchmark.studies.thesis.rendered import HISTORY_ORDERS, PART, Depth
from benchmark.studies.thesis.study import words as environment_of_words

N = 40
ALL, NONE, HALF = [True] * N, [False] * N, [True, False] * (N // 2)
MOST = [True] * 30 + [False] * 10


def rows(part, contestant, identified=ALL, near=None, depth=6.0, **changes):
    """Rows of one contestant, one a frame: whether its stars are identified, and whether its error is below 10 km."""
    near = identified if near is None else near
    made = []
    for place, (named, close) in enumerate(zip(identified, near, strict=True)):
        values = {"status": "fix", "reason": "", "error_km": 1.0 if close else 50.0, "confidence": 0.5, "solve_ms": 5.0}
        values |= {name: value[place] if isinstance(value, list) else value for name, value in changes.items()}
        made.append(
            Row(part=part, depth_mag=depth, frame_id=f"f{place:03}", contestant=contestant, n_matches=2,
                n_correct=2 if named else 0, detect_ms=0.0, **values)
        )  # fmt: skip
    return made


def words(answer: Answer) -> str:
    """The paragraphs of an answer as plain text."""
    template = '{% import "study_thesis/" ~ key ~ ".html" as words %}{{ words.text(finding) }}'
    page = environment_of_words().from_string(template).render(key=answer.key, finding=answer.finding)
    return re.sub(r"\s+", " ", html.unescape(re.sub("<[^>]+>", "", page)))


def h1(adaptive, baseline, selection, iteration, both):
    shares = {
        who.ADAPTIVE: adaptive, who.BASELINE: baseline, who.CATALOGUE_ONLY: selection, who.BASELINE_SI: iteration,
        who.BASELINE_SI_PR: both,
    }  # fmt: skip
    bright = [row for name in shares for row in rows(PART, name, NONE, depth=7.0)]  # beyond the hypothesis' labels
    return identification.h1(Rows((*bright, *(row for name, one in shares.items() for row in rows(PART, name, one)))))


def test_a_gain_of_iteration_is_not_one_of_selection():
    answer = h1(ALL, HALF, HALF, ALL, ALL)
    assert answer.verdicts == (("", Verdict.YES), ("by selecting the catalogue alone", Verdict.NO))
    assert answer.verdict == "yes; by selecting the catalogue alone: no"
    found = answer.finding
    assert (found.adaptive.value, found.baseline.value, found.adaptive.n) == (1.0, 0.5, N)
    assert (found.selection_alone.value, found.iteration_alone.value) == (0.5, 1.0)
    assert found.over_iteration_and_rejection is Outcome.NO_DIFFERENCE
    assert "these frames show no gain" in words(answer)
    assert "6.5 and below" in words(answer)


def test_selection_alone_may_gain_and_adaptive_may_lose():
    answer = h1(ALL, HALF, ALL, HALF, HALF)
    assert dict(answer.verdicts)["by selecting the catalogue alone"] is Verdict.YES
    assert "also gains over" in words(answer)
    assert h1(HALF, ALL, ALL, ALL, ALL).verdicts == (("", Verdict.NO),)


def h2(reset, baseline, shuffled, literal_reset, literal_baseline, literal_one, literal_shuffled):
    mine = dict(zip(HISTORY_ORDERS, (reset, reset, shuffled), strict=True))
    literal = {"reset": literal_reset, "carried, one depth": literal_one, "carried, shuffled": literal_shuffled}
    made = rows(PART, who.BASELINE, baseline)
    made += rows("centroids", who.LITERAL_BASELINE, literal_baseline)
    for part, orders in (("history", mine), ("literal history", literal)):
        made += [row for name, near in orders.items() for row in rows(part, name, near)]
    return answers_history.h2(Rows(tuple(made)))


def test_history_effects_go_each_its_way():
    answer = h2(MOST, HALF, ALL, ALL, HALF, ALL, HALF)
    found = answer.finding
    assert found.carried_shuffled is Outcome.BETTER
    assert found.literal_carried_one_depth is Outcome.NO_DIFFERENCE
    assert found.literal_carried_shuffled is Outcome.WORSE
    assert (found.reset.value, found.baseline.value, found.literal_shuffled.value) == (0.75, 0.5, 0.5)
    text = words(answer)
    assert "one depth does not change recall measurably: 100 %" in text
    assert "through shuffled depths it lowers recall: 50.0 %" in text
    assert "through shuffled frames raises recall" in text


@pytest.mark.parametrize(
    ("ours", "literal", "verdict"),
    [(ALL, ALL, Verdict.YES), (ALL, HALF, Verdict.IN_PART), (HALF, ALL, Verdict.IN_PART), (HALF, HALF, Verdict.NO)],
)
def test_the_gain_survives_in_both_readings_or_in_part(ours, literal, verdict):
    assert h2(ours, HALF, ours, literal, HALF, literal, literal).verdicts == (("", verdict),)


def test_brightest_against_adaptive_on_each_kind_of_frames():
    made = rows(PART, who.ADAPTIVE, HALF) + rows(PART, who.BRIGHTEST_N, ALL) + rows(PART, who.DAI, HALF)
    made += rows("centroids", who.ADAPTIVE, ALL) + rows("centroids", who.BRIGHTEST_N, MOST)
    made += rows("centroids", who.DAI, ALL)
    made += rows("disturbed: 50 hot pixels", who.ADAPTIVE, ALL) + rows(
        "disturbed: 50 hot pixels", who.BRIGHTEST_N, NONE
    )
    answer = identification.h3(Rows(tuple(made)))
    assert answer.verdict == "on rendered frames: better; on centroids: worse"
    assert "it fixes 0 %" in words(answer)
    assert "recall is 75.0 % (59.8 – 85.8 %, n = 40) against 100 %" in words(answer)


@pytest.mark.parametrize(
    ("factors", "verdict"),
    [([8.0] * N, Verdict.YES), ([3.0] * 13 + [8.0] * 27, Verdict.APPROXIMATELY), ([2.0] * N, Verdict.NO),
     ([50.0] * N, Verdict.NO)],
)  # fmt: skip
def test_the_gain_of_many_stars(factors, verdict):
    made = rows(PART, who.ADAPTIVE, MOST, error_km=0.5)
    made += rows(PART, who.ADAPTIVE_ONE_STAR, error_km=[0.5 * factor for factor in factors])
    answer = position.h4(Rows(tuple(made)))
    assert answer.verdicts == (("", verdict),)
    assert answer.finding.ratio.n == 30  # frames that both identify
    assert answer.finding.one_star_km.value == pytest.approx(0.5 * float(np.median(factors)))
    assert "6.80 km of the thesis" in words(answer)


def projection_part(wrong_km, right_km=0.002):
    one = [
        OneStar(projection, depth, noise, 5.0, (wrong_km if projection == "stereographic" else right_km) + noise * 20)
        for projection in ("pinhole", "stereographic")
        for depth in ONE_STAR_DEPTHS_MAG
        for noise in NOISES_PX
        for _ in range(20)
    ]
    return CentroidPart(20, (), tuple(one), ())


def patterns(right, wrong):
    made = rows("projection pinhole", "literal adaptive, 60 deg", right)
    return Rows(tuple(made + rows("projection stereographic", "literal adaptive, 60 deg", wrong)))


def test_projection_verdicts():
    answer = h5(patterns(ALL, HALF), projection_part(thesis.MEDIAN_KM))
    assert [verdict for _, verdict in answer.verdicts] == [Verdict.YES, Verdict.POSSIBLE, Verdict.NO]
    assert answer.finding.over_prediction.value == pytest.approx(thesis.MEDIAN_KM / float(swap_error_km(5.0)))
    assert answer.finding.right_noisy_km.value == pytest.approx(6.002)
    assert answer.finding.wrong_sparse_km.value == pytest.approx(thesis.MEDIAN_KM)
    text = words(answer)
    assert "identifies 50.0 %" in text
    assert "100 % (91.2 – 100 %, n = 40) with the right one" in text
    other = h5(patterns(ALL, ALL), projection_part(1.0, right_km=2.0))
    assert [verdict for _, verdict in other.verdicts] == [Verdict.NO, Verdict.NOT_SHOWN, Verdict.NOT_SHOWN]


def test_the_two_recalls_differ_or_do_not():
    contestants = ((PART, (who.BASELINE, who.ADAPTIVE, who.ADAPTIVE_ONE_STAR, who.LITERAL_ADAPTIVE)),
                   ("centroids", (who.ADAPTIVE, *who.LITERAL)))  # fmt: skip
    for near, verdict in ((HALF, Verdict.YES), (ALL, Verdict.NO)):
        made = [row for part, names in contestants for name in names for row in rows(part, name, ALL, near)]
        answer = identification.h6(Rows(tuple(made)))
        assert answer.verdicts == (("", verdict),)
        assert answer.finding.test.name.startswith("literal adaptive, centroids")
        assert answer.finding.near.value == sum(near) / N
    assert "p = 1 after Holm" in words(answer)


def true_stars(**errors_km):
    fixes = [
        TrueStarFix("choice", name, site, errors_km.get(key, [1.0] * N)[site])
        for name, key in zip(CHOICES, ("central", "dec", "limit", "weight", "everything"), strict=True)
        for site in range(N)
    ]
    fixes += [
        TrueStarFix("attitude", f"{sigma:g}", site, 1.0 + errors_km.get("per_deg", [100.0])[0] * sigma)
        for sigma in ATTITUDE_ERRORS_DEG
        for site in range(N)
    ]
    return CentroidPart(N, (), (), tuple(fixes))


def test_rules_for_the_star_of_a_fix():
    half = [1.0, 20.0] * (N // 2)
    answer = position.h7(true_stars(central=half, dec=half, weight=[1.0] * N, limit=[20.0] * N))
    assert answer.verdicts == (("as a limit", Verdict.NO), ("as a weight", Verdict.YES))
    found = answer.finding
    assert found.central.within_10_km.value == found.declination_limit.within_10_km.value == 0.5
    assert (found.determinant_limit.p90_km, found.determinant_weight.p90_km) == (20.0, 1.0)
    assert "0 % (0 – 8.8 %, n = 40) with the determinant as a limit" in words(answer)
    assert dict(position.h7(true_stars()).verdicts) == {
        "as a limit": Verdict.NOT_SHOWN,
        "as a weight": Verdict.NOT_SHOWN,
    }


def test_an_attitude_error_counts_or_does_not():
    answer = position.h9(true_stars())
    assert answer.verdicts == (("", Verdict.YES),)
    assert answer.finding.factor == pytest.approx(11.0)
    assert answer.finding.tenth_within_10_km == 0.0
    assert "11.0 times as much" in words(answer)
    assert position.h9(true_stars(per_deg=[0.0])).verdicts == (("", Verdict.NOT_SHOWN),)


def confident(right, confidence, status="fix"):
    parts = ((PART, who.ADAPTIVE), ("centroids", who.ADAPTIVE), ("centroids", who.LITERAL_ADAPTIVE),
             ("centroids", who.LITERAL_BASELINE))  # fmt: skip
    return Rows(
        tuple(row for part, name in parts for row in rows(part, name, right, confidence=confidence, status=status))
    )


def test_confidence_is_calibrated_when_it_is_the_share_of_right_fixes():
    assert h8(confident(MOST, 0.75)).verdicts == (("", Verdict.YES),)
    answer = h8(confident(MOST, 0.95))
    assert answer.verdicts == (("", Verdict.NO),)
    assert answer.finding.of_variants[0].error == pytest.approx(0.2)
    assert "0.20 for thesis-adaptive on rendered frames; 0.20 for thesis-adaptive on centroids;" in words(answer)
    assert h8(confident(MOST, 0.95, status="refused")).verdicts == (("", Verdict.NOT_SHOWN),)
    # Confidence that ranks right above wrong: AUC 1.
    ranked = h8(confident(MOST, [0.9] * 30 + [0.2] * 10))
    assert ranked.tables[0].rows[0][-1].startswith("1.00 (p = ")


def test_disturbances_are_sorted_by_their_tests():
    worst, mildest = SETTINGS_OF_LIGHT[0], SETTINGS_OF_LIGHT[1]
    made = []
    for setting in SETTINGS:
        near = {worst: NONE, mildest: ALL, FEW_STARS: MOST, CLEAR: ALL}.get(setting, MOST)
        made += [row for name in NAMES for row in rows(part_of(setting), name, near)]
    made += [
        row
        for part, depth in (("none", 5.0), ("20 % missing", 5.0), ("20 % false", 5.0), ("50 hot pixels", 5.0),
                            ("half clouded", 5.0), ("none", 3.0))
        for name in (who.ADAPTIVE, who.BRIGHTEST_N)
        for row in rows(f"disturbed: {part}", name, depth=depth)
    ]  # fmt: skip
    answer = h10(Rows(tuple(made)))
    assert answer.verdicts == (("", Verdict.FOR_SOME),)
    assert (answer.finding.worse, answer.finding.better) == ((worst,), (mildest,))
    assert answer.finding.undecided == SETTINGS_OF_LIGHT[2:]
    assert f"Worse than stars to magnitude 4 (5 % after Holm): {worst}." in words(answer)
    assert f"Less harmful: {mildest}." in words(answer)


def timed(ours, literal):
    made = []
    for names, times in ((who.OURS_IN_TABLE, ours), (who.LITERAL_IN_TABLE, literal)):
        for name, ms in zip(names, (*times, 1.0), strict=True):
            made += rows(PART, name, depth=thesis.TABLE_LABEL_MAG, solve_ms=ms)
    return Rows(tuple(made))


def test_the_ranking_by_time():
    given = [5.64, 47.21, 52.62, 5.23]
    assert h11(timed(given, given)).verdicts == (("", Verdict.YES),)
    assert h11(timed(given, given[::-1])).verdicts == (("", Verdict.IN_PART),)
    answer = h11(timed([1.0, 2.0, 3.0, 4.0], [4.0, 2.0, 3.0, 1.0]))
    assert answer.verdicts == (("", Verdict.NO),)
    assert answer.finding.thesis == ("Adaptive", "Baseline", "Baseline + SI", "Baseline + SI + PR")
    assert answer.finding.ours == ("Baseline", "Baseline + SI", "Baseline + SI + PR", "Adaptive")
    assert (answer.finding.our_factor, answer.finding.literal_factor) == (2.0, 0.5)
    assert "a factor of 2.00 in our reading" in words(answer)
    adaptive, iteration = speeds(timed([1.0, 200.0, 1.0, 50.0], given))
    assert (adaptive.name, adaptive.median_ms, adaptive.reached) == (who.ADAPTIVE, 50.0, True)
    assert (iteration.median_ms, iteration.reached) == (200.0, False)


def test_what_a_label_means():
    recalls = {depth: HALF if depth == 4.0 else NONE for depth in DEPTHS_MAG}
    made = [
        row for depth, near in recalls.items() for row in rows("centroids", who.LITERAL_BASELINE, near, depth=depth)
    ]
    depths = (Depth(8.0, 6.3, 1900.0, 5), Depth(6.5, 6.4, 900.0, 5), Depth(4.0, 4.25, 90.0, 5))
    answer = label_answer(Rows(tuple(made)), depths)
    assert answer.verdicts == (("", Verdict.NO),)
    assert (answer.finding.true_to_mag, answer.finding.camera_mag, answer.finding.camera_label_mag) == (6.5, 6.3, 8.0)
    assert (answer.finding.best_mag, answer.finding.at_best.value, answer.finding.at_most.value) == (4.0, 0.5, 0.0)
    assert "at magnitude 4, with a recall of 50.0 %" in words(answer)
    assert label_answer(Rows(tuple(made)), depths[1:]).verdicts == (("", Verdict.YES),)


def test_an_answer_as_json_keeps_its_numbers():
    answer = h1(ALL, HALF, HALF, ALL, ALL)
    stored = plain(answer)
    assert stored["key"] == "H1"
    assert stored["claim"] == CLAIMS["H1"]
    assert stored["verdicts"] == [["", "yes"], ["by selecting the catalogue alone", "no"]]
    assert stored["finding"]["baseline"]["value"] == 0.5
    assert plain(Estimate(math.inf, 0.0, math.nan, 3)) == {"value": None, "low": 0.0, "high": None, "n": 3}
