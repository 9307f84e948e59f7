"""Whether a stored result is of today's code: of the solver as it is now, and of the task's frames as they are now."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cache

from benchmark.run.shared_detections import shared_detector
from benchmark.solvers.registry import known_solvers, solver_folder
from benchmark.tasks.definition import SPLITS, load_task, task_names


class State(StrEnum):
    """Whether numbers are of today's code."""

    TODAY = "today's"
    OLDER = "not today's"
    UNRECORDED = "not recorded"


@dataclass(frozen=True)
class Origin:
    """What a result states of the code and the frames that it is of.

    Attributes
    ----------
    solver : str
    revision : str or None
        None where it was not recorded.
    detector : str or None
        Name of the shared detector; None where the solver detected by itself.
    task, split : str
        Label, ``bortle@1``, and split.
    task_sha256, scenario_sha256 : str
    """

    solver: str
    revision: str | None
    detector: str | None
    task: str
    split: str
    task_sha256: str
    scenario_sha256: str


@dataclass(frozen=True)
class Today:
    """Code and tasks as they are now.

    Attributes
    ----------
    revisions : mapping of str to str
        Of the solvers that come with skybench, by name.
    detector : str
        Name of the shared detector.
    tasks : mapping of (str, str) to (str, str)
        By label and split, the hashes of the task and of the split's scenario. A label of an earlier revision of a task
        has those of today's.
    """

    revisions: Mapping[str, str]
    detector: str
    tasks: Mapping[tuple[str, str], tuple[str, str]] = field(default_factory=dict)


@dataclass(frozen=True)
class Age:
    """How a result stands to today's code.

    Attributes
    ----------
    state : State
    revision : str or None
        Of the result.
    reasons : tuple of str
        What has changed since, in words; empty for one of today's code.
    """

    state: State
    revision: str | None
    reasons: tuple[str, ...] = ()

    @property
    def words(self) -> str:
        """In a sentence without its stop."""
        head = f"revision {self.revision}" if self.revision else "made before revisions were recorded"
        return f"{head}; not of today's code: {', '.join(self.reasons)}" if self.reasons else head


def today(origins: Iterable[Origin]) -> Today:
    """Look at the code as it is installed, as far as some results are concerned."""
    wanted = list(origins)
    solvers = {origin.solver for origin in wanted} & set(known_solvers())
    splits = {(origin.task, origin.split) for origin in wanted}
    frames = {(label, split): found for label, split in sorted(splits) if (found := _frames(label, split))}
    return Today({name: _revision(name) for name in sorted(solvers)}, shared_detector(), frames)


@cache
def _revision(solver: str) -> str:
    return solver_folder(solver).revision


@cache
def _frames(label: str, split: str) -> tuple[str, str] | None:
    """Hashes of a task and of a split's scenario; None for frames that are not of a task of skybench."""
    name = label.partition("@")[0]
    if name not in task_names() or split not in SPLITS:
        return None
    task = load_task(name)
    return task.sha256, task.scenario_of(split).sha256


def age_of(origin: Origin, now: Today) -> Age | None:
    """Hold a result against today's code.

    Returns
    -------
    Age or None
        None where today's code is not at hand: a solver or frames of the user's own.
    """
    revision = now.revisions.get(origin.solver)
    frames = now.tasks.get((origin.task, origin.split))
    if revision is None or frames is None:
        return None
    reasons = []
    if origin.revision is not None and origin.revision != revision:
        reasons.append(f"the solver's revision is {revision}")
    if origin.detector is not None and origin.detector != now.detector and origin.revision is not None:
        reasons.append(f"the shared detector is {now.detector}, then {origin.detector}")
    if frames != (origin.task_sha256, origin.scenario_sha256):
        reasons.append("the task's frames have changed")
    if origin.revision is None:
        return Age(State.UNRECORDED, None, tuple(reasons))
    return Age(State.OLDER if reasons else State.TODAY, origin.revision, tuple(reasons))
