"""Sentences of the report: who leads, what can be told apart, and which times may be compared."""

import dataclasses
import math

import pytest
from unit.benchmark.fake_results import TASKS, write_results

from benchmark.report.site.boards import make_board
from benchmark.report.site.columns import MEDIAN
from benchmark.report.site.tree import read_tree
from benchmark.report.site.words import detectable_words, processor_words, site_verdict
from benchmark.stats.comparison import lead_p
from benchmark.stats.intervals import Estimate


@pytest.fixture(scope="module")
def boards(tmp_path_factory):
    root = write_results(tmp_path_factory.mktemp("tree") / "results", TASKS[::2], frames_per_level=9, modes=("own",))
    return [make_board(group) for group in read_tree(root)]


def test_the_best_solver_comes_first_and_the_verdict_admits_doubt(boards):
    for board in boards:
        rates = [entry.success.value for entry in board.entries]
        assert rates == sorted(rates, reverse=True)
    best = boards[0].entries[0].label
    sure, doubt = _with_lead(boards[0], 0.03), _with_lead(boards[0], 0.06)
    expected = (
        f"Of 1 comparison (a task in one mode of detections): {best} leads 1 (5 % level for all of them together)."
    )
    assert site_verdict([sure]) == expected
    assert "in 1 the first place is not decided" in site_verdict([doubt])
    assert "level" not in site_verdict([doubt])
    assert "12.3 points of success" in detectable_words(dataclasses.replace(boards[0], detectable=0.123))
    assert "none" in detectable_words(dataclasses.replace(boards[0], detectable=math.nan))


def test_rows_timed_on_several_processors_are_named(boards):
    assert processor_words(boards) == ""
    first, *others = boards[0].entries
    run = dataclasses.replace(first.stored.provenance, machine={"cpu": "a faster one"})
    faster = dataclasses.replace(first, stored=dataclasses.replace(first.stored, provenance=run))
    mixed = dataclasses.replace(boards[0], entries=(faster, *others))
    rest = ", ".join(sorted(entry.label for entry in others))
    expected = (
        f"Times of different processors are not comparable: {first.label} on a faster one; {rest} on a processor."
    )
    assert processor_words([mixed]) == expected
    several = "Times are of several processors (a faster one, a processor): compare those that a task's page allows."
    assert processor_words([mixed, *boards]) == several


def test_leads_named_together_are_tested_together(boards):
    """A lead that counts alone (p 0.03) does not count as one of three, beside others that do."""
    sure, doubt = (_with_lead(boards[0], p) for p in (0.0001, 0.03))
    best = boards[0].entries[0].label
    assert f"{best} leads 3 " in site_verdict([sure, sure, doubt])
    assert f"{best} leads 1; in 2 the first place is not decided" in site_verdict([sure, doubt, doubt])


def test_a_lead_is_over_every_other_solver(boards):
    board = _with_lead(boards[0], 0.001)
    best, second, *_ = (entry.label for entry in board.entries)
    assert lead_p(best, board.comparisons) == 0.001
    assert lead_p(second, board.comparisons) == 1.0
    last = board.entries[-1].label
    level = [
        dataclasses.replace(one, difference=Estimate(0.0, -0.1, 0.1, 9))
        if {one.first, one.second} == {best, last}
        else one
        for one in board.comparisons
    ]
    assert lead_p(best, level) == 1.0
    assert lead_p(best, []) == 1.0


def _with_lead(board, p):
    """The board, its first solver ahead of each other with an adjusted p-value of `p`."""
    best = board.entries[0].label
    ahead = Estimate(0.1, 0.05, 0.15, 9)
    behind = Estimate(-0.1, -0.15, -0.05, 9)
    changed = [
        dataclasses.replace(one, success_p_holm=p, difference=ahead if one.first == best else behind)
        if best in (one.first, one.second)
        else one
        for one in board.comparisons
    ]
    return dataclasses.replace(board, comparisons=tuple(changed))


def test_an_interval_that_excludes_nothing_is_left_out(boards):
    entry = boards[0].entries[0]

    def shown(low, high):
        metrics = {**entry.metrics, "median_error_km": Estimate(2.0, low, high, 9)}
        return MEDIAN.interval(dataclasses.replace(entry, metrics=metrics))

    assert shown(0.0, math.inf) == shown(math.nan, math.nan) == shown(math.inf, math.inf) == ""
    assert shown(0.0, 3.0)
    assert shown(1.0, math.inf)
