"""Finished results are skipped, interrupted runs resume, and solvers that cannot be told apart are run anew."""

import dataclasses
import os
import subprocess
import sys
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from unit.benchmark.fake_night import Contestant, Raising, Truth, write_dataset
from unit.benchmark.stored import detections, stored

from benchmark.errors import ResultsError
from benchmark.frames.dataset import open_dataset
from benchmark.run import engine, journal

ROOT = Path(__file__).parents[3]


class StoppedError(Exception):
    """Stands for Ctrl-C."""


@dataclasses.dataclass(frozen=True)
class Counting(Truth):
    """The truth, which counts the frames that it was asked for, and has a revision."""

    revision: str = "first"
    asked: list = dataclasses.field(default_factory=list, compare=False)

    def solve(self, detections, observation):
        self.asked.append(observation.utc)
        return super().solve(detections, observation)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return write_dataset(tmp_path_factory.mktemp("data") / "night", (1, 2, None), per_class=3)


@pytest.fixture(scope="module")
def frames(folder):
    return open_dataset(folder).frames


def interrupted(folder, solver, out, after):
    """Run, and stop once so many frames are done."""
    done = []

    def progress(name, count):
        done.extend([name] * count)
        if len(done) == after:
            raise StoppedError

    with pytest.raises(StoppedError):
        engine.run(folder, [solver], out, progress=progress)


def test_a_folder_that_cannot_be_written_is_found_before_any_frame_is_solved(folder, frames, tmp_path):
    (tmp_path / "file").write_text("")
    solver = Counting("truth", frames)
    with pytest.raises(ResultsError, match=r"file/out: cannot be written \(Not a directory\); choose another folder"):
        engine.run(folder, [solver], tmp_path / "file" / "out")
    assert solver.asked == []


def test_an_interrupted_run_resumes_and_gives_what_a_whole_one_gives(folder, frames, tmp_path):
    first = Counting("truth", frames)
    interrupted(folder, first, tmp_path / "cut", after=4)
    assert not list((tmp_path / "cut").rglob("summary.json"))
    second = Counting("truth", frames)
    (run,) = engine.run(folder, [second], tmp_path / "cut")
    # The first frame of each session is put twice, for the warm-up.
    assert (run.n_solved, len(second.asked)) == (5, 6)
    engine.run(folder, [Counting("truth", frames)], tmp_path / "whole")
    cut, whole = stored(tmp_path / "cut")["truth"], stored(tmp_path / "whole")["truth"]
    for column in ("frame_id", "error_km", "n_correct", "condition"):
        assert cut.frames[column].equals(whole.frames[column])
    assert detections(cut).equals(detections(whole))
    assert not list((tmp_path / "cut").rglob(journal.FOLDER))


@pytest.mark.parametrize("name", ["frames-00000.parquet", "matches-00000.parquet", "stamp.json"])
def test_a_damaged_table_of_an_unfinished_run_is_made_anew(folder, frames, tmp_path, name):
    interrupted(folder, Counting("truth", frames), tmp_path, after=4)
    (damaged,) = tmp_path.rglob(name)
    damaged.write_bytes(b"\xff" + damaged.read_bytes()[:100])
    (run,) = engine.run(folder, [Counting("truth", frames)], tmp_path)
    assert (run.n_solved, run.summary.recall.value) == (9, 1.0)


def test_a_finished_result_is_skipped_until_the_solver_changes(folder, frames, tmp_path):
    engine.run(folder, [Counting("truth", frames)], tmp_path)
    again = Counting("truth", frames)
    (run,) = engine.run(folder, [again], tmp_path)
    assert (run.n_solved, again.asked, run.summary.recall.value) == (0, [], 1.0)
    other = Counting("truth", frames, revision="second")
    (run,) = engine.run(folder, [other], tmp_path)
    assert run.n_solved == 9
    assert len(list(tmp_path.rglob("summary.json"))) == 2


def test_an_object_without_revision_is_run_anew_and_leaves_nothing_to_resume(folder, frames, tmp_path):
    for _ in range(2):
        (run,) = engine.run(folder, [Truth("truth", frames)], tmp_path / "a")
        assert run.n_solved == 9
    interrupted(folder, Truth("truth", frames), tmp_path / "b", after=4)
    assert not list((tmp_path / "b").rglob("*.parquet"))


# Starts processes of its own.
@pytest.mark.journey
def test_outcomes_of_another_machine_or_number_of_jobs_are_not_taken_over(folder, frames, tmp_path):
    interrupted(folder, Counting("truth", frames), tmp_path, after=4)
    (run,) = engine.run(folder, [Counting("truth", frames)], tmp_path, jobs=2)
    assert run.n_solved == 9


def test_a_result_of_errors_alone_is_not_finished(folder, frames, tmp_path):
    class Settled(Raising):
        revision = "one"

    for _ in range(2):
        (run,) = engine.run(folder, [Settled("raising", frames)], tmp_path)
        assert (run.n_solved, run.failed_throughout) == (9, True)


class Ending(Contestant):
    """Ends its process on one frame."""

    def solve(self, detections, observation):
        import os

        if observation.utc == self.frames[2].observation.utc:
            os._exit(3)
        return Truth.solve(self, detections, observation)


# Starts processes of its own.
@pytest.mark.journey
def test_an_object_that_ends_its_process_costs_itself_the_frame(folder, frames, tmp_path):
    (run,) = engine.run(folder, [Ending("ending", frames)], tmp_path, jobs=2)
    assert (run.summary.n_errors, run.summary.n_fixes) == (1, 8)
    reasons = pq.read_table(run.folder / "frames.parquet")["reason"].to_pylist()
    assert [reason for reason in reasons if reason] == ["error: ended its process"]


# Starts processes of its own.
@pytest.mark.journey
@pytest.mark.parametrize("guarded", [False, True])
def test_a_script_that_its_processes_cannot_import_again_is_told_so(folder, tmp_path, guarded):
    run = f"engine.run({str(folder)!r}, [Mine()], Path({str(tmp_path / 'out')!r}), jobs=2)"
    script = tmp_path / "script.py"
    script.write_text(
        "from pathlib import Path\nfrom benchmark.run import engine\n"
        "class Mine:\n    name, version, detector = 'mine', '1', 'none'\n"
        "    def detect(self, image):\n        raise ValueError('sees nothing')\n"
        "    def solve(self, detections, observation):\n        raise ValueError\n"
        + (f"if __name__ == '__main__':\n    {run}\n" if guarded else f"{run}\n")
    )
    done = subprocess.run([sys.executable, str(script)], cwd=ROOT, env=os.environ | {"PYTHONPATH": str(ROOT)},
                          capture_output=True, text=True, timeout=120)  # fmt: skip
    if guarded:
        assert (done.returncode, done.stderr) == (0, "")
    else:
        assert "SolverError: mine: its process ended before it held the object" in done.stderr
        assert not list((tmp_path / "out").rglob("summary.json"))
