"""Earlier definitions of a task that has gained conditions at its hard end.

Frames are numbered from the easiest condition on, and each has random streams that depend on its number, so appending
conditions changes no earlier frame. The hash of a definition tells whether it is such an earlier one.
"""

from __future__ import annotations

from typing import Any

import yaml

from benchmark.tasks.definition import FEWEST_VALUES, Task, meaning_sha256

_SWEEP = "sweep"


def earlier_definitions(task: Task) -> dict[str, int]:
    """Hashes of a task's definition without its last conditions, each with the number of conditions that it had.

    What is equal in all remaining conditions may have been one value instead of a list.
    """
    if task.sequence_length > 1:
        return {}  # graded by the number of frames so far, so no condition is appended
    n = len(task.definition.condition.values)
    return {_sha256_of_first(task, count): count for count in range(FEWEST_VALUES, n)}


def _sha256_of_first(task: Task, count: int) -> str:
    n = len(task.definition.condition.values)
    definition, scenario = (
        yaml.load(text, Loader=yaml.BaseLoader) for text in (task.definition_text, task.scenario_text)
    )
    definition["condition"]["values"] = definition["condition"]["values"][:count]
    if "instruments" in definition:
        told = definition["instruments"]
        definition["instruments"] = {key: _first(given, n, count) for key, given in told.items()}
    return meaning_sha256(definition, _swept(scenario, n, count))


def _first(given: Any, n: int, count: int) -> Any:
    """Truncate a list with a value for each of `n` conditions; a single value where the remaining ones are equal."""
    if not isinstance(given, list) or len(given) != n:
        return given
    left = given[:count]
    return left[0] if all(value == left[0] for value in left) else left


def _swept(tree: Any, n: int, count: int) -> Any:
    """Truncate the sweeps in a scenario's tree."""
    if isinstance(tree, list):
        return [_swept(value, n, count) for value in tree]
    if not isinstance(tree, dict):
        return tree
    if _SWEEP in tree:
        left = _first(tree[_SWEEP], n, count)
        return tree | {_SWEEP: left} if isinstance(left, list) else left
    return {key: _swept(value, n, count) for key, value in tree.items()}
