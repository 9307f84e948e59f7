"""A machine that has no more to give ends a command with one line, and other errors keep their traceback."""

import errno
import tempfile

import pytest
import typer
from typer.testing import CliRunner

from benchmark.cli.errors import EXIT_BAD_INPUT, InterruptibleGroup, fault_of_machine


def ended(error: BaseException):
    """How a command ends in which an error is raised."""
    app = typer.Typer(cls=InterruptibleGroup)

    @app.command()
    def work() -> None:
        raise error

    @app.command()
    def other() -> None: ...

    return CliRunner().invoke(app, ["work"])


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (OSError(errno.ENOSPC, "No space left on device", "/data/a"), "skybench: /data/a: No space left on device; "),
        (OSError(errno.EROFS, "Read-only file system"), "skybench: Read-only file system; "),
        (MemoryError(), "skybench: out of memory; "),
    ],
)
def test_one_line_and_exit_status_2(error, words) -> None:
    result = ended(error)
    assert result.exit_code == EXIT_BAD_INPUT
    assert result.stderr.startswith(words)
    assert result.stderr.count("\n") == 1


@pytest.mark.parametrize("error", [ValueError("a bug"), FileNotFoundError(errno.ENOENT, "No such file", "a")])
def test_other_errors_pass(error) -> None:
    assert ended(error).exception is error


def test_no_room_in_any_temporary_folder_names_the_variable(monkeypatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", None)
    monkeypatch.setattr(tempfile, "_candidate_tempdir_list", list)
    with pytest.raises(FileNotFoundError) as caught, tempfile.TemporaryDirectory():
        pass
    assert "TMPDIR" in str(fault_of_machine(caught.value))
