"""Groups of tasks, as readers look for them."""

from __future__ import annotations

from collections.abc import Iterable

_GROUPS = (
    ("sky and camera", ("bortle", "weather", "optics", "motion", "clutter", "glints", "thesis-mag")),
    ("stations: whole sky, meteors", ("allsky", "meteor")),
    ("star trackers", ("startracker", "startracker-false", "startracker-field")),
    ("hand, vehicle, street", ("phone", "uav", "city")),
    ("calibration and told values", ("attitude", "drift", "unknown-camera")),
)
_GROUP_OF = {task: group for group, tasks in _GROUPS for task in tasks}
_PLACE = {task: place for place, task in enumerate(_GROUP_OF)}
OTHERS = "other frames"


def group_of(task: str) -> str:
    """Group of a task by its name without a revision; `OTHERS` for frames that are not skybench's."""
    return _GROUP_OF.get(task, OTHERS)


def place_of(task: str) -> int:
    """Rank of a task in the order of display: group by group, tasks that are not skybench's last."""
    return _PLACE.get(task, len(_PLACE))


def groups_among(tasks: Iterable[str]) -> tuple[str, ...]:
    """Groups of these tasks, in the order of display."""
    return tuple(dict.fromkeys(group_of(task) for task in sorted(tasks, key=place_of)))
