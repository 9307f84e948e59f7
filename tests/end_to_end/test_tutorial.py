"""The tutorial does what it says: its notebook is made of it, and is run from the data sheet to the leaderboard."""

import importlib.util
import os
import re
import stat
import sys
from pathlib import Path

import nbformat
import pandas as pd
import pytest

ROOT = Path(__file__).parents[2]
TUTORIAL = (ROOT / "docs" / "tutorial.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def tool():
    spec = importlib.util.spec_from_file_location("tutorial_notebook", ROOT / "tools" / "tutorial_notebook.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def test_the_notebook_says_and_does_what_the_tutorial_does(tool) -> None:
    made = tool.notebook_of(TUTORIAL)
    kept = nbformat.read(ROOT / "docs" / "tutorial.ipynb", as_version=4)
    again = "run: python tools/tutorial_notebook.py"
    assert [cell.source for cell in kept.cells] == [cell.source for cell in made.cells], again
    assert all(cell.outputs for cell in kept.cells if cell.cell_type == "code" and "mkdir" not in cell.source), again
    assert (ROOT / "docs" / "tutorial.ipynb").stat().st_size < 100_000
    text = nbformat.writes(kept)
    assert not re.search(r"/(home|root|tmp|Users)/", text)


def test_every_command_of_the_tutorial_is_run_unless_it_says_otherwise(tool) -> None:
    blocks = re.findall(r"^```sh\n(.*?)^```", TUTORIAL, re.DOTALL | re.MULTILINE)
    commands = [part.text for part in tool.parts_of(TUTORIAL) if part.kind == "commands"]
    assert len(commands) >= 5
    assert [block.strip() for block in blocks if not block.startswith(tool.NOT_RUN)] == commands
    assert {part.path for part in tool.parts_of(TUTORIAL) if part.kind == "file"} == {
        "my-camera.yaml",
        "one-star/solver.yaml",
        "one-star/one_star.py",
    }


@pytest.mark.journey
def test_the_tutorial_leads_to_a_row_on_the_leaderboard(tool, tmp_path, monkeypatch) -> None:
    shim = tmp_path / "bin" / "skybench"
    shim.parent.mkdir()
    code = "import sys; sys.argv[0] = 'skybench'; from benchmark.cli.app import main; main()"
    shim.write_text(f'#!/bin/sh\nexec "{sys.executable}" -c "{code}" "$@"\n', encoding="utf-8")
    shim.chmod(shim.stat().st_mode | stat.S_IXUSR)
    monkeypatch.setenv("PATH", f"{shim.parent}{os.pathsep}{os.environ['PATH']}")
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]))
    folder = tmp_path / "work"
    folder.mkdir()
    done = tool.run(tool.notebook_of(TUTORIAL), folder)
    printed = "".join(output.get("text", "") for cell in done.cells for output in cell.get("outputs", ()))
    assert re.search(r"│ one-star *│ own *│", printed)
    assert re.search(r"│ one-star *│ shared *│", printed)
    assert (folder / "results" / "tutorial" / "site" / "solver-one-star.html").is_file()
    assert "one-star" in (folder / "results" / "tutorial" / "leaderboard.svg").read_text(encoding="utf-8")
    result = next((folder / "results" / "tutorial" / "attitude@2" / "dev" / "own").glob("one-star-*"))
    frames = pd.read_parquet(result / "frames.parquet")
    assert len(frames) == 33
    exact = frames[frames["condition"] == 0.0]
    assert (exact["error_km"] < 10.0).all()
    unknown = frames[frames["condition"] == frames["condition"].max()]
    assert set(unknown["reason"]) == {"heading unknown"}
