"""Write the tables of the latest round into README.md and docs/rounds.md: python tools/build_round_table.py [--check].

Two questions on the same frames: who finds the place with a detector of its own, and who does when all are given the same
detections. `--check` writes nothing and fails where a page has another table.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterable, Mapping
from pathlib import Path

from build_board_tables import with_tables

from benchmark.report.site.boards import Board, Entry, make_board
from benchmark.report.site.columns import BOUND, NEES, SUCCESS, TIME, WRONG, Column
from benchmark.report.site.tree import read_tree

ROOT = Path(__file__).parents[1]
LATEST = "open-sky-2026-11f"
PAGES = (ROOT / "README.md", ROOT / "docs" / "rounds.md")
THIN_SPACE = "\u2009"  # of thousands
TABLE = "the latest round"


def boards_of(results: Path) -> Mapping[str, Board]:
    """The round's boards by their mode of detections."""
    return {group[0].detections: make_board(group) for group in read_tree(results)}


def table(boards: Mapping[str, Board]) -> str:
    """Whole systems in the order of their rank, and beside each what it does with the detections that all share."""
    shared = {entry.label: entry for entry in boards["shared"].entries}
    columns = (
        "solver", "success, %", "median error / bound", "NEES, 2 is honest", "wrong and confident, %", "median time, ms",
        "success with shared detections, %", "wrong and confident there, %",
    )  # fmt: skip
    lines = [f"| {' | '.join(columns)} |", f"|{'---|' * len(columns)}"]
    for entry in boards["own"].entries:
        other = shared.get(entry.label)
        cells = [
            entry.label,
            _with_interval(SUCCESS, entry),
            _value(BOUND, entry),
            _with_interval(NEES, entry),
            _value(WRONG, entry),
            _value(TIME, entry),
            *(("-", "-") if other is None else (_with_interval(SUCCESS, other), _value(WRONG, other))),
        ]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def _value(column: Column, entry: Entry) -> str:
    text = column.value(entry).removesuffix(" %").replace(THIN_SPACE, "")
    return "-" if text == "—" else text


def _with_interval(column: Column, entry: Entry) -> str:
    value, between = _value(column, entry), column.interval(entry).replace(THIN_SPACE, "")
    numbers = re.findall(r"[\d.]+", between)
    return f"{value} ({numbers[0]} to {numbers[1]})" if len(numbers) == 2 and value != "-" else value


def main(arguments: Iterable[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--results", type=Path, default=ROOT / "results" / "rounds" / LATEST / "results")
    parser.add_argument("--pages", type=Path, nargs="+", default=PAGES)
    parser.add_argument("--check", action="store_true")
    asked = parser.parse_args(None if arguments is None else list(arguments))
    made = table(boards_of(asked.results))
    for page in asked.pages:
        before = page.read_text(encoding="utf-8")
        after = with_tables(before, {TABLE: made}, page.name)
        if not asked.check:
            page.write_text(after, encoding="utf-8")
        elif before != after:
            raise SystemExit(f"{page}: its table is not of {asked.results}; run python tools/build_round_table.py")


if __name__ == "__main__":
    main()
