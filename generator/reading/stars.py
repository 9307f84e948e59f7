"""Tables of stars, of rendered frames and of photographs; values that are unknowable for a photograph are empty."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from pathlib import Path

import pyarrow as pa

from generator.errors import GeneratorError
from generator.reading.table import read_table

PHOTOGRAPHS = {b"truth": b"photographs"}
"""Metadata of a table of stars in photographs."""
UNKNOWN_OF_PHOTOGRAPHS = frozenset(
    {
        "light_u_px", "light_v_px", "electrons_e", "snr", "saturated", "occluded", "hidden_fraction",
        "cloud_optical_depth", "cloud_transmission", "scintillation",
    }
)  # fmt: skip
"""Columns that may be empty, but only in the table of photographs."""


def photograph_schema(schema: pa.Schema) -> pa.Schema:
    """The schema of stars for photographs: columns that may be unknown are nullable, and the metadata mark the table."""
    fields = [field.with_nullable(field.name in UNKNOWN_OF_PHOTOGRAPHS) for field in schema]
    return pa.schema(fields, metadata={**(schema.metadata or {}), **PHOTOGRAPHS})


def read_stars(
    path: Path, schema: pa.Schema, *, needed: Collection[str] = (), columns: Collection[str] | None = None
) -> pa.Table:
    """Read a table of stars; only a table marked as one of photographs may have empty cells.

    Parameters
    ----------
    path : Path
    schema : pyarrow.Schema
        Schema for rendered stars.
    needed, columns
        As for `generator.reading.table.read_table`.

    Raises
    ------
    GeneratorError
        The file is damaged, or not a table of stars; the message names the file and the column.
    """
    table = read_table(path, photograph_schema(schema), needed=needed, columns=columns)
    if PHOTOGRAPHS.items() <= (table.schema.metadata or {}).items():
        return table
    for name in table.column_names:
        if empty := table[name].null_count:
            raise GeneratorError(f"{path}: column {name} has {empty} empty cells; it may have none")
    return table


def missing_rows(place: str, stated: Mapping[int, int], rows: Mapping[int, int]) -> Iterator[str]:
    """Yield contradictions between frame records and a table of stars, one line each.

    Parameters
    ----------
    place : str
        The table's name for messages.
    stated : mapping of int to int
        ``stars.n_in_field`` of the frame records, by frame indices.
    rows : mapping of int to int
        Rows of the table, by frame indices.
    """
    for index in sorted(stated.keys() | rows.keys()):
        if (have := rows.get(index, 0)) != (want := stated.get(index, 0)):
            yield f"{place}: has {have} rows of frame-{index:05d}, its record says {want}; make the frames anew"
