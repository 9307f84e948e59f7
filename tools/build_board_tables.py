"""Write the tables of docs/tasks.md and docs/rivals.md from the boards: tools/build_board_tables.py [--boards DIR] [--check].

The tables only show complete systems, each with its own detector. The first table has success and wrong fixes of the solvers
on each task that most of them have run (a dash: not run). The second has successes at each condition, the bracket of the
break and its interval, the third errors over the bound where the supplied vertical limits every solver. The table of
docs/rivals.md shows what each solver makes of a sequence. `--check` writes nothing and fails where a page has other tables.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np

from benchmark.report.site.tree import StoredResult, read_tree
from benchmark.stats.break_point import break_point, tested_around
from benchmark.stats.covariance import nees_of_identified
from benchmark.stats.frame_metrics import column, errors_km, fixed, resamples_of, succeeded

DOCS = Path(__file__).parents[1] / "docs"
SOLVERS = ("skybench", "learned", "tetra3rs", "cedar-solve", "zenith-fixer", "ruststartracker")
LEAST = 4
"""Number of these solvers that must have run a task for it to get a line."""
BY_CONDITION = ("skybench", "tetra3rs", "tetra3rs-fused")
BY_SOLVER_TABLE, BY_CONDITION_TABLE, BOUND_TABLE = "success by solver", "success by condition", "error over bound"
FUSION_TABLE = "fusion over frames"
TABLES_OF_PAGE = {
    "tasks.md": (BY_SOLVER_TABLE, BY_CONDITION_TABLE, BOUND_TABLE),
    "rivals.md": (FUSION_TABLE,),
}
LIMITED_BY_ATTITUDE, SEQUENCES = "attitude@2", "uav@1"
FUSED = (
    "skybench",
    *(f"{name}-fused" for name in ("tetra3rs", "cedar-solve", "learned", "ruststartracker", "zenith-fixer")),
)
"""Solvers that answer whole sequences."""
Boards = Mapping[str, Mapping[str, StoredResult]]


def whole_systems(boards: Path) -> Boards:
    """Rows by task and solver."""
    groups = read_tree(boards)
    return {
        group[0].task.key: {row.solver: row for row in group if row.detections == "own"}
        for group in sorted(groups, key=lambda group: group[0].task.key)
        if any(row.detections == "own" for row in group)
    }


def by_solver(boards: Boards) -> str:
    """Success in per cent, with wrong fixes in brackets."""
    lines = [f"| task | {' | '.join(SOLVERS)} |", f"|{'---|' * (1 + len(SOLVERS))}"]
    for task, rows in boards.items():
        if len(set(SOLVERS) & set(rows)) >= LEAST:
            lines.append(f"| `{task}` | {' | '.join(_cell(rows.get(solver)) for solver in SOLVERS)} |")
    return "\n".join(lines)


def by_condition(boards: Boards) -> str:
    """Successes at each condition from easy to hard, and where success falls below one half, with its interval."""
    lines = [
        "| task | frames a condition | solver | successes, from easy to hard "
        "| falls below one half between (95 % interval) | wrong |",
        "|---|---|---|---|---|---|",
    ]
    for task, rows in boards.items():
        shown = [solver for solver in BY_CONDITION if solver in rows]
        for solver in shown:
            row = rows[solver]
            levels, hits, size = _levels(row)
            head = f"`{task}` | {size}" if solver == shown[0] else " | "
            _, wrong = _outcome(row)
            lines.append(f"| {head} | {solver} | {' '.join(map(str, hits))} | {_bracket(row, levels)} | {wrong} |")
    return "\n".join(lines)


def over_bound(rows: Mapping[str, StoredResult]) -> str:
    """Median error of all fixes over the frames' bounds, at each condition."""
    shown = {solver: rows[solver] for solver in SOLVERS if solver in rows}
    levels = _levels(next(iter(shown.values())))[0]
    lines = [f"| solver | {' | '.join(map(_number, levels))} |", f"|{'---|' * (1 + len(levels))}"]
    for solver, row in shown.items():
        values, ratios = column(row.frames, row.task.by), column(row.frames, "error_km") / column(row.frames, "crlb_km")
        medians = [np.median(ratios[(values == level) & fixed(row.frames)]) for level in levels]
        lines.append(f"| {solver} | {' | '.join(f'{median:.3g}' for median in medians)} |")
    return "\n".join(lines)


def fusion(rows: Mapping[str, StoredResult]) -> str:
    """Right answers after each number of frames, wrong ones, NEES, and the median error of the longest sequences.

    The median is over all sequences, a refusal infinitely far off.
    """
    shown = {solver: rows[solver] for solver in FUSED if solver in rows}
    levels = _levels(next(iter(shown.values())))[0]
    heads = ["solver", *map(_number, levels), "all", "wrong", "NEES", f"median after {_number(levels[0])}, km"]
    lines = [f"| {' | '.join(heads)} |", f"|{'-|' * len(heads)}"]
    for solver, row in shown.items():
        right, wrong = _outcome(row)
        longest = column(row.frames, row.task.by) == levels[0]
        median = np.median(errors_km(row.frames)[longest])
        nees = nees_of_identified(row.frames, resamples_of(row.frames), row.task.limit_km).value
        total = f"{right.sum()} of {len(right)}" if len(lines) == 2 else str(right.sum())
        cells = [
            solver,
            *map(str, _levels(row)[1]),
            total,
            str(wrong),
            "-" if np.isnan(nees) else f"{nees:.2f}",
            f"{median:.1f}",
        ]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def _cell(row: StoredResult | None) -> str:
    if row is None:
        return "-"
    right, wrong = _outcome(row)
    return f"{100 * right.mean():.0f} ({wrong})"


def _outcome(row: StoredResult) -> tuple[np.ndarray, int]:
    """Which frames succeeded by the task's own limit, and the number of fixes that did not."""
    right = succeeded(row.frames, row.task.limit_km)
    return right, int((fixed(row.frames) & ~right).sum())


def _levels(row: StoredResult) -> tuple[list[float], list[int], str]:
    """Conditions from easy to hard, successes at each, and frames at each."""
    values = column(row.frames, row.task.by)
    right = succeeded(row.frames, row.task.limit_km)
    levels = sorted({float(value) for value in values}, reverse=row.task.harder < 0)
    counts = {int((values == level).sum()) for level in levels}
    size = str(min(counts)) if len(counts) == 1 else f"{min(counts)} to {max(counts)}"
    return levels, [int(right[values == level].sum()) for level in levels], size


def _bracket(row: StoredResult, levels: list[float]) -> str:
    """Describe the tested values around the break point, and its interval, from the easier to the harder end."""
    point = break_point(row.frames, row.task.harder, limit_km=row.task.limit_km)
    found, unit = point.value, f" {row.task.unit}" if row.task.unit else ""
    ends = (point.low, point.high)[:: 1 if row.task.harder > 0 else -1]
    interval = f" ({' to '.join(_end(end, levels, row.task.harder) for end in ends)})"
    if np.isfinite(found):
        around = tested_around(found, levels)
        if around is None:
            return f"at {_number(found)}{unit}{interval}"
        easier, harder = around if row.task.harder > 0 else around[::-1]
        return f"{_number(easier)} and {_number(harder)}{unit}{interval}"
    hardest = np.inf if row.task.harder > 0 else -np.inf
    return f"not within{interval}" if found == hardest else f"at {_number(levels[0])}{unit} already"


def _end(end: float, levels: list[float], harder: int) -> str:
    """One end of the interval of a break point; an infinite one is beyond the easiest or the hardest of the tested values."""
    if np.isfinite(end):
        return _number(float(f"{end:.3g}"))
    return "beyond" if end * harder > 0 else f"before {_number(levels[0])}"


def _number(value: float) -> str:
    """Format a condition, with thin spaces between groups of thousands."""
    return f"{value:,.0f}".replace(",", " ") if abs(value) >= 1e4 else f"{value:g}"


def with_tables(page: str, tables: Mapping[str, str], page_name: str = "tasks.md") -> str:
    """Replace each table of a page between its marks."""
    for name, table in tables.items():
        begin, end = f"<!-- table: {name} -->", "<!-- end of table -->"
        pattern = re.compile(f"{re.escape(begin)}\n.*?\n{re.escape(end)}", re.DOTALL)
        found = pattern.findall(page)
        if len(found) != 1:
            raise SystemExit(f"{page_name}: there must be one {begin}, and {end} after it")
        page = page.replace(found[0], f"{begin}\n\n{table}\n\n{end}")
    return page


def tables_of(boards: Path) -> dict[str, str]:
    """All tables by their names."""
    rows = whole_systems(boards)
    tables = {BY_SOLVER_TABLE: by_solver(rows), BY_CONDITION_TABLE: by_condition(rows)}
    if limited := rows.get(LIMITED_BY_ATTITUDE):
        tables[BOUND_TABLE] = over_bound(limited)
    if sequences := rows.get(SEQUENCES):
        tables[FUSION_TABLE] = fusion(sequences)
    return tables


def main(arguments: Iterable[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--boards", type=Path, default=DOCS.parent / "results" / "leaderboard")
    parser.add_argument("--page", type=Path, nargs="+", default=[DOCS / name for name in TABLES_OF_PAGE])
    parser.add_argument("--check", action="store_true")
    asked = parser.parse_args(None if arguments is None else list(arguments))
    made = tables_of(asked.boards)
    for page in asked.page:
        before = page.read_text(encoding="utf-8")
        names = TABLES_OF_PAGE[page.name]
        after = with_tables(before, {name: table for name, table in made.items() if name in names}, page.name)
        if not asked.check:
            page.write_text(after, encoding="utf-8")
        elif before != after:
            raise SystemExit(f"{page}: its tables are not of {asked.boards}; run python tools/build_board_tables.py")


if __name__ == "__main__":
    main()
