"""Marks beside measured numbers, and the check that fails when one is not true."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from benchmark.cli.bench import app
from benchmark.errors import ResultsError
from benchmark.report import stale
from benchmark.report.marks import Mark, find_marks, older_digest, sentence_of
from benchmark.report.stale import check_marks, revision_today, source_digest, stamp_file
from benchmark.run.freshness import Age, Origin, State, Today, age_of, today
from benchmark.solvers.registry import solver_folder

COMMAND = "skybench speed --solver --fields 1000"
OLDER = "0123456789ab"


@pytest.fixture
def root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A small repository: one document with a table, one result."""
    monkeypatch.setattr(stale, "_MEASURED", ("docs/solver.md",))
    (tmp_path / "docs").mkdir()
    (tmp_path / "results").mkdir()
    (tmp_path / "results" / "study.json").write_text('{"solved": 0.87}')
    return tmp_path


def write(root: Path, mark: Mark, sentence: str) -> Path:
    path = root / "docs" / "solver.md"
    path.write_text(f"# Measured\n\n{mark.line()}\n*{sentence}*\n\n| solved |\n|-|\n| 87 % |\n")
    return path


def marked(root: Path, revision: str | None, sentence: str) -> Path:
    sources = {"results/study.json": source_digest(root / "results" / "study.json")}
    return write(root, Mark(COMMAND, {"skybench": revision}, sources), sentence)


def test_numbers_of_todays_code_pass(root: Path) -> None:
    revision = solver_folder("skybench").revision
    marked(root, revision, f"Measured with revision {revision} of skybench.")
    assert check_marks(root, {}) == []


def test_numbers_of_an_older_revision_pass_where_they_say_so(root: Path) -> None:
    marked(root, OLDER, f"Measured with revision {OLDER} of skybench, which is not today's.")
    assert check_marks(root, {}) == []


def test_numbers_of_an_unrecorded_revision_pass_where_they_say_so(root: Path) -> None:
    marked(root, None, "Measured before revisions of skybench were recorded.")
    assert check_marks(root, {}) == []


def test_numbers_of_an_older_revision_fail_where_they_are_said_to_be_todays(root: Path) -> None:
    marked(root, OLDER, f"Measured with revision {OLDER} of skybench.")
    (problem,) = check_marks(root, {})
    assert str(problem).startswith("docs/solver.md: line 3: prints 'Measured with revision 0123456789ab of skybench.'")
    assert f"make it again: `{COMMAND}` and `skybench bench stale --measured docs/solver.md`" in problem.remedy
    assert "`skybench bench stale --stamp docs/solver.md`" in problem.remedy


def test_a_changed_result_fails_every_page_that_was_made_from_it(root: Path) -> None:
    revision = solver_folder("skybench").revision
    marked(root, revision, f"Measured with revision {revision} of skybench.")
    (root / "results" / "study.json").write_text('{"solved": 0.97}')
    (problem,) = check_marks(root, {})
    assert str(problem) == (
        f"docs/solver.md: line 3: was not made from results/study.json as it is; make it again: `{COMMAND}`"
    )


def test_another_revision_in_the_sentence_than_in_the_mark_fails(root: Path) -> None:
    revision = solver_folder("skybench").revision
    marked(root, revision, f"Measured with revision {OLDER} of skybench.")
    assert len(check_marks(root, {})) == 1


def test_results_of_a_user_beside_the_committed_ones_are_not_checked(root: Path) -> None:
    """`make demo` writes its site into results/demo, whose rows are not of the leaderboard."""
    revision = solver_folder("skybench").revision
    page = marked(root, revision, f"Measured with revision {revision} of skybench.").read_text()
    text = page.replace("Measured with revision", "Measured with another revision")
    for folder in ("demo", "leaderboard"):
        site = root / "results" / folder / "site"
        site.mkdir(parents=True)
        (site / "index.html").write_text(text)
    (problem,) = check_marks(root, {})
    assert problem.path == "results/leaderboard/site/index.html"


def test_measured_numbers_without_a_mark_fail(root: Path) -> None:
    (root / "docs" / "solver.md").write_text("| solved |\n|-|\n| 87 % |\n")
    (problem,) = check_marks(root, {})
    assert str(problem).startswith("docs/solver.md: has measured numbers and no mark")
    (root / "docs" / "solver.md").unlink()
    (problem,) = check_marks(root, {})
    assert str(problem) == "docs/solver.md: is missing; restore it"


@pytest.mark.parametrize(
    "text", ["{}", '{"by": "x"}', '{"by": "x", "of": {}}', "{nonsense}", '{"by": 1, "of": {"a": 1}, "more": 2}']
)
def test_a_damaged_mark_fails(root: Path, text: str) -> None:
    (root / "docs" / "solver.md").write_text(f"<!-- measured {text} -->\n*Measured before noon.*\n")
    (problem,) = check_marks(root, {})
    assert "docs/solver.md: line 1: " in str(problem)


def test_something_unknown_fails(root: Path) -> None:
    write(root, Mark(COMMAND, {"the moon": OLDER}), f"Measured with revision {OLDER} of the moon.")
    (problem,) = check_marks(root, {})
    assert "'the moon': neither a solver, nor" in str(problem)


def test_rows_of_the_leaderboard(root: Path) -> None:
    rows = {f"bortle@1/dev/own/{n}": State.OLDER if n < 2 else State.TODAY for n in range(5)}
    others = {"bortle@1/dev/shared/0": State.TODAY}
    mark = Mark("skybench bench report", rows=("bortle@1/dev/own/*",), older=older_digest(rows))
    sentence = sentence_of(mark, rows)
    assert sentence == "Measured with 5 results: 3 of today's code, 2 of older revisions."
    write(root, mark, sentence)
    assert check_marks(root, rows | others) == []
    # A row that grows old, and another one instead of it.
    one_more = {"bortle@1/dev/own/4": State.OLDER}
    for change in (one_more, one_more | {"bortle@1/dev/own/0": State.TODAY}):
        (problem,) = check_marks(root, rows | change)
        assert problem.remedy == "make it again: `skybench bench report`"
    (problem,) = check_marks(root, others)
    assert "no row of results/leaderboard matches bortle@1/dev/own/*" in str(problem)


def test_stamping_lets_older_numbers_say_so(root: Path) -> None:
    path = marked(root, OLDER, f"Measured with revision {OLDER} of skybench.")
    assert stamp_file(root, path, {}, measured=False) == 1
    assert check_marks(root, {}) == []
    assert f"*Measured with revision {OLDER} of skybench, which is not today's.*\n" in path.read_text()
    assert stamp_file(root, path, {}, measured=False) == 0


def test_stamping_after_a_measurement_states_todays_revision_and_sources(root: Path) -> None:
    path = marked(root, None, "Measured before revisions of skybench were recorded.")
    (root / "results" / "study.json").write_text('{"solved": 0.97}')
    assert stamp_file(root, path, {}, measured=True) == 1
    assert check_marks(root, {}) == []
    (printed,) = find_marks(path.read_text())
    assert printed.mark.of == {"skybench": solver_folder("skybench").revision}
    assert printed.mark.sources == {"results/study.json": source_digest(root / "results" / "study.json")}
    assert printed.mark.by == COMMAND


def test_stamping_needs_a_sentence_to_replace(root: Path) -> None:
    path = root / "docs" / "solver.md"
    path.write_text(Mark(COMMAND, {"skybench": None}).line() + "\n| solved |\n")
    with pytest.raises(ResultsError, match="line 2 must hold the words"):
        stamp_file(root, path, {}, measured=False)


@pytest.mark.parametrize("option", ["--stamp", "--measured"])
def test_a_file_to_stamp_that_cannot_be_read_is_named(root: Path, option: str) -> None:
    (root / "binary.md").write_bytes(b"\xff\xfe")
    for name, reason in (("none.md", "No such file"), ("docs", "Is a directory"), ("binary.md", "not UTF-8 text")):
        outcome = CliRunner().invoke(app, ["stale", "--root", str(root), option, str(root / name)])
        assert outcome.exit_code == 2, outcome.output
        assert f"skybench: {root / name}: cannot be read ({reason}" in outcome.output
        assert "give a document with marks, such as docs/solver.md" in outcome.output


def test_a_mark_is_a_comment_of_xml() -> None:
    line = Mark(COMMAND, {"skybench": None}).line()
    assert "--" not in line.removeprefix("<!--").removesuffix("-->")
    (printed,) = find_marks(line)
    assert printed.mark.by == COMMAND


def test_what_marks_may_name_has_revisions_of_its_own() -> None:
    names = ("rendering", "the gallery", "the study thesis", "the study calibration", stale.DETECTOR, "cedar-solve")
    assert len({revision_today(name) for name in names}) == len(names)


NOW = Today({"skybench": OLDER}, "celnav-1", {("bortle@1", "dev"): ("t", "s")})


def origin(**changes: str | None) -> Origin:
    stated = {"solver": "skybench", "revision": OLDER, "detector": None, "task": "bortle@1", "split": "dev"}
    return Origin(**(stated | {"task_sha256": "t", "scenario_sha256": "s"} | changes))  # type: ignore[arg-type]


def test_a_result_of_todays_code_and_frames() -> None:
    assert age_of(origin(), NOW) == Age(State.TODAY, OLDER)
    assert age_of(origin(detector="celnav-1"), NOW) == Age(State.TODAY, OLDER)


def test_a_result_is_older_where_solver_detector_or_frames_have_changed() -> None:
    found = age_of(origin(revision="f" * 12), NOW)
    assert found is not None
    assert found.words == f"revision {'f' * 12}; today's is {OLDER}"
    for change in ({"detector": "celnav-2"}, {"task_sha256": "u"}, {"scenario_sha256": "u"}):
        changed = age_of(origin(**change), NOW)
        assert changed is not None
        assert (changed.state, len(changed.reasons)) == (State.OLDER, 1)


def test_an_unrecorded_revision_is_said_to_be_one() -> None:
    found = age_of(origin(revision=None), NOW)
    assert found == Age(State.UNRECORDED, None)
    assert found.words == "revision not recorded"


def test_solvers_and_frames_that_are_not_at_hand_have_no_age() -> None:
    assert age_of(origin(solver="mine"), NOW) is None
    assert age_of(origin(task="my-frames@3"), NOW) is None


def test_today_is_what_is_installed() -> None:
    found = today([origin(), origin(solver="./nowhere", task="nowhere.task.yaml"), origin(solver="", task="out/mine")])
    assert found.revisions == {"skybench": solver_folder("skybench").revision}
    assert set(found.tasks) == {("bortle@1", "dev")}
