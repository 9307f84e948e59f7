"""Results on disk: written by a run, read by the report (docs/benchmark.md describes the files).

Every file appears under its name only when it is whole. A solver's summary is written last, so that a folder holds a
solver's summary only when the tables beside it belong to it.
"""

import dataclasses
import json
import math
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from benchmark.errors import ResultsError
from benchmark.run.result_tables import DetectionRow, FrameDetails, finite, frame_table
from benchmark.stats.intervals import CONFIDENCE, Estimate
from benchmark.stats.metrics import DEFINITIONS, FrameScore, Summary, by_bortle, summarise

RESULT_FORMAT = "skybench-result/1"
PREVIEW_FOLDER = "previews"
SUMMARY_NAME = "summary.json"
_SOLVER_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._@+-]{0,99}")
_RUN_AGAIN = "run `skybench bench run` again"


@dataclass(frozen=True)
class RunProvenance:
    """Where a result comes from.

    Attributes
    ----------
    dataset, scenario_name, scenario_sha256, truth_sha256 : str
        What was solved; the dataset's name comes without its path.
    dataset_provenance : mapping of str to str
        The generator's versions, as recorded in the frames.
    solver_version, detector : str
        From the solver.
    versions, machine : mapping of str to str
        See `benchmark.provenance`.
    date_utc : str
        When the run ended.
    jobs : int
        Processes that worked at the same time, which bears on the times.
    task : mapping or None
        What of which task was run, see `benchmark.run.task_run`; None for a plain dataset.
    """

    dataset: str
    scenario_name: str
    scenario_sha256: str
    truth_sha256: str
    dataset_provenance: Mapping[str, str]
    solver_version: str
    detector: str
    versions: Mapping[str, str]
    machine: Mapping[str, str]
    date_utc: str
    jobs: int
    task: Mapping[str, Any] | None = None


@dataclass(frozen=True)
class SolverResult:
    """One solver's results on a dataset, as the report reads them."""

    solver: str
    provenance: RunProvenance
    overall: Summary
    bortle: tuple[tuple[int | None, Summary], ...]
    scores: tuple[FrameScore, ...]
    detections: tuple[DetectionRow, ...]


def check_solver_name(name: str) -> None:
    """Refuse a solver name that cannot be a file name.

    Raises
    ------
    ResultsError
    """
    if not _SOLVER_NAME.fullmatch(name):
        raise ResultsError(f"solver name {name!r}: use letters, digits and . _ @ + - only, at most 100 of them")


@dataclass(frozen=True)
class ResultFiles:
    """Where the three files of one solver's result lie."""

    frames: Path
    matches: Path
    summary: Path

    @classmethod
    def beside(cls, out: Path, solver: str) -> "ResultFiles":
        """Files of a plain run, all solvers' in one folder. Raises ResultsError for a name that is no file name."""
        check_solver_name(solver)
        return cls(out / f"{solver}.parquet", out / f"{solver}-matches.parquet", out / f"{solver}.json")

    @classmethod
    def within(cls, folder: Path) -> "ResultFiles":
        """Files of a task's run, a folder to each solver and key."""
        return cls(folder / "frames.parquet", folder / "matches.parquet", folder / SUMMARY_NAME)


def write_result(
    files: ResultFiles,
    solver: str,
    scores: Sequence[FrameScore],
    details: Sequence[FrameDetails],
    matches: pa.Table,
    provenance: RunProvenance,
) -> None:
    """Write the tables of frames and detections and, last, the summary."""
    check_solver_name(solver)
    stamp = json.dumps({"format": RESULT_FORMAT, "solver": solver, **dataclasses.asdict(provenance)}, allow_nan=False)
    metadata = {b"skybench": stamp.encode()}
    _write_parquet(files.frames, frame_table(scores, details).replace_schema_metadata(metadata))
    _write_parquet(files.matches, matches.replace_schema_metadata(metadata))
    summary = {
        "format": RESULT_FORMAT,
        "definitions": DEFINITIONS,
        "confidence": CONFIDENCE,
        "solver": solver,
        "null_means": "in an error (_km) or a time (_ms): infinite; elsewhere: undefined, nothing to count",
        "overall": _summary_to_json(summarise(scores)),
        "by_bortle": [{"bortle": bortle, **_summary_to_json(summary)} for bortle, summary in by_bortle(scores)],
        "reasons": _count(score.reason for score in scores if score.reason),
        "provenance": dataclasses.asdict(provenance),
    }
    text = json.dumps(summary, indent=2, allow_nan=False, ensure_ascii=False) + "\n"
    write_atomically(files.summary, text.encode())


def read_results(out: Path) -> list[SolverResult]:
    """Read all solvers' results in a folder, sorted by name.

    Raises
    ------
    ResultsError
        The folder holds none, a file is damaged, or the results are not of one dataset and one set of definitions.
    """
    results = [_read_result(ResultFiles.beside(out, path.stem)) for path in _summary_paths(out)]
    if not results:
        raise ResultsError(
            f"{out}: no results in it; make some with `skybench bench run DIR --solver NAME --out {out}`"
        )
    first = results[0]
    for other in results[1:]:
        if _fingerprint(other.provenance) != _fingerprint(first.provenance):
            raise ResultsError(
                f"{out}: {first.solver} and {other.solver} were run on different datasets and cannot share a table; "
                f"run both on one dataset, or delete the files of one of them"
            )
    return results


def read_task_results(root: Path) -> list[SolverResult]:
    """Read every finished result of the layout ``TASK@REVISION/SPLIT/DETECTIONS/SOLVER-KEY/``, in the order of the paths.

    The table of detections may be missing (it is large, and nothing but pictures needs it): `detections` is then empty.

    Raises
    ------
    ResultsError
        There is none, or a file is damaged.
    """
    found = sorted(path.parent for path in root.glob(f"*@*/*/*/*/{SUMMARY_NAME}") if path.is_file())
    if not found:
        raise ResultsError(f"{root}: no results of tasks in it; make some with `skybench bench run TASK --solver NAME`")
    return [_read_result(ResultFiles.within(folder)) for folder in found]


def check_room(out: Path, solvers: Iterable[str], scenario_sha256: str, truth_sha256: str) -> None:
    """Refuse, before any work, to put results beside those of another dataset.

    Raises
    ------
    ResultsError
        `out` holds results of a solver not in `solvers` on another dataset.
    """
    replaced = set(solvers)
    for path in _summary_paths(out):
        if path.stem in replaced:
            continue
        if _fingerprint(read_summary(path)[1]) != (scenario_sha256, truth_sha256):
            raise ResultsError(
                f"{path}: is a result on another dataset; choose another --out, delete it, or add --solver {path.stem}"
            )


def write_atomically(path: Path, content: bytes) -> None:
    """Write a file that appears under its name only when whole."""
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        temporary.write_bytes(content)
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def _write_parquet(path: Path, table: pa.Table) -> None:
    sink = pa.BufferOutputStream()
    pq.write_table(table, sink, compression="zstd")
    write_atomically(path, sink.getvalue().to_pybytes())


def _summary_to_json(summary: Summary) -> dict[str, Any]:
    def entry(value: object) -> object:
        if isinstance(value, Estimate):
            return {"value": finite(value.value), "low": finite(value.low), "high": finite(value.high), "n": value.n}
        return value

    return {field.name: entry(getattr(summary, field.name)) for field in dataclasses.fields(Summary)}


def _summary_from_json(entry: Mapping[str, Any]) -> Summary:
    values: dict[str, Any] = {}
    for field in dataclasses.fields(Summary):
        found = entry[field.name]
        if field.type is Estimate:
            missing = math.inf if field.name.endswith(("_km", "_ms")) else math.nan
            ends = {end: missing if found[end] is None else float(found[end]) for end in ("value", "low", "high")}
            values[field.name] = Estimate(n=int(found["n"]), **ends)
        else:
            values[field.name] = int(found)
    return Summary(**values)


def _summary_paths(out: Path) -> list[Path]:
    return sorted(path for path in out.glob("*.json") if path.is_file() and not path.name.startswith("."))


def _fingerprint(provenance: RunProvenance) -> tuple[str, str]:
    return provenance.scenario_sha256, provenance.truth_sha256


def read_summary(path: Path) -> tuple[dict[str, Any], RunProvenance]:
    """Read a solver's summary file.

    Raises
    ------
    ResultsError
        It is damaged, of another format or other definitions, or not of the solver whose name it bears.
    """
    try:
        summary = json.loads(path.read_text(encoding="utf-8"))
        found, solver = (summary["format"], summary["definitions"]), summary["solver"]
        provenance = RunProvenance(**summary["provenance"])
    except (ValueError, KeyError, TypeError, OSError) as error:
        raise ResultsError(f"{path}: not a readable result ({error!r}); delete it or {_RUN_AGAIN}") from error
    if found != (RESULT_FORMAT, DEFINITIONS):
        raise ResultsError(f"{path}: is {found}, this version reads {(RESULT_FORMAT, DEFINITIONS)}; {_RUN_AGAIN}")
    owned = path.parent.name.startswith(f"{solver}-") if path.name == SUMMARY_NAME else path.stem == solver
    if not isinstance(solver, str) or not owned:
        raise ResultsError(f"{path}: holds a result of {solver!r}, which its name does not say; {_RUN_AGAIN}")
    check_solver_name(solver)
    return summary, provenance


def _read_result(files: ResultFiles) -> SolverResult:
    summary, provenance = read_summary(files.summary)
    try:
        overall = _summary_from_json(summary["overall"])
        bortle = tuple((entry["bortle"], _summary_from_json(entry)) for entry in summary["by_bortle"])
    except (KeyError, TypeError, ValueError) as error:
        raise ResultsError(f"{files.summary}: its summary is damaged ({error!r}); {_RUN_AGAIN}") from error
    scores = []
    for row in _read_rows(files.frames):
        values = {field.name: row[field.name] for field in dataclasses.fields(FrameScore)}
        values["error_km"] = math.inf if values["error_km"] is None else values["error_km"]
        scores.append(FrameScore(**values))
    if summarise(scores) != overall and not _same(summarise(scores), overall):
        raise ResultsError(f"{files.frames}: does not belong to {files.summary.name}; {_RUN_AGAIN}")
    detections: tuple[DetectionRow, ...] = ()
    if provenance.task is None or files.matches.is_file():
        detections = tuple(DetectionRow(**row) for row in _read_rows(files.matches))
    return SolverResult(summary["solver"], provenance, overall, bortle, tuple(scores), detections)


def _same(one: Summary, other: Summary) -> bool:
    """Equality in which an undefined number equals itself."""
    return _summary_to_json(one) == _summary_to_json(other)


def _read_rows(path: Path) -> list[dict[str, Any]]:
    try:
        rows: list[dict[str, Any]] = pq.read_table(path).to_pylist()
    except (pa.ArrowInvalid, OSError) as error:
        raise ResultsError(f"{path}: missing or damaged ({error}); {_RUN_AGAIN}") from error
    return rows


def _count(values: Iterable[str]) -> dict[str, int]:
    names, counts = np.unique(np.asarray(list(values), dtype=str), return_counts=True)
    return {str(name): int(count) for name, count in zip(names, counts, strict=True)}
