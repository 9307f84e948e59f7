"""Results of strangers: tables that claim gigabytes, numbers and lists that no result has."""

import hashlib
import json

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from benchmark.errors import ResultsError
from benchmark.run.packed import read_packed
from benchmark.run.results import read_summary, read_table
from celnav.command.attitude_option import read_attitude
from celnav.errors import AttitudeError
from generator.reading import table

DEEP = "[" * 100_000


@pytest.fixture
def bomb(tmp_path, monkeypatch):
    """A table of a million equal rows in some kilobytes."""
    monkeypatch.setattr(table, "FREE_BYTES", 2**20)
    path = tmp_path / "part.parquet"
    pq.write_table(pa.table({"index": np.zeros(1_000_000)}), path, compression="zstd")
    return path


def test_tables_that_claim_more_than_they_hold_are_not_read(bomb, monkeypatch) -> None:
    digest = hashlib.sha256(bomb.read_bytes()).hexdigest()
    listing = bomb.with_suffix(".json")
    listing.write_text(json.dumps({"format": "skybench-packed/1", "table_sha256": digest, "rows": []}))
    monkeypatch.setattr(pq, "read_table", lambda *arguments: pytest.fail("the table was read"))
    for read, path in ((read_packed, listing), (read_table, bomb)):
        with pytest.raises(ResultsError, match=r"part\.parquet: claims 8 MB in a file of"):
            read(path)


@pytest.mark.parametrize("text", [DEEP, '{"format": 1, "overall": {"n_frames": 1e400}}'])
def test_summaries_and_lists_are_strict_json(tmp_path, text) -> None:
    path = tmp_path / "summary.json"
    path.write_text(text)
    for read in (read_summary, read_packed):
        with pytest.raises(ResultsError, match=r"summary\.json: not .*(nested deeper|not finite)"):
            read(path)


def test_an_attitude_that_is_nested_deep_is_refused(tmp_path) -> None:
    (tmp_path / "a.json").write_text(DEEP)
    with pytest.raises(AttitudeError, match=r"a\.json is nested too deep"):
        read_attitude(str(tmp_path / "a.json"))
