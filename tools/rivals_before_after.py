"""Compare two trees of results condition by condition: python tools/rivals_before_after.py BEFORE AFTER.

Each tree holds results of `skybench bench run TASK --frames N --condition VALUE --solver … --out TREE/NAME`, one folder NAME
to each condition. Prints Markdown: success in each mode of detections with Wilson's 95 % intervals over all frames together,
and frames within 10 km at each condition. docs/rivals.md holds the table of the code of its day.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from pathlib import Path

import numpy as np

from benchmark.run.results import FRAMES_NAME
from benchmark.stats.frame_metrics import errors_km, fixed, read_frames, succeeded
from benchmark.stats.intervals import proportion

Counts = dict[tuple[str, str], dict[str, tuple[list[bool], list[bool], list[float]]]]


def counts_of(tree: Path) -> Counts:
    """By solver and mode, and by condition: which frames succeeded, which fixes were wrong, and the errors, km."""
    found: Counts = defaultdict(dict)
    for path in sorted(tree.glob(f"*/**/{FRAMES_NAME}")):
        frames = read_frames(path)
        name, mode = path.parent.name.rpartition("-")[0], path.parent.parent.name
        right = succeeded(frames)
        condition = path.relative_to(tree).parts[0]
        errors = [float(each) for each in errors_km(frames)[right]]
        found[(name, mode)][condition] = (right.tolist(), (fixed(frames) & ~right).tolist(), errors)
    return found


def words(results: dict[str, tuple[list[bool], list[bool], list[float]]], conditions: list[str]) -> list[str]:
    """Cells of one row: all together, and each condition."""
    known = [results[condition] for condition in conditions if condition in results]
    if len(known) < len(conditions):
        return ["not run"] * (3 + len(conditions))
    right = [one for part in known for one in part[0]]
    wrong = sum(one for part in known for one in part[1])
    share = proportion(right)
    median = float(np.median([error for part in known for error in part[2]])) if any(right) else float("nan")
    head = f"{100 * share.value:.1f} ({100 * share.low:.1f} - {100 * share.high:.1f})"
    return [head, f"{100 * wrong / len(right):.1f}", f"{median:.2f}", *(str(sum(part[0])) for part in known)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("before", type=Path)
    parser.add_argument("after", type=Path)
    asked = parser.parse_args()
    before, after = counts_of(asked.before), counts_of(asked.after)
    shared = [set(results) for results in (*before.values(), *after.values())]
    conditions = sorted(set.intersection(*shared)) if shared else []
    heads = ["solver", "", "success, %", "wrong, %", "median of the right, km", *conditions]
    print(f"| {' | '.join(heads)} |\n|{'-|' * len(heads)}")
    for name in sorted({solver for solver, _ in after}):
        for label, tree, mode in (
            ("before", before, "own"),
            ("whole system", after, "own"),
            ("shared", after, "shared"),
        ):
            if results := tree.get((name, mode)):
                print(f"| {name} | {label} | {' | '.join(words(results, conditions))} |")


if __name__ == "__main__":
    main()
