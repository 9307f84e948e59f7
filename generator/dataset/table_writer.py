"""Parquet files written while a shard is rendered, so that its truth need not fit into memory."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from generator.files import atomic_path

ROWS_PER_GROUP = 1 << 17
"""Rows per group; about 20 MB of star truth in memory at a time."""
ZSTD_LEVEL = -1
"""Compression level. It takes two thirds of the time of level 1, for files 4 % larger, because most bytes are the ends of
mantissas, which cannot be compressed."""
REPEATED = ("index", "frame_id", "kind", "split", "shard")
"""Columns with few distinct values, stored with a dictionary."""


class TableWriter:
    """Collects tables and writes them in row groups of at least ROWS_PER_GROUP rows.

    The ends of groups depend only on the tables, so the same frames give the same file.
    """

    def __init__(self, writer: pq.ParquetWriter) -> None:
        self._writer = writer
        self._waiting: list[pa.Table] = []
        self._rows = 0

    def add(self, table: pa.Table) -> None:
        """Add rows at the end."""
        self._waiting.append(table)
        self._rows += table.num_rows
        if self._rows >= ROWS_PER_GROUP:
            self.flush()

    def flush(self) -> None:
        """Write the pending rows as one row group."""
        # An empty row group stops the readers of `datasets`; a file without row groups does not.
        if self._rows:
            self._writer.write_table(pa.concat_tables(self._waiting), row_group_size=self._rows)
        self._waiting, self._rows = [], 0


@contextmanager
def table_writer(path: Path, schema: pa.Schema) -> Iterator[TableWriter]:
    """Write a Parquet file of a schema; it receives its final name when the block ends without an error.

    Floating-point columns are stored byte by byte (BYTE_STREAM_SPLIT), which makes them smaller and quicker to compress.
    """
    floats = [field.name for field in schema if pa.types.is_floating(field.type)]
    repeated = [name for name in schema.names if name in REPEATED]
    with (
        atomic_path(path) as temporary,
        pq.ParquetWriter(
            temporary,
            schema,
            compression="zstd",
            compression_level=ZSTD_LEVEL,
            use_dictionary=repeated,
            use_byte_stream_split=floats,
        ) as writer,
    ):
        tables = TableWriter(writer)
        yield tables
        tables.flush()


def write_table(path: Path, table: pa.Table) -> None:
    """Write one table."""
    with table_writer(path, table.schema) as tables:
        tables.add(table)
