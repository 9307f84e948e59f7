"""Rows of a study: one contestant's judged answer on one frame."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from benchmark.judge.outcome import SolverOutcome
from benchmark.stats.intervals import Estimate, proportion, quantile_estimate
from benchmark.stats.metrics import SUCCESS_KM
from benchmark.stats.paired_tests import PairedTest, mcnemar_exact
from generator.files import write_bytes

UNITS = {"depth_mag": "mag", "error_km": "km", "detect_ms": "ms", "solve_ms": "ms"}


@dataclass(frozen=True)
class Row:
    """A contestant's answer on one frame.

    Attributes
    ----------
    part : str
        Experiment of the study.
    depth_mag : float
        Limiting magnitude of the frame: the scenario's label for pictures, the end of the star list for centroids.
    frame_id, contestant, status, reason : str
    error_km : float
        Infinite without a fix.
    n_matches, n_correct : int
    confidence : float
        NaN where the solver returns none.
    detect_ms, solve_ms : float
    """

    part: str
    depth_mag: float
    frame_id: str
    contestant: str
    status: str
    reason: str
    error_km: float
    n_matches: int
    n_correct: int
    confidence: float
    detect_ms: float
    solve_ms: float

    @property
    def near(self) -> bool:
        """Whether it is a fix within 10 km, which the thesis counts in its recall."""
        return self.error_km < SUCCESS_KM

    @property
    def identified(self) -> bool:
        """Whether more than half of the named stars are correct."""
        return 2 * self.n_correct > self.n_matches


def row_of(part: str, depth_mag: float, contestant: str, outcome: SolverOutcome, detect_ms: float = 0.0) -> Row:
    """Make a row from a judged outcome."""
    score = outcome.score
    confidence = outcome.details.confidence
    return Row(
        part,
        depth_mag,
        score.frame_id,
        contestant,
        score.status,
        score.reason,
        score.error_km,
        score.n_matches,
        score.n_correct,
        math.nan if confidence is None else confidence,
        detect_ms,
        score.time_ms,
    )


@dataclass(frozen=True)
class Rows:
    """Rows with selections and summaries, in the order in which frames were solved."""

    rows: tuple[Row, ...]

    def of(self, part: str | None = None, contestant: str | None = None, depths: Iterable[float] | None = None) -> Rows:
        """Select the rows of an experiment, of a contestant, of some depths."""
        wanted = None if depths is None else set(depths)
        kept = (
            row
            for row in self.rows
            if (part is None or row.part == part)
            and (contestant is None or row.contestant == contestant)
            and (wanted is None or row.depth_mag in wanted)
        )
        return Rows(tuple(kept))

    def __len__(self) -> int:
        return len(self.rows)

    @property
    def near(self) -> NDArray[np.bool_]:
        """Whether each row is a fix within 10 km, shape (n,)."""
        return np.array([row.near for row in self.rows], dtype=bool)

    @property
    def identified(self) -> NDArray[np.bool_]:
        """Whether the stars of each row are identified, shape (n,)."""
        return np.array([row.identified for row in self.rows], dtype=bool)

    @property
    def errors_km(self) -> NDArray[np.float64]:
        """Error of each row, shape (n,), infinite without a fix."""
        return np.array([row.error_km for row in self.rows], dtype=np.float64)

    @property
    def confidence(self) -> NDArray[np.float64]:
        """Confidence of each row, shape (n,)."""
        return np.array([row.confidence for row in self.rows], dtype=np.float64)

    @property
    def fixed(self) -> NDArray[np.bool_]:
        """Whether each row is a fix, shape (n,)."""
        return np.array([row.status == "fix" for row in self.rows], dtype=bool)

    def recall(self) -> Estimate:
        """Share of frames fixed within 10 km."""
        return proportion(self.near)

    def id_recall(self) -> Estimate:
        """Share of frames whose stars are identified."""
        return proportion(self.identified)

    def median_km(self) -> Estimate:
        """Median error over all frames, with refusals as infinite."""
        return quantile_estimate(self.errors_km, 0.5)

    def median_solve_ms(self) -> Estimate:
        """Median time of solving, without detection."""
        return quantile_estimate([row.solve_ms for row in self.rows], 0.5)

    def p95_solve_ms(self) -> Estimate:
        """95 % quantile of the time of solving, without detection."""
        return quantile_estimate([row.solve_ms for row in self.rows], 0.95)


def near_test(first: Rows, second: Rows) -> PairedTest:
    """McNemar's exact test of the frames fixed within 10 km; both must contain the same frames in the same order."""
    _check_pairs(first, second)
    return mcnemar_exact(first.near, second.near)


def identified_test(first: Rows, second: Rows) -> PairedTest:
    """McNemar's exact test of the frames with identified stars; both must contain the same frames in the same order."""
    _check_pairs(first, second)
    return mcnemar_exact(first.identified, second.identified)


def _check_pairs(first: Rows, second: Rows) -> None:
    if [row.frame_id for row in first.rows] != [row.frame_id for row in second.rows]:
        raise ValueError("rows of different frames, or in another order, cannot be compared in pairs")


def write_rows(path: Path, rows: Sequence[Any], units: Mapping[str, str] = UNITS) -> None:
    """Write rows, instances of one data class, as one Parquet file; units are in the fields' metadata.

    Non-finite numbers become null; times are in single precision.
    """
    kinds = {"str": pa.string(), "float": pa.float64(), "int": pa.int32()}
    # A clock's last digits are noise, and noise cannot be compressed.
    times = {field.name: pa.float32() for field in dataclasses.fields(rows[0]) if field.name.endswith("_ms")}
    fields, columns = [], []
    for field in dataclasses.fields(rows[0]):
        values = [getattr(row, field.name) for row in rows]
        if field.type == "float":
            values = [value if math.isfinite(value) else None for value in values]
        kind = times.get(field.name, kinds[str(field.type)])
        fields.append(pa.field(field.name, kind, metadata={"unit": units.get(field.name, "")}))
        columns.append(pa.array(values, type=fields[-1].type))
    write_table(path, pa.Table.from_arrays(columns, schema=pa.schema(fields)))


def write_table(path: Path, table: pa.Table) -> None:
    """Write a table as one Parquet file, which is complete or absent."""
    sink = pa.BufferOutputStream()
    pq.write_table(table, sink, compression="zstd", compression_level=15)
    write_bytes(path, sink.getvalue().to_pybytes())
