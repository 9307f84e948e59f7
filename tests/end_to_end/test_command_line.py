"""What holds for every command of `skybench`: help, version, completion, JSON, and a start without heavy imports."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from documented_commands import commands_that_exist
from typer.testing import CliRunner

import generator
from benchmark.cli.app import app
from benchmark.cli.output import print_json
from benchmark.real_tasks.definition import real_task_names
from benchmark.solvers.registry import known_solvers
from benchmark.tasks.definition import task_names
from generator.presets import all_named
from generator.scenario.shipped import shipped_scenarios

ROOT = Path(__file__).parents[2]
COMMANDS = commands_that_exist()


def completed(line: str) -> list[str]:
    """What bash is offered for the last word of a command line."""
    words = line.split(" ")
    env = {"_SKYBENCH_COMPLETE": "complete_bash", "COMP_WORDS": line, "COMP_CWORD": str(len(words) - 1)}
    return CliRunner().invoke(app, [], env=env, prog_name="skybench").stdout.split()


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_short_help_and_json(name: str) -> None:
    run = CliRunner().invoke(app, [*name.split()[1:], "-h"], env={"COLUMNS": "200"})
    assert run.exit_code == 0, run.output
    assert "Usage: " in run.stdout
    assert "--json" in {option for parameter in COMMANDS[name].params for option in parameter.opts}


def test_version() -> None:
    assert CliRunner().invoke(app, ["--version"]).stdout == f"skybench {generator.__version__}\n"


def test_the_command_starts_without_what_only_its_work_needs() -> None:
    code = "import sys, benchmark.cli.app; print(*sorted({name.split('.')[0] for name in sys.modules}))"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    heavy = {"numpy", "scipy", "pandas", "pyarrow", "pydantic", "mitsuba", "drjit", "celnav", "yaml", "rich", "jinja2"}
    assert heavy & set(loaded) == set()


def test_completion_knows_tasks_solvers_scenes_and_presets(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("mine.yaml").write_text("", encoding="utf-8")
    Path("frames").mkdir()
    assert set(completed("skybench bench run ")) == {*task_names(), *real_task_names(), "frames/"}
    assert completed("skybench bench run bor") == ["bortle"]
    assert set(completed("skybench bench run bortle --solver ")) == {*known_solvers(), "frames/"}
    assert set(completed("skybench render ")) == {*shipped_scenarios(), "mine.yaml", "frames/"}
    assert completed("skybench scenes demo_") == ["demo_small"]
    assert set(completed("skybench presets ")) == {named.name for named in all_named()}
    assert completed("skybench export set --to f") == ["files", "fits"]
    assert "--solver" in completed("skybench bench run bortle --so")
    assert completed("skybench stu") == ["study"]


def test_completion_can_be_installed(monkeypatch) -> None:
    monkeypatch.setattr("shellingham.detect_shell", lambda *arguments: ("bash", "/bin/bash"))
    run = CliRunner().invoke(app, ["--show-completion", "bash"], prog_name="skybench")
    assert run.exit_code == 0, run.output
    assert "_SKYBENCH_COMPLETE" in run.stdout


@pytest.mark.parametrize(
    ("line", "keys"),
    [
        ("scenes --json", set(shipped_scenarios())),
        ("scenes demo --json", {"title", "path", "text"}),
        ("presets thesis-720p --json", {"named", "values", "defaults"}),
        ("bench list --json", {"tasks", "tasks_of_photographs", "solvers"}),
        ("bench revisions --json", {"revisions"}),
        ("bench pack-results --out nothing --json", {"tables"}),
        ("doctor --json", {"ok", "checks"}),
    ],
)
def test_json_is_one_document(line: str, keys: set[str], tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    run = CliRunner().invoke(app, line.split())
    assert run.exit_code == 0, run.output
    assert keys <= set(json.loads(run.stdout))


def test_json_of_a_failed_check_is_a_document_too(tmp_path) -> None:
    run = CliRunner().invoke(app, ["bench", "stale", "--root", str(tmp_path), "--json"])
    assert run.exit_code == 1
    assert {problem["what"] for problem in json.loads(run.stdout)["problems"]} == {"is missing"}


def test_json_of_numbers_that_json_does_not_have(capsys) -> None:
    print_json({"infinite": float("inf"), "path": Path("a/b"), "tuple": (1, 2.5, None), 3: float("nan")})
    answer: dict[str, Any] = json.loads(capsys.readouterr().out)
    assert answer == {"infinite": None, "path": "a/b", "tuple": [1, 2.5, None], "3": None}
