"""Write the tables of the rounds into README.md and docs/rounds.md: python tools/build_round_table.py [--check].

The table of the latest round answers two questions on the same frames: how many places each solver finds with its own
detector, and how many it finds with the detections that all solvers share. Beside each is the share of frames with a fix
of whose named stars most are right; a dash means that the solver names none, and its error over bound and NEES are of its
fixes within 10 km. Solvers scored with `--later`, whose revision is not the committed one, have "(later)" behind their
name. Tables of earlier rounds answer the first question only and omit times, which were measured on busy machines; one
table has the success of some solvers in all rounds. `--check` writes nothing and fails if a page has another table.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path

from build_board_tables import with_tables

from benchmark.frames.frame_set import ALL
from benchmark.report.site.boards import Board, Entry, make_board
from benchmark.report.site.columns import BOUND, NAMED, NEES, SUCCESS, TIME, WRONG, Column
from benchmark.report.site.tree import read_tree
from benchmark.rounds.private_frames import LATER

ROOT = Path(__file__).parents[1]
LATEST = "open-sky-2026-12"
EARLIER = (
    "open-sky-2026-11p",
    "open-sky-2026-11o",
    "open-sky-2026-11m",
    "open-sky-2026-11l",
    "open-sky-2026-11i",
    "open-sky-2026-11h",
    "open-sky-2026-11g",
    "open-sky-2026-11f",
    "open-sky-2026-11e",
    "open-sky-2026-11c",
    "open-sky-2026-11b",
    "open-sky-2026-11",
)
PAGES = (ROOT / "README.md", ROOT / "docs" / "rounds.md")
THIN_SPACE = "\u2009"  # between groups of thousands
WITHIN = "within 10 km"
COMPARED = ("skybench", "learned", "cedar-solve", "tetra3rs", "zenith-fixer", "ruststartracker")
ALL_ROUNDS = "all rounds"
TABLE = "the latest round"
COLUMNS = (
    "solver", "success, %", "stars named right, %", "median error / bound", "NEES, 2 is honest", "wrong and confident, %",
)  # fmt: skip
"""Headings of the cells that all tables of rounds contain."""


def boards_of(results: Path, split: str = ALL, modes: Collection[str] = ("own", "shared")) -> Mapping[str, Board]:
    """Boards of a round's part by their mode of detections."""
    first = {group[0].detections: group for group in read_tree(results) if group[0].split == split}
    return {mode: make_board(group) for mode, group in first.items() if mode in modes}


def table(boards: Mapping[str, Board], later: Mapping[str, Board]) -> str:
    """Whole systems by their success, each with what it does with the shared detections; those scored later are marked."""
    columns = (
        *COLUMNS, "median time, ms", "success with shared detections, %", "stars named right there, %",
        "wrong and confident there, %",
    )  # fmt: skip
    rows = [*_rows_of_both_modes(boards), *_rows_of_both_modes(later, " (later)")]
    return _markdown(columns, sorted(rows, key=lambda cells: -float(cells[1].split()[0])))


def _rows_of_both_modes(boards: Mapping[str, Board], mark: str = "") -> list[list[str]]:
    if "own" not in boards:
        return []
    shared = {entry.label: entry for entry in boards["shared"].entries} if "shared" in boards else {}
    rows = []
    for entry in boards["own"].entries:
        other = shared.get(entry.label)
        there = ("-",) * 3 if other is None else tuple(_with_interval(one, other) for one in (SUCCESS, NAMED, WRONG))
        rows.append([entry.label + mark, *_cells(entry)[1:], _value(TIME, entry), *there])
    return rows


def table_of_earlier(boards: Mapping[str, Board]) -> str:
    """Complete systems in the order of their rank."""
    return _markdown(COLUMNS, [_cells(entry) for entry in boards["own"].entries])


def _markdown(columns: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [f"| {' | '.join(columns)} |", f"|{'---|' * len(columns)}"]
    return "\n".join([*lines, *(f"| {' | '.join(cells)} |" for cells in rows)])


def _cells(entry: Entry) -> list[str]:
    """Cells about a solver that all tables of rounds contain."""
    named, bound, nees = _with_interval(NAMED, entry), _value(BOUND, entry), _with_interval(NEES, entry)
    if named == "-":  # without names, only a place within the limit tells that the stars were identified
        bound, nees = (value if value == "-" else f"{value}, {WITHIN}" for value in (bound, nees))
    return [entry.label, _with_interval(SUCCESS, entry), named, bound, nees, _with_interval(WRONG, entry)]


def table_of_all(rounds: Mapping[str, Mapping[str, Board]]) -> str:
    """Success of some solvers in every round, the latest first."""
    rows = []
    for name, boards in rounds.items():
        own = {entry.label: entry for entry in boards["own"].entries}
        cells = (_with_interval(SUCCESS, own[solver]) if solver in own else "-" for solver in COMPARED)
        rows.append([name, str(boards["own"].n_frames), *cells])
    return _markdown(("round", "frames", *(f"{solver}, %" for solver in COMPARED)), rows)


def _value(column: Column, entry: Entry) -> str:
    text = column.value(entry).removesuffix(" %").replace(THIN_SPACE, "")
    return "-" if text == "—" else text


def _with_interval(column: Column, entry: Entry) -> str:
    value, between = _value(column, entry), column.interval(entry).replace(THIN_SPACE, "")
    numbers = re.findall(r"[\d.]+", between)
    return f"{value} ({numbers[0]} to {numbers[1]})" if len(numbers) == 2 and value != "-" else value


def tables(rounds: Path) -> dict[str, str]:
    """All tables by their names, from the folder that contains the rounds."""
    latest = rounds / LATEST
    boards = {LATEST: boards_of(latest / "results")}
    boards |= {name: boards_of(rounds / name / "results", modes=("own",)) for name in EARLIER}
    earlier = {name: table_of_earlier(boards[name]) for name in EARLIER}
    later = boards_of(latest / "later", LATER) if (latest / "later").is_dir() else {}
    return {TABLE: table(boards[LATEST], later), ALL_ROUNDS: table_of_all(boards), **earlier}


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
