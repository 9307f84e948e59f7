"""Packing a tree of results: raw results move into the tables of `benchmark.run.packed`, and their folders are removed."""

from __future__ import annotations

import dataclasses
import shutil
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

from benchmark.errors import ResultsError
from benchmark.run.packed import OtherFramesError, PackedRow, on_same_frames, pack, read_packed
from benchmark.run.results import FRAMES_NAME, SUMMARY_NAME, read_summary
from benchmark.stats.frame_metrics import read_frames
from generator.files import write_bytes


@dataclass(frozen=True)
class PackedTable:
    """A table that was written: its listing, the rows that are new, its size, and the solvers whose rows were removed."""

    listing: Path
    n_new: int
    n_rows: int
    size_bytes: int
    removed: tuple[str, ...] = ()


def pack_tree(root: Path, leave_others: bool = False, remove_others: bool = False) -> list[PackedTable]:
    """Pack all raw results of a tree; each replaces the packed one of the same solver and mode of detection.

    The folders of raw results are removed once the table holds their contents. Results on other frames than those of the
    other rows stay raw, and do not keep other tables from being packed.

    Parameters
    ----------
    root : Path
    leave_others : bool
        Whether results that stay raw are no error, because the other rows are still to be run.
    remove_others : bool
        Whether packed rows on other frames than those of the raw results are removed, instead of keeping these from being
        packed.

    Returns
    -------
    list of PackedTable
        The tables that changed.

    Raises
    ------
    ResultsError
        A result is damaged, or a solver has two raw results for one table, or, once everything else is packed, results
        disagree about their frames.
    """
    found: defaultdict[Path, list[tuple[Path, PackedRow]]] = defaultdict(list)
    for summary in sorted(root.glob(f"*@*/*/*/*/{SUMMARY_NAME}")):
        found[summary.parents[2]].append((summary.parent, raw_row(summary)))
    packed, refused = [], []
    for part, raw in sorted(found.items()):
        try:
            packed.append(_pack_part(part, raw, remove_others))
        except OtherFramesError as error:
            refused.append(f"{part}: {error}")
    if refused and not leave_others:
        raise ResultsError("; ".join(refused))
    return packed


def raw_row(summary: Path) -> PackedRow:
    """Read a raw result, given its ``summary.json``, as a row of a packed table. Raises ResultsError."""
    stored = read_summary(summary)
    return PackedRow(
        solver=stored.solver,
        detections=stored.provenance.detections,
        key=stored.provenance.key,
        provenance=dataclasses.asdict(stored.provenance),
        frames=read_frames(summary.parent / FRAMES_NAME),
    )


def _pack_part(part: Path, raw: list[tuple[Path, PackedRow]], remove_others: bool) -> PackedTable:
    listing = part.parent / f"{part.name}.json"
    new = {(row.detections, row.solver): row for _, row in raw}
    if len(new) < len(raw):
        twice = sorted({row.solver for _, row in raw if new[row.detections, row.solver] is not row})
        raise ResultsError(f"{part}: two results of {', '.join(twice)}; delete the folder of the older one")
    kept = read_packed(listing) if listing.is_file() else []
    same = on_same_frames(kept, list(new.values())) if remove_others else kept
    rows = {(row.detections, row.solver): row for row in same} | new
    removed = tuple(row.solver for row in kept if (row.detections, row.solver) not in rows)
    ordered = [rows[place] for place in sorted(rows)]
    size_bytes = write_packed(listing, ordered)
    for folder, _ in raw:
        shutil.rmtree(folder)
    for mode in sorted({folder.parent for folder, _ in raw}):
        if not any(mode.iterdir()):
            mode.rmdir()
    if not any(part.iterdir()):
        part.rmdir()
    return PackedTable(listing, len(new), len(ordered), size_bytes, removed)


def write_packed(listing: Path, rows: list[PackedRow]) -> int:
    """Write a packed table and its listing, and read them back; returns the bytes of both. Raises ResultsError."""
    table, text = pack(rows)
    write_bytes(listing.with_suffix(".parquet"), table)
    write_bytes(listing, text)
    _check(listing, rows)
    return len(table) + len(text)


def _check(listing: Path, rows: list[PackedRow]) -> None:
    """Refuse to go on, and so to remove anything, unless the table holds what it was given."""
    for row, back in zip(rows, read_packed(listing), strict=True):
        same = (row.solver, row.detections, row.key) == (back.solver, back.detections, back.key)
        if not same or row.frames["status"].tolist() != back.frames["status"].tolist():
            raise ResultsError(
                f"{listing}: does not hold the answers of {row.solver} that were packed; nothing was removed"
            )
