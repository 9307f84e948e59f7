"""Submissions: any file is a list of answers, or a list of problems that can be printed."""

from pathlib import Path

import pytest
from fuzz.fuzzing import ODD, corpus, damaged, fuzzed
from hypothesis import given
from hypothesis import strategies as st

from benchmark.submit.submission import FRAME_COLUMNS, MAX_PROBLEMS, check_answers, check_stars

FILES = corpus("submission")
FRAMES = ("frame-00000", "frame-00001")
CELLS = (
    st.sampled_from(["frame-00000", "frame-00001", "fix", "refused", "error", "", "1", "91", "-1e999", '"', "=1+1"])
    | st.floats().map(repr)
    | ODD.map(str)
)


def read(path: Path) -> None:
    """Check a file as answers and as a star table, with and without the frames that it must answer."""
    for check in (check_answers, check_stars):
        for frames in (None, FRAMES):
            checked = check(path, frames)
            assert len(checked.problems) <= MAX_PROBLEMS + 1
            assert all(str(problem).isprintable() for problem in checked.problems)
            if frames is not None:
                assert {answer.frame_id for answer in checked.answers} | set(checked.stars) <= set(frames)


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_the_corpus(path) -> None:
    read(path)


# A file that begins as Parquet does is read in a process of its own, which takes a second: tests/unit has those.
@fuzzed(100)
@given(content=damaged([path.read_bytes() for path in FILES]).filter(lambda content: not content.startswith(b"PAR1")))
def test_any_bytes(tmp_path_factory, content) -> None:
    path = tmp_path_factory.getbasetemp() / "any.csv"
    path.write_bytes(content)
    read(path)


@fuzzed(60)
@given(rows=st.lists(st.lists(CELLS, max_size=10), max_size=5))
def test_any_cells(tmp_path_factory, rows) -> None:
    path = tmp_path_factory.getbasetemp() / "cells.csv"
    lines = [",".join(row) for row in (FRAME_COLUMNS, *rows)]
    path.write_bytes("\n".join(lines).encode("utf-8", "surrogatepass"))
    read(path)
