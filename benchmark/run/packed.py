"""Packed results: all solvers' answers to one set of frames in one Parquet file, and where each comes from beside it.

``PART.parquet`` has a row to each frame: its circumstances once, and in the column ``answers`` a list with a structure to
each solver, in the order of the rows of ``PART.json``; null where a solver was not given that frame. ``PART.json`` holds
a provenance for each row and the SHA-256 of the table that it belongs to, so that neither changes alone.

Covariances, times, memory and the components of errors are kept in single precision, which is more than any page prints.
Positions, the solver's own account of its stages and its detections are not kept: a run makes them again.
"""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from benchmark.errors import ResultsError

PACK_FORMAT = "skybench-packed/1"
ANSWERS = "answers"
_FRAME_COLUMNS = (
    "frame_id",
    "index",
    "bortle",
    "width_px",
    "height_px",
    "zenith_mag_arcsec2",
    "true_latitude_deg",
    "true_longitude_deg",
    "utc_mid",
    "exposure_s",
    "n_in_field",
    "condition",
    "site",
    "limiting_magnitude",
    "moon_altitude_deg",
    "moon_illuminated",
    "cloud_optical_depth",
    "rate_deg_s",
    "fov_deg",
    "image_sha256",
    "truth_sha256",
)
_ANSWER_COLUMNS = {
    "status": pa.string(),
    "reason": pa.string(),
    "error_km": pa.float64(),  # solvers with the same stars differ in its last digits, and who is closer counts
    "error_east_km": pa.float32(),
    "error_north_km": pa.float32(),
    "cov_ee_km2": pa.float32(),
    "cov_en_km2": pa.float32(),
    "cov_nn_km2": pa.float32(),
    "confidence": pa.float64(),  # its order near 1 counts
    "n_detections": pa.int32(),
    "n_detected_stars": pa.int32(),
    "n_matches": pa.int32(),
    "n_correct": pa.int32(),
    "time_ms": pa.float32(),
    "crlb_km": pa.float32(),
    "peak_memory_mib": pa.float32(),
}


@dataclass(frozen=True, eq=False)
class PackedRow:
    """One solver's result.

    Attributes
    ----------
    solver, detections, key : str
        As in the folder of its raw result.
    provenance : mapping of str to object
        As JSON.
    frames : DataFrame
        As read from its ``frames.parquet``.
    established : str
        How the solver's revision was found where the run did not record it; empty where it did, or where nobody knows.
    """

    solver: str
    detections: str
    key: str
    provenance: Mapping[str, Any]
    frames: pd.DataFrame
    established: str = ""


def pack(rows: Sequence[PackedRow]) -> tuple[bytes, bytes]:
    """Put results on the same frames into one table.

    Parameters
    ----------
    rows : sequence of PackedRow
        Their frames may be fewer than the others', but not different.

    Returns
    -------
    tuple of (bytes, bytes)
        The table (Parquet) and what it holds (JSON).

    Raises
    ------
    ResultsError
        Two of them disagree about a frame.
    """
    largest = max(rows, key=lambda row: len(row.frames))
    frames = _frame_part(largest.frames)
    for row in rows:
        _check_same(largest, row, frames)
    ids = frames.index
    columns = [_spread(row.frames, ids) for row in rows]
    structs = pa.StructArray.from_arrays(
        [_interleaved([column[name] for column in columns], kind) for name, kind in _ANSWER_COLUMNS.items()],
        fields=[pa.field(name, kind) for name, kind in _ANSWER_COLUMNS.items()],
        mask=pa.array(np.column_stack([column["absent"] for column in columns]).ravel()),
    )
    offsets = pa.array(np.arange(len(ids) + 1) * len(rows), type=pa.int32())
    table = pa.Table.from_pandas(frames.reset_index(), preserve_index=False).replace_schema_metadata(None)
    table = table.append_column(ANSWERS, pa.ListArray.from_arrays(offsets, structs))
    content = _parquet(table)
    listed = [
        {
            "solver": row.solver,
            "detections": row.detections,
            "key": row.key,
            "revision_established": row.established,
            "provenance": dict(row.provenance),
        }
        for row in rows
    ]
    head = {"format": PACK_FORMAT, "table_sha256": hashlib.sha256(content).hexdigest()}
    lines = ",\n".join(json.dumps(row, ensure_ascii=False, allow_nan=False, separators=(",", ":")) for row in listed)
    return content, f'{json.dumps(head)[:-1]}, "rows": [\n{lines}\n]}}\n'.encode()


def read_packed(listing: Path) -> list[PackedRow]:
    """Read a packed table by its ``PART.json``.

    Raises
    ------
    ResultsError
        It is damaged, or does not belong to the table beside it.
    """
    path = listing.with_suffix(".parquet")
    try:
        tree = json.loads(listing.read_text(encoding="utf-8"))
        if tree["format"] != PACK_FORMAT:
            raise ResultsError(f"{listing}: is {tree['format']!r}, this version reads {PACK_FORMAT!r}")
        content = path.read_bytes()
        if hashlib.sha256(content).hexdigest() != tree["table_sha256"]:
            raise ResultsError(
                f"{path}: was changed after it was packed ({listing.name} states another SHA-256); restore both, or run "
                "the solvers again and pack them"
            )
        table = pq.read_table(io.BytesIO(content))
        listed = [
            (
                str(row["solver"]),
                str(row["detections"]),
                str(row["key"]),
                row["provenance"],
                row["revision_established"],
            )
            for row in tree["rows"]
        ]
        answers = table[ANSWERS].combine_chunks()
        if (np.diff(answers.offsets.to_numpy()) != len(listed)).any():
            raise ValueError(f"lists of other lengths than {len(listed)}")
        frames = table.drop_columns([ANSWERS]).to_pandas()
        given = answers.values
        found = []
        for place, (solver, detections, key, provenance, established) in enumerate(listed):
            mine = given.take(pa.array(np.arange(place, len(given), len(listed))))
            columns = {name: mine.field(name).to_pandas() for name in _ANSWER_COLUMNS}
            whole = pd.concat([frames, pd.DataFrame(columns)], axis=1)
            kept = whole[mine.is_valid().to_numpy(zero_copy_only=False)].reset_index(drop=True)
            found.append(PackedRow(solver, detections, key, provenance, kept, established))
    except (ValueError, KeyError, TypeError, AttributeError, OSError, pa.ArrowException) as error:
        raise ResultsError(f"{listing}: not readable packed results ({error!r}); restore it and {path.name}") from error
    return found


def _frame_part(frames: pd.DataFrame) -> pd.DataFrame:
    return frames[[name for name in _FRAME_COLUMNS if name in frames]].set_index("frame_id")


def _check_same(largest: PackedRow, row: PackedRow, frames: pd.DataFrame) -> None:
    mine = _frame_part(row.frames)
    if mine.index.isin(frames.index).all() and mine.equals(frames.loc[mine.index]):
        return
    raise ResultsError(
        f"{row.solver}-{row.key} and {largest.solver}-{largest.key} ({row.detections} and {largest.detections} "
        "detections): their frames differ, so that they cannot be packed; run the older one again"
    )


def _spread(frames: pd.DataFrame, ids: pd.Index) -> dict[str, pd.Series]:
    """One solver's columns over all frames."""
    spread = frames.set_index("frame_id").reindex(ids)
    columns = {name: spread[name] for name in _ANSWER_COLUMNS}
    return columns | {"absent": pd.Series(~ids.isin(frames["frame_id"]), index=ids)}


def _interleaved(columns: Sequence[pd.Series], kind: pa.DataType) -> pa.Array:
    """Frame after frame, each with all solvers' values."""
    stacked = pd.concat(list(columns), axis=1).to_numpy(dtype=object).ravel()
    return pa.array([None if pd.isna(value) else value for value in stacked], type=kind)


def _parquet(table: pa.Table) -> bytes:
    sink = pa.BufferOutputStream()
    split = [f"{ANSWERS}.list.element.{name}" for name, kind in _ANSWER_COLUMNS.items() if pa.types.is_floating(kind)]
    encoded = {name: "BYTE_STREAM_SPLIT" for name in split if not name.endswith("crlb_km")}
    plain = [
        *table.drop_columns([ANSWERS]).column_names,
        *(f"{ANSWERS}.list.element.{name}" for name in ("status", "reason", "crlb_km", "peak_memory_mib")),
    ]
    encoded.pop(f"{ANSWERS}.list.element.peak_memory_mib")
    pq.write_table(table, sink, compression="zstd", compression_level=15, use_dictionary=plain, column_encoding=encoded)
    return bytes(sink.getvalue().to_pybytes())
