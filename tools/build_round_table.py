"""Write the tables of the rounds into README.md and docs/rounds.md: python tools/build_round_table.py [--check].

For the latest round there are two questions on the same frames: which solver finds the position with its own detector, and
which does when all receive the same detections. For earlier rounds only the first is shown, without times, because the
machines were busy. `--check` writes nothing and fails where a page has another table.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from build_board_tables import with_tables

from benchmark.report.site.boards import Board, Entry, make_board
from benchmark.report.site.columns import BOUND, NEES, SUCCESS, TIME, WRONG, Column
from benchmark.report.site.tree import read_tree

ROOT = Path(__file__).parents[1]
LATEST = "open-sky-2026-11f"
EARLIER = ("open-sky-2026-11e", "open-sky-2026-11c", "open-sky-2026-11b", "open-sky-2026-11")
PAGES = (ROOT / "README.md", ROOT / "docs" / "rounds.md")
THIN_SPACE = "\u2009"  # between groups of thousands
TABLE = "the latest round"


def boards_of(results: Path) -> Mapping[str, Board]:
    """The round's boards by their mode of detection."""
    return {group[0].detections: make_board(group) for group in read_tree(results)}


def table(boards: Mapping[str, Board]) -> str:
    """Complete systems in the order of their rank, each next to its result with the shared detections."""
    shared = {entry.label: entry for entry in boards["shared"].entries}
    columns = (
        "solver", "success, %", "median error / bound", "NEES, 2 is honest", "wrong and confident, %", "median time, ms",
        "success with shared detections, %", "wrong and confident there, %",
    )  # fmt: skip
    rows = []
    for entry in boards["own"].entries:
        other = shared.get(entry.label)
        there = ("-", "-") if other is None else (_with_interval(SUCCESS, other), _value(WRONG, other))
        rows.append([*_cells(entry), _value(TIME, entry), *there])
    return _markdown(columns, rows)


def table_of_earlier(boards: Mapping[str, Board]) -> str:
    """Complete systems in the order of their rank."""
    columns = ("solver", "success, %", "median error / bound", "NEES, 2 is honest", "wrong and confident, %")
    return _markdown(columns, [_cells(entry) for entry in boards["own"].entries])


def _markdown(columns: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [f"| {' | '.join(columns)} |", f"|{'---|' * len(columns)}"]
    return "\n".join([*lines, *(f"| {' | '.join(cells)} |" for cells in rows)])


def _cells(entry: Entry) -> list[str]:
    """Cells about a solver that all tables of rounds contain."""
    return [
        entry.label,
        _with_interval(SUCCESS, entry),
        _value(BOUND, entry),
        _with_interval(NEES, entry),
        _value(WRONG, entry),
    ]


def _value(column: Column, entry: Entry) -> str:
    text = column.value(entry).removesuffix(" %").replace(THIN_SPACE, "")
    return "-" if text == "—" else text


def _with_interval(column: Column, entry: Entry) -> str:
    value, between = _value(column, entry), column.interval(entry).replace(THIN_SPACE, "")
    numbers = re.findall(r"[\d.]+", between)
    return f"{value} ({numbers[0]} to {numbers[1]})" if len(numbers) == 2 and value != "-" else value


def tables(rounds: Path) -> dict[str, str]:
    """All tables by their names, from the folder that contains the rounds."""
    earlier = {name: table_of_earlier(boards_of(rounds / name / "results")) for name in EARLIER}
    return {TABLE: table(boards_of(rounds / LATEST / "results")), **earlier}


def main(arguments: Iterable[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=Path, default=ROOT / "results" / "rounds")
    parser.add_argument("--pages", type=Path, nargs="+", default=PAGES)
    parser.add_argument("--check", action="store_true")
    asked = parser.parse_args(None if arguments is None else list(arguments))
    made = tables(asked.rounds)
    for page in asked.pages:
        before = page.read_text(encoding="utf-8")
        # A page has the latest round, and the earlier ones for which it has marks.
        marked = {name: each for name, each in made.items() if name == TABLE or f"<!-- table: {name} -->" in before}
        after = with_tables(before, marked, page.name)
        if not asked.check:
            page.write_text(after, encoding="utf-8")
        elif before != after:
            raise SystemExit(f"{page}: its tables are not of {asked.rounds}; run python tools/build_round_table.py")


if __name__ == "__main__":
    main()
