"""Frame records and the table of truth beside them: any files are a set of frames, or a DatasetError.

Warnings of NumPy on the way to a refusal are no errors here.
"""

import json
from contextlib import suppress
from pathlib import Path

import pytest
from fuzz.fuzzing import NUMBERS, corpus, damaged, fuzzed, grafted, values
from hypothesis import given
from unit.benchmark.fake_night import write_dataset

from benchmark.errors import DatasetError
from benchmark.frames.dataset import load_image, open_dataset

FILES = corpus("frame_record")
TABLES = corpus("truth_table")
PICTURES = corpus("picture")
WHOLE = FILES[-1]

pytestmark = pytest.mark.filterwarnings("ignore::RuntimeWarning")


@pytest.fixture(scope="module")
def night(tmp_path_factory) -> Path:
    """A set of one frame, whose record, table and image the targets replace."""
    return write_dataset(tmp_path_factory.mktemp("fuzz") / "night", (1,))


def read(night: Path, name: str, content: bytes) -> None:
    """Open the set with other contents of one of its files."""
    path = night / name
    kept = path.read_bytes()
    path.write_bytes(content)
    try:
        with suppress(DatasetError):
            (frame,) = open_dataset(night).frames
            load_image(frame)
    finally:
        path.write_bytes(kept)


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_the_corpus_of_records(night, path) -> None:
    read(night, "frame-00000.json", path.read_bytes())


@pytest.mark.parametrize("path", PICTURES, ids=lambda path: path.stem)
def test_the_corpus_of_images(night, path) -> None:
    read(night, "frame-00000.png", path.read_bytes())


@fuzzed(60)
@given(content=damaged([path.read_bytes() for path in FILES]))
def test_any_bytes_of_a_record(night, content) -> None:
    read(night, "frame-00000.json", content)


@fuzzed(100)
@given(record=grafted([json.loads(WHOLE.read_bytes())], values(NUMBERS)))
def test_any_values_of_a_record(night, record) -> None:
    read(night, "frame-00000.json", json.dumps(record).encode())


@fuzzed(60)
@given(content=damaged([path.read_bytes() for path in PICTURES]))
def test_any_bytes_of_an_image(night, content) -> None:
    read(night, "frame-00000.png", content)


@fuzzed(60)
@given(content=damaged([path.read_bytes() for path in TABLES]))
def test_any_bytes_of_the_truth(night, content) -> None:
    read(night, "stars.parquet", content)
