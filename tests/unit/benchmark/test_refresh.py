"""A leaderboard brought to today's code: only what is missing or older is run, and pages state revisions."""

from __future__ import annotations

import dataclasses
import json
import shutil
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner
from unit.benchmark.fake_results import FakeSolver, FakeTask, write_results
from unit.benchmark.test_tasks import PROGRAM, TINY, TINY_SCENARIO

from benchmark.cli.bench import app
from benchmark.errors import ResultsError
from benchmark.report import refresh
from benchmark.report.marks import find_marks, source_digest
from benchmark.report.refresh import BoardsRequest, compared_frames, plan_boards
from benchmark.report.refresh_plan import Job, Place, Plan, Standing, make_plan
from benchmark.report.site.boards import make_board
from benchmark.report.site.columns import CALIBRATION, HEADLINE, MORE
from benchmark.report.site.tree import read_tree
from benchmark.report.superseded import outdated, remove_outdated, superseded
from benchmark.run.contestants import contestant_of
from benchmark.run.freshness import Age, State
from benchmark.run.packing import pack_tree
from benchmark.solvers.definition import read_solver_folder
from benchmark.tasks.definition import load_task

TODAY, OLDER = Age(State.TODAY, "a" * 12), Age(State.OLDER, "b" * 12, ("today's is " + "a" * 12,))
UNRECORDED = Age(State.UNRECORDED, None)


def test_a_plan_has_what_is_missing_older_unrecorded_or_too_small() -> None:
    standing = {
        Place("one@1", "own", "fresh"): Standing(TODAY, 20, 0.5),
        Place("one@1", "own", "older"): Standing(OLDER, 20, 0.2, "b" * 12),
        Place("one@1", "own", "unrecorded"): Standing(UNRECORDED, 20, 0.1),
        Place("one@1", "own", "few"): Standing(TODAY, 10, 0.1),
        Place("one@1", "shared", "older"): Standing(OLDER, 20, 0.3),
        Place("one@1", "shared", "fresh"): Standing(TODAY, 30, 0.3),
        Place("other@1", "own", "older"): Standing(OLDER, 20, 0.3),
        Place("one@1", "own", "gone"): Standing(OLDER, 20, 0.3),
    }
    plan = make_plan(standing, {"one@1": 20}, ["fresh", "older", "unrecorded", "few", "absent"], ["own"])
    assert plan.jobs == (
        Job(Place("one@1", "own", "older"), f"revision {'b' * 12}; today's is {'a' * 12}", 20, 4.0, revision="b" * 12),
        Job(Place("one@1", "own", "unrecorded"), "revision not recorded", 20, 2.0),
        Job(Place("one@1", "own", "few"), "has 10 frames", 20, 2.0),
        Job(Place("one@1", "own", "absent"), "missing", 20, None),
        Job(Place("one@1", "shared", "older"), f"revision {'b' * 12}; today's is {'a' * 12}", 20, 6.0),
    )
    assert plan.fresh == (Place("one@1", "own", "fresh"), Place("one@1", "shared", "fresh"))
    assert plan.seconds(2, 40) == pytest.approx((14.0 + 4.0) / 2)
    assert plan.n_unknown == 1


def test_the_time_of_a_missing_row_is_that_of_the_other_rows_of_the_solver() -> None:
    standing = {
        Place("one@1", "own", "slow"): Standing(TODAY, 20, 4.0),
        Place("two@1", "own", "slow"): Standing(TODAY, 20, 2.0),
        Place("one@1", "own", "quick"): Standing(TODAY, 20, 0.01),
    }
    (job,) = make_plan(standing, {"three@1": 10}, ["slow"], ["own"]).jobs
    assert job.seconds == pytest.approx(30.0)


def test_a_plan_leaves_rows_out_that_are_not_asked_for_but_keeps_those_that_are_there() -> None:
    standing = {Place("one@1", "own", "a"): Standing(OLDER, 20, 0.5)}
    left_out = {("one@1", "a"), ("two@1", "b"), ("one@1", "b")}
    plan = make_plan(standing, {"one@1": 20, "two@1": 20}, ["a", "b"], ["own"], left_out)
    assert [job.place for job in plan.jobs] == [Place("two@1", "own", "a"), Place("one@1", "own", "a")]


def test_fused_solvers_have_rows_of_tasks_of_sequences_alone(tmp_path: Path) -> None:
    solvers = ("tetra3rs", "tetra3rs-fused")
    plan = plan_boards(BoardsRequest(("uav", "drift"), solvers, tmp_path, tmp_path, 1, 1))
    rows = {(job.place.task, job.place.solver) for job in plan.jobs}
    assert rows == {("uav@1", "tetra3rs"), ("uav@1", "tetra3rs-fused"), ("drift@1", "tetra3rs")}


def test_rows_that_are_missing_are_left_out_where_only_those_that_are_there_are_wanted(tmp_path: Path) -> None:
    task = dataclasses.replace(TASKS[0], revision=load_task(TASKS[0].name).definition.revision)
    root = write_results(tmp_path / "results", (task,), (SOLVERS[0],), frames_per_level=10, modes=("own",))
    request = BoardsRequest((task.name,), ("skybench", "tetra3rs"), root, tmp_path, 1, 1)
    assert len(plan_boards(request).jobs) == 2
    (job,) = plan_boards(dataclasses.replace(request, existing=True)).jobs
    assert (job.place.solver, job.why == "missing") == ("skybench", False)


def test_frames_are_compared_only_for_rows_of_the_solvers_revision(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(refresh, "at_hand", lambda task, choice: True)
    request = BoardsRequest(("bortle", "city"), ("skybench",), tmp_path, tmp_path, 1, 1)
    today = contestant_of("skybench").facts("", "own").revision
    held = (("bortle", today, 30), ("city", "b" * 12, 20))
    places = [(Place(load_task(name).label, "own", "skybench"), *row) for name, *row in held]
    jobs = tuple(Job(place, "has few frames", n, None, revision=revision) for place, revision, n in places)
    assert compared_frames(Plan(jobs, ()), request) == 30


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A tiny task and two programs that answer it."""
    root = tmp_path_factory.mktemp("refresh")
    (root / "tiny.task.yaml").write_text(TINY)
    (root / "tiny.scenario.yaml").write_text(TINY_SCENARIO)
    for name in ("one", "two"):
        (root / name).mkdir()
        (root / name / "program.py").write_bytes(PROGRAM.read_bytes())
        (root / name / "solver.yaml").write_text(
            f'name: {name}\ntitle: Says Munich\nlicence: MIT\nversion: "1"\ncommand: [python, program.py, well]\n'
        )
    return root


def boards(folder: Path, *arguments: str) -> str:
    solvers = ["--solver", str(folder / "one"), "--solver", str(folder / "two")]
    places = ["--out", str(folder / "results"), "--data", str(folder / "data"), "--frames", "1"]
    command = ["boards", str(folder / "tiny.task.yaml"), *solvers, *places, *arguments]
    outcome = CliRunner().invoke(app, command, catch_exceptions=False)
    assert outcome.exit_code == 0, outcome.output
    return outcome.output


def listed(folder: Path) -> dict[str, Any]:
    rows = json.loads((folder / "results" / "tiny@1" / "dev.json").read_text())["rows"]
    return {row["solver"]: row for row in rows}


@pytest.mark.journey
def test_only_stale_rows_are_run(folder: Path) -> None:
    assert "2 rows to be made, 0 of today's code; 3 frames to be rendered" in boards(folder, "--plan")
    assert not (folder / "results").exists()
    boards(folder)
    first = listed(folder)
    assert set(first) == {"one", "two"}
    # Packed, so that no raw result is left, and shown.
    assert sorted(path.name for path in (folder / "results" / "tiny@1").iterdir()) == ["dev.json", "dev.parquet"]
    page = folder / "results" / "site" / "tiny@1-dev-own.html"
    (printed,) = find_marks(page.read_text(encoding="utf-8"))
    assert printed.sentence == "Measured with 2 results: 2 of today's code."
    assert printed.mark.sources == {"dev.json": source_digest(folder / "results" / "tiny@1" / "dev.json")}
    assert f"revision {first['two']['provenance']['solver']['revision']}" in page.read_text(encoding="utf-8")

    # Nothing to do; nor after a word to readers.
    assert "0 rows to be made, 2 of today's code" in boards(folder)
    (folder / "one" / "README.md").write_text("What a remark!")
    assert "0 rows to be made, 2 of today's code" in boards(folder)
    assert listed(folder) == first

    # A change of one solver marks its row, and only it is run again.
    program = folder / "one" / "program.py"
    program.write_text(program.read_text() + "\n# another\n")
    old, new = first["one"]["provenance"]["solver"]["revision"], read_solver_folder(folder / "one").revision
    assert old != new
    outcome = CliRunner().invoke(app, ["report", "--out", str(folder / "results")], catch_exceptions=False)
    assert outcome.exit_code == 0
    text = page.read_text(encoding="utf-8")
    assert f"revision {old}; today&#39;s is {new}" in text
    (printed,) = find_marks(text)
    assert printed.sentence == "Measured with 2 results: 1 of today's code, 1 of older revisions."
    assert "1 rows to be made, 1 of today's code" in boards(folder, "--plan")
    boards(folder)
    second = listed(folder)
    assert second["two"] == first["two"]
    assert second["one"]["provenance"]["solver"]["revision"] == new
    assert "0 rows to be made, 2 of today's code" in boards(folder)


def test_a_solver_that_cannot_run_is_named_and_the_others_are_made(folder: Path, tmp_path: Path) -> None:
    for name in ("tiny.task.yaml", "tiny.scenario.yaml"):
        shutil.copy(folder / name, tmp_path / name)
    shutil.copytree(folder / "two", tmp_path / "two")
    shutil.copytree(folder / "one", tmp_path / "one")
    spec = tmp_path / "one" / "solver.yaml"
    spec.write_text(spec.read_text() + "environment: not-made\n")
    command = ["boards", str(tmp_path / "tiny.task.yaml"), "--solver", str(tmp_path / "one")]
    command += ["--solver", str(tmp_path / "two"), "--frames", "1"]
    command += ["--out", str(tmp_path / "results"), "--data", str(folder / "data")]
    outcome = CliRunner().invoke(app, command, catch_exceptions=False)
    assert outcome.exit_code == 1, outcome.output
    assert "not made: one: its environment" in outcome.output
    assert set(listed(tmp_path)) == {"two"}


TASKS = (FakeTask("bortle", "From a dark site to a city", "Bortle class", "", (1.0, 5.0, 9.0)),)
SOLVERS = (FakeSolver("skybench", 2.2, 45.0, 0.02), FakeSolver("brightest-n", -1.0, 12.0, 0.4))


def numbers(root: Path) -> list[object]:
    """All numbers of the tables of all boards as they are printed."""
    found: list[object] = []
    for group in read_tree(root):
        for entry in make_board(group).entries:
            printed = [(one.value(entry), one.interval(entry)) for one in (*HEADLINE, *MORE, *CALIBRATION)]
            found.append((entry.stored.detections, entry.label, entry.rank, printed, entry.worst, entry.reasons))
    return found


def test_packing_changes_no_printed_number(tmp_path: Path) -> None:
    root = write_results(tmp_path / "results", TASKS, SOLVERS, frames_per_level=30)
    before = numbers(root)
    assert len(before) == 4
    (table,) = pack_tree(root)
    assert (table.n_new, table.n_rows) == (4, 4)
    assert sorted(path.name for path in root.rglob("*") if path.is_file()) == ["dev.json", "dev.parquet"]
    assert numbers(root) == before
    assert pack_tree(root) == []


def test_a_raw_result_takes_the_place_of_the_packed_one(tmp_path: Path) -> None:
    root = write_results(tmp_path / "results", TASKS, SOLVERS, frames_per_level=30)
    pack_tree(root)
    stronger = FakeSolver("brightest-n", 1.9, 12.0, 0.1)
    write_results(root, TASKS, (SOLVERS[1],), frames_per_level=30, modes=("own",))
    assert len(list(root.rglob("summary.json"))) == 1
    raw = write_results(tmp_path / "other", TASKS, (SOLVERS[0], stronger), frames_per_level=30, modes=("own",))
    shutil.rmtree(root / "bortle@1" / "dev")
    shutil.copytree(raw / "bortle@1" / "dev", root / "bortle@1" / "dev")
    mixed = numbers(root)
    assert len(mixed) == 4
    (table,) = pack_tree(root)
    assert (table.n_new, table.n_rows) == (2, 4)
    assert numbers(root) == mixed


def test_two_raw_results_of_one_solver_are_not_packed(tmp_path: Path) -> None:
    root = write_results(tmp_path / "results", TASKS, SOLVERS, frames_per_level=30, modes=("own",))
    (folder,) = root.glob("bortle@1/dev/own/skybench-*")
    other = shutil.copytree(folder, folder.with_name("skybench-000000000000")) / "summary.json"
    other.write_text(other.read_text().replace(folder.name.removeprefix("skybench-"), "000000000000"))
    with pytest.raises(ResultsError, match="two results of skybench; delete the folder of the older one"):
        pack_tree(root)
    assert folder.is_dir()


def test_an_earlier_revision_is_left_out_of_the_report_and_removed_when_asked(tmp_path: Path) -> None:
    root = write_results(tmp_path / "results", TASKS, SOLVERS, frames_per_level=10, modes=("own",))
    pack_tree(root)
    old = root / "bortle@1"
    newer = shutil.copytree(old, root / "bortle@10")
    listing = newer / "dev.json"
    listing.write_text(listing.read_text().replace("bortle@1", "bortle@10"))
    shutil.copytree(old, root / "calibration@3")
    assert outdated(root) == {old: "bortle@10 is there", root / "calibration@3": "the task is retired"}
    assert superseded(root) == {old: "bortle@10 is there"}
    shutil.rmtree(root / "calibration@3")
    assert {stored.task.key for group in read_tree(root) for stored in group} == {"bortle@10"}
    outcome = CliRunner().invoke(app, ["report", "--out", str(root)], catch_exceptions=False)
    assert "bortle@1: bortle@10 is there; `skybench bench boards --remove-old` removes it" in outcome.stderr
    assert list(remove_outdated(root)) == [old]
    assert not old.exists()
    assert superseded(root) == {}
