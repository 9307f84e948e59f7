"""Reader of untrusted tables, CSV or Parquet, within limits of size.

CSV is read line by line, so that a quote that is never closed spoils one line only. Parquet is read by a separate process
with limited memory and time (`benchmark.submit.parquet_guard`), because it can unpack to far more than the file's size.
"""

from __future__ import annotations

import csv
import errno
import os
import stat
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa

from benchmark.submit.parquet_guard import GuardError, read_guarded

LARGEST_FILE_BYTES = 64 * 2**20
LONGEST_LINE_BYTES = 4096
LONGEST_CELL = 200
MOST_SPARE_LINES = 1000
"""Number of empty and faulty lines that are allowed in addition to the rows."""
PARQUET_MAGIC = b"PAR1"
UTF16_MARKS = (b"\xff\xfe", b"\xfe\xff")
_SEPARATORS = {";": "semicolons", "\t": "tabs", "|": "bars"}
"""Other characters than the comma by which spreadsheets separate cells."""
_COMPRESSED = {b"\x1f\x8b": "gzip", b"PK": "zip", b"BZh": "bzip2", b"\xfd7zXZ": "xz", b"\x28\xb5\x2f\xfd": "zstd"}

Cell = str | float | int | None
Report = Callable[[int, str, str], None]
"""Callback that receives line (0: the whole file), column and reason."""


@dataclass(frozen=True)
class CellTable:
    """Cells of a table that has the expected columns.

    Attributes
    ----------
    columns : tuple of str
        Columns that the file has.
    rows : iterable of (int, dict)
        Line number and cells by column; unreadable lines are left out.
    """

    columns: tuple[str, ...]
    rows: Iterable[tuple[int, dict[str, Cell]]]


def read_cells(path: Path, known: tuple[str, ...], max_rows: int, report: Report) -> CellTable | None:
    """Open a table; faults are reported at once or while its rows are read.

    Parameters
    ----------
    path : Path
        A plain file; a link is not followed.
    known : tuple of str
        Columns that are allowed.
    max_rows : int
    report : callable

    Returns
    -------
    CellTable or None
        None where the file cannot be read.
    """
    content = _content(path, report)
    if content is None:
        return None
    if content.startswith(PARQUET_MAGIC):
        return _parquet(content, known, max_rows, report)
    for magic, name in _COMPRESSED.items():
        if content.startswith(magic):
            report(0, "", f"is compressed ({name}); send the CSV or Parquet file itself")
            return None
    if content.startswith(UTF16_MARKS):
        report(0, "", "is UTF-16 text; save it as UTF-8")
        return None
    if b"\r" in content and b"\n" not in content:
        report(0, "", "ends its lines with carriage returns alone; save it with line feeds (Unix or Windows)")
        return None
    return _csv(content, known, max_rows, report)


def _content(path: Path, report: Report) -> bytes | None:
    try:
        handle = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError as error:
        is_link = error.errno == errno.ELOOP
        report(0, "", "is a link; give the file itself" if is_link else f"cannot be opened ({error.strerror})")
        return None
    try:
        status = os.fstat(handle)
        if not stat.S_ISREG(status.st_mode):
            kind = "a folder" if stat.S_ISDIR(status.st_mode) else "a pipe or a device"
            report(0, "", f"is {kind}; give a CSV or Parquet file")
            return None
        if status.st_size > LARGEST_FILE_BYTES:
            report(
                0, "", f"has {status.st_size} bytes, more than {LARGEST_FILE_BYTES}; Parquet files are smaller than CSV"
            )
            return None
        with open(handle, "rb", closefd=False) as file:
            content = file.read(LARGEST_FILE_BYTES + 1)
    finally:
        os.close(handle)
    if not content or len(content) > LARGEST_FILE_BYTES:
        report(0, "", "is empty" if not content else f"has more than {LARGEST_FILE_BYTES} bytes")
        return None
    return content


def _known_columns(names: list[str], known: tuple[str, ...], report: Report) -> bool:
    for place, name in enumerate(names):
        if name not in known:
            report(1, "", f"column {place + 1} has no known name: found {shown(name)}, expected of {', '.join(known)}")
        elif name in names[:place]:
            report(1, name, "is there twice")
    return len(set(names)) == len(names) and set(names) <= set(known)


def _csv(content: bytes, known: tuple[str, ...], max_rows: int, report: Report) -> CellTable | None:
    if content.count(b"\n") > max_rows + MOST_SPARE_LINES:
        report(0, "", f"has more than {max_rows + MOST_SPARE_LINES} lines")
        return None
    lines = _lines(content.removeprefix(b"\xef\xbb\xbf"), report)
    for line, cells in lines:
        names = [cell.strip(" ") for cell in cells]
        separator = _separator_of(names, known)
        if separator is not None:
            report(line, "", f"cells are separated by {separator}; separate them by commas, and write 1.5, not 1,5")
            return None
        if line == 1 and not set(names) & set(known):
            report(1, "", f"is no header: found {shown(','.join(cells))}, expected {','.join(known)}")
            return None
        if line != 1:
            report(1, "", f"expected the header {','.join(known)}")
        return (
            CellTable(tuple(names), _csv_rows(lines, names, max_rows, report))
            if line == 1 and _known_columns(names, known, report)
            else None
        )
    report(1, "", f"expected the header {','.join(known)}")
    return None


def _separator_of(names: list[str], known: tuple[str, ...]) -> str | None:
    """Name of the character that separates the header's cells, where it is not the comma."""
    if len(names) > 1 or not names:
        return None
    for character, word in _SEPARATORS.items():
        if any(name.strip(' "') in known for name in names[0].split(character)[1:]):
            return word
    return None


def _csv_rows(
    lines: Iterator[tuple[int, list[str]]], names: list[str], max_rows: int, report: Report
) -> Iterator[tuple[int, dict[str, Cell]]]:
    for count, (line, cells) in enumerate(lines):
        if count >= max_rows:
            report(line, "", f"more than {max_rows} rows; the rest is not read")
            return
        if len(cells) != len(names):
            report(line, "", f"has {len(cells)} cells, the header {len(names)}")
            continue
        yield line, dict(zip(names, cells, strict=True))


def _lines(content: bytes, report: Report) -> Iterator[tuple[int, list[str]]]:
    """Yield the cells of each readable line, with its number; empty lines are skipped."""
    start, number = 0, 0
    while start < len(content):
        end = content.find(b"\n", start)
        end = len(content) if end < 0 else end
        raw, start, number = content[start:end].removesuffix(b"\r"), end + 1, number + 1
        if not raw.strip():
            continue
        if len(raw) > LONGEST_LINE_BYTES:
            report(number, "", f"has {len(raw)} bytes, more than {LONGEST_LINE_BYTES}")
            continue
        try:
            (cells,) = csv.reader([raw.decode("utf-8")], strict=True)
        except UnicodeDecodeError:
            report(number, "", "is not UTF-8 text; save the file as UTF-8")
            continue
        except (csv.Error, ValueError):
            report(number, "", "is not a line of CSV: a quote is not closed, or a character is not allowed")
            continue
        if "\0" in "".join(cells) or any(len(cell) > LONGEST_CELL for cell in cells):
            report(number, "", f"has a cell of more than {LONGEST_CELL} characters, or a zero byte")
            continue
        yield number, cells


def _parquet(content: bytes, known: tuple[str, ...], max_rows: int, report: Report) -> CellTable | None:
    try:
        table = read_guarded(content, max_rows, LONGEST_CELL)
    except GuardError as error:
        report(0, "", str(error))
        return None
    if not _known_columns(table.column_names, known, report):
        return None
    return CellTable(tuple(table.column_names), _parquet_rows(table))


def _parquet_rows(table: pa.Table) -> Iterator[tuple[int, dict[str, Cell]]]:
    line = 0
    for batch in table.to_batches(max_chunksize=10_000):
        for row in batch.to_pylist():
            line += 1
            yield line, row


def shown(cell: Cell) -> str:
    """A cell made safe to print: short, quoted, with every character outside ASCII escaped."""
    if cell is None or cell == "":
        return "nothing"
    if not isinstance(cell, str):
        return repr(cell)
    return ascii(cell[:60]) + ("..." if len(cell) > 60 else "")
