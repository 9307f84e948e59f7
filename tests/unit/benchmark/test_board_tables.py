"""The tables of docs/tasks.md and docs/rivals.md are of the committed boards."""

from __future__ import annotations

import importlib.util
import math
import re
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pandas as pd
import pytest

ROOT = Path(__file__).parents[3]


@pytest.fixture(scope="module")
def tables() -> ModuleType:
    spec = importlib.util.spec_from_file_location("board_tables", ROOT / "tools" / "build_board_tables.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    made = module.tables_of(ROOT / "results" / "leaderboard")
    module.__dict__["tables_of"] = lambda boards: made  # read once
    return module


def test_the_pages_have_the_tables_of_the_committed_boards(tables: ModuleType) -> None:
    tables.main(["--check"])


@pytest.mark.parametrize(
    ("name", "cell", "other"),
    [("tasks.md", "| skybench | 40 ", "| skybench | 39 "), ("rivals.md", "| skybench | 33 |", "| skybench | 36 |")],
)
def test_a_changed_cell_is_found_and_mended(
    tables: ModuleType, tmp_path: Path, name: str, cell: str, other: str
) -> None:
    page = tmp_path / name
    kept = (ROOT / "docs" / name).read_text(encoding="utf-8")
    page.write_text(kept.replace(cell, other), encoding="utf-8")
    with pytest.raises(SystemExit, match=r"run python tools/build_board_tables\.py"):
        tables.main(["--check", "--page", str(page)])
    tables.main(["--page", str(page)])
    assert page.read_text(encoding="utf-8") == kept


def test_a_page_without_marks_is_named(tables: ModuleType) -> None:
    with pytest.raises(SystemExit, match="success by solver"):
        tables.with_tables("no table here", {"success by solver": "| a |"})


def test_a_break_has_its_interval_from_the_easier_to_the_harder_end(tables: ModuleType) -> None:
    levels = [0.125, 0.25, 0.5]
    assert [tables._end(end, levels, 1) for end in (-math.inf, 0.33333, math.inf)] == [
        "before 0.125",
        "0.333",
        "beyond",
    ]
    assert tables._end(math.inf, levels[::-1], -1) == "before 0.5"
    text = tables.tables_of(ROOT / "results" / "leaderboard")[tables.BY_CONDITION_TABLE]
    brackets = [line.split(" | ")[-2] for line in text.splitlines()[2:]]
    assert all(re.search(r"\(.+ to .+\)$", one) or one.endswith("already") for one in brackets)


def test_a_median_over_sequences_counts_refusals(tables: ModuleType) -> None:
    """A median of the fixes alone would be that of the easier sequences."""
    frames = pd.DataFrame({
        "frame_id": [str(n) for n in range(8)],
        "site": [f"site {n}" for n in range(8)],
        "status": ["fix", "fix", "fix", "refused", "fix", "fix", "fix", "fix"],
        "error_km": [1.0, 5.0, 9.0, math.nan, 1.0, 1.0, 1.0, 40.0],
        "condition": [8.0] * 4 + [1.0] * 4,
        "n_correct": 0,
        "n_matches": 0,
    })  # fmt: skip
    task = SimpleNamespace(limit_km=30.0, by="condition", harder=-1)
    found = tables.fusion({"skybench": SimpleNamespace(frames=frames, task=task)}).splitlines()
    assert found[0] == "| solver | 8 | 1 | all | wrong | NEES | median after 8, km |"
    assert found[2] == "| skybench | 3 | 3 | 6 of 8 | 1 | - | 7.0 |"
