"""Results of each rival on the present boards: python tools/rivals_today.py [--boards results/leaderboard].

Takes the rows of complete systems on tasks of single frames that skybench and all rivals have run, and prints Markdown:
success with Wilson's 95 % intervals, wrong fixes and the median error of the right ones over all frames together; then
success and that median by task. `skybench bench boards --plan` says which rows are not of today's code. docs/rivals.md
contains a dated table.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmark.report.site.tree import StoredResult, read_tree
from benchmark.stats.frame_metrics import errors_km, fixed, succeeded
from benchmark.stats.intervals import proportion

SOLVERS = ("skybench", "learned", "tetra3rs", "cedar-solve", "zenith-fixer", "ruststartracker")
SEQUENCES = "uav@1"


def counted(result: StoredResult) -> tuple[list[bool], int, list[float]]:
    """Which frames succeeded by the task's own limit, how many fixes did not, and the errors of those that did, km."""
    right = succeeded(result.frames, result.task.limit_km)
    errors = [float(each) for each in errors_km(result.frames)[right]]
    return right.tolist(), int((fixed(result.frames) & ~right).sum()), errors


def shared_tasks(boards: Path) -> dict[str, dict[str, StoredResult]]:
    """Rows by task and solver, for the tasks that all have run."""
    found = {}
    for group in read_tree(boards):
        rows = {row.solver: row for row in group if row.detections == "own"}
        if set(SOLVERS) <= set(rows) and group[0].task.key != SEQUENCES:
            found[group[0].task.key] = rows
    return found


def cells(results: Sequence[StoredResult]) -> list[str]:
    """Table cells: all tasks together, then each task."""
    parts = [counted(result) for result in results]
    right = [one for part in parts for one in part[0]]
    errors = [error for part in parts for error in part[2]]
    share = proportion(right)
    head = f"{100 * share.value:.1f} ({100 * share.low:.1f} - {100 * share.high:.1f})"
    wrong = f"{100 * sum(part[1] for part in parts) / len(right):.1f}"
    by_task = [f"{100 * np.mean(part[0]):.0f} %, {np.median(part[2]):.1f} km" for part in parts]
    return [head, wrong, f"{np.median(errors):.1f}", *by_task]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--boards", type=Path, default=Path("results/leaderboard"))
    tasks = shared_tasks(parser.parse_args().boards)
    heads = ["solver", "success, %", "wrong, %", "median of the right, km", *tasks]
    print(f"| {' | '.join(heads)} |\n|{'-|' * len(heads)}")
    for solver in SOLVERS:
        print(f"| {solver} | {' | '.join(cells([rows[solver] for rows in tasks.values()]))} |")
    print(f"\n{sum(len(rows[SOLVERS[0]].frames) for rows in tasks.values())} frames")


if __name__ == "__main__":
    main()
