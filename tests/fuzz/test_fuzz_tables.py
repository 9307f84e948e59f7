"""Tables of numbers: any CSV file is a table of finite numbers, or a CsvError."""

from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from fuzz.fuzzing import corpus, damaged, fuzzed
from hypothesis import given
from hypothesis import strategies as st

from generator.csv_table import CsvError, read_csv

FILES = corpus("csv_table")
CELLS = st.floats().map(repr) | st.integers().map(str) | st.sampled_from(["", " ", "1e999", "0x1", "1_0", "٣", "-.e1"])


def read(path: Path) -> None:
    """Read a table, and one of two columns whose first increases."""
    for columns, increasing in ((None, False), (("t", "wx"), True)):
        with suppress(CsvError):
            table = read_csv(path, path.name, columns, most_rows=50, increasing=increasing)
            assert table.values.shape[1] == len(table.columns)
            assert np.isfinite(table.values).all()


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_the_corpus(path) -> None:
    read(path)


@fuzzed(100)
@given(content=damaged([path.read_bytes() for path in FILES]))
def test_any_bytes(tmp_path_factory, content) -> None:
    path = tmp_path_factory.getbasetemp() / "any.csv"
    path.write_bytes(content)
    read(path)


@fuzzed(60)
@given(rows=st.lists(st.lists(CELLS, min_size=1, max_size=3), max_size=6))
def test_any_cells(tmp_path_factory, rows) -> None:
    path = tmp_path_factory.getbasetemp() / "cells.csv"
    path.write_text("t,wx\n" + "".join(",".join(row) + "\n" for row in rows), encoding="utf-8")
    read(path)
