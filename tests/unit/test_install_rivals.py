"""tools/install_rivals.py: what it would install, and what a failure leaves; nothing is downloaded here."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest

from benchmark.solvers.definition import FOLDER, SolverFolder, read_solver_folder, solver_folders

ROOT = Path(__file__).parents[2]


@pytest.fixture
def tool() -> ModuleType:
    spec = importlib.util.spec_from_file_location("install_rivals", ROOT / "tools" / "install_rivals.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def solver(folder: Path, text: str) -> dict[str, SolverFolder]:
    folder.mkdir(exist_ok=True)
    (folder / "solver.yaml").write_text(f"name: own\ntitle: A solver\nlicence: MIT\n{text}")
    return {"own": read_solver_folder(folder)}


def test_a_bare_machine_gets_packages_environments_and_programs(tool, monkeypatch, tmp_path) -> None:
    monkeypatch.setattr("benchmark.solvers.registry._installed_version", lambda package: "")
    monkeypatch.setenv("SKYBENCH_ENVIRONMENTS", str(tmp_path))
    monkeypatch.setenv("PATH", "/nowhere")
    listed = [what for what, _ in tool.steps(solver_folders(FOLDER))]
    assert {"solve-field", "ruststartracker==0.2.10"} <= set(listed)
    assert {f"the environment {tmp_path / name}" for name in ("cedar-solve", "seiza")} <= set(listed)


def test_what_is_there_stays(tool, monkeypatch, tmp_path) -> None:
    found = solver(tmp_path / "own", 'version: "1"\nenvironment: own\ncommand: [python, x.py]\nprograms: [sh]\n')
    monkeypatch.setenv("SKYBENCH_ENVIRONMENTS", str(tmp_path / "environments"))
    assert len(list(tool.steps(found))) == 1
    python = tmp_path / "environments" / "own" / "bin" / "python"
    python.parent.mkdir(parents=True)
    python.write_text("")
    assert list(tool.steps(found)) == []


def test_a_package_is_installed_without_what_it_depends_on(tool, monkeypatch, tmp_path) -> None:
    ran = []
    monkeypatch.setattr(tool, "run", lambda *command: ran.append(command))
    found = solver(tmp_path / "own", "adapter: ruststartracker\nrequires: [no-such-package==1.0]\n")
    ((what, install),) = tool.steps(found)
    install()
    assert what == "no-such-package==1.0"
    assert ran == [(*tool.PIP, "install", *tool.QUIET, "--no-deps", "no-such-package==1.0")]


def test_nothing_is_left_of_an_environment_that_fails(tool, tmp_path) -> None:
    (tmp_path / "requirements.txt").write_text("./no-such-folder\n")
    with pytest.raises(tool.StepError, match="no-such-folder"):
        tool.make_environment(tmp_path / "environments" / "own", tmp_path / "requirements.txt")
    assert not (tmp_path / "environments" / "own").exists()


def test_an_environment_has_what_its_requirements_say(tool, tmp_path) -> None:
    (tmp_path / "requirements.txt").write_text("# nothing\n")
    tool.make_environment(tmp_path / "own", tmp_path / "requirements.txt")
    tool.run(str(tmp_path / "own" / "bin" / "python"), "-c", "import json")


def test_only_root_installs_programs(tool, monkeypatch) -> None:
    monkeypatch.setattr(tool, "run", lambda *command: pytest.fail(f"ran {command}"))
    monkeypatch.setattr("os.geteuid", lambda: 1000)
    with pytest.raises(tool.StepError, match="install it by hand: apt-get install -y stars"):
        tool.install_programs("apt-get install -y stars")
    monkeypatch.setattr("os.geteuid", lambda: 0)
    with pytest.raises(tool.StepError, match="install it by hand: pip install stars"):
        tool.install_programs("pip install stars")


def test_a_failure_is_printed_and_the_rest_is_installed(tool, monkeypatch, capsys) -> None:
    def fails() -> None:
        tool.run(sys.executable, "-c", "raise SystemExit('ERROR: no such thing')")

    monkeypatch.setattr(tool, "steps", lambda solvers: iter([("one", fails), ("two", lambda: None)]))
    tool.main()
    assert capsys.readouterr().out == "no one: ERROR: no such thing\ninstalled two (0 s)\n"
