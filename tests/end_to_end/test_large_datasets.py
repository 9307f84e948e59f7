"""Datasets of many frames: what commands hold in memory does not grow with the frames beyond one shard and one table."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest
from large_dataset import write_dataset, write_scenario
from large_results import write_large

from benchmark.report.site.pages import make_boards
from generator.dataset.verify import problems

ROOT = Path(__file__).parents[2]
LARGE = 100_000
MOST_BYTES = 10**9


def peak_bytes(*words: str) -> int:
    """Largest resident memory of a command of skybench's, which must succeed."""
    code = (
        "import resource, sys; from benchmark.cli.app import main; sys.argv[0] = 'skybench'\n"
        "try: main()\n"
        "finally: print('peak', resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code, *words], capture_output=True, text=True, check=False, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    return 1024 * int(re.findall(r"^peak (\d+)$", done.stderr, re.MULTILINE)[-1])


def test_many_shards_are_a_whole_dataset(tmp_path) -> None:
    folder = write_dataset(write_scenario(tmp_path, 40), tmp_path / "set", shard_size=2)
    assert problems(folder) == []
    assert len(list(folder.glob("data/*/*.tar"))) == 20


# A hundred thousand frames are written, about three minutes of one core.
@pytest.mark.slow
def test_a_hundred_thousand_frames_take_less_than_a_gigabyte(tmp_path) -> None:
    scenario = write_scenario(tmp_path, LARGE)
    folder = write_dataset(scenario, tmp_path / "set")
    for words in (
        ("plan", str(scenario)),
        ("verify", str(folder)),
        ("show", str(folder), "--out", str(tmp_path / "page")),
    ):
        assert peak_bytes(*words) < MOST_BYTES, words


def test_results_of_many_solvers_are_one_board(tmp_path) -> None:
    (board,) = make_boards(write_large(tmp_path, 4, 90))
    assert len(board.entries) == 4
    assert board.n_frames == 90
