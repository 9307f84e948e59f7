"""Whether a run's result exists already, raw or packed, and its summary."""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping
from pathlib import Path
from typing import Any

from benchmark.run.packed import PackedRow, packed_rows
from benchmark.run.provenance import RunProvenance, read_provenance
from benchmark.run.result_tables import scores_of
from benchmark.run.results import FRAMES_NAME, SUMMARY_NAME, read_summary, read_table, result_folder
from benchmark.stats.frame_metrics import errors_km, success_limit_km
from benchmark.stats.metrics import ERROR, FrameScore, Summary, summarise


def finished(out: Path, solver: str, wanted: RunProvenance) -> Summary | None:
    """Find the result of a run; one of fewer frames, or one that consists of errors alone, does not count.

    Parameters
    ----------
    out : Path
        Root of all results.
    solver : str
    wanted : RunProvenance
        Provenance of the run.

    Returns
    -------
    Summary or None
        Of the raw result, or else of the packed one; None where there is neither.

    Raises
    ------
    ResultsError
        A result is damaged.
    """
    raw = finished_raw(out, solver, wanted)
    return _finished_packed(out, solver, wanted) if raw is None else raw


def finished_raw(out: Path, solver: str, wanted: RunProvenance) -> Summary | None:
    """The same as `finished`, of raw results alone, which hold all that a run gives."""
    folder = result_folder(out, solver, wanted)
    if not (folder / SUMMARY_NAME).is_file():
        return None
    stored = read_summary(folder / SUMMARY_NAME)
    if not _enough(stored.provenance, wanted) or stored.n_errors == stored.n_frames:
        return None
    return summarise(scores_of(read_table(folder / FRAMES_NAME)), success_limit_km(wanted.frames.metric))


def _finished_packed(out: Path, solver: str, wanted: RunProvenance) -> Summary | None:
    for row in packed_rows(out, wanted.frames.place):
        same = (row.solver, row.detections, row.key) == (solver, wanted.detections, wanted.key)
        if same and _enough(read_provenance(row.provenance), wanted) and (row.frames["status"] != ERROR).any():
            return summarise(_scores(row), success_limit_km(wanted.frames.metric))
    return None


def _enough(stored: RunProvenance, wanted: RunProvenance) -> bool:
    return (stored.frames.per_condition or 0) >= (wanted.frames.per_condition or 0)


def _scores(row: PackedRow) -> list[FrameScore]:
    """Scores in a packed result, which has no positions."""
    frames = row.frames.assign(error_km=errors_km(row.frames))
    return [_score(one) for one in frames.to_dict("records")]


def _score(told: Mapping[Hashable, Any]) -> FrameScore:
    bortle, condition = _number(told.get("bortle")), _number(told.get("condition"))
    return FrameScore(
        frame_id=told["frame_id"],
        index=int(told["index"]),
        bortle=None if bortle is None else int(bortle),
        width_px=int(told["width_px"]),
        height_px=int(told["height_px"]),
        status=told["status"],
        reason=told["reason"] or "",
        lat_deg=None,
        lon_deg=None,
        error_km=told["error_km"],
        n_detections=int(told["n_detections"]),
        n_detected_stars=int(told["n_detected_stars"]),
        n_matches=int(told["n_matches"]),
        n_correct=int(told["n_correct"]),
        time_ms=float(told["time_ms"]),
        site=told.get("site") or "",
        condition=condition,
    )


def _number(value: float | None) -> float | None:
    return None if value is None or math.isnan(value) else float(value)
