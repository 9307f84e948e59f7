"""Reading an untrusted Parquet file in a separate process with limited memory and time.

A small file can claim enormous columns, and a damaged one can crash its reader. Run as a program, this module reads a file
from standard input and writes an Arrow stream of plain columns (texts, integers, floating-point numbers), or exits with
status 1 and a reason.
"""

from __future__ import annotations

import io
import json
import resource
import subprocess
import sys

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.ipc as ipc
import pyarrow.parquet as pq

MEMORY_BYTES = 3 * 2**30
CPU_SECONDS = 60
MOST_COLUMNS = 32
MOST_ROW_GROUPS = 10_000
LARGEST_UNPACKED_BYTES = 256 * 2**20
_THRIFT_TEXT_BYTES = 1_000_000
_THRIFT_ITEMS = 1_000_000
_BATCH_ROWS = 4096
_NUMBERS = {"INT32", "INT64", "FLOAT", "DOUBLE"}


class GuardError(Exception):
    """The file cannot be read within the limits; the message is safe to print."""


def read_guarded(content: bytes, max_rows: int, longest_text: int) -> pa.Table:
    """Read a Parquet file of flat columns.

    Parameters
    ----------
    content : bytes
        The file.
    max_rows : int
    longest_text : int
        Length of the longest text, in characters.

    Returns
    -------
    pyarrow.Table
        Columns of type string, int64 or double.

    Raises
    ------
    GuardError
    """
    limits = json.dumps({"max_rows": max_rows, "longest_text": longest_text})
    try:
        run = subprocess.run(
            [sys.executable, "-I", "-c", _CHILD, json.dumps(sys.path), limits],
            input=content,
            capture_output=True,
            timeout=2 * CPU_SECONDS,
            check=False,
        )
    except subprocess.TimeoutExpired as error:
        raise GuardError(f"takes longer than {2 * CPU_SECONDS} s to read") from error
    if run.returncode == 1 and run.stdout.startswith(b"refused: "):
        raise GuardError(run.stdout.decode("ascii", "replace").removeprefix("refused: "))
    if run.returncode != 0:
        raise GuardError("is damaged, or needs more memory or time than its content may take")
    try:
        with ipc.open_stream(run.stdout) as stream:
            return stream.read_all()
    except pa.ArrowException as error:
        raise GuardError("is damaged") from error


_CHILD = (
    "import json, sys; sys.path = json.loads(sys.argv[1]); "
    "from benchmark.submit.parquet_guard import serve; serve(**json.loads(sys.argv[2]))"
)


def serve(max_rows: int, longest_text: int) -> None:
    """Read the file in the limited process."""
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
    resource.setrlimit(resource.RLIMIT_CPU, (CPU_SECONDS, CPU_SECONDS))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    pa.set_cpu_count(1)
    pa.set_memory_pool(pa.system_memory_pool())
    try:
        table = _plain_table(sys.stdin.buffer.read(), max_rows, longest_text)
        sink = io.BytesIO()
        with ipc.new_stream(sink, table.schema) as stream:
            stream.write_table(table)
    except GuardError as error:
        sys.stdout.write(f"refused: {error}")
        sys.stdout.flush()
        sys.exit(1)
    except (pa.ArrowException, MemoryError, OSError, UnicodeDecodeError):
        sys.exit(2)
    sys.stdout.buffer.write(sink.getvalue())


def _plain_table(content: bytes, max_rows: int, longest_text: int) -> pa.Table:
    file = pq.ParquetFile(
        pa.BufferReader(content), thrift_string_size_limit=_THRIFT_TEXT_BYTES, thrift_container_size_limit=_THRIFT_ITEMS
    )
    found = file.metadata
    if found.num_rows > max_rows:
        raise GuardError(f"has {found.num_rows} rows, more than {max_rows}")
    if found.num_columns > MOST_COLUMNS or found.num_row_groups > MOST_ROW_GROUPS:
        raise GuardError(f"has more than {MOST_COLUMNS} columns or {MOST_ROW_GROUPS} row groups")
    columns = [found.schema.column(i) for i in range(found.num_columns)]
    for place, column in enumerate(columns):
        flat = column.max_repetition_level == 0 and column.max_definition_level <= 1 and "." not in column.path
        is_text = column.physical_type == "BYTE_ARRAY" and column.logical_type.type in ("STRING", "NONE")
        is_number = column.physical_type in _NUMBERS and column.logical_type.type in ("INT", "NONE")
        if not flat or not (is_text or is_number):
            raise GuardError(f"column {place + 1} is nested or of a type other than text, integer or float")
    groups = range(found.num_row_groups)
    unpacked = sum(found.row_group(g).column(c).total_uncompressed_size for g in groups for c in range(len(columns)))
    if unpacked > LARGEST_UNPACKED_BYTES:
        raise GuardError(f"unpacks to {unpacked} bytes, more than {LARGEST_UNPACKED_BYTES}")
    texts = [column.name for column in columns if column.physical_type == "BYTE_ARRAY"]
    schema = pa.schema(
        [
            (column.name, pa.string() if column.name in texts else
             pa.float64() if column.physical_type in ("FLOAT", "DOUBLE") else pa.int64())
            for column in columns
        ]
    )  # fmt: skip
    batches, rows = [], 0
    for batch in file.iter_batches(batch_size=_BATCH_ROWS, use_threads=False):
        rows += batch.num_rows
        if rows > max_rows:
            raise GuardError(f"has more than {max_rows} rows")
        plain = [_plain_column(batch.column(i), schema.field(i).type, longest_text) for i in range(len(columns))]
        batches.append(pa.record_batch(plain, schema=schema))
    return pa.Table.from_batches(batches, schema=schema)


def _plain_column(array: pa.Array, kind: pa.DataType, longest_text: int) -> pa.Array:
    if pa.types.is_dictionary(array.type):
        array = array.dictionary_decode()
    plain = array.cast(kind)
    plain.validate(full=True)
    if pa.types.is_string(kind):
        longest = pc.max(pc.binary_length(plain)).as_py() or 0
        if longest > 4 * longest_text:
            raise GuardError(f"has a text of {longest} bytes, more than {4 * longest_text}")
    return plain
