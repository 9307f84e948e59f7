"""Renewal of an earlier result for today's frames: answers to unchanged frames are kept, the others are solved again.

An answer depends on the solver's revision and on what the solver receives. The image is identified by its hash. The
circumstances that a solver receives follow from the task's definition, the frame's number and the truth. The hash of the
truth covers the site and the position of each star to the last bit; camera, attitude, time and air together determine these.
Size and time are compared as well. A frame without stars reveals none of this and is solved again. Two kinds of change go
unnoticed: changes of what a frame record states for solvers (``told``, pressure, temperature) that move no star, and changes
of `benchmark.instruments`, which is not part of any revision. After such changes, produce the results anew.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from benchmark.frames.dataset import Frame
from benchmark.frames.identity import UNKNOWN, FrameIdentity
from benchmark.frames.sites import counted_site
from benchmark.judge.outcome import FrameDetails, SolverOutcome
from benchmark.run.identities import identities_in
from benchmark.run.packed import PackedRow, packed_rows
from benchmark.run.packing import raw_row
from benchmark.run.provenance import Renewal, RunProvenance, circumstances, machines_together, read_provenance
from benchmark.run.results import SUMMARY_NAME, read_summary
from benchmark.run.sessions import asked_together
from benchmark.stats.metrics import ERROR, FrameScore


def earlier_row(out: Path, solver: str, wanted: RunProvenance) -> PackedRow | None:
    """Find the latest result whose answers equal those that a run would give, as far as the frames are the same.

    Parameters
    ----------
    out : Path
        Root of all results, raw or packed.
    solver : str
    wanted : RunProvenance
        Provenance of the run. Revision, detector, limits, libraries and the task's definition must agree. A result that
        consists of errors alone does not count.

    Returns
    -------
    PackedRow or None
        None where there is no such result.

    Raises
    ------
    ResultsError
        A result is damaged.
    """
    usable = [
        row
        for row in (*_raw_rows(out, solver, wanted), *_packed_rows(out, solver, wanted))
        if _same_but_for_frames(read_provenance(row.provenance), wanted) and (row.frames["status"] != ERROR).any()
    ]
    return max(usable, key=lambda row: str(row.provenance["date_utc"]), default=None)


def _packed_rows(out: Path, solver: str, wanted: RunProvenance) -> list[PackedRow]:
    rows = packed_rows(out, wanted.frames.place)
    return [row for row in rows if (row.solver, row.detections) == (solver, wanted.detections)]


def _raw_rows(out: Path, solver: str, wanted: RunProvenance) -> list[PackedRow]:
    """Raw results, which stay where rows on other frames keep them from being packed."""
    return [raw_row(folder / SUMMARY_NAME) for folder in raw_folders(out, solver, wanted)]


def raw_folders(out: Path, solver: str, wanted: RunProvenance) -> list[Path]:
    """Folders of a solver's finished raw results on the frames that a run is to solve, of any revision of code and frames."""
    found = sorted((out / wanted.frames.place / wanted.detections).glob(f"*/{SUMMARY_NAME}"))
    return [summary.parent for summary in found if read_summary(summary).solver == solver]


def _same_but_for_frames(earlier: RunProvenance, wanted: RunProvenance) -> bool:
    settled = wanted.solver.revision is not None and earlier.solver.revision == wanted.solver.revision
    same_task = earlier.frames.definition_sha256 == wanted.frames.definition_sha256
    return settled and same_task and circumstances(earlier) == circumstances(wanted)


def frames_as_before(
    row: PackedRow, frames: Sequence[Frame], identity: Callable[[Frame], FrameIdentity]
) -> list[Frame]:
    """Frames that are unchanged since a result; of a sequence either all frames or none.

    Parameters
    ----------
    row : PackedRow
    frames : sequence of Frame
        In the order that `outcomes` of the engine takes.
    identity : callable
        Returns the hashes of a frame.
    """
    stated = identities_in(row.frames)
    columns = ["index", "width_px", "height_px", "utc_mid"]
    told = dict(zip(row.frames["frame_id"], row.frames[columns].itertuples(index=False, name=None), strict=True))

    def is_as_before(frame: Frame) -> bool:
        seen = frame.observation
        here = frame.index, seen.camera.width, seen.camera.height, seen.utc
        known = stated.get(frame.frame_id, UNKNOWN)
        if not len(frame.truth.star_id) or told.get(frame.frame_id) != here or None in dataclasses.astuple(known):
            return False
        return known == identity(frame)

    return [frame for group in asked_together(frames) if all(map(is_as_before, group)) for frame in group]


def outcome_before(row: PackedRow, frame: Frame, bound_km: float | None, identity: FrameIdentity) -> SolverOutcome:
    """A result's answer to one of its frames, with the frame's circumstances as they are read today.

    Position, detections and the times of single stages are unknown, because packing leaves them out.
    """
    (answer,) = row.frames.loc[row.frames["frame_id"] == frame.frame_id].to_dict("records")
    error_km, conditions = _number(answer["error_km"]), frame.conditions
    ee, en, nn = (_number(answer[name]) for name in ("cov_ee_km2", "cov_en_km2", "cov_nn_km2"))
    score = FrameScore(
        frame_id=frame.frame_id,
        index=frame.index,
        bortle=conditions.bortle,
        width_px=frame.observation.camera.width,
        height_px=frame.observation.camera.height,
        status=answer["status"],
        reason=answer["reason"],
        lat_deg=None,
        lon_deg=None,
        error_km=math.inf if error_km is None else error_km,
        n_detections=int(answer["n_detections"]),
        n_detected_stars=int(answer["n_detected_stars"]),
        n_matches=int(answer["n_matches"]),
        n_correct=int(answer["n_correct"]),
        time_ms=float(answer["time_ms"]),
        site=counted_site(frame),
        condition=frame.condition,
    )
    details = FrameDetails(
        cov_km2=None if ee is None or en is None or nn is None else (ee, en, nn),
        confidence=_number(answer["confidence"]),
        detect_ms=math.nan,
        solve_ms=math.nan,
        stage_ms={},
        utc=frame.observation.utc,
        conditions=conditions,
        site=counted_site(frame),
        error_east_km=_number(answer["error_east_km"]),
        error_north_km=_number(answer["error_north_km"]),
        crlb_km=bound_km,
        peak_memory_mib=_number(answer["peak_memory_mib"]),
        identity=identity,
    )
    return SolverOutcome(score, details, ())


def _number(value: Any) -> float | None:
    return None if value is None or not math.isfinite(value) else float(value)


def renewed(run: RunProvenance, row: PackedRow, n_kept: int, n_solved: int) -> RunProvenance:
    """Provenance of a result with answers taken over from an earlier one.

    Where no frame was solved again, it is the earlier result's, for frames that were rendered again.

    Parameters
    ----------
    run : RunProvenance
        Provenance of the run that solved the other frames.
    row : PackedRow
        The earlier result.
    n_kept, n_solved : int
        Number of frames with its answers, and with new ones.
    """
    earlier = read_provenance(row.provenance)
    if not n_solved:
        frames = dataclasses.replace(
            run.frames, rendered_with=earlier.frames.rendered_with, rendered_again_with=run.frames.rendered_with
        )
        return dataclasses.replace(earlier, frames=frames, solver=run.solver, key=run.key)
    first = earlier.renewed or Renewal(
        n_kept, n_solved, earlier.date_utc, earlier.frames.scenario_sha256, earlier.frames.rendered_with
    )
    return dataclasses.replace(
        run,
        machine=machines_together([earlier.machine, run.machine]),
        jobs=max(earlier.jobs, run.jobs),
        renewed=dataclasses.replace(first, n_kept=n_kept, n_solved=n_solved),
    )
