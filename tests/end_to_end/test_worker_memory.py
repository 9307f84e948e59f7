"""What a worker keeps in memory while it makes a shard."""

import subprocess
import sys

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from generator.dataset import table_writer as module
from generator.dataset.table_writer import table_writer, write_table

SCHEMA = pa.schema([("index", pa.int32()), ("u_px", pa.float64()), ("kind", pa.string())])


def rows(first: int, count: int) -> pa.Table:
    columns = [list(range(first, first + count)), [0.5 * n for n in range(count)], ["star"] * count]
    return pa.table(columns, schema=SCHEMA)


def test_row_groups_end_with_the_table_that_fills_them(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(module, "ROWS_PER_GROUP", 10)
    path = tmp_path / "stars.parquet"
    with table_writer(path, SCHEMA) as tables:
        for first, count in ((0, 4), (4, 5), (9, 3), (12, 0), (12, 25), (37, 2)):
            tables.add(rows(first, count))
            assert not path.exists()
    file = pq.ParquetFile(path)
    assert [file.metadata.row_group(n).num_rows for n in range(file.num_row_groups)] == [12, 25, 2]
    assert file.read().column("index").to_pylist() == list(range(39))


def test_a_table_without_rows_has_no_row_group(tmp_path) -> None:
    write_table(tmp_path / "none.parquet", rows(0, 0))
    file = pq.ParquetFile(tmp_path / "none.parquet")
    assert file.num_row_groups == 0
    assert file.read().num_rows == 0


def test_nothing_stays_when_the_block_fails(tmp_path) -> None:
    def fail() -> None:
        with table_writer(tmp_path / "stars.parquet", SCHEMA) as tables:
            tables.add(rows(0, 5))
            raise RuntimeError("cosmic ray")

    with pytest.raises(RuntimeError, match="cosmic ray"):
        fail()
    assert not list(tmp_path.iterdir())


WORKER = """
import sys
from pathlib import Path
import psutil
from generator.dataset.layout import DatasetSpec, Shard
from generator.dataset.run import prepare_worker
from generator.dataset.shard import render_shard
from generator.dataset.target import LocalTarget
from generator.speed.scenes import FrameSize, data_set
prepare_worker()
scenario = data_set(FrameSize(48, 32, 6.0), 500)
resident = {}
def progress(index):
    resident[index] = psutil.Process().memory_info().rss / 2**20
report = render_shard(scenario, DatasetSpec(), Shard(0, 0, 500, "train"), LocalTarget(Path(sys.argv[1])), progress)
assert report.complete
early, late = (max(resident[n] for n in range(first, first + 200)) for first in (100, 300))
print(f"{early:.1f} {late:.1f}")
"""
MOST_GROWTH_MIB = 12.0


@pytest.mark.slow
def test_memory_of_a_worker_is_flat_over_500_frames(tmp_path) -> None:
    """The most memory that frames 300 to 499 saw exceeds that of frames 100 to 299 by at most 12 MiB, 60 KiB a frame.

    The truth of a frame of this set takes about 400 KiB and is written in groups of some 60 frames: keeping that of every
    frame would exceed the bound six times.
    """
    run = subprocess.run(
        [sys.executable, "-c", WORKER, str(tmp_path)], capture_output=True, text=True, timeout=900, check=True
    )
    early, late = (float(value) for value in run.stdout.split()[-2:])
    assert late - early < MOST_GROWTH_MIB, run.stdout
