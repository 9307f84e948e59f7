"""Datasets that strangers forged are refused with file and frame, by the check, the exports, the page and the benchmark."""

import json
import re
from pathlib import Path

import pytest
from hostile_sets import ATTACKS, forged
from unit.benchmark.fake_night import frame_record

from benchmark.errors import DatasetError
from benchmark.frames.sharded import open_sharded
from benchmark.report.show.source import open_source
from generator.dataset.reader import Dataset
from generator.dataset.verify import problems
from generator.errors import GeneratorError
from generator.export.export import export
from generator.reading.json_text import strict_json
from generator.reading.record import read_record


def read_all(folder: Path) -> None:
    """Everything that a dataset gives."""
    Dataset.open(folder).frames()
    for frame in Dataset.open(folder):
        _ = frame.record, frame.image, frame.stars.num_rows, frame.objects.num_rows


def look_at(folder: Path) -> None:
    """What the page draws."""
    source = open_source(folder)
    _ = source.image(0), source.record(0), source.stars(0)


@pytest.mark.parametrize("name", ATTACKS)
def test_a_forged_dataset_is_refused_by_name(small_set, tmp_path, name) -> None:
    attack, message = ATTACKS[name]
    folder = forged(small_set, tmp_path / "set", attack)
    found = problems(folder)
    assert any(re.search(message, problem) for problem in found), found
    with pytest.raises(GeneratorError, match=message):
        read_all(folder)
    with pytest.raises(GeneratorError, match=message):
        export(folder, "files", tmp_path / "files")


@pytest.mark.parametrize(
    "name",
    ["holes in the archive", "stars of equal rows", "deep record", "401 digits", "texts for places", "empty places"],
)
def test_the_benchmark_and_the_page_refuse_it_too(small_set, tmp_path, name) -> None:
    attack, message = ATTACKS[name]
    folder = forged(small_set, tmp_path / "set", attack)
    with pytest.raises(DatasetError, match=message):
        open_sharded(str(folder), tmp_path / "frames")
    with pytest.raises(GeneratorError, match=message):
        look_at(folder)


def test_a_forged_dataset_that_changes_nothing_is_whole(small_set, tmp_path) -> None:
    folder = forged(small_set, tmp_path / "set", lambda folder: None)
    assert problems(folder) == []
    read_all(folder)


def test_records_of_other_generators_may_lack_what_few_readers_use() -> None:
    record = frame_record("frame-00000", 0, None, 48.0, 11.0, 160, 120, 0, "fake night") | {"further": {"key": [1]}}
    assert read_record(json.dumps(record), "a.json", "frame-00000") == record


@pytest.mark.parametrize("text", ["1" * 5000, "[" * 20 + "]" * 20, '{"a": 1e999}', "-Infinity", '["\\udc00"]', "{", ""])
def test_json_that_readers_stumble_over_is_refused(text) -> None:
    with pytest.raises(GeneratorError, match=r"a\.json"):
        strict_json(text, "a.json", 100_000)
