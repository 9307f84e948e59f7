"""Shell commands that produce a page again, ready to be pasted."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmark.frames.task_frames import DEFAULT_DATA
from benchmark.report.marks import stated_path
from benchmark.report.site.boards import Board, Entry


@dataclass(frozen=True)
class Places:
    """Folders from which the report reads, as the user named them.

    Attributes
    ----------
    out : Path
        Root of the results.
    data : Path
        Folder of the frames of tasks and of sharded datasets.
    """

    out: Path
    data: Path = DEFAULT_DATA

    @property
    def options(self) -> list[str]:
        """Options for the command line."""
        chosen = ["--out", str(self.out)]
        return chosen if self.data == DEFAULT_DATA else [*chosen, "--data", str(self.data)]


def report_command(places: Places, figure: Path | None = None) -> str:
    """Command that writes the report, and the leaderboard as a picture."""
    more = [] if figure is None else ["--figure", stated_path(figure)]
    return shlex.join(["skybench", "bench", "report", "--out", stated_path(places.out), *more])


def commands_of(runs: Sequence[tuple[Board, Sequence[Entry]]], places: Places) -> tuple[str, ...]:
    """Commands that run these entries again and write the report; a comment for each entry that no command runs.

    Parameters
    ----------
    runs : sequence of (Board, sequence of Entry)
    places : Places
    """
    lines: list[str] = []
    for board, entries in runs:
        lines += _run_commands(board, entries, places)
    return (*dict.fromkeys(lines), shlex.join(["skybench", "bench", "report", *places.options]))


def _run_commands(board: Board, entries: Sequence[Entry], places: Places) -> list[str]:
    sources = {entry.stored.provenance.solver.target: entry.stored.provenance for entry in entries}
    lines = []
    if any(entry.stored.provenance.frames.frozen is not None for entry in entries):
        return ["# frames of a round, which its opened secret draws again: skybench bench round verify, docs/rounds.md"]
    targets = sorted(target for target in sources if target is not None)
    if targets:
        frames = sources[targets[0]].frames
        command = ["skybench", "bench", "run", frames.target]
        for target in targets:
            command += ["--solver", target]
        if frames.grading is not None and frames.per_condition is not None:
            command += ["--split", frames.split, "--frames", str(frames.per_condition)]
        if frames.condition is not None:
            command += ["--condition", f"{frames.condition:.12g}"]
        if board.detections != "own":
            command += ["--detections", board.detections]
        lines.append(shlex.join([*command, *places.options]))
    for entry in sorted(entries, key=lambda entry: entry.label):
        kind = entry.stored.provenance.solver.kind
        if kind == "submission":
            lines.append(f"# {entry.label}: submitted answers; score their file with skybench bench score")
        elif entry.stored.provenance.solver.target is None:
            lines.append(f"# {entry.label}: a Python object; run it with benchmark.run.engine.run")
    return lines
