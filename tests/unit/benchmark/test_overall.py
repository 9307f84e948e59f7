"""One number over several sets of frames."""

import dataclasses
import math

import numpy as np
import pytest
from unit.benchmark.fake_results import SOLVERS, TASKS, write_results

from benchmark.report.site.boards import make_board
from benchmark.report.site.columns import BOUND, NEES, SUCCESS
from benchmark.report.site.overall import OWN_BOUND, PAIRED, SHOWN, overall_rows
from benchmark.report.site.paired_errors import paired_errors
from benchmark.report.site.site_view import overall_of
from benchmark.report.site.terminal import boards_document, overall_document, result_tables
from benchmark.report.site.tree import read_tree
from benchmark.stats.intervals import Estimate, wilson
from benchmark.stats.overall import geometric_mean_of, mean_of

UNDEFINED = Estimate(math.nan, math.nan, math.nan, 0)


@pytest.fixture(scope="module")
def boards(tmp_path_factory):
    root = write_results(tmp_path_factory.mktemp("tree") / "results", frames_per_level=3, modes=("own",))
    return [make_board(group) for group in read_tree(root)]


def test_distances_to_the_ends_add_in_squares():
    found = mean_of([Estimate(0.5, 0.2, 0.9, 10), Estimate(0.3, 0.26, 0.33, 20), UNDEFINED])
    assert found.value == pytest.approx(0.4)
    assert found.low == pytest.approx(0.4 - math.hypot(0.3, 0.04) / 2)
    assert found.high == pytest.approx(0.4 + math.hypot(0.4, 0.03) / 2)
    assert found.n == 30


def test_a_published_interval_of_a_difference_is_recovered():
    # Newcombe 1998, Statistics in Medicine 17, 873-890, table II, method 10: 56/70 less 48/80 is 0.2, 0.0524 to 0.3339.
    one, other = (Estimate(k / n, *wilson(k, n), n) for k, n in ((56, 70), (48, 80)))
    minus = Estimate(-other.value, -other.high, -other.low, other.n)
    found = mean_of([one, minus])
    assert 2 * found.low == pytest.approx(0.0524, abs=5e-5)
    assert 2 * found.high == pytest.approx(0.3339, abs=5e-5)


def test_ratios_are_averaged_by_their_logarithms_and_open_ends_stay_open():
    found = geometric_mean_of([Estimate(2.0, 1.0, 4.0, 5), Estimate(8.0, 0.0, math.inf, 5)])
    assert (found.value, found.low, found.high) == pytest.approx((4.0, 0.0, math.inf))
    assert math.isnan(geometric_mean_of([UNDEFINED]).value)
    assert mean_of([Estimate(math.inf, 1.0, math.inf, 3), Estimate(1.0, 0.5, 2.0, 3)]).value == math.inf


def test_each_set_counts_alike_and_who_did_not_answer_all_has_dashes(boards):
    rows = overall_rows(boards)
    assert {row.label for row in rows} == {solver.name for solver in SOLVERS}
    for row in rows:
        assert row.success.value == pytest.approx(np.mean([entry.success.value for entry in row.entries]))
        assert len(row.entries) == row.n_sets == len(TASKS)
    shares = [row.success.value for row in rows]
    assert shares == sorted(shares, reverse=True)
    silent = next(row for row in rows if row.label == "never")
    assert BOUND.value(silent) == NEES.value(silent) == "—"
    fewer = overall_rows([*boards, boards[0].__class__(**{**vars(boards[0]), "entries": boards[0].entries[:1]})])
    assert [SUCCESS.value(row) == "—" for row in fewer] == [False] + [True] * (len(SOLVERS) - 1)
    assert fewer[0].label == boards[0].entries[0].label


def test_one_set_with_a_few_wild_covariances_does_not_outweigh_the_others(boards):
    row = overall_rows(boards)[0]
    values = (2.0, 2.0, 66_000.0)
    changed = [
        dataclasses.replace(board, entries=(_with_nees(entry, value),))
        for board, entry, value in zip(boards, row.entries, values, strict=True)
    ]
    (found,) = overall_rows(changed)
    assert NEES.estimate(found).value == pytest.approx(math.prod(values) ** (1 / 3))


def _with_nees(entry, value):
    return dataclasses.replace(entry, metrics={**entry.metrics, "nees": Estimate(value, value / 2, 2 * value, 50)})


def test_errors_are_compared_on_the_frames_that_both_identify(boards):
    """A solver with twice the errors that only identifies easy frames has a small median and a paired ratio of two."""
    best = overall_rows(boards)[0].label
    changed = []
    for board in boards:
        first = next(entry for entry in board.entries if entry.label == best)
        frames = first.stored.frames
        easy = (frames["error_km"] < frames["error_km"].median()).to_numpy()
        picky = frames.assign(
            error_km=np.where(easy, 2 * frames["error_km"], math.inf),
            status=np.where(easy, frames["status"], "refused"),
        ).sample(frac=1, random_state=1)
        stored = dataclasses.replace(first.stored, frames=picky, label="the picky")
        changed.append(dataclasses.replace(board, entries=(first, dataclasses.replace(first, stored=stored))))
    rows = {row.label: row for row in overall_rows(changed)}
    found = PAIRED.estimate(rows["the picky"])
    assert (found.value, found.low, found.high) == pytest.approx((2.0, 2.0, 2.0))
    assert PAIRED.value(rows[best]) == "1.00"
    assert PAIRED.interval(rows[best]) == ""
    assert rows["the picky"].lacks(PAIRED) == 0


def test_who_identifies_nothing_or_not_all_sets_has_no_paired_error(boards):
    rows = {row.label: row for row in overall_rows(boards)}
    assert PAIRED.value(rows["never"]) == "—"
    assert rows["never"].lacks(OWN_BOUND) == 0
    one = boards[0]
    alone = dataclasses.replace(one, entries=one.entries[:1])
    fewer = overall_rows([alone, *boards[1:]])
    assert [PAIRED.value(row) == "—" for row in fewer] == [False] + [True] * (len(SOLVERS) - 1)
    everyone_once = [dataclasses.replace(one, entries=one.entries[k : k + 1]) for k in range(2)]
    assert all(PAIRED.value(row) == "—" for row in overall_rows(everyone_once))
    assert set(paired_errors(one, one.entries[0].label)) == {entry.label for entry in one.entries}


def test_the_table_over_all_sets_says_what_its_rows_can_be_compared_by(boards):
    assert "do not compare rows" in SHOWN[2].hint
    assert SHOWN[3] is PAIRED
    table, *_ = result_tables(boards)
    assert "do not compare rows" in table.caption
    (overall,) = overall_document(boards)
    assert "identified_error_ratio" in overall["solvers"][0]


def test_who_did_not_answer_all_sets_is_named_below_the_table(boards):
    first = boards[0].__class__(**{**vars(boards[0]), "entries": boards[0].entries[:1]})
    (found,) = overall_of([first, *boards[1:]])
    everywhere = boards[0].entries[0].label
    assert [row.label for row in found.complete] == [everywhere]
    assert {row.label for row in found.partial} == {solver.name for solver in SOLVERS} - {everywhere}
    table, *_ = result_tables([first, *boards[1:]])
    assert table.row_count == 1
    for row in found.partial:
        assert f"{row.label} ({len(boards) - 1})" in table.caption


def test_a_number_that_some_sets_lack_is_said_so(boards):
    row = overall_rows(boards)[0]
    lame = [{**entry.metrics, "nees": UNDEFINED} if n == 0 else entry.metrics for n, entry in enumerate(row.entries)]
    changed = [
        board.__class__(**{**vars(board), "entries": (entry.__class__(**{**vars(entry), "metrics": metrics}),)})
        for board, entry, metrics in zip(boards, row.entries, lame, strict=True)
    ]
    (found,) = overall_rows(changed)
    assert found.lacks(NEES) == 1
    assert found.lacks(SUCCESS) == 0


def test_terminal_and_documents_lead_with_the_four_numbers(boards):
    first, *_ = result_tables(boards)
    assert [column.header for column in first.columns] == [
        "solver", "success", "stars named right", "error / bound", "NEES", "wrong and confident", "median time, ms",
    ]  # fmt: skip
    (overall,) = overall_document(boards)
    assert overall["sets"] == len(TASKS)
    names = [
        "success", "stars_named_right", "identified_bound_ratio", "nees", "wrong_and_confident", "median_time_ms",
        "risk_coverage_area",
    ]  # fmt: skip
    assert list(overall["solvers"][0])[2:9] == names
    assert list(boards_document(boards)[0]["solvers"][0])[2:9] == names
    (table,) = overall_of(boards)
    assert table.title.startswith("Whole system")


def test_a_submission_to_another_split_takes_no_solver_s_place(boards):
    alone = dataclasses.replace(boards[0], split="test", entries=boards[0].entries[:1])
    (overall,) = overall_of([*boards, alone])
    (without,) = overall_of(boards)
    assert overall.n_sets == without.n_sets == len(boards)
    assert overall.title == f"{without.title}, split {boards[0].split}"
    assert [row.label for row in overall.complete] == [row.label for row in without.complete]
    assert overall.complete
