"""Earlier definitions of a task that has gained conditions at its hard end.

Frames are numbered from the easiest condition on, and each has random streams that depend on its number, so appending
conditions changes no earlier frame. The hash of a definition tells whether it is such an earlier one.
"""

from __future__ import annotations

from collections import Counter
from typing import Any

import yaml

from benchmark.tasks.definition import FEWEST_VALUES, Task, meaning_sha256

_SWEEP, _ZIP, _NOT_GIVEN = "sweep", "zip", "null"


def earlier_definitions(task: Task) -> dict[str, int]:
    """Hashes of a task's definition without its last conditions, each with the number of conditions that it had.

    What is equal in all remaining conditions may have been one value instead of a list, what is null in all of them may
    have been left out, and a sweep that remains alone on its axis may have had no name for it.
    """
    if task.sequence_length > 1:
        return {}  # graded by the number of frames so far, so no condition is appended
    n = len(task.definition.condition.values)
    return {sha256: count for count in range(FEWEST_VALUES, n) for sha256 in _sha256_of_first(task, count)}


def _sha256_of_first(task: Task, count: int) -> tuple[str, str]:
    """Hashes of a task's definition with its first `count` conditions, with and without names of axes of one sweep."""
    n = len(task.definition.condition.values)
    definition, scenario = (
        yaml.load(text, Loader=yaml.BaseLoader) for text in (task.definition_text, task.scenario_text)
    )
    definition["condition"]["values"] = definition["condition"]["values"][:count]
    if "instruments" in definition:
        told = definition["instruments"]
        definition["instruments"] = {key: _first(given, n, count) for key, given in told.items()}
    left = _swept(scenario, n, count)
    return meaning_sha256(definition, left), meaning_sha256(definition, _without_lone_axes(left))


def _first(given: Any, n: int, count: int) -> Any:
    """Truncate a list with a value for each of `n` conditions; a single value where the remaining ones are equal."""
    if not isinstance(given, list) or len(given) != n:
        return given
    left = given[:count]
    return left[0] if all(value == left[0] for value in left) else left


def _swept(tree: Any, n: int, count: int) -> Any:
    """Truncate the sweeps in a scenario's tree, and leave out the keys that are null then."""
    if isinstance(tree, list):
        return [_swept(value, n, count) for value in tree]
    if not isinstance(tree, dict):
        return tree
    if _SWEEP in tree:
        left = _first(tree[_SWEEP], n, count)
        return tree | {_SWEEP: left} if isinstance(left, list) else left
    truncated = ((key, value, _swept(value, n, count)) for key, value in tree.items())
    return {key: left for key, value, left in truncated if left == value or left != _NOT_GIVEN}


def _without_lone_axes(tree: Any) -> Any:
    """Remove the names of axes on which a scenario's tree has one sweep."""
    counts = Counter(sweep.get(_ZIP) for sweep in _sweeps(tree))
    return _nameless(tree, {name for name, count in counts.items() if count == 1})


def _sweeps(tree: Any) -> list[dict[str, Any]]:
    if isinstance(tree, dict):
        return [tree] if _SWEEP in tree else [sweep for value in tree.values() for sweep in _sweeps(value)]
    return [sweep for value in tree for sweep in _sweeps(value)] if isinstance(tree, list) else []


def _nameless(tree: Any, lone: set[str | None]) -> Any:
    """Remove these names from the sweeps in a scenario's tree."""
    if isinstance(tree, list):
        return [_nameless(value, lone) for value in tree]
    if not isinstance(tree, dict):
        return tree
    return {
        key: _nameless(value, lone)
        for key, value in tree.items()
        if not (key == _ZIP and _SWEEP in tree and value in lone)
    }
