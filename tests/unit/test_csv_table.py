"""Tables of numbers in CSV: read exactly, or refused with file, line, column and what is expected."""

import os
import tracemalloc

import numpy as np
import pytest

from generator.csv_table import LARGEST_ROW_BYTES, CsvError, read_csv

COLUMNS = ("t", "wx")


def written(tmp_path, content: str | bytes):
    path = tmp_path / "a.csv"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


@pytest.mark.parametrize(
    "content",
    ["t,wx\n0,0.1\n1,-2e-3\n", " t , wx \r\n 0 , .1\r\n+1.,-0.002\r\n", "\ufefft,wx\n\n0,0.1\n  \n1,-2E-3",
     "# a\n#b\nt,wx\n0,0.1\n1,-0.002"],
)  # fmt: skip
def test_numbers_are_read_exactly(tmp_path, content) -> None:
    table = read_csv(written(tmp_path, content), "a.csv", COLUMNS, most_rows=5, increasing=True)
    assert table.columns == COLUMNS
    np.testing.assert_array_equal(table.values, [[0.0, 0.1], [1.0, -0.002]])


def test_seventeen_digits_give_the_same_double(tmp_path) -> None:
    values = np.random.default_rng(1).normal(size=(200, 2)) * 10.0 ** np.arange(-100, 100)[:, None]
    content = "a,b\n" + "".join(f"{a!r},{b!r}\n" for a, b in values.tolist())
    np.testing.assert_array_equal(read_csv(written(tmp_path, content), "a.csv", most_rows=200).values, values)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", r"'a.csv', line 1: found the columns , expected t, wx"),
        ("az,el\n0,1\n", r"'a.csv', line 1: found the columns az, el, expected t, wx"),
        ("# note\nt\n0\n", r"'a.csv', line 2: found the columns t, expected t, wx"),
        ("t,wx\n", r"'a.csv': found 0 rows of numbers, expected 1 to 3"),
        ("t,wx\n" + "0,0\n" * 4, r"'a.csv': found more than 3 rows of numbers, expected 1 to 3"),
        ("t,wx\n0,0\n\n1,x y\n", r"'a.csv', line 4, column wx: found 'x y', expected a finite number"),
        ("t,wx\n0,0\n1,\n", r"'a.csv', line 3, column wx: found '', expected a finite number"),
        ("t,wx\n0,nan\n", r"line 2, column wx: found 'nan', expected a finite number"),
        ("t,wx\n0,1\ninf,1\n", r"line 3, column t: found 'inf', expected a finite number"),
        ("t,wx\n0,1e999\n", r"line 2, column wx: found '1e999', expected a finite number"),
        ("t,wx\n0,1_0\n", r"line 2, column wx: found '1_0', expected a finite number"),
        ("t,wx\n0,0x1p3\n", r"line 2, column wx: found '0x1p3', expected a finite number"),
        ("t,wx\n0,\u0661\n", r"line 2, column wx: found '\u0661', expected a finite number"),
        ('t,wx\n0,"1"\n', r"line 2, column wx: found '\"1\"', expected a finite number"),
        ("t,wx\n0,1,2\n", r"line 2: found 3 cells, expected 2"),
        ("t,wx\n0,1\n2\n", r"line 3: found 1 cells, expected 2"),
        ("t,wx\n# note\n0,1\n", r"line 2: found 1 cells, expected 2"),
        ("t,wx\n0,1\n\n0,1\n", r"line 4, column t: found 0 after 0, expected values that increase"),
        (b"t,wx\n\xff,1\n", r"'a.csv': not UTF-8 text \(invalid start byte at byte 5\)"),
        (b"t,wx\n" + b"0" * 3 * LARGEST_ROW_BYTES + b"," + b"1" * LARGEST_ROW_BYTES,
         r"found 4102 bytes, expected at most 4096"),
    ],
)  # fmt: skip
def test_other_contents_are_refused_at_their_place(tmp_path, content, message) -> None:
    with pytest.raises(CsvError, match=message):
        read_csv(written(tmp_path, content), "a.csv", COLUMNS, most_rows=3, increasing=True)


@pytest.mark.parametrize("line", [b"ab\n", b"\n"])
def test_memory_is_not_taken_for_rows_beyond_the_limit(tmp_path, line) -> None:
    """The text itself, and as much again while it is decoded; a list of its rows takes forty times that."""
    path = written(tmp_path, b"t,wx\n" + line * 1_000_000)
    tracemalloc.start()
    try:
        with pytest.raises(CsvError, match=r"'a\.csv': found (0|more than 5000) rows of numbers, expected 1 to 5000"):
            read_csv(path, "a.csv", most_rows=5000)
        assert tracemalloc.get_traced_memory()[1] < 4 * path.stat().st_size + 2_000_000
    finally:
        tracemalloc.stop()


def test_only_regular_files_are_opened(tmp_path) -> None:
    """A FIFO without a writer would block for ever."""
    os.mkfifo(tmp_path / "a.csv")
    for path in (tmp_path / "a.csv", tmp_path, tmp_path / "none.csv"):
        with pytest.raises(CsvError, match="not a regular file"):
            read_csv(path, path.name, most_rows=3)
