"""Whether a stored result is of today's code: of the current solver and of the current frames of its task."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path

from benchmark.run.provenance import RunProvenance
from benchmark.run.shared_detections import shared_detector
from benchmark.solvers.definition import SPEC_NAME
from benchmark.solvers.registry import known_solvers, solver_folder
from benchmark.tasks.definition import RETIRED, SPLITS, TASK_SUFFIX, load_task, load_task_file, task_names

RETIRED_HASHES = ("", "")
"""Hashes for the frames of a retired task, which match no result."""


class State(StrEnum):
    """Whether numbers are of today's code."""

    TODAY = "today's"
    OLDER = "not today's"
    UNRECORDED = "not recorded"


@dataclass(frozen=True)
class Origin:
    """What a result states about the code and the frames that produced it.

    Attributes
    ----------
    solver : str
        Its name or folder; empty where no command runs it.
    revision : str or None
        None where the result does not record it.
    detector : str or None
        Name of the shared detector; None where the solver detected by itself.
    task, split : str
        Argument of `skybench bench run` that gets the frames, ``bortle@2`` or the path of a task's file; and the split.
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
    """The code and the tasks as they are now.

    Attributes
    ----------
    revisions : mapping of str to str
        Revisions of the available solvers, by name or folder.
    detector : str
        Name of the shared detector.
    tasks : mapping of (str, str) to (str, str)
        Hashes of the task and of the split's scenario, by task and split; an earlier revision of a task has today's.
    """

    revisions: Mapping[str, str]
    detector: str
    tasks: Mapping[tuple[str, str], tuple[str, str]] = field(default_factory=dict)


@dataclass(frozen=True)
class Age:
    """How a result relates to today's code.

    Attributes
    ----------
    state : State
    revision : str or None
        Revision of the solver that the result states.
    reasons : tuple of str
        What has changed since, in words; empty for a result of today's code.
    """

    state: State
    revision: str | None
    reasons: tuple[str, ...] = ()

    @property
    def words(self) -> str:
        """The age as a sentence without its full stop."""
        head = f"revision {self.revision}" if self.revision else "revision not recorded"
        return "; ".join((head, *self.reasons))


def today(origins: Iterable[Origin]) -> Today:
    """Read the current state of the code, as far as it concerns some results."""
    wanted = list(origins)
    solvers = sorted({origin.solver for origin in wanted})
    splits = sorted({(origin.task, origin.split) for origin in wanted})
    revisions = {solver: found for solver in solvers if (found := _revision(solver))}
    frames = {(task, split): hashes for task, split in splits if (hashes := _frames(task, split))}
    return Today(revisions, shared_detector(), frames)


def _revision(solver: str) -> str | None:
    """Revision of a solver by its name or folder; None where it is not available."""
    at_hand = solver in known_solvers() or (solver and (Path(solver) / SPEC_NAME).is_file())
    return solver_folder(solver).revision if at_hand else None


def _frames(target: str, split: str) -> tuple[str, str] | None:
    """Hashes of a task and of a split's scenario; `RETIRED_HASHES` for a retired task, None for anything else."""
    if split not in SPLITS:
        return None
    if target.endswith(TASK_SUFFIX):
        task = load_task_file(Path(target)) if Path(target).is_file() else None
    else:
        name = target.partition("@")[0]
        if name in RETIRED:
            return RETIRED_HASHES
        task = load_task(name) if name in task_names() else None
    return (task.sha256, task.scenario_of(split).sha256) if task else None


def origin_of(source: RunProvenance) -> Origin:
    """Origin that a result's provenance states."""
    frames = source.frames
    return Origin(
        solver=source.solver.target or "",
        revision=source.solver.revision,
        detector=source.solver.detector if source.detections == "shared" else None,
        task=frames.target,
        split=frames.split,
        task_sha256=frames.definition_sha256 or "",
        scenario_sha256=frames.scenario_sha256,
    )


def age_of(origin: Origin, now: Today) -> Age | None:
    """Compare a result with today's code.

    Returns
    -------
    Age or None
        None where today's code is not available: a Python object, a submission, frames that are not of a task.
    """
    revision = now.revisions.get(origin.solver)
    frames = now.tasks.get((origin.task, origin.split))
    if revision is None or frames is None:
        return None
    reasons = []
    if origin.revision is not None and origin.revision != revision:
        reasons.append(f"today's is {revision}")
    if origin.detector is not None and origin.detector != now.detector and origin.revision is not None:
        reasons.append(f"detections by {origin.detector}, today's is {now.detector}")
    if frames == RETIRED_HASHES:
        reasons.append("the task is retired")
    elif frames != (origin.task_sha256, origin.scenario_sha256):
        reasons.append("the task's frames have changed since")
    if origin.revision is None:
        return Age(State.UNRECORDED, None, tuple(reasons))
    return Age(State.OLDER if reasons else State.TODAY, origin.revision, tuple(reasons))
