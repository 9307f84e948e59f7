"""What is said of files that people write: file, key and remedy, without the words of the library that checks."""

from pathlib import Path

import pytest
from typer.testing import CliRunner

from benchmark.cli.app import app
from benchmark.errors import ResultsError, SolverError, TaskError
from benchmark.frames.opening import open_frames
from benchmark.frames.task_frames import FrameChoice
from benchmark.run.confirm import packed_listing
from benchmark.solvers.definition import SPEC_NAME, read_solver_folder

FUSED = "name: mine-fused\ntitle: mine, fused\nlicence: MIT\n"


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        ("fuses: ../none\n", f"fuses: no {SPEC_NAME} in ../none"),
        ("fuses: .\n", "fuses: . fuses another"),
        ("fuses: 5\n", "fuses: found int 5, expected text, in quotes if it looks like a number"),
        ("fuse: .\n", "fuse: unknown key; did you mean 'fuses'? Allowed: name, title,"),
        ("command: python\n", "command: found str 'python', expected a list"),
        ("command: [python]\ntime_limit_s: -1\n", "time_limit_s: found"),
        ("", "give either adapter or command or fuses"),
        ("fuses: ../none\nmemory_limit_mib: 100\n", "memory_limit_mib cannot be beside fuses"),
    ],
)
def test_a_wrong_fused_solver_is_named_by_file_and_key(tmp_path: Path, lines: str, words: str) -> None:
    (tmp_path / SPEC_NAME).write_text(FUSED + lines, encoding="utf-8")
    with pytest.raises(SolverError) as raised:
        read_solver_folder(tmp_path)
    assert str(raised.value).startswith(f"{tmp_path / SPEC_NAME}: {words}")


def test_what_does_not_exist_is_said_before_what_does_not_fit() -> None:
    with pytest.raises(Exception, match="no such folder, and not a task"):
        open_frames("no_such_frames", FrameChoice(per_condition=3))


def test_a_folder_has_no_conditions(tmp_path: Path) -> None:
    with pytest.raises(TaskError, match="nothing grades its frames"):
        open_frames(str(tmp_path), FrameChoice(per_condition=3))


def test_confirming_without_results_ends_before_any_rendering(tmp_path: Path) -> None:
    with pytest.raises(ResultsError, match=r"dev\.json: there are no packed results"):
        packed_listing(tmp_path, Path("bortle@1/dev"))
    data = tmp_path / "data"
    told = CliRunner().invoke(app, ["bench", "confirm", "bortle", "--out", str(tmp_path), "--data", str(data)])
    assert told.exit_code == 2
    assert not data.exists()
