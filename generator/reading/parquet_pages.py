"""Check the pages of a Parquet file against the file's footer before anything is unpacked.

Readers allocate the sizes that each page's own header states, whatever the footer states for the column, and a text
column in prefix coding can repeat strings of any length in a few bytes. Page headers are Thrift structures in the compact
protocol (https://github.com/apache/parquet-format: README.md, parquet.thrift; https://github.com/apache/thrift:
doc/specs/thrift-compact-protocol.md).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import pyarrow.parquet as pq

from generator.errors import GeneratorError

LARGEST_HEADER_BYTES = 65536
"""Limit of a page header; with statistics of strings it has some hundred bytes."""
MOST_PAGES = 100_000
"""Limit of the pages of a column in a row group; writers use pages of 1 MB, or of 20,000 rows."""
DELTA_BYTE_ARRAY = 7
"""The encoding in which a string is a number of characters shared with the previous one, and a remainder."""
_DATA, _INDEX, _DICTIONARY, _DATA_V2 = range(4)
_TRUE, _FALSE, _BYTE, _SHORT, _INT, _LONG, _DOUBLE, _BINARY, _LIST, _SET, _MAP, _STRUCT = range(1, 13)
_DEEPEST = 4


@dataclass(frozen=True)
class Page:
    """Statements of a page's header: sizes of the subsequent data (bytes), number of values, encoding."""

    unpacked: int
    packed: int
    values: int
    encoding: int
    is_data: bool


def check_pages(path: Path, metadata: pq.FileMetaData, columns: list[str]) -> None:
    """Compare the headers of columns' pages with the statements of the footer about the columns.

    Parameters
    ----------
    path : Path
    metadata : pyarrow.parquet.FileMetaData
        Metadata from the footer.
    columns : list of str
        Names of the top-level columns that will be read.

    Raises
    ------
    GeneratorError
        A page states more bytes or values than its column has, uses prefix coding, or is not a valid page.
    """
    wanted = set(columns)
    size = path.stat().st_size
    with path.open("rb") as stream:
        for group in range(metadata.num_row_groups):
            row_group = metadata.row_group(group)
            for place in range(row_group.num_columns):
                column = row_group.column(place)
                if column.path_in_schema.partition(".")[0] in wanted:
                    _check_column(f"{path}: column {column.path_in_schema}", stream, column, size)


def _check_column(name: str, stream: BinaryIO, column: Any, size: int) -> None:
    start = column.data_page_offset
    if column.has_dictionary_page and 0 < column.dictionary_page_offset < start:
        start = column.dictionary_page_offset
    end = start + column.total_compressed_size
    if start < 0 or column.total_compressed_size < 0 or end > size:
        raise GeneratorError(f"{name}: lies outside the file")
    unpacked = values = pages = 0
    while values < column.num_values:
        pages += 1
        if start >= end or pages > MOST_PAGES:
            raise GeneratorError(f"{name}: its pages do not hold the values that the footer lists")
        stream.seek(start)
        page, length = _page(name, stream.read(min(LARGEST_HEADER_BYTES, end - start)))
        unpacked += page.unpacked
        values += page.values if page.is_data else 0
        if (
            unpacked > column.total_uncompressed_size
            or values > column.num_values
            or page.values > max(column.num_values, 1)
        ):
            raise GeneratorError(f"{name}: a page claims more than the footer lists; it is not read")
        if page.encoding == DELTA_BYTE_ARRAY:
            raise GeneratorError(f"{name}: texts coded by their prefixes are not read; write it with another encoding")
        start += length + page.packed


def _page(name: str, data: bytes) -> tuple[Page, int]:
    """A page's header and its length in bytes."""
    reader = _Thrift(data)
    try:
        header = reader.struct(_DEEPEST)
    except (IndexError, ValueError) as error:
        raise GeneratorError(f"{name}: has a damaged page") from error
    kind, unpacked, packed = (header.get(key) for key in (1, 2, 3))
    place = {_DATA: 5, _DICTIONARY: 7, _DATA_V2: 8}.get(kind if isinstance(kind, int) else -1)
    inner = header.get(place) if place is not None else {1: 0}
    if not isinstance(inner, dict):
        raise GeneratorError(f"{name}: has a damaged page")
    values, encoding = inner.get(1), inner.get(4 if kind == _DATA_V2 else 2, 0)
    numbers = [number for number in (unpacked, packed, values, encoding) if isinstance(number, int) and number >= 0]
    if len(numbers) != 4:
        raise GeneratorError(f"{name}: has a damaged page")
    return Page(numbers[0], numbers[1], numbers[2], numbers[3], kind in (_DATA, _DATA_V2)), reader.place


class _Thrift:
    """Reader of Thrift's compact protocol: structures become dictionaries by field number; other contents are skipped.

    Reading past the end raises IndexError, and an invalid structure ValueError.
    """

    def __init__(self, data: bytes) -> None:
        self._data = data
        self.place = 0

    def struct(self, levels: int) -> dict[int, Any]:
        if levels == 0:
            raise ValueError("nested too deep")
        fields: dict[int, Any] = {}
        number = 0
        while head := self._byte():
            delta, kind = head >> 4, head & 15
            number = number + delta if delta else self._zigzag()
            fields[number] = self._value(kind, levels)
        return fields

    def _value(self, kind: int, levels: int) -> Any:
        if kind in (_TRUE, _FALSE):
            return kind == _TRUE
        if kind in (_SHORT, _INT, _LONG):
            return self._zigzag()
        if kind == _STRUCT:
            return self.struct(levels - 1)
        if kind == _BYTE:
            self._skip(1)
        elif kind == _DOUBLE:
            self._skip(8)
        elif kind == _BINARY:
            self._skip(self._varint())
        else:
            raise ValueError(f"type {kind} is in no page header")
        return None

    def _byte(self) -> int:
        byte = self._data[self.place]
        self.place += 1
        return byte

    def _varint(self) -> int:
        number = shift = 0
        while True:
            byte = self._byte()
            number |= (byte & 127) << shift
            if byte < 128:
                return number
            shift += 7
            if shift > 63:
                raise ValueError("number of more than 64 bits")

    def _zigzag(self) -> int:
        number = self._varint()
        return (number >> 1) ^ -(number & 1)

    def _skip(self, count: int) -> None:
        self.place += count
        if self.place > len(self._data):
            raise IndexError("past the end")
