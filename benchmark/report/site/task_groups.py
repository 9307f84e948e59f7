"""Tasks in the groups in which people look for them."""

from __future__ import annotations

from collections.abc import Iterable

_GROUPS = (
    ("sky and camera", ("bortle", "weather", "optics", "motion", "clutter", "glints", "thesis-mag")),
    ("stations: whole sky, meteors", ("allsky", "meteor")),
    ("star trackers", ("startracker", "startracker-false")),
    ("hand, vehicle, street", ("phone", "uav", "city")),
    ("calibration and told values", ("attitude", "drift", "unknown-camera")),
)
_GROUP_OF = {task: group for group, tasks in _GROUPS for task in tasks}
_PLACE = {task: place for place, task in enumerate(_GROUP_OF)}
OTHERS = "other frames"


def group_of(task: str) -> str:
    """Group of a task by its name without a revision; `OTHERS` for frames of somebody else."""
    return _GROUP_OF.get(task, OTHERS)


def place_of(task: str) -> int:
    """Order in which tasks stand: group by group, those of somebody else last."""
    return _PLACE.get(task, len(_PLACE))


def groups_among(tasks: Iterable[str]) -> tuple[str, ...]:
    """Groups of these tasks, in the order in which they stand."""
    return tuple(dict.fromkeys(group_of(task) for task in sorted(tasks, key=place_of)))
