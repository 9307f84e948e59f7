"""Tables from other parties: a Parquet file is read only if its footer fits its schema and its size.

A Parquet file of a few megabytes can contain billions of equal values. The tables of a dataset contain places in an
image, which do not repeat, so a file that unpacks to much more than its size is not one of them. Its pages are checked
against its footer.
"""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from generator.errors import GeneratorError
from generator.reading.parquet_pages import check_pages

FREE_BYTES = 128 * 2**20
"""Bytes in memory allowed for any table: 200,000 stars, 50,000 frames or a million readings, however alike they are."""
MOST_EXPANSION = 32
"""Ratio of bytes in memory to bytes in the file allowed beyond that; tables of stars reach 7, of frames 8."""
LONGEST_TEXT_BYTES = 1000
"""Longest text of a cell; hashes have 64 bytes, times 27, names of scenarios some tens."""
_USUAL_TEXT_BYTES = 100
MOST_LIST_ITEMS = 32
"""Mean number of list items allowed per cell: a matrix has 9 numbers, the coefficients of a lens at most 32."""
_VALUE_BYTES = 8
_LARGEST_FOOTER_BYTES = 10_000_000
_MOST_FOOTER_ITEMS = 1_000_000


def read_table(
    path: Path,
    schema: pa.Schema,
    *,
    needed: Collection[str] = (),
    columns: Collection[str] | None = None,
    never_null: Collection[str] = (),
    most_rows: int | None = None,
) -> pa.Table:
    """Read a table's known columns.

    Parameters
    ----------
    path : Path
    schema : pyarrow.Schema
        Columns that the table may have; a number may be stored wider or narrower, and is returned as stored. Other columns
        are not read.
    needed : collection of str
        Columns that the table must have.
    columns : collection of str, optional
        Columns to read; by default all columns of the schema that exist.
    never_null : collection of str
        Columns without empty cells, in addition to those that the schema marks.
    most_rows : int, optional

    Raises
    ------
    GeneratorError
        The file is damaged, or not a table of this schema; the message names the file and the column.
    """
    wanted = [name for name in schema.names if columns is None or name in columns]
    try:
        size = path.stat().st_size
        with _opened(path) as plain:
            found = plain.schema_arrow
            missing = [name for name in needed if name not in found.names]
            if missing:
                raise GeneratorError(f"{path}: column {missing[0]} is missing (docs/dataset_format.md)")
            names = [name for name in wanted if name in found.names]
            for name in names:
                _check_type(path, found.field(name), schema.field(name).type)
            _check_size(path, plain.metadata, pa.schema([found.field(name) for name in names]), size, most_rows)
            check_pages(path, plain.metadata, names)
        # A repeated string is held once until its length is known.
        texts = [name for name in names if _is_text(found.field(name).type)]
        with _opened(path, texts) as file:
            table = file.read(columns=names)
        for name in texts:
            place = table.schema.get_field_index(name)
            plain_field = found.field(name).with_type(pa.string())
            table = table.set_column(place, plain_field, _plain_text(path, table[name], name, size))
    except (OSError, pa.ArrowException, ValueError, OverflowError) as error:
        raise GeneratorError(f"{path}: not a readable Parquet file ({str(error)[:300]})") from error
    for name in names:
        if table[name].null_count and (name in never_null or not schema.field(name).nullable):
            raise GeneratorError(f"{path}: column {name} has {table[name].null_count} empty cells; it may have none")
    return table.replace_schema_metadata(found.metadata)


def check_claims(path: Path) -> None:
    """Check a table of any form by its footer and its pages, before it is read.

    Raises
    ------
    GeneratorError
        The table states more values than a file of its size may contain, or is damaged.
    """
    try:
        with _opened(path) as file:
            claimed, names = file.metadata, file.schema_arrow.names
        groups = [claimed.row_group(group) for group in range(claimed.num_row_groups)]
        columns = [group.column(place) for group in groups for place in range(group.num_columns)]
        unpacked = sum(max(column.total_uncompressed_size, _VALUE_BYTES * column.num_values) for column in columns)
        size = path.stat().st_size
        if unpacked > 2 * _most_bytes(size):
            raise GeneratorError(
                f"{path}: claims {unpacked // 10**6} MB in a file of {size / 1e6:.1f} MB; it is not read"
            )
        check_pages(path, claimed, names)
    except (OSError, pa.ArrowException, ValueError, OverflowError) as error:
        raise GeneratorError(f"{path}: not a readable Parquet file ({str(error)[:300]})") from error


def _opened(path: Path, texts: Collection[str] = ()) -> pq.ParquetFile:
    return pq.ParquetFile(
        path,
        read_dictionary=list(texts),
        thrift_string_size_limit=_LARGEST_FOOTER_BYTES,
        thrift_container_size_limit=_MOST_FOOTER_ITEMS,
    )


def _check_type(path: Path, found: pa.Field, wanted: pa.DataType) -> None:
    if _kind(found.type) != _kind(wanted) and (_kind(found.type), _kind(wanted)) != ("integer", "number"):
        raise GeneratorError(f"{path}: column {found.name} is of type {str(found.type)[:100]}, not {wanted}")


def _kind(kind: pa.DataType) -> str:
    """Kind of values in a column, regardless of their storage width."""
    if _is_text(kind):
        return "text"
    if pa.types.is_list(kind) or pa.types.is_fixed_size_list(kind) or pa.types.is_large_list(kind):
        return f"list of {_kind(kind.value_type)}"
    if pa.types.is_integer(kind):
        return "integer"
    return "number" if pa.types.is_floating(kind) else str(kind)


def _is_text(kind: pa.DataType) -> bool:
    if pa.types.is_dictionary(kind):
        return _is_text(kind.value_type)
    return pa.types.is_string(kind) or pa.types.is_large_string(kind)


def _check_size(path: Path, claimed: pq.FileMetaData, schema: pa.Schema, size: int, most_rows: int | None) -> None:
    """Compare the statements of the file's footer with the limits for a file of this size."""
    groups = [claimed.row_group(group) for group in range(claimed.num_row_groups)]
    rows = max(claimed.num_rows, sum(group.num_rows for group in groups))
    if most_rows is not None and rows > most_rows:
        raise GeneratorError(f"{path}: has {rows} rows, at most {most_rows} belong there")
    # The column of a list is named after the list: "R_cam.list.element".
    stored = [group.column(place) for group in groups for place in range(group.num_columns)]
    values = [(column.num_values, column.total_uncompressed_size)
              for column in stored if column.path_in_schema.split(".")[0] in schema.names]  # fmt: skip
    lists = sum(_kind(kind).startswith("list") for kind in schema.types)
    if values and max(count for count, _ in values) > rows * (MOST_LIST_ITEMS if lists else 1):
        raise GeneratorError(f"{path}: a column claims more values than its {rows} rows can have")
    unpacked = max(rows * sum(_width(kind) for kind in schema.types), sum(size_of for _, size_of in values))
    if unpacked > _most_bytes(size):
        raise GeneratorError(
            f"{path}: claims {rows} rows, which take {unpacked // 10**6} MB, in a file of {size / 1e6:.1f} MB; "
            "no table of a dataset is so empty, and it is not read"
        )


def _most_bytes(size: int) -> int:
    """Memory that a table in a file of `size` bytes may take."""
    return FREE_BYTES + MOST_EXPANSION * size


def _width(kind: pa.DataType) -> int:
    """Largest size of a cell in memory; for a string, the usual size."""
    if _is_text(kind):
        return _USUAL_TEXT_BYTES
    if _kind(kind).startswith("list"):
        return MOST_LIST_ITEMS * _width(kind.value_type)
    return max(1, int(kind.bit_width) // 8)


def _plain_text(path: Path, column: pa.ChunkedArray, name: str, size: int) -> pa.ChunkedArray:
    """Return a column's strings after checking that they are short."""
    for chunk in column.chunks:
        words = chunk.dictionary if pa.types.is_dictionary(chunk.type) else chunk
        longest = pc.max(pc.binary_length(words)).as_py() or 0
        if longest > LONGEST_TEXT_BYTES or longest * len(column) > _most_bytes(size):
            raise GeneratorError(f"{path}: column {name} has a text of {longest} bytes, more than belongs there")
    return column.cast(pa.string())
