"""Completion of a task's results after the task has gained conditions, with results of the new conditions alone."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path

import pandas as pd

from benchmark.frames.frame_set import FrameFacts
from benchmark.run.packed import PackedRow, read_packed
from benchmark.run.packing import write_packed
from benchmark.run.provenance import circumstances, machines_together, read_provenance


def results_alone(
    root: Path, row: PackedRow, today: FrameFacts, values: Sequence[float]
) -> dict[Path, PackedRow] | None:
    """Find packed results of single conditions by the solver of a row.

    Parameters
    ----------
    root : Path
        Root folder of the results.
    row : PackedRow
        Result on the task's first conditions.
    today : FrameFacts
        Facts about all frames of today's task.
    values : sequence of float
        Conditions that the row lacks.

    Returns
    -------
    dict of Path to PackedRow, or None
        By the listing of each; None where one is missing.
    """
    alone: dict[Path, PackedRow] = {}
    for value in values:
        place = root / dataclasses.replace(today, condition=value).place
        listing = place.with_name(f"{place.name}.json")
        found = [one for one in read_packed(listing) if _is_of_the_same(row, one, today)] if listing.is_file() else []
        if not found:
            return None
        alone[listing] = found[0]
    return alone


def _is_of_the_same(row: PackedRow, alone: PackedRow, today: FrameFacts) -> bool:
    """Whether a result has the same solver as another, and is of today's task."""
    mine, its = read_provenance(row.provenance), read_provenance(alone.provenance)
    settled = mine.solver.revision is not None and mine.solver.revision == its.solver.revision
    return (
        settled
        and (row.solver, row.detections) == (alone.solver, alone.detections)
        and circumstances(mine) == circumstances(its)
        and mine.frames.per_condition == its.frames.per_condition
        and its.frames.definition_sha256 == today.definition_sha256
    )


def completed(row: PackedRow, alone: Sequence[PackedRow], today: FrameFacts) -> PackedRow:
    """Append the results of the other conditions to a row of a task's first conditions; the key stays the row's own."""
    mine = read_provenance(row.provenance)
    others = [read_provenance(one.provenance) for one in alone]
    facts = dataclasses.replace(
        mine.frames,
        definition_sha256=today.definition_sha256,
        grading=today.grading,
        truth_sha256=today.truth_sha256,
    )
    source = dataclasses.replace(
        mine,
        frames=facts,
        date_utc=max(mine.date_utc, *(one.date_utc for one in others)),
        jobs=max(mine.jobs, *(one.jobs for one in others)),
        machine=machines_together([mine.machine, *(one.machine for one in others)]),
    )
    frames = pd.concat([row.frames, *(one.frames for one in alone)], ignore_index=True)
    return dataclasses.replace(row, provenance=dataclasses.asdict(source), frames=frames)


def remove_used(used: Mapping[Path, Sequence[PackedRow]]) -> None:
    """Remove rows from their tables, given by listing; a table that is left without rows is deleted."""
    for listing, gone in used.items():
        keys = {(row.detections, row.key) for row in gone}
        left = [row for row in read_packed(listing) if (row.detections, row.key) not in keys]
        if left:
            write_packed(listing, left)
        else:
            listing.unlink()
            listing.with_suffix(".parquet").unlink()
