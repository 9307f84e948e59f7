"""Pages of Parquet files are held against the footer: files of any writer pass, files that lie are refused."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from generator.errors import GeneratorError
from generator.reading.parquet_pages import check_pages
from generator.reading.table import read_table

ROWS = 3000
HIDDEN = 2_000_000
"""Values of a forged page: 16 MB, in columns of 24 kB."""
LIST = pa.list_(pa.float64())
SCHEMA = pa.schema([("x", pa.float64()), ("name", pa.string()), ("many", LIST)])
ONE_PAGE = {"data_page_size": 2**31 - 1, "max_rows_per_page": 2**31 - 1, "row_group_size": 2**31 - 1}
FORMS = {
    "plain": {"use_dictionary": False},
    "dictionary": {"use_dictionary": True},
    "version 2": {"data_page_version": "2.0", "compression": "zstd"},
    "version 2, dictionary": {"data_page_version": "2.0", "use_dictionary": True, "compression": "gzip"},
    "row groups": {"row_group_size": 70},
    "many pages": {"data_page_size": 200, "write_batch_size": 20, "max_rows_per_page": 30},
    "checksums and index": {"write_page_checksum": True, "write_page_index": True},
    "uncompressed": {"compression": "none"},
    "no statistics": {"write_statistics": False, "compression": "brotli"},
    "split bytes": {"use_dictionary": False, "column_encoding": {"x": "BYTE_STREAM_SPLIT"}},
}


def columns(rows: int = ROWS) -> pa.Table:
    draws = np.random.default_rng(4)
    values = pa.array(draws.random(rows), mask=draws.random(rows) < 0.1)
    names = pa.array([None if number % 7 == 0 else f"star {number % 100}" * 9 for number in range(rows)], pa.string())
    lists = pa.array([[float(number)] * (number % 4) for number in range(rows)], LIST)
    return pa.table({"x": values, "name": names, "many": lists})


@pytest.mark.parametrize("form", FORMS)
def test_honest_files_pass(tmp_path, form) -> None:
    pq.write_table(columns(), tmp_path / "a.parquet", **FORMS[form])
    check_pages(tmp_path / "a.parquet", pq.read_metadata(tmp_path / "a.parquet"), ["x", "name", "many"])
    assert read_table(tmp_path / "a.parquet", SCHEMA).num_rows == ROWS


@pytest.mark.parametrize("rows", [0, 1])
def test_small_files_pass(tmp_path, rows) -> None:
    pq.write_table(columns(rows), tmp_path / "a.parquet")
    assert read_table(tmp_path / "a.parquet", SCHEMA).num_rows == rows


def test_files_of_another_writer_pass(tmp_path) -> None:
    duckdb = pytest.importorskip("duckdb")
    written = columns()
    for number, codec in enumerate(("snappy", "zstd", "uncompressed")):
        path = tmp_path / f"{number}.parquet"
        duckdb.sql(f"copy (select x, name, many from written) to '{path}' (format parquet, compression {codec})")
        check_pages(path, pq.read_metadata(path), ["x", "name", "many"])
        assert read_table(path, SCHEMA)["x"].to_pylist() == written["x"].to_pylist()


def pages_of(values: pa.Array, **options: object) -> bytes:
    """The pages of a column, as they stand in a file."""
    sink = io.BytesIO()
    pq.write_table(pa.table({"x": values}), sink, compression="zstd", use_dictionary=False, **ONE_PAGE, **options)
    column = pq.ParquetFile(io.BytesIO(sink.getvalue())).metadata.row_group(0).column(0)
    return sink.getvalue()[column.data_page_offset :][: column.total_compressed_size]


def forged(path: Path, pages: bytes) -> Path:
    """A file whose footer lists ROWS values, and whose column x starts with other pages."""
    honest = pa.table({"x": np.random.default_rng(1).random(ROWS)})
    pq.write_table(honest, path, compression="zstd", use_dictionary=False, **ONE_PAGE)
    column = pq.read_metadata(path).row_group(0).column(0)
    assert len(pages) <= column.total_compressed_size
    content = bytearray(path.read_bytes())
    start = column.data_page_offset
    content[start : start + len(pages)] = pages
    path.write_bytes(content)
    return path


@pytest.mark.parametrize("version", ["1.0", "2.0"])
def test_a_page_of_more_than_its_column_is_refused(tmp_path, version) -> None:
    pages = pages_of(pa.array(np.zeros(HIDDEN)), data_page_version=version)
    with pytest.raises(GeneratorError, match=r"a\.parquet: column x: a page claims more than the footer lists"):
        read_table(forged(tmp_path / "a.parquet", pages), SCHEMA)


def test_pages_that_end_before_their_column_are_refused(tmp_path) -> None:
    few = pages_of(pa.array(np.zeros(ROWS // 2)))
    path = forged(tmp_path / "a.parquet", few + b"\0" * 1000)
    with pytest.raises(GeneratorError, match=r"a\.parquet: column x"):
        read_table(path, SCHEMA)


def test_texts_coded_by_prefixes_are_refused(tmp_path) -> None:
    """A kilobyte holds a thousand texts of a thousand letters each, whatever the footer lists."""
    table = pa.table({"name": ["a" * 1000 + str(number) for number in range(1000)]})
    path = tmp_path / "a.parquet"
    pq.write_table(table, path, use_dictionary=False, column_encoding={"name": "DELTA_BYTE_ARRAY"})
    assert path.stat().st_size < 30_000 < table.nbytes / 30
    with pytest.raises(GeneratorError, match="column name: texts coded by their prefixes are not read"):
        read_table(path, SCHEMA)


def test_wounded_pages_are_refused_or_read(tmp_path) -> None:
    """600 wounds in the pages of a small file end in a table or in the documented error."""
    pq.write_table(columns(200).select(["x", "name"]), tmp_path / "a.parquet")
    whole = (tmp_path / "a.parquet").read_bytes()
    first = pq.read_metadata(tmp_path / "a.parquet").row_group(0).column(0).dictionary_page_offset
    draws = np.random.default_rng(600)
    refused = 0
    for _ in range(600):
        content = bytearray(whole)
        for place in draws.integers(first, len(whole) // 2, draws.integers(1, 4)):
            content[place] = draws.integers(256)
        (tmp_path / "b.parquet").write_bytes(content)
        try:
            read_table(tmp_path / "b.parquet", SCHEMA)
        except GeneratorError:
            refused += 1
    assert refused > 50
