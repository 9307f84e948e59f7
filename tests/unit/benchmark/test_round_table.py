"""The tables of README.md and docs/rounds.md are of the committed rounds."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parents[3]


@pytest.fixture(scope="module")
def tool() -> ModuleType:
    spec = importlib.util.spec_from_file_location("round_table", ROOT / "tools" / "build_round_table.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(ROOT / "tools")
        spec.loader.exec_module(module)
    made = module.tables(ROOT / "results" / "rounds")
    module.__dict__["tables"] = lambda rounds: made  # read once
    return module


def test_both_pages_have_the_tables_of_the_committed_rounds(tool: ModuleType) -> None:
    tool.main(["--check"])


def test_no_round_on_the_page_has_a_table_of_other_origin(tool: ModuleType) -> None:
    text = (ROOT / "docs" / "rounds.md").read_text(encoding="utf-8").split("## Rounds so far")[1]
    marked = re.findall(r"<!-- table: (.*?) -->", text)
    assert marked == [tool.ALL_ROUNDS, tool.TABLE, *tool.EARLIER]
    assert len(re.findall(r"^\| (?:solver|round) \|", text, re.MULTILINE)) == len(marked)


def test_numbers_of_solvers_that_name_no_star_are_told_apart(tool: ModuleType) -> None:
    rows = [line.split(" | ") for line in tool.tables(ROOT / "results" / "rounds")[tool.TABLE].splitlines()[2:]]
    assert {row[0].strip("| ") for row in rows if "within 10 km" in row[3]} == {"seiza", "zenith-fixer"}
    assert not any("within 10 km" in cell for row in rows if row[2] != "-" for cell in row)


def test_a_changed_cell_is_found_and_mended(tool: ModuleType, tmp_path: Path) -> None:
    page = tmp_path / "README.md"
    kept = (ROOT / "README.md").read_text(encoding="utf-8")
    page.write_text(kept.replace("| skybench | 9", "| skybench | 8"), encoding="utf-8")
    assert page.read_text(encoding="utf-8") != kept
    with pytest.raises(SystemExit, match=r"run python tools/build_round_table\.py"):
        tool.main(["--check", "--pages", str(page)])
    tool.main(["--pages", str(page)])
    assert page.read_text(encoding="utf-8") == kept


def test_a_page_without_marks_is_named(tool: ModuleType, tmp_path: Path) -> None:
    page = tmp_path / "other.md"
    page.write_text("no table here", encoding="utf-8")
    with pytest.raises(SystemExit, match=r"other\.md: there must be one"):
        tool.main(["--pages", str(page)])
