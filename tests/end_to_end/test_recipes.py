"""The recipes for contributors, step by step: their files are written, their edits made, their commands run, in a copy."""

from __future__ import annotations

import os
import re
import shutil
import stat
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
RECIPES = sorted((ROOT / "docs" / "contributing").glob("*.md"))
COPIED = ("benchmark", "celnav", "docs", "generator", "scenes", "tests", "tools", "pyproject.toml", "README.md")
NOT_RUN = "# not run by the tests"
FENCED = re.compile(r"^```(\w+)\n(.*?)^```$", re.DOTALL | re.MULTILINE)


@dataclass(frozen=True)
class Step:
    """A block of a recipe: `sh`, `text` (what the commands before it print), `diff`, or a file to write."""

    kind: str
    text: str
    path: str = ""


def steps_of(recipe: str) -> list[Step]:
    """The blocks of a recipe in their order."""
    steps = []
    for language, text in FENCED.findall(recipe):
        named = re.match(r"# file: (\S+)\n", text)
        if language == "diff":
            first, body = text.split("\n", 1)
            assert first.startswith("--- "), text
            steps.append(Step("diff", body, first.removeprefix("--- ")))
        elif named is not None:
            steps.append(Step("file", text[named.end() :], named.group(1)))
        else:
            assert language in {"sh", "text"}, f"a block of {language} without a file's name"
            steps += [] if text.startswith(NOT_RUN) else [Step(language, text)]
    return steps


def edited(original: str, diff: str) -> str:
    """A file's text after an edit: lines that begin with a space or a minus stand in it once; pluses take their place."""
    lines = diff.splitlines(keepends=True)
    assert all(line[0] in " +-" for line in lines), diff
    old = "".join(line[1:] for line in lines if line[0] in " -")
    new = "".join(line[1:] for line in lines if line[0] in " +")
    assert original.count(old) == 1, f"to be found once, found {original.count(old)} times:\n{old}"
    return original.replace(old, new)


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    """A copy of the repository's working files."""
    for name in COPIED:
        place = ROOT / name
        if place.is_dir():
            shutil.copytree(place, tmp_path / "copy" / name, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy(place, tmp_path / "copy" / name)
    shim = tmp_path / "bin" / "skybench"
    shim.parent.mkdir()
    code = "import sys; sys.argv[0] = 'skybench'; from benchmark.cli import main; main()"
    shim.write_text(f'#!/bin/sh\nexec "{sys.executable}" -c "{code}" "$@"\n', encoding="utf-8")
    shim.chmod(shim.stat().st_mode | stat.S_IXUSR)
    return tmp_path / "copy"


@pytest.mark.journey
@pytest.mark.parametrize("path", RECIPES, ids=lambda path: path.stem)
def test_every_step_of_the_recipe_works(path: Path, copy: Path) -> None:
    programs = f"{copy.parent / 'bin'}{os.pathsep}{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    environment = {**os.environ, "PATH": programs, "PYTHONPATH": str(copy), "COLUMNS": "200", "NO_COLOR": "1"}
    printed = ""
    for step in steps_of(path.read_text(encoding="utf-8")):
        if step.kind == "file":
            place = copy / step.path
            assert not place.exists(), f"{step.path}: would overwrite"
            place.parent.mkdir(parents=True, exist_ok=True)
            place.write_text(step.text, encoding="utf-8")
        elif step.kind == "diff":
            place = copy / step.path
            place.write_text(edited(place.read_text(encoding="utf-8"), step.text), encoding="utf-8")
        elif step.kind == "sh":
            done = subprocess.run(
                ["bash", "-e", "-o", "pipefail", "-c", step.text],
                cwd=copy,
                env=environment,
                capture_output=True,
                text=True,
                check=False,
            )
            assert done.returncode == 0, f"{step.text}\n{done.stdout}\n{done.stderr}"
            printed = done.stdout
        else:
            assert [line for line in step.text.splitlines() if line not in printed] == []


@pytest.mark.parametrize("path", RECIPES, ids=lambda path: path.stem)
def test_every_edit_of_the_recipe_fits_its_file(path: Path) -> None:
    texts: dict[str, str] = {}
    for step in steps_of(path.read_text(encoding="utf-8")):
        if step.kind == "file":
            texts[step.path] = step.text
        elif step.kind == "diff":
            before = texts.get(step.path) or (ROOT / step.path).read_text(encoding="utf-8")
            texts[step.path] = edited(before, step.text)
            assert texts[step.path] != before


def test_the_recipes_are_those_that_contributing_names() -> None:
    named = re.findall(r"\((docs/contributing/\w+\.md)\)", (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8"))
    assert sorted(set(named)) == [path.relative_to(ROOT).as_posix() for path in RECIPES]
    assert {path.stem for path in RECIPES} == {"sky_component", "sensor_effect", "solver", "task"}
    for path in RECIPES:
        assert {step.kind for step in steps_of(path.read_text(encoding="utf-8"))} >= {"file", "sh"}


def test_an_edit_that_does_not_fit_is_noticed() -> None:
    assert edited("a\nb\nc\n", " a\n-b\n+x\n") == "a\nx\nc\n"
    with pytest.raises(AssertionError, match="found 0 times"):
        edited("a\nb\nc\n", " a\n-c\n")
    with pytest.raises(AssertionError, match="found 2 times"):
        edited("a\na\n", " a\n+b\n")
