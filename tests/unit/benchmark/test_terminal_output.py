"""What commands print: readable on a terminal of 80 letters, and on one whose encoding lacks dashes and signs."""

from __future__ import annotations

import io
import os
import subprocess
import sys
from types import SimpleNamespace

import pytest
from rich.console import Console
from typer.testing import CliRunner

from benchmark.cli import boards
from benchmark.cli.bench import app
from benchmark.cli.listing import ListedSolver, solver_table
from benchmark.cli.output import let_print
from benchmark.report.refresh_plan import Job, Place

LONGEST_NAMES = ("startracker-false@1", "thesis-baseline+si+pr", "ruststartracker-fused")


@pytest.mark.parametrize(
    ("said", "printed"),
    [("12 \u00b1 3 \u2013 5\u2009km", b"12 +- 3 - 5 km"), ("caf\u00e9 \u2264 \u03bb", b"cafe <= \\u03bb")],
)
def test_a_stream_of_few_letters_takes_every_text(said, printed):
    for errors in ("strict", "backslashreplace"):
        stream = io.TextIOWrapper(io.BytesIO(), encoding="ascii", errors=errors)
        let_print(stream)
        stream.write(said)
        stream.flush()
        assert stream.buffer.getvalue() == printed


def test_a_stream_that_has_all_letters_prints_them():
    stream = io.TextIOWrapper(io.BytesIO(), encoding="utf-8")
    let_print(stream, io.StringIO())
    stream.write("\u00b1 \u2013")
    stream.flush()
    assert stream.buffer.getvalue().decode() == "\u00b1 \u2013"


def test_a_command_prints_its_tables_in_ascii():
    done = subprocess.run(
        [sys.executable, "-m", "benchmark.cli.app", "bench", "list"],
        env=os.environ | {"PYTHONIOENCODING": "ascii", "COLUMNS": "80"}, capture_output=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr.decode()
    assert "+- points" in done.stdout.decode("ascii")


def test_what_solvers_lack_is_said_once_below_the_list():
    need = "one: its environment is missing; make it with: python3 -m venv here"
    solvers = [ListedSolver(name, "Names stars", "MIT", need) for name in ("one", "one-fused")]
    console = Console(width=80, file=io.StringIO())
    console.print(solver_table([*solvers, ListedSolver("two", "Names stars too", "MIT", "")]))
    printed = " ".join(console.file.getvalue().split())
    assert printed.count("not ready, see below") == 2
    assert printed.count(need) == 1


def test_the_list_is_readable_at_80_letters():
    shown = CliRunner().invoke(app, ["list"], env={"COLUMNS": "80"}).output
    lines = shown.splitlines()
    assert max(map(len, lines)) <= 80
    assert len(lines) < 240  # eight columns made 640 of letters below each other; solvers that are missing add lines
    for words in (*LONGEST_NAMES, "How much cloud a fisheye", "part of the sky that clouds", "10 km", "7 x 30"):
        assert words in shown


def test_the_plan_is_readable_at_80_letters(monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "80")
    why = "the solver has changed, and so have the frames of the task"
    jobs = [Job(Place("startracker-false@1", "shared", name), why, 320, 500.0, 20) for name in LONGEST_NAMES[1:]]
    plan = SimpleNamespace(jobs=jobs, fresh=(), seconds=lambda processes, frames: 1000.0, n_unknown=0)
    monkeypatch.setattr("benchmark.report.refresh.missing_frames", lambda found, request: 0)
    boards._print_plan(plan, SimpleNamespace(jobs=1))
    shown = capsys.readouterr().out
    assert max(map(len, shown.splitlines()[:-2])) <= 80
    for words in (*LONGEST_NAMES, "300 of 320", "shared detections", "the solver has changed"):
        assert words in shown
