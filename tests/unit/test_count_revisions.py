"""tools/count_revisions.py on small histories of its own: clones of this repository may be shallow."""

from __future__ import annotations

import importlib.util
import json
import shutil
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
WHO = ("-c", "user.name=A", "-c", "user.email=a@example.org", "-c", "commit.gpgsign=false")

pytestmark = pytest.mark.skipif(shutil.which("git") is None, reason="git is not installed")


@pytest.fixture(scope="module")
def tool() -> ModuleType:
    spec = importlib.util.spec_from_file_location("count_revisions", ROOT / "tools" / "count_revisions.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # data classes look their module up by its name
    spec.loader.exec_module(module)
    return module


def commit(folder: Path, files: dict[str, str], date: str = "2026-11-21") -> str:
    """Write files, commit them, and return the commit's name."""
    for name, text in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    for command in (["init", "--quiet"], ["add", "."], [*WHO, "commit", "--quiet", "-m", "a change"]):
        dates = {"GIT_AUTHOR_DATE": f"{date}T00:00:00Z", "GIT_COMMITTER_DATE": f"{date}T00:00:00Z"}
        subprocess.run(["git", *command], cwd=folder, check=True, env={"PATH": "/usr/bin:/bin"} | dates)
    return subprocess.run(
        ["git", "rev-parse", "HEAD"], cwd=folder, check=True, capture_output=True, text=True
    ).stdout.strip()


def result(solver: str, revision: str) -> dict[str, Any]:
    return {"provenance": {"solver": {"target": solver, "revision": revision}}}


def table(*results: tuple[str, str]) -> str:
    return json.dumps({"format": "skybench-packed/1", "rows": [result(*each) for each in results]})


DEV = "results/leaderboard/bortle@1/dev.json"


def test_each_revision_with_results_on_dev_counts_once(tool, tmp_path) -> None:
    single = "results/leaderboard/bortle@1/dev/own/skybench-1/summary.json"
    first = commit(tmp_path, {single: json.dumps(result("skybench", "one"))})
    second = commit(tmp_path, {DEV: table(("skybench", "two"), ("tetra3rs", "a"))}, "2026-11-22")
    (tmp_path / single).unlink()  # what is removed later was tried all the same
    other = "results/leaderboard/city@1/dev-8.json"
    third = commit(tmp_path, {other: table(("skybench", "three"), ("skybench", "two"))}, "2026-11-23")
    not_on_dev = {
        "results/leaderboard/bortle@1/test.json": table(("skybench", "four")),
        "results/rounds/open/results/all.json": table(("skybench", "five")),
        "results/leaderboard/bortle@1/development.json": table(("skybench", "six")),
    }
    commit(tmp_path, not_on_dev, "2026-11-24")
    commit(tmp_path, {DEV: table(("tetra3rs", ""))}, "2026-11-25")  # a result that does not state it
    assert tool.tries(tmp_path) == {
        "skybench": {"one": first, "two": second, "three": third},
        "tetra3rs": {"a": second},
    }


def test_commits_count_that_change_code(tool, tmp_path) -> None:
    start = commit(tmp_path, {"celnav/solver.py": "LIMIT = 1\n"})
    changed = commit(tmp_path, {"celnav/deep/limits.py": "LIMIT = 2\n", "celnav/solver.py": "LIMIT = 2\n"})
    commit(tmp_path, {"celnav/solver.py": "LIMIT  =  2  # twice as many\n"})
    commit(tmp_path, {"celnav/data/notes.txt": "1\n", "benchmark/cli.py": "LIMIT = 1\n"})
    adapter = commit(tmp_path, {"benchmark/solvers/celnav_solver.py": "LIMIT = 1\n"})
    (tmp_path / "celnav" / "deep" / "limits.py").unlink()
    removed = commit(tmp_path, {})
    assert tool.changing_commits(tmp_path, f"{start}..HEAD", tool.CELNAV) == [changed, adapter, removed]


def test_it_prints_what_it_has_counted(tool, tmp_path, monkeypatch, capsys) -> None:
    commit(tmp_path, {DEV: table(("skybench", "one"), ("tetra3rs", "a"))})
    commit(tmp_path, {"celnav/solver.py": "LIMIT = 1\n", DEV: table(("skybench", "two"))}, "2026-11-22")
    monkeypatch.setattr(sys, "argv", ["count_revisions.py", "--repository", str(tmp_path)])
    tool.main()
    said = capsys.readouterr().out
    assert "| skybench | 2 | 2026-11-21 | 2026-11-22 |\n| tetra3rs | 1 | 2026-11-21 | 2026-11-21 |\n" in said
    assert said.endswith("that change celnav's code: 1\n")


def test_a_part_of_the_history_is_refused(tool, tmp_path, monkeypatch) -> None:
    whole = tmp_path / "whole"
    whole.mkdir()
    commit(whole, {DEV: table(("skybench", "one"))})
    commit(whole, {DEV: table(("skybench", "two"))})
    shallow = tmp_path / "shallow"
    subprocess.run(["git", "clone", "--quiet", "--depth", "1", whole.as_uri(), shallow], check=True)
    monkeypatch.setattr(sys, "argv", ["count_revisions.py", "--repository", str(shallow)])
    with pytest.raises(SystemExit, match="git fetch --unshallow"):
        tool.main()
