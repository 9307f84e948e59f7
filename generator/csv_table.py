"""Reader of the generator's CSV files: numbers in named columns, of limited size, with errors that name the place."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

LARGEST_ROW_BYTES = 1024
"""Bytes per row, on average over a file; 64 columns of full double precision take less."""
COMMENT = "#"
_LINE = re.compile(r"[^\n]+")
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)


class CsvError(ValueError):
    """The file is not a valid table; the message names the file, line and column, what was found and what is expected."""


@dataclass(frozen=True)
class CsvTable:
    """A table of finite numbers.

    Attributes
    ----------
    columns : tuple of str
    values : (rows, columns) array
    """

    columns: tuple[str, ...]
    values: Floats


def read_csv(
    path: Path,
    name: str,
    columns: Sequence[str] | None = None,
    *,
    least_rows: int = 1,
    most_rows: int,
    increasing: bool = False,
    first_column: Mapping[str, Callable[[str], float]] | None = None,
) -> CsvTable:
    """Read a comma-separated table: UTF-8, one header line, then one line per row; blank lines are skipped.

    Lines before the header may be comments that start with #.

    Parameters
    ----------
    path : Path
        A regular file.
    name : str
        Name of the file in messages.
    columns : sequence of str, optional
        Required columns, in order; without them, any columns are accepted.
    least_rows, most_rows : int
        Allowed range of the number of rows.
    increasing : bool
        Whether the first column must increase from row to row.
    first_column : mapping of str to callable, optional
        For each accepted name of the first column, a function that converts a cell to a number, or raises ValueError
        with the problem.

    Raises
    ------
    CsvError
        The file cannot be read or is not a valid table.
    """
    lines = _lines(path, name, most_rows)
    number, header = next(lines, (1, ""))
    found = tuple(cell.strip() for cell in header.split(","))
    if columns is not None and found != tuple(columns):
        raise CsvError(f"'{name}', line {number}: found the columns {', '.join(found)}, expected {', '.join(columns)}")
    # A row in memory takes many times the bytes of a short line, so reading ends at the first one too many.
    rows = list(islice(lines, most_rows + 1))
    convert = (first_column or {}).get(found[0])
    if not least_rows <= len(rows) <= most_rows:
        count = f"more than {most_rows}" if len(rows) > most_rows else str(len(rows))
        raise CsvError(f"'{name}': found {count} rows of numbers, expected {least_rows} to {most_rows}")
    try:
        converters: dict[int | str, Callable[[str], Any]] | None = None if convert is None else {0: convert}
        values = np.loadtxt([line for _, line in rows], delimiter=",", comments=None, ndmin=2, converters=converters)
    except ValueError as error:
        raise _fault(name, rows, found, convert) or CsvError(f"'{name}': {error}") from error
    if values.shape[1] != len(found) or not np.isfinite(values).all():
        raise _fault(name, rows, found, convert) or CsvError(f"'{name}': holds something that is not a finite number")
    if increasing:
        falling = np.flatnonzero(np.diff(values[:, 0]) <= 0)
        if len(falling):
            before, after = values[falling[0], 0], values[falling[0] + 1, 0]
            raise CsvError(
                f"'{name}', line {rows[falling[0] + 1][0]}, column {found[0]}: found {after:g} after {before:g}, "
                "expected values that increase"
            )
    return CsvTable(found, values)


def _lines(path: Path, name: str, most_rows: int) -> Iterator[tuple[int, str]]:
    """Yield the lines that are neither blank nor leading comments, with their line numbers from 1."""
    limit = LARGEST_ROW_BYTES * (most_rows + 1)
    try:
        if not path.is_file():
            raise CsvError(f"'{name}': not a regular file")
        if path.stat().st_size > limit:
            raise CsvError(f"'{name}': found {path.stat().st_size} bytes, expected at most {limit}")
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise CsvError(f"'{name}': cannot be read ({error.strerror})") from error
    except UnicodeDecodeError as error:
        raise CsvError(f"'{name}': not UTF-8 text ({error.reason} at byte {error.start})") from error
    header_seen = False
    number, counted = 1, 0
    for found in _LINE.finditer(text):
        number, counted = number + text.count("\n", counted, found.start()), found.start()
        line = found[0]
        if line.strip() and (header_seen or not line.startswith(COMMENT)):
            header_seen = True
            yield number, line


def _fault(
    name: str, rows: Sequence[tuple[int, str]], columns: tuple[str, ...], convert: Callable[[str], float] | None
) -> CsvError | None:
    """Describe the first cell that is not a finite number, or the first row with a wrong number of cells."""
    for number, line in rows:
        cells = line.split(",")
        if len(cells) != len(columns):
            return CsvError(f"'{name}', line {number}: found {len(cells)} cells, expected {len(columns)}")
        if convert is not None:
            try:
                convert(cells[0])
            except ValueError as error:
                return CsvError(f"'{name}', line {number}, column {columns[0]}: {error}")
        for column, cell in list(zip(columns, cells, strict=True))[0 if convert is None else 1 :]:
            found = cell.strip()
            if not _NUMBER.fullmatch(found) or not math.isfinite(float(found)):
                short = found[:40]
                return CsvError(f"'{name}', line {number}, column {column}: found {short!r}, expected a finite number")
    return None
