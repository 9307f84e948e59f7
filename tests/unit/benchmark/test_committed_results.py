"""The results of this repository: small, whole, and of the revisions that they state."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest
from typer.testing import CliRunner

from benchmark.cli.bench import app
from benchmark.report import stale
from benchmark.report.marks import Mark
from benchmark.report.site.tree import StoredResult, read_tree
from benchmark.run.freshness import State

ROOT = Path(__file__).parents[3]
RESULTS = ROOT / "results"
LARGEST_BYTES = 10_000_000
IGNORED = {"demo", "demo-small"}


def committed() -> list[Path]:
    return [path for path in RESULTS.rglob("*") if path.is_file() and path.relative_to(RESULTS).parts[0] not in IGNORED]


def test_results_stay_below_ten_megabytes() -> None:
    sizes = {path.relative_to(RESULTS): path.stat().st_size for path in committed()}
    largest = sorted(sizes.items(), key=lambda item: -item[1])[:5]
    assert sum(sizes.values()) < LARGEST_BYTES, f"largest: {largest}; pack raw results with skybench bench pack-results"


@pytest.fixture(scope="module")
def board() -> list[StoredResult]:
    """All rows of the leaderboard."""
    return [stored for group in read_tree(RESULTS / "leaderboard") for stored in group]


def test_every_row_of_the_leaderboard_states_its_revision_or_that_it_has_none(board: list[StoredResult]) -> None:
    assert {stored.task.key for stored in board} >= {"bortle@2", "clutter@2", "drift@1", "uav@1"}
    assert not list(RESULTS.glob("leaderboard/*@*/*/*/*/summary.json"))
    for stored in board:
        revision, age = stored.provenance.solver.revision, stored.age
        assert age is not None, stored.folder
        assert (revision is None) == (age.state is State.UNRECORDED)
        assert revision is None or len(revision) == 12
        frames = stored.provenance.frames
        assert len(stored.frames) == frames.per_condition * len(frames.grading.values)


def test_code_of_the_results_page_reads_a_table(
    board: list[StoredResult], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (code,) = re.findall(r"```python\n(.*?)```", (RESULTS / "README.md").read_text(), re.DOTALL)
    monkeypatch.chdir(ROOT)
    exec(compile(code, "results/README.md", "exec"), {})
    (row,) = (row for row in board if (row.task.key, row.solver, row.detections) == ("bortle@2", "skybench", "own"))
    within = (row.frames["error_km"] < 10).mean()
    assert capsys.readouterr().out == f"{within:.3f}\n"
    assert within > 0.5


@pytest.fixture
def repository(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """One document and one result of this repository."""
    monkeypatch.setattr(stale, "_MEASURED", ("docs/calibration.md",))
    for name in ("docs/calibration.md", "results/studies/calibration/study.json"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, tmp_path / name)
    return tmp_path


def check(root: Path, *arguments: str) -> tuple[int, str]:
    outcome = CliRunner().invoke(app, ["stale", "--root", str(root), *arguments], catch_exceptions=False)
    return outcome.exit_code, outcome.output


def test_the_check_passes_on_what_is_true(repository: Path) -> None:
    assert check(repository) == (0, "all measured numbers are of the revision that is printed beside them\n")


def test_the_check_fails_on_a_changed_result_and_names_file_and_remedy(repository: Path) -> None:
    path = repository / "results" / "studies" / "calibration" / "study.json"
    path.write_text(path.read_text() + "\n")
    code, said = check(repository)
    assert code == 1
    assert "skybench: docs/calibration.md: line " in said
    assert "was not made from results/studies/calibration/study.json as it is" in said
    assert "make it again: `skybench study calibration`" in said


def test_the_check_fails_on_a_changed_mark_until_the_file_says_so(repository: Path) -> None:
    path = repository / "docs" / "calibration.md"
    mark = Mark("skybench speed --solver", {"skybench": "0" * 12})
    path.write_text(f"{mark.line()}\n*Measured with revision {'0' * 12} of skybench.*\n")
    code, said = check(repository)
    assert code == 1
    assert "which is not today's" in said
    code, said = check(repository, "--stamp", str(path))
    assert code == 0, said
    assert f"*Measured with revision {'0' * 12} of skybench, which is not today's.*" in path.read_text()


def test_a_tree_without_the_packages_is_refused_by_name(tmp_path: Path) -> None:
    (tmp_path / "generator").mkdir()
    (tmp_path / "generator" / "__init__.py").touch()
    for tree, what in ((tmp_path, "has no package benchmark, celnav;"), (tmp_path / "none", "no such folder;")):
        outcome = CliRunner().invoke(app, ["revisions", "--tree", str(tree)])
        assert outcome.exit_code == 2
        assert f"skybench: --tree {tree}: {what} give the folder that holds benchmark, celnav, " in outcome.output


def test_the_revisions_of_a_tree_are_printed(tmp_path: Path) -> None:
    for package in ("benchmark", "celnav", "generator"):
        ignored = shutil.ignore_patterns("__pycache__", "*.exr", "*.npy")
        shutil.copytree(ROOT / package, tmp_path / package, ignore=ignored)
    runner = CliRunner()
    before = runner.invoke(app, ["revisions"], catch_exceptions=False).output
    assert runner.invoke(app, ["revisions", "--tree", str(tmp_path)], catch_exceptions=False).output == before
    module = tmp_path / "celnav" / "matching" / "votes.py"
    module.write_text(module.read_text() + "\nANOTHER = 1\n")
    after = runner.invoke(app, ["revisions", "--tree", str(tmp_path)], catch_exceptions=False).output
    changed = {line.split("  ")[1] for line in set(after.splitlines()) - set(before.splitlines())}
    assert changed == {
        "brightest-n",
        "thesis-adaptive",
        "thesis-baseline",
        "thesis-baseline+si",
        "thesis-baseline+si+pr",
        "thesis-catalogue-only",
    }
