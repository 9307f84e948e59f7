"""All frames on which a solver of a board failed, and the selection that is shown with pictures."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from benchmark.report.site.boards import Board, conditions_of
from benchmark.report.site.frame_source import is_frame_id
from benchmark.stats.frame_metrics import errors_km, succeeded
from benchmark.stats.metrics import ERROR, FIX

KINDS = ("wrong fix", "refused", "error")
_WRONG, _REFUSED, _ERROR = range(len(KINDS))


@dataclass(frozen=True)
class Failure:
    """One solver's failure on one frame.

    Attributes
    ----------
    entry : int
        Index of the solver on the board.
    frame_id : str
    condition : float
        Value by which success is shown; NaN where there is none.
    kind : int
        Index in `KINDS`.
    error_km : float
        Infinite without a fix.
    reason : str
        Empty with a fix.
    n_correct, n_matches, n_detections : int
    """

    entry: int
    frame_id: str
    condition: float
    kind: int
    error_km: float
    reason: str
    n_correct: int
    n_matches: int
    n_detections: int


def failures_of(board: Board) -> list[Failure]:
    """All failures on a board, solver by solver, each in the order of the frames."""
    return [failure for place in range(len(board.entries)) for failure in _of_entry(board, place)]


def _of_entry(board: Board, place: int) -> Iterator[Failure]:
    frames = board.entries[place].stored.frames
    failed = ~succeeded(frames, board.task.limit_km)
    values = zip(
        frames["frame_id"][failed],
        conditions_of(frames, board.task)[failed].tolist(),
        frames["status"][failed],
        errors_km(frames)[failed].tolist(),
        frames["reason"][failed],
        *(frames[name][failed].astype(int) for name in ("n_correct", "n_matches", "n_detections")),
        strict=True,
    )
    for frame_id, condition, status, error, reason, correct, matches, detections in values:
        kind = _WRONG if status == FIX else _ERROR if status == ERROR else _REFUSED
        yield Failure(
            place, str(frame_id), condition, kind, error, str(reason or ""), int(correct), int(matches), int(detections)
        )


def worst_first(board: Board, failures: Sequence[Failure]) -> list[Failure]:
    """Sort failures with the worst of each solver first; the solvers take turns.

    Wrong fixes come before refusals, the farthest first; refusals follow from the easiest condition on.
    """

    def harm(failure: Failure) -> tuple[float, float, float]:
        ease = 0.0 if math.isnan(failure.condition) else board.task.harder * failure.condition
        return float(failure.kind != _WRONG), -failure.error_km if failure.kind == _WRONG else 0.0, ease

    rows = [sorted(group, key=harm) for _, group in itertools.groupby(failures, key=lambda failure: failure.entry)]
    turns = itertools.chain.from_iterable(itertools.zip_longest(*rows))
    return [failure for failure in turns if failure is not None]


def pictured_frames(board: Board, failures: Sequence[Failure], most: int) -> list[str]:
    """Ids of the frames that are shown with pictures, at most `most`; the worst first."""
    ids = dict.fromkeys(failure.frame_id for failure in worst_first(board, failures))
    return [frame_id for frame_id in ids if is_frame_id(frame_id)][:most]


def listed(board: Board, failures: Sequence[Failure]) -> dict[str, Any]:
    """Convert the failures for the page's script; the form is compact, because there may be thousands."""
    frames = list(dict.fromkeys(failure.frame_id for failure in failures))
    reasons = {reason: place for place, reason in enumerate(dict.fromkeys(failure.reason for failure in failures))}
    place_of = {frame_id: place for place, frame_id in enumerate(frames)}
    condition_of = {failure.frame_id: failure.condition for failure in failures}
    return {
        "solvers": [entry.label for entry in board.entries],
        "kinds": list(KINDS),
        "condition": board.task.condition,
        "frames": frames,
        "conditions": [_short(condition_of[frame_id]) for frame_id in frames],
        "reasons": list(reasons),
        "rows": [
            [
                failure.entry,
                place_of[failure.frame_id],
                failure.kind,
                _short(failure.error_km) if failure.kind == _WRONG else reasons[failure.reason],
                failure.n_correct,
                failure.n_matches,
                failure.n_detections,
            ]
            for failure in failures
        ],
    }


def counts_by_kind(board: Board, failures: Sequence[Failure]) -> list[tuple[str, list[int]]]:
    """Number of failures of each kind, for each solver."""
    table = np.zeros((len(board.entries), len(KINDS)), dtype=int)
    for failure in failures:
        table[failure.entry, failure.kind] += 1
    return [(entry.label, row) for entry, row in zip(board.entries, table.tolist(), strict=True)]


def _short(value: float) -> float | None:
    return None if pd.isna(value) or math.isinf(value) else float(f"{value:.4g}")
