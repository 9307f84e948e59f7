"""The layout: no circle of imports among modules or among rooms, and no room that has outgrown itself."""

from __future__ import annotations

import ast
from collections import Counter
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PACKAGES = ("generator", "celnav", "benchmark")
MOST_MODULES = 20


def modules() -> dict[str, Path]:
    """Every module of the three packages by its dotted name; programs for environments of their own are not modules."""
    found = {}
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*.py")):
            parts = path.relative_to(ROOT).with_suffix("").parts
            if all(part.isidentifier() for part in parts):
                found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def imports(graph_of: dict[str, Path]) -> dict[str, set[str]]:
    """For each module, the modules that it imports anywhere in it, imports inside functions included."""
    graph = {}
    for name, path in graph_of.items():
        found = set()
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                found |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module:
                for alias in node.names:
                    whole = f"{node.module}.{alias.name}"
                    found.add(whole if whole in graph_of else node.module)
        graph[name] = {each for each in found if each in graph_of} - {name}
    return graph


def room(module: str) -> str:
    """The folder a module lies in, to the second level; modules at a package's top are rooms of their own."""
    return ".".join(module.split(".")[:2])


def circle(graph: dict[str, set[str]]) -> tuple[str, ...] | None:
    """The first circle of a graph, if there is one."""
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return tuple(error.args[1])
    return None


def test_a_circle_is_found() -> None:
    assert circle({"a": {"b"}, "b": {"c"}, "c": {"a"}}) is not None
    assert circle({"a": {"b"}, "b": {"c"}, "c": set()}) is None


def test_no_modules_import_each_other_in_a_circle() -> None:
    graph = imports(modules())
    assert sum(len(each) for each in graph.values()) > 500
    assert circle(graph) is None


def test_no_rooms_import_each_other_in_a_circle() -> None:
    graph: dict[str, set[str]] = {}
    for name, targets in imports(modules()).items():
        graph.setdefault(room(name), set()).update(room(target) for target in targets if room(target) != room(name))
    for package in PACKAGES:  # a package's __init__ gathers what is public
        graph.pop(package, None)
    assert circle({name: {each for each in targets if each in graph} for name, targets in graph.items()}) is None


@pytest.mark.parametrize("package", PACKAGES)
def test_no_folder_holds_more_modules_than_a_reader_can_take_in(package: str) -> None:
    count = Counter(path.parent for path in (ROOT / package).rglob("*.py"))
    largest = {str(path.relative_to(ROOT)): number for path, number in count.items()}
    assert {path: number for path, number in largest.items() if number > MOST_MODULES} == {}
