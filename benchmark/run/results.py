"""Result files: written by the engine, read by the report (docs/benchmark.md describes the files).

``RESULTS/LABEL/PART/DETECTIONS/SOLVER-KEY/`` holds the result of one solver on one set of frames. Every file appears under
its name only when it is complete. The summary is written last, so a folder contains a summary only when it belongs to the
tables next to it.
"""

from __future__ import annotations

import dataclasses
import json
import os
import re
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from benchmark.errors import ResultsError
from benchmark.run.provenance import RunProvenance, blanks, read_provenance
from benchmark.run.result_tables import finite, scores_of
from benchmark.stats.frame_metrics import success_limit_km
from benchmark.stats.intervals import CONFIDENCE, Estimate
from benchmark.stats.metrics import DEFINITIONS, Summary, by_bortle, summarise
from generator.errors import GeneratorError
from generator.files import read_at_most, write_bytes
from generator.reading.json_text import strict_json
from generator.reading.table import check_claims

RESULT_FORMAT = "skybench-result/2"
SUMMARY_NAME = "summary.json"
SAME_COUNTS = ("skybench-metrics/1", DEFINITIONS)
"""Definitions of metrics under which a summary's counts of frames, the only numbers read from it, mean the same."""
LARGEST_SUMMARY_BYTES = 16 * 2**20
FRAMES_NAME = "frames.parquet"
MATCHES_NAME = "matches.parquet"
_SOLVER_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._@+-]{0,99}")
RUN_AGAIN = "run `skybench bench run` again"


def check_solver_name(name: str) -> None:
    """Refuse a solver name that cannot be used as a file name.

    Raises
    ------
    ResultsError
    """
    if not _SOLVER_NAME.fullmatch(name):
        raise ResultsError(f"solver name {name!r}: use letters, digits and . _ @ + - only, at most 100 of them")


def result_folder(out: Path, solver: str, provenance: RunProvenance) -> Path:
    """Folder of a result. Raises ResultsError for a name that cannot be used as a file name."""
    check_solver_name(solver)
    return out / provenance.frames.place / provenance.detections / f"{solver}-{provenance.key}"


@dataclass(frozen=True)
class StoredSummary:
    """What a result's summary says: its solver, its provenance and its counts of frames.

    Attributes
    ----------
    solver : str
    provenance : RunProvenance
    n_frames, n_fixes, n_errors : int
    """

    solver: str
    provenance: RunProvenance
    n_frames: int
    n_fixes: int
    n_errors: int


def write_result(folder: Path, solver: str, frames: pa.Table, matches: pa.Table, provenance: RunProvenance) -> Summary:
    """Write the tables of frames and detections and, last, the summary.

    Raises
    ------
    ResultsError
        The provenance leaves something blank.
    """
    check_solver_name(solver)
    if missing := blanks(provenance):
        raise ResultsError(f"{folder}: its provenance leaves blank: {', '.join(missing)}")
    scores = scores_of(frames)
    source = dataclasses.asdict(provenance)
    stamp = json.dumps({"format": RESULT_FORMAT, "solver": solver, "provenance": source}, allow_nan=False)
    metadata = {b"skybench": stamp.encode()}
    (folder / SUMMARY_NAME).unlink(missing_ok=True)
    write_parquet(folder / FRAMES_NAME, frames.replace_schema_metadata(metadata))
    write_parquet(folder / MATCHES_NAME, matches.replace_schema_metadata(metadata))
    limit_km = success_limit_km(provenance.frames.metric)
    overall = summarise(scores, limit_km)
    summary = {
        "format": RESULT_FORMAT,
        "definitions": DEFINITIONS,
        "confidence": CONFIDENCE,
        "solver": solver,
        "null_means": "in an error (_km) or a time (_ms): infinite; elsewhere: undefined, nothing to count",
        "limit_km": limit_km,
        "overall": _summary_to_json(overall),
        "by_bortle": [{"bortle": bortle, **_summary_to_json(part)} for bortle, part in by_bortle(scores, limit_km)],
        "reasons": _count(score.reason for score in scores if score.reason),
        "provenance": source,
    }
    text = json.dumps(summary, indent=2, allow_nan=False, ensure_ascii=False) + "\n"
    write_bytes(folder / SUMMARY_NAME, text.encode())
    return overall


def read_summary(path: Path) -> StoredSummary:
    """Read a result's summary file.

    Raises
    ------
    ResultsError
        It is damaged, has another format or other definitions, or does not match the solver and frames in its path.
    """
    try:
        tree = strict_json(read_at_most(path, LARGEST_SUMMARY_BYTES), str(path), LARGEST_SUMMARY_BYTES)
        found, solver = (tree["format"], tree["definitions"]), tree["solver"]
        if found[0] != RESULT_FORMAT or found[1] not in SAME_COUNTS:
            raise ResultsError(f"{path}: is {found}, this version reads {(RESULT_FORMAT, DEFINITIONS)}; {RUN_AGAIN}")
        provenance = read_provenance(tree["provenance"])
        counts = [int(tree["overall"][name]) for name in ("n_frames", "n_fixes", "n_errors")]
    except ResultsError as error:
        message = str(error)
        raise ResultsError(message if message.startswith(str(path)) else f"{path}: {message}; {RUN_AGAIN}") from error
    except (GeneratorError, ValueError, KeyError, TypeError, OSError) as error:
        raise ResultsError(f"{path}: not a readable result ({error!r}); delete it or {RUN_AGAIN}") from error
    folder = path.parent
    if not isinstance(solver, str) or folder.name != f"{solver}-{provenance.key}":
        raise ResultsError(f"{path}: holds a result of {solver!r}, which its folder does not say; {RUN_AGAIN}")
    check_solver_name(solver)
    place = Path(*folder.parts[-4:-1])
    if place != provenance.frames.place / provenance.detections:
        raise ResultsError(
            f"{path}: holds a result of {provenance.frames.place}, {provenance.detections} detections, which its folder "
            f"does not say; {RUN_AGAIN}"
        )
    return StoredSummary(solver, provenance, *counts)


def read_table(
    path: Path, columns: Sequence[str] | None = None, filters: Sequence[tuple[str, str, object]] | None = None
) -> pa.Table:
    """Read a table of a result: only the columns that it has, and the rows that pass all filters (in Arrow's notation).

    Raises
    ------
    ResultsError
        It is missing or damaged, or claims more data than a file of its size can hold.
    """
    try:
        check_claims(path)
        known = None if columns is None else [name for name in columns if name in pq.read_schema(path).names]
        return pq.read_table(path, columns=known, filters=None if filters is None else list(filters))
    except (GeneratorError, pa.ArrowException, OSError) as error:
        raise ResultsError(f"{path}: missing or damaged ({error}); {RUN_AGAIN}") from error


def check_writable(out: Path) -> None:
    """Check whether results can be written to a folder, or the folder created, without leaving a trace.

    Raises
    ------
    ResultsError
        It is not possible.
    """
    try:
        there = next(folder for folder in (out, *out.absolute().parents) if os.path.lexists(folder))
        with tempfile.TemporaryFile(dir=there) as probe:
            probe.write(b"\0")
    except OSError as error:
        raise ResultsError(f"{out}: cannot be written ({error.strerror}); choose another folder with --out") from error


@contextmanager
def writing(folder: Path) -> Iterator[None]:
    """Context in which files of a result are written; each appears under its name only when complete.

    Raises
    ------
    ResultsError
        The operating system refuses: for example a full disk or a failed renaming.
    """
    try:
        yield
    except OSError as error:
        raise ResultsError(
            f"{error.filename or folder}: writing failed ({error.strerror or error}); free some space and run the same "
            "command again"
        ) from error


def write_parquet(path: Path, table: pa.Table) -> None:
    """Write a table that appears under its name only when complete."""
    sink = pa.BufferOutputStream()
    pq.write_table(table, sink, compression="zstd")
    write_bytes(path, sink.getvalue().to_pybytes())


def _summary_to_json(summary: Summary) -> dict[str, Any]:
    def entry(value: object) -> object:
        if isinstance(value, Estimate):
            return {"value": finite(value.value), "low": finite(value.low), "high": finite(value.high), "n": value.n}
        return value

    return {field.name: entry(getattr(summary, field.name)) for field in dataclasses.fields(Summary)}


def _count(values: Iterable[str]) -> Mapping[str, int]:
    names, counts = np.unique(np.asarray(list(values), dtype=str), return_counts=True)
    return {str(name): int(count) for name, count in zip(names, counts, strict=True)}
