"""Scenarios that come with skybench: found by name in every installation, with or without the repository."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from pathlib import Path

from generator.errors import ScenarioError
from generator.files import write_bytes

SUFFIX = ".yaml"
SCHEMA_NAME = "schema.json"
_FOLDER_NAME = "scenes"
# Next to the generator's data, not in it: the revision covers all data, and must be the same with and without the
# repository.
_IN_PACKAGE = Path(__file__).parents[1] / _FOLDER_NAME
_IN_REPOSITORY = Path(__file__).parents[2] / _FOLDER_NAME


def scenes_folder() -> Path:
    """Return the folder of the scenarios that come with skybench, with the files that they name and the schema.

    A wheel contains a copy of the repository's folder ``scenes`` (pyproject.toml); an editable installation reads the
    folder itself.
    """
    return _IN_PACKAGE if _IN_PACKAGE.is_dir() else _IN_REPOSITORY


def shipped_scenarios() -> dict[str, Path]:
    """Return the scenario files that come with skybench by name (the file's, without its suffix), sorted."""
    return {path.stem: path for path in sorted(scenes_folder().glob(f"*{SUFFIX}"))}


def find_scenario(argument: str | Path) -> Path:
    """Return the scenario file that an argument means.

    Parameters
    ----------
    argument : str or Path
        A file; or, where there is no such file, a scenario that comes with skybench: ``demo``, ``demo.yaml`` or
        ``scenes/demo.yaml``.

    Raises
    ------
    ScenarioError
        It is neither; the message lists the names.
    """
    path = Path(argument)
    if path.is_file():
        return path
    if path.parent in (Path(), Path(_FOLDER_NAME)):
        return find_shipped(path.stem if path.suffix == SUFFIX else path.name, str(path))
    raise ScenarioError(f"{path}: cannot be read (no such file); `skybench scenes` lists what comes with skybench")


def find_shipped(name: str, written: str = "") -> Path:
    """Return the file of a scenario that comes with skybench; `written` is the argument as the user wrote it.

    Raises
    ------
    ScenarioError
        There is no scenario of that name; the message lists the names.
    """
    shipped = shipped_scenarios()
    if name in shipped:
        return shipped[name]
    near = difflib.get_close_matches(name, shipped, n=1)
    hint = f" (did you mean {near[0]}?)" if near else ""
    raise ScenarioError(
        f"{written or name}: cannot be read (no such file), and no scenario of that name comes with skybench{hint}; "
        f"these do: {', '.join(shipped)}"
    )


def copy_scenarios(scenarios: Mapping[str, Path], folder: Path) -> list[Path]:
    """Copy scenarios to a folder, with the files that they name and the schema for editors; returns what was written.

    Raises
    ------
    ScenarioError
        A different file of that name exists.
    """
    from generator.scenario.file import load_scenario  # not needed to list names, which completion does at every key

    wanted = {path.name: path for path in scenarios.values()}
    for path in scenarios.values():
        wanted |= {file.path: path.parent / file.path for file in load_scenario(path).files}
    wanted[SCHEMA_NAME] = scenes_folder() / SCHEMA_NAME
    for name, source in wanted.items():
        target = folder / name
        if target.exists() and target.read_bytes() != source.read_bytes():
            raise ScenarioError(f"{target}: is there already and is another; give --copy another folder")
    for name, source in wanted.items():
        write_bytes(folder / name, source.read_bytes())
    return [folder / name for name in wanted]


def title_of(path: Path) -> str:
    """Return the comment line at the top of a scenario file, without its sign and its full stop."""
    with path.open(encoding="utf-8") as lines:
        return next(lines, "").removeprefix("#").strip().removesuffix(".")
