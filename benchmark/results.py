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

from benchmark.dataset import FrameConditions
from benchmark.errors import ResultsError
from benchmark.intervals import CONFIDENCE, Estimate
from benchmark.metrics import DEFINITIONS, FrameScore, Summary, by_bortle, summarise

RESULT_FORMAT = "skybench-result/1"
PREVIEW_FOLDER = "previews"
_SOLVER_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._@+-]{0,99}")
_RUN_AGAIN = "run `skybench bench run` again"


@dataclass(frozen=True)
class DetectionRow:
    """One detection of one frame; `flux` is None where unknown, `star_id` and `correct` where it is not identified."""

    frame_id: str
    detection: int
    u_px: float
    v_px: float
    flux: float | None
    star_id: int | None
    correct: bool | None


@dataclass(frozen=True)
class FrameDetails:
    """What is recorded of a frame beside its score: covariance (ee, en, nn; km^2), confidence, times, conditions."""

    cov_km2: tuple[float, float, float] | None
    confidence: float | None
    detect_ms: float
    solve_ms: float
    stage_ms: Mapping[str, float]
    utc: str
    conditions: FrameConditions


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


def write_result(
    out: Path,
    solver: str,
    scores: Sequence[FrameScore],
    details: Sequence[FrameDetails],
    detections: Sequence[DetectionRow],
    provenance: RunProvenance,
) -> None:
    """Write ``<solver>.parquet``, ``<solver>-matches.parquet`` and, last, ``<solver>.json``."""
    check_solver_name(solver)
    out.mkdir(parents=True, exist_ok=True)
    stamp = json.dumps({"format": RESULT_FORMAT, "solver": solver, **dataclasses.asdict(provenance)}, allow_nan=False)
    metadata = {b"skybench": stamp.encode()}
    _write_parquet(out / f"{solver}.parquet", _frame_table(scores, details).replace_schema_metadata(metadata))
    _write_parquet(out / f"{solver}-matches.parquet", _match_table(detections).replace_schema_metadata(metadata))
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
    write_atomically(out / f"{solver}.json", text.encode())


def read_results(out: Path) -> list[SolverResult]:
    """Read all solvers' results in a folder, sorted by name.

    Raises
    ------
    ResultsError
        The folder holds none, a file is damaged, or the results are not of one dataset and one set of definitions.
    """
    results = [_read_result(path) for path in _summary_paths(out)]
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
        if _fingerprint(_read_summary(path)[1]) != (scenario_sha256, truth_sha256):
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
    pq.write_table(table, sink)
    write_atomically(path, sink.getvalue().to_pybytes())


def _finite(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else float(value)


def _frame_table(scores: Sequence[FrameScore], details: Sequence[FrameDetails]) -> pa.Table:
    columns: list[tuple[str, Any, str, list[Any]]] = [
        ("frame_id", pa.string(), "", [s.frame_id for s in scores]),
        ("index", pa.int32(), "", [s.index for s in scores]),
        ("bortle", pa.int32(), "", [s.bortle for s in scores]),
        ("width_px", pa.int32(), "px", [s.width_px for s in scores]),
        ("height_px", pa.int32(), "px", [s.height_px for s in scores]),
        ("zenith_mag_arcsec2", pa.float64(), "mag arcsec-2", [d.conditions.zenith_mag_arcsec2 for d in details]),
        ("true_latitude_deg", pa.float64(), "deg", [d.conditions.latitude_deg for d in details]),
        ("true_longitude_deg", pa.float64(), "deg", [d.conditions.longitude_deg for d in details]),
        ("utc_mid", pa.string(), "", [d.utc for d in details]),
        ("exposure_s", pa.float64(), "s", [d.conditions.exposure_s for d in details]),
        ("n_in_field", pa.int32(), "", [d.conditions.n_in_field for d in details]),
        ("status", pa.string(), "", [s.status for s in scores]),
        ("reason", pa.string(), "", [s.reason for s in scores]),
        ("lat_deg", pa.float64(), "deg", [s.lat_deg for s in scores]),
        ("lon_deg", pa.float64(), "deg", [s.lon_deg for s in scores]),
        ("error_km", pa.float64(), "km", [_finite(s.error_km) for s in scores]),
        ("cov_ee_km2", pa.float64(), "km2", [d.cov_km2[0] if d.cov_km2 else None for d in details]),
        ("cov_en_km2", pa.float64(), "km2", [d.cov_km2[1] if d.cov_km2 else None for d in details]),
        ("cov_nn_km2", pa.float64(), "km2", [d.cov_km2[2] if d.cov_km2 else None for d in details]),
        ("confidence", pa.float64(), "", [_finite(d.confidence) for d in details]),
        ("n_detections", pa.int32(), "", [s.n_detections for s in scores]),
        ("n_detected_stars", pa.int32(), "", [s.n_detected_stars for s in scores]),
        ("n_matches", pa.int32(), "", [s.n_matches for s in scores]),
        ("n_correct", pa.int32(), "", [s.n_correct for s in scores]),
        ("time_ms", pa.float64(), "ms", [s.time_ms for s in scores]),
        ("detect_ms", pa.float64(), "ms", [d.detect_ms for d in details]),
        ("solve_ms", pa.float64(), "ms", [d.solve_ms for d in details]),
        ("stage_ms", pa.map_(pa.string(), pa.float64()), "ms", [list(d.stage_ms.items()) for d in details]),
    ]
    return _table(columns)


def _match_table(rows: Sequence[DetectionRow]) -> pa.Table:
    columns: list[tuple[str, Any, str, list[Any]]] = [
        ("frame_id", pa.string(), "", [r.frame_id for r in rows]),
        ("detection", pa.int32(), "", [r.detection for r in rows]),
        ("u_px", pa.float64(), "px", [r.u_px for r in rows]),
        ("v_px", pa.float64(), "px", [r.v_px for r in rows]),
        ("flux", pa.float64(), "detector's own", [r.flux for r in rows]),
        ("star_id", pa.int32(), "", [r.star_id for r in rows]),
        ("correct", pa.bool_(), "", [r.correct for r in rows]),
    ]
    return _table(columns)


def _table(columns: Sequence[tuple[str, Any, str, list[Any]]]) -> pa.Table:
    schema = pa.schema([pa.field(name, kind, metadata={"unit": unit}) for name, kind, unit, _ in columns])
    return pa.Table.from_arrays([pa.array(values, type=kind) for _, kind, _, values in columns], schema=schema)


def _summary_to_json(summary: Summary) -> dict[str, Any]:
    def entry(value: object) -> object:
        if isinstance(value, Estimate):
            return {"value": _finite(value.value), "low": _finite(value.low), "high": _finite(value.high), "n": value.n}
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


def _read_summary(path: Path) -> tuple[dict[str, Any], RunProvenance]:
    try:
        summary = json.loads(path.read_text(encoding="utf-8"))
        found = summary["format"], summary["definitions"], summary["solver"]
        provenance = RunProvenance(**summary["provenance"])
    except (ValueError, KeyError, TypeError, OSError) as error:
        raise ResultsError(f"{path}: not a readable result ({error!r}); delete it or {_RUN_AGAIN}") from error
    if found != (RESULT_FORMAT, DEFINITIONS, path.stem):
        expected = (RESULT_FORMAT, DEFINITIONS, path.stem)
        raise ResultsError(f"{path}: is {found}, this version reads {expected}; {_RUN_AGAIN}")
    check_solver_name(path.stem)
    return summary, provenance


def _read_result(path: Path) -> SolverResult:
    summary, provenance = _read_summary(path)
    frames_path, matches_path = path.with_suffix(".parquet"), path.with_name(f"{path.stem}-matches.parquet")
    try:
        overall = _summary_from_json(summary["overall"])
        bortle = tuple((entry["bortle"], _summary_from_json(entry)) for entry in summary["by_bortle"])
    except (KeyError, TypeError, ValueError) as error:
        raise ResultsError(f"{path}: its summary is damaged ({error!r}); {_RUN_AGAIN}") from error
    scores = []
    for row in _read_rows(frames_path):
        values = {field.name: row[field.name] for field in dataclasses.fields(FrameScore)}
        values["error_km"] = math.inf if values["error_km"] is None else values["error_km"]
        scores.append(FrameScore(**values))
    if summarise(scores) != overall and not _same(summarise(scores), overall):
        raise ResultsError(f"{frames_path}: does not belong to {path.name}; {_RUN_AGAIN}")
    detections = tuple(DetectionRow(**row) for row in _read_rows(matches_path))
    return SolverResult(path.stem, provenance, overall, bortle, tuple(scores), detections)


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
