"""Folder of results where the command line names none: a part of a task's frames stays out of the leaderboard."""

from pathlib import Path

import pytest

from benchmark.cli.running import default_out
from benchmark.frames.task_frames import FrameChoice

WHOLE = FrameChoice()


@pytest.mark.parametrize(
    ("targets", "choice", "folder"),
    [
        (["bortle", "city@1"], WHOLE, "results/leaderboard"),
        (["bortle"], FrameChoice(per_condition=20), "results/part"),
        (["bortle"], FrameChoice(condition=7.0), "results/part"),
        (["out/demo"], WHOLE, "results/demo"),
        (["bortle", "out/demo"], WHOLE, "results/demo"),
        (["allsky-real"], FrameChoice(condition=30.0), "results/real"),
    ],
)
def test_results_go_where_their_like_is(targets, choice, folder) -> None:
    assert default_out(targets, choice) == Path(folder)
