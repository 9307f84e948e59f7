"""Journal of an unfinished run: its outcomes, kept on disk so that it resumes after an interruption."""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Sequence
from pathlib import Path

import pyarrow as pa

from benchmark.errors import ResultsError
from benchmark.frames.dataset import Frame
from benchmark.frames.identity import identity_of
from benchmark.judge.outcome import SolverOutcome
from benchmark.run.identities import identities_in
from benchmark.run.result_tables import frame_table, in_order, match_table
from benchmark.run.results import read_table, write_parquet
from generator.files import write_bytes

FOLDER = "unfinished"
LONGEST_WAIT_S = 20.0
"""Longest time, in seconds, before outcomes are written, and so the most work that an interruption can lose."""


class Journal:
    """Tables of the frames that a run has completed so far.

    Parameters
    ----------
    folder : Path
        Folder of the result.
    stamp : dict
        What must agree for earlier outcomes to be taken over: versions, machine, number of jobs.
    kept : bool
        Whether outcomes are kept on disk. They are not where the solver could not be distinguished from another one later.
    """

    def __init__(self, folder: Path, stamp: dict[str, object], kept: bool) -> None:
        self._folder = folder / FOLDER
        self._kept = kept
        self._stamp = json.dumps(stamp, sort_keys=True)
        self._frames: list[pa.Table] = []
        self._matches: list[pa.Table] = []
        self._waiting: list[SolverOutcome] = []
        self._written = time.monotonic()

    def take_over(self, wanted: Sequence[Frame]) -> set[str]:
        """Read the outcomes of an interrupted run, and return the ids of its frames among those wanted.

        Nothing is taken over if a table is damaged, or if any frame has changed since, that is, if its image or its truth has
        another hash.
        """
        stamp = self._folder / "stamp.json"
        if not self._kept or not stamp.is_file() or stamp.read_bytes() != self._stamp.encode():
            self.clear()
            return set()
        try:
            for path in sorted(self._folder.glob("frames-*.parquet")):
                self._frames.append(read_table(path))
                self._matches.append(read_table(path.with_name(path.name.replace("frames", "matches"))))
        except ResultsError:
            self.clear()
            return set()
        done = {name: identity for table in self._frames for name, identity in identities_in(table.to_pandas()).items()}
        kept = [frame for frame in wanted if frame.frame_id in done]
        if any(identity_of(frame).contradicts(done[frame.frame_id]) for frame in kept):
            self.clear()
            return set()
        return {frame.frame_id for frame in kept}

    def add(self, outcome: SolverOutcome) -> None:
        """Keep an outcome; it is on disk after `LONGEST_WAIT_S` or after `flush`."""
        self._waiting.append(outcome)
        if time.monotonic() - self._written > LONGEST_WAIT_S:
            self.flush()

    def flush(self) -> None:
        """Write the waiting outcomes; the table of frames comes last: it confirms that that of detections is complete."""
        if self._waiting and self._kept:
            part = f"{len(self._frames):05d}.parquet"
            self._gather()
            write_bytes(self._folder / "stamp.json", self._stamp.encode())
            write_parquet(self._folder / f"matches-{part}", self._matches[-1])
            write_parquet(self._folder / f"frames-{part}", self._frames[-1])
        self._written = time.monotonic()

    def tables(self, frame_ids: Sequence[str]) -> tuple[pa.Table, pa.Table]:
        """Tables of frames and of detections of these frames, in their order."""
        if self._waiting:
            self._gather()
        frames, matches = pa.concat_tables(self._frames), pa.concat_tables(self._matches)
        return in_order(frames, frame_ids), in_order(matches, frame_ids)

    def clear(self) -> None:
        """Discard all outcomes, in memory and on disk."""
        self._frames, self._matches, self._waiting = [], [], []
        shutil.rmtree(self._folder, ignore_errors=True)

    def _gather(self) -> None:
        self._frames.append(frame_table(self._waiting))
        self._matches.append(match_table(self._waiting))
        self._waiting = []
