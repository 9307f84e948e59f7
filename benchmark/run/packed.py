"""Packed results: all solvers' answers to one set of frames in one Parquet file, with their provenance in a JSON file.

``PART.parquet`` has one row per frame. A row holds the circumstances of the frame once and, in the column ``answers``, a list
with one structure per solver, in the order of the rows of ``PART.json``; null where a solver was not given that frame.
``PART.json`` holds the provenance of each row and the SHA-256 of the table that it belongs to, so neither can change alone.

Numbers are kept to as many binary digits as their use needs (`_DIGITS`), which is more than any page prints. Errors are
truncated towards zero, so that none moves across a limit of whole kilometres; across one of 200 arcsec (6.178 km), which
three tasks have, an error may move by up to 3 cm. Other numbers are rounded. Hashes are stored as bytes. Positions, the
solver's own timing of its stages and its detections are not kept; a new run reproduces them.
"""

from __future__ import annotations

import hashlib
import io
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from benchmark.errors import ResultsError
from benchmark.run.provenance import KEY_DIGITS, DetectionsMode
from benchmark.run.results import check_solver_name
from generator.errors import GeneratorError
from generator.files import read_at_most
from generator.reading.json_text import strict_json
from generator.reading.table import check_claims

PACK_FORMAT = "skybench-packed/1"
LARGEST_LISTING_BYTES = 64 * 2**20
LARGEST_TABLE_BYTES = 2**30
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
    "error_km": pa.float32(),
    "error_east_km": pa.float32(),
    "error_north_km": pa.float32(),
    "cov_ee_km2": pa.float32(),
    "cov_en_km2": pa.float32(),
    "cov_nn_km2": pa.float32(),
    "confidence": pa.float64(),  # full precision, because the order of values near 1 matters
    "n_detections": pa.int32(),
    "n_detected_stars": pa.int32(),
    "n_matches": pa.int32(),
    "n_correct": pa.int32(),
    "time_ms": pa.float32(),
    "crlb_km": pa.float32(),
    "peak_memory_mib": pa.float32(),
}
_ERROR = "error_km"
_DIGITS = {
    _ERROR: 18,
    "error_east_km": 16,
    "error_north_km": 16,
    "cov_ee_km2": 16,
    "cov_en_km2": 16,
    "cov_nn_km2": 16,
    "time_ms": 16,
    "peak_memory_mib": 24,
    "zenith_mag_arcsec2": 24,
    "true_latitude_deg": 24,
    "true_longitude_deg": 24,
    "moon_altitude_deg": 24,
    "moon_illuminated": 24,
}
"""Binary digits that are kept: 18 are 4 to 8 mm of an error of about 1 km, 16 are 1 µs of a time of 50 ms, 24 are single
precision."""
_HASHES = ("image_sha256", "truth_sha256")
_KEY = re.compile(f"[0-9a-f]{{{KEY_DIGITS}}}")


class OtherFramesError(ResultsError):
    """Results for one table are of different frames."""


@dataclass(frozen=True, eq=False)
class PackedRow:
    """The result of one solver.

    Attributes
    ----------
    solver, detections, key : str
        As in the folder of the raw result.
    provenance : mapping of str to object
        As JSON.
    frames : DataFrame
        As read from its ``frames.parquet``.
    established : str
        How the solver's revision was established where the run did not record it; empty where it did, or where it is unknown.
    """

    solver: str
    detections: str
    key: str
    provenance: Mapping[str, Any]
    frames: pd.DataFrame
    established: str = ""


def pack(rows: Sequence[PackedRow]) -> tuple[bytes, bytes]:
    """Pack results on the same frames into one table.

    Parameters
    ----------
    rows : sequence of PackedRow
        Some may have fewer frames than others, but no different ones.

    Returns
    -------
    tuple of (bytes, bytes)
        The table (Parquet) and its listing (JSON).

    Raises
    ------
    OtherFramesError
        Two results disagree about a frame.
    """
    largest, frames = _with_most_frames(rows)
    for row in rows:
        if not _is_on(frames, row):
            raise OtherFramesError(
                f"{row.solver}-{row.key} and {largest.solver}-{largest.key} ({row.detections} and {largest.detections} "
                "detections): their frames differ, so that they cannot be packed; run the older one again, or let "
                "`skybench bench boards --remove-old` remove it"
            )
    ids = frames.index
    columns = [_spread(row.frames, ids) for row in rows]
    structs = pa.StructArray.from_arrays(
        [_interleaved([column[name] for column in columns], kind) for name, kind in _ANSWER_COLUMNS.items()],
        fields=[pa.field(name, kind) for name, kind in _ANSWER_COLUMNS.items()],
        mask=pa.array(np.column_stack([column["absent"] for column in columns]).ravel()),
    )
    offsets = pa.array(np.arange(len(ids) + 1) * len(rows), type=pa.int32())
    table = _as_stored(pa.Table.from_pandas(frames.reset_index(), preserve_index=False).replace_schema_metadata(None))
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
    """Read a packed table, given its ``PART.json``.

    Raises
    ------
    ResultsError
        It is damaged, does not belong to the table next to it, or names a solver by what is no name of a file.
    """
    path = listing.with_suffix(".parquet")
    try:
        tree = strict_json(read_at_most(listing, LARGEST_LISTING_BYTES), str(listing), LARGEST_LISTING_BYTES)
        if tree["format"] != PACK_FORMAT:
            raise ResultsError(f"{listing}: is {tree['format']!r}, this version reads {PACK_FORMAT!r}")
        content = read_at_most(path, LARGEST_TABLE_BYTES)
        if hashlib.sha256(content).hexdigest() != tree["table_sha256"]:
            raise ResultsError(
                f"{path}: was changed after it was packed ({listing.name} states another SHA-256); restore both, or run "
                "the solvers again and pack them"
            )
        check_claims(path)
        table = pq.read_table(io.BytesIO(content))
        listed = [(*_folder_of(row), row["provenance"], row["revision_established"]) for row in tree["rows"]]
        answers = table[ANSWERS].combine_chunks()
        if (np.diff(answers.offsets.to_numpy()) != len(listed)).any():
            raise ValueError(f"lists of other lengths than {len(listed)}")
        frames = _as_read(table.drop_columns([ANSWERS]))
        given = answers.values
        found = []
        for place, (solver, detections, key, provenance, established) in enumerate(listed):
            mine = given.take(pa.array(np.arange(place, len(given), len(listed))))
            columns = {name: mine.field(name).to_pandas() for name in _ANSWER_COLUMNS}
            whole = pd.concat([frames, pd.DataFrame(columns)], axis=1)
            kept = whole[mine.is_valid().to_numpy(zero_copy_only=False)].reset_index(drop=True)
            found.append(PackedRow(solver, detections, key, provenance, kept, established))
    except (GeneratorError, ValueError, KeyError, TypeError, AttributeError, OSError, pa.ArrowException) as error:
        raise ResultsError(f"{listing}: not readable packed results ({error!r}); restore it and {path.name}") from error
    return found


def packed_rows(out: Path, place: Path) -> list[PackedRow]:
    """Read the packed results on a part of some frames (``LABEL/PART``) in a tree; none where it has none."""
    listing = out / place.with_name(f"{place.name}.json")
    return read_packed(listing) if listing.is_file() else []


def _folder_of(row: Mapping[str, Any]) -> tuple[str, str, str]:
    """Solver, mode of detections and key of a listed row, which become parts of file names. Raises ValueError."""
    solver, detections, key = str(row["solver"]), str(row["detections"]), str(row["key"])
    try:
        check_solver_name(solver)
    except ResultsError as error:
        raise ValueError(error) from error
    if detections not in get_args(DetectionsMode) or not _KEY.fullmatch(key):
        raise ValueError(f"{solver}: detections {detections!r}, key {key!r}")
    return solver, detections, key


def _frame_part(frames: pd.DataFrame) -> pd.DataFrame:
    part = frames[[name for name in _FRAME_COLUMNS if name in frames]].set_index("frame_id")
    return part.assign(**{name: _kept(part[name]) for name in _DIGITS if name in part})


def _kept(values: pd.Series) -> pd.Series:
    """Reduce a column to its binary digits; values without further digits stay as they are."""
    digits = _DIGITS[str(values.name)]
    mantissa, exponent = np.frexp(values.to_numpy(dtype=np.float64, na_value=np.nan))
    whole = np.trunc if values.name == _ERROR else np.rint
    return pd.Series(np.ldexp(whole(np.ldexp(mantissa, digits)), exponent - digits), index=values.index)


def _as_stored(frames: pa.Table) -> pa.Table:
    """Convert hashes to bytes, and numbers of few digits to single precision."""
    for place, name in enumerate(frames.column_names):
        if name in _DIGITS:
            frames = frames.set_column(place, name, frames[name].cast(pa.float32()))
        elif name in _HASHES:
            given = [None if text is None else bytes.fromhex(text) for text in frames[name].to_pylist()]
            frames = frames.set_column(place, name, pa.array(given, type=pa.binary(32)))
    return frames


def _as_read(stored: pa.Table) -> pd.DataFrame:
    """Convert circumstances to the types of a run's table; older packed tables hold hashes as text."""
    for place, name in enumerate(stored.column_names):
        if name in _DIGITS:
            stored = stored.set_column(place, name, stored[name].cast(pa.float64()))
        elif name in _HASHES and pa.types.is_fixed_size_binary(stored.schema.field(name).type):
            given = [None if one is None else one.hex() for one in stored[name].to_pylist()]
            stored = stored.set_column(place, name, pa.array(given, type=pa.string()))
    return stored.to_pandas()


def on_same_frames(rows: Sequence[PackedRow], others: Sequence[PackedRow]) -> list[PackedRow]:
    """Those of the rows that can be packed together with the others, which must not be empty."""
    largest, frames = _with_most_frames(others)
    return [row for row in rows if _is_on(frames, row) or _is_on(_frame_part(row.frames), largest)]


def _with_most_frames(rows: Sequence[PackedRow]) -> tuple[PackedRow, pd.DataFrame]:
    largest = max(rows, key=lambda row: len(row.frames))
    return largest, _frame_part(largest.frames)


def _is_on(frames: pd.DataFrame, row: PackedRow) -> bool:
    """Whether all frames of a row are among these, with the same circumstances."""
    mine = _frame_part(row.frames)
    return bool(mine.index.isin(frames.index).all() and mine.equals(frames.loc[mine.index]))


def _spread(frames: pd.DataFrame, ids: pd.Index) -> dict[str, pd.Series]:
    """Extend one solver's columns to all frames."""
    spread = frames.set_index("frame_id").reindex(ids)
    columns = {name: _kept(spread[name]) if name in _DIGITS else spread[name] for name in _ANSWER_COLUMNS}
    return columns | {"absent": pd.Series(~ids.isin(frames["frame_id"]), index=ids)}


def _interleaved(columns: Sequence[pd.Series], kind: pa.DataType) -> pa.Array:
    """Order values frame by frame, each frame with the values of all solvers."""
    stacked = pd.concat(list(columns), axis=1).to_numpy(dtype=object).ravel()
    return pa.array([None if pd.isna(value) else value for value in stacked], type=kind)


def _parquet(table: pa.Table) -> bytes:
    sink = pa.BufferOutputStream()
    split = [
        *(f"{ANSWERS}.list.element.{name}" for name, kind in _ANSWER_COLUMNS.items() if pa.types.is_floating(kind)),
        *(name for name in table.column_names if name in _DIGITS),
    ]
    repeated = [f"{ANSWERS}.list.element.{name}" for name in ("confidence", "crlb_km", "peak_memory_mib")]
    texts = [f"{ANSWERS}.list.element.{name}" for name in ("status", "reason")]
    once = ("site", "utc_mid", *_DIGITS, *_HASHES, ANSWERS)
    pq.write_table(
        table,
        sink,
        compression="zstd",
        compression_level=19,
        use_dictionary=[*(name for name in table.column_names if name not in once), *repeated[1:], *texts],
        column_encoding={name: "BYTE_STREAM_SPLIT" for name in split if name not in repeated},
        write_statistics=False,
    )
    return bytes(sink.getvalue().to_pybytes())
