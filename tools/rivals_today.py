"""Results of each rival on the present boards: python tools/rivals_today.py [--boards results/leaderboard].

Takes the rows of complete systems on tasks of single frames that skybench and all rivals have run, and prints Markdown:
success and wrong fixes as means over the tasks, of which each counts alike, with the intervals of `skybench bench report`;
then success and the median error of the right fixes by task. `skybench bench boards --plan` says which rows are not of
today's code. docs/rivals.md contains a dated table.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmark.report.site.tree import StoredResult, read_tree
from benchmark.stats.clustered import Resamples
from benchmark.stats.frame_metrics import errors_km, sites, succeeded, success, wrong_and_confident
from benchmark.stats.overall import mean_of

SOLVERS = ("skybench", "learned", "tetra3rs", "cedar-solve", "zenith-fixer", "ruststartracker")
SEQUENCES = "uav@1"


def shared_tasks(boards: Path) -> dict[str, dict[str, StoredResult]]:
    """Rows by task and solver, for the tasks that all have run."""
    found = {}
    for group in read_tree(boards):
        rows = {row.solver: row for row in group if row.detections == "own"}
        if set(SOLVERS) <= set(rows) and group[0].task.key != SEQUENCES:
            found[group[0].task.key] = rows
    return found


def cells(results: Sequence[StoredResult]) -> list[str]:
    """Table cells: the mean over the tasks, then each task."""
    shares, wrong, by_task = [], [], []
    for result in results:
        frames, limit_km = result.frames, result.task.limit_km
        resamples = Resamples.of(sites(frames))
        shares.append(success(frames, resamples, limit_km))
        wrong.append(wrong_and_confident(frames, resamples, limit_km))
        right_km = errors_km(frames)[succeeded(frames, limit_km)]
        by_task.append(f"{100 * shares[-1].value:.0f} %, {np.median(right_km):.1f} km")
    share = mean_of(shares)
    head = f"{100 * share.value:.1f} ({100 * share.low:.1f} to {100 * share.high:.1f})"
    return [head, f"{100 * mean_of(wrong).value:.1f}", *by_task]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--boards", type=Path, default=Path("results/leaderboard"))
    tasks = shared_tasks(parser.parse_args().boards)
    heads = ["solver", "success, %", "wrong, %", *tasks]
    print(f"| {' | '.join(heads)} |\n|{'-|' * len(heads)}")
    for solver in SOLVERS:
        print(f"| {solver} | {' | '.join(cells([rows[solver] for rows in tasks.values()]))} |")
    print(f"\n{sum(len(rows[SOLVERS[0]].frames) for rows in tasks.values())} frames")


if __name__ == "__main__":
    main()
