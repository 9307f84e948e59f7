"""Solving times of the boards and the rounds: python tools/solving_times.py [--boards DIR] [--rounds DIR] [--longer-s 2].

Prints the table of docs/performance.md (times of complete systems on the boards, for solvers with rows on several tasks),
and the counts of docs/rivals.md: frames of the boards and of all rounds, shared detections included, that took tetra3rs
and zenith-fixer longer than a given time for all tries together.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmark.report.site.tree import StoredResult, read_tree
from benchmark.stats.frame_metrics import column

COMPLETE_SEARCHES = ("tetra3rs", "zenith-fixer")
"""Solvers whose searches no clock of their own ends."""


def times_s(result: StoredResult) -> NDArray[np.float64]:
    """Solving time of each frame."""
    return column(result.frames, "time_ms") / 1000.0


def print_boards(rows: Iterable[StoredResult]) -> None:
    """Print a Markdown table of solvers that have rows on several tasks."""
    by_solver: dict[str, list[StoredResult]] = {}
    for row in rows:
        if row.detections == "own":
            by_solver.setdefault(row.solver, []).append(row)
    print("| solver | tasks | frames | sum of solving times | median of a frame |\n|---|---|---|---|---|")
    for solver, results in by_solver.items():
        if len(results) > 1:
            spent_s = np.concatenate([times_s(result) for result in results])
            total, median_ms = np.nansum(spent_s), 1000 * np.nanmedian(spent_s)
            print(f"| {solver} | {len(results)} | {len(spent_s):,} | {total:,.0f} s | {median_ms:.0f} ms |")


def print_long_searches(rows: Iterable[StoredResult], longer_s: float) -> None:
    """Print how many frames took a solver longer, in all and by set of frames."""
    frames: Counter[str] = Counter()
    long: dict[str, Counter[str]] = {solver: Counter() for solver in COMPLETE_SEARCHES}
    longest: dict[str, float] = dict.fromkeys(COMPLETE_SEARCHES, 0.0)
    for row in rows:
        if row.solver in long:
            spent_s = times_s(row)
            frames[row.solver] += len(spent_s)
            long[row.solver][f"{row.task.key} {row.detections}"] += int(np.sum(spent_s > longer_s))
            longest[row.solver] = max(longest[row.solver], float(np.nanmax(spent_s)))
    for solver, counts in long.items():
        total = f"{solver}: {sum(counts.values())} of {frames[solver]:,} frames above {longer_s:g} s"
        print(f"{total}, at most {longest[solver]:.2f} s: {dict(+counts)}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--boards", type=Path, default=Path("results/leaderboard"))
    parser.add_argument("--rounds", type=Path, default=Path("results/rounds"))
    parser.add_argument("--longer-s", type=float, default=2.0)
    options = parser.parse_args()
    boards = [row for group in read_tree(options.boards) for row in group]
    drawn = [
        row for folder in sorted(options.rounds.iterdir()) for group in read_tree(folder / "results") for row in group
    ]
    print_boards(boards)
    print()
    print_long_searches([*boards, *drawn], options.longer_s)


if __name__ == "__main__":
    main()
