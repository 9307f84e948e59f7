"""Shell completion: names that come with skybench, and files next to them.

The functions run at every key press, so they only read names and titles of files, and import neither models nor Mitsuba.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import benchmark.real_tasks
import benchmark.solvers
import benchmark.tasks

_TASK_SUFFIX = ".task.yaml"


def scenarios(incomplete: str) -> list[tuple[str, str]]:
    """Scenarios that come with skybench, YAML files and folders."""
    from generator.scenario.shipped import shipped_scenarios, title_of

    named = [(name, title_of(path)) for name, path in shipped_scenarios().items()]
    return _beginning(named, incomplete) + _files(incomplete, ".yaml")


def shipped(incomplete: str) -> list[tuple[str, str]]:
    """Scenarios that come with skybench."""
    from generator.scenario.shipped import shipped_scenarios, title_of

    return _beginning([(name, title_of(path)) for name, path in shipped_scenarios().items()], incomplete)


def tasks(incomplete: str) -> list[tuple[str, str]]:
    """Tasks that come with skybench."""
    found = sorted(Path(benchmark.tasks.__path__[0]).glob(f"*{_TASK_SUFFIX}"))
    return _beginning([(path.name.removesuffix(_TASK_SUFFIX), _value(path, "title")) for path in found], incomplete)


def real_tasks(incomplete: str) -> list[tuple[str, str]]:
    """Tasks of photographs."""
    found = sorted(Path(benchmark.real_tasks.__path__[0]).glob("*.yaml"))
    return _beginning([(path.stem, _value(path, "title")) for path in found], incomplete)


def targets(incomplete: str) -> list[tuple[str, str]]:
    """Tasks, files of tasks, and folders."""
    return tasks(incomplete) + real_tasks(incomplete) + _files(incomplete, _TASK_SUFFIX)


def solvers(incomplete: str) -> list[tuple[str, str]]:
    """Solvers that come with skybench, and folders."""
    found = sorted(Path(benchmark.solvers.__path__[0]).glob("*/solver.yaml"))
    named = [(_value(path, "name"), _value(path, "title")) for path in found]
    return _beginning(named, incomplete) + _files(incomplete, None)


def presets(incomplete: str) -> list[tuple[str, str]]:
    """Names of the scenario language."""
    from generator.presets import all_named

    return _beginning([(named.name, named.title) for named in all_named()], incomplete)


def _beginning(named: Iterable[tuple[str, str]], incomplete: str) -> list[tuple[str, str]]:
    return [(name, title) for name, title in named if name.startswith(incomplete)]


def _files(incomplete: str, suffix: str | None) -> list[tuple[str, str]]:
    """Folders, and files of a kind, whose path begins with the text; hidden ones only where the dot has been typed."""
    folder, begun = Path(incomplete).parent, Path(incomplete).name
    if incomplete.endswith("/"):
        folder, begun = Path(incomplete), ""
    found = []
    try:
        for path in sorted(folder.iterdir()):
            if not path.name.startswith(begun) or (path.name.startswith(".") and not begun):
                continue
            if path.is_dir():
                found.append((f"{path.as_posix()}/", ""))
            elif suffix is not None and path.name.endswith(suffix):
                found.append((path.as_posix(), ""))
    except OSError:  # a folder that does not exist or is unreadable has no completions
        return []
    return found


def _value(path: Path, key: str) -> str:
    """Read a one-line value at the top of a YAML file."""
    for line in path.read_text(encoding="utf-8").splitlines():
        if line.startswith(f"{key}:"):
            return line.removeprefix(f"{key}:").strip().strip("\"'")
    return ""
