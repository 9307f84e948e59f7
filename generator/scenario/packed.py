"""Scenarios whose landscape packages come from a third party: how these are compressed is checked before they are read."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml

from generator.errors import ScenarioError
from generator.files import read_text_at_most
from generator.ground.stellarium.compression import check_compression
from generator.ground.stellarium.package import PackageError
from generator.reading.strict_yaml import StrictLoader
from generator.scenario.file import LARGEST_FILE_BYTES, Scenario, load_scenario
from generator.scenario.strict import LARGEST_INPUT_BYTES


def load_packed(path: Path) -> Scenario:
    """Read a scenario as `load_scenario` does, after a look at the packages that it names. Raises ScenarioError."""
    check_packages(path)
    return load_scenario(path)


def check_packages(path: Path) -> None:
    """Refuse a scenario that names a package with files that are neither stored nor deflated.

    Raises
    ------
    ScenarioError
        There is such a package. All other errors of a scenario are those that `load_scenario` finds.
    """
    try:
        tree = yaml.load(read_text_at_most(path, LARGEST_FILE_BYTES), Loader=StrictLoader)  # a SafeLoader underneath
    except (OSError, ValueError, RecursionError, yaml.YAMLError):
        return
    for place in sorted({text for text in _texts(tree) if text.lower().endswith(".zip")}):
        try:
            folder = path.parent.resolve()
            package = (folder / place).resolve()
            readable = package.is_relative_to(folder) and package.is_file()
            if not readable or package.stat().st_size > LARGEST_INPUT_BYTES:
                continue
        except (OSError, RuntimeError, ValueError):  # Python up to 3.12 raises RuntimeError for circular links
            continue
        try:
            check_compression(package, place)
        except PackageError as error:
            raise ScenarioError(f"{path}: foreground.landscape: {error}") from error


def _texts(tree: Any) -> Iterator[str]:
    """Yield all texts of a tree: a package may also be one of the values of a sweep."""
    parts = [tree]
    while parts:
        part = parts.pop()
        if isinstance(part, str):
            yield part
        elif isinstance(part, dict):
            parts += part.values()
        elif isinstance(part, list):
            parts += part
