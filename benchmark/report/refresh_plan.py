"""Plan of what to run to bring a leaderboard up to today's code: missing or older rows, and the time that they take."""

from __future__ import annotations

import statistics
from collections import defaultdict
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

from benchmark.run.freshness import Age, State
from benchmark.run.provenance import DetectionsMode

RENDER_S = 0.1
"""Time that one process takes to render a frame of a task (docs/performance.md)."""


@dataclass(frozen=True)
class Place:
    """A row of a leaderboard."""

    task: str
    detections: DetectionsMode
    solver: str


@dataclass(frozen=True)
class Standing:
    """What is known about an existing row.

    Attributes
    ----------
    age : Age or None
        None where today's code is not available.
    n_frames : int
    frame_s : float
        Mean time per frame.
    revision : str or None
        Revision of the solver; None where it is unknown.
    """

    age: Age | None
    n_frames: int
    frame_s: float
    revision: str | None = None


@dataclass(frozen=True)
class Job:
    """A row to be run.

    Attributes
    ----------
    place : Place
    why : str
    n_frames : int
    seconds : float or None
        Estimated time of one process, from the existing row or from the solver's other rows; None where it has no row.
    n_as_before : int
        Those of the frames that are unchanged since the existing row, and so are not solved again.
    revision : str or None
        Revision of the solver of the existing row; None without a row, or where it is unknown.
    """

    place: Place
    why: str
    n_frames: int
    seconds: float | None
    n_as_before: int = 0
    revision: str | None = None


@dataclass(frozen=True)
class Plan:
    """Rows to be run, and rows that are of today's code."""

    jobs: tuple[Job, ...]
    fresh: tuple[Place, ...]

    def seconds(self, processes: int, missing_frames: int) -> float:
        """Estimate of the total time, including that of rendering the missing frames, without rows of unknown time."""
        return (sum(job.seconds or 0.0 for job in self.jobs) + RENDER_S * missing_frames) / processes

    @property
    def n_unknown(self) -> int:
        """Number of rows of unknown time."""
        return sum(job.seconds is None for job in self.jobs)


def make_plan(
    standing: Mapping[Place, Standing],
    tasks: Mapping[str, int],
    solvers: Sequence[str],
    modes: Sequence[DetectionsMode],
    left_out: Collection[tuple[str, str]] = (),
) -> Plan:
    """Find the rows that are missing or not of today's code.

    Parameters
    ----------
    standing : mapping of Place to Standing
        The existing rows.
    tasks : mapping of str to int
        Labels, and the number of frames on which each task is to be run.
    solvers : sequence of str
        Each has a row for each task in each of the `modes`.
    modes : sequence of str
        Existing rows in another mode of detection are kept up to date too.
    left_out : collection of (str, str)
        Tasks and solvers for which no new row is added.
    """
    each = [(task, mode, solver) for task in tasks for mode in modes for solver in solvers]
    wanted = [Place(task, mode, solver) for task, mode, solver in each if (task, solver) not in left_out]
    others = [place for place in standing if place.task in tasks and place.solver in solvers]
    frame_s: defaultdict[str, list[float]] = defaultdict(list)
    for place, row in standing.items():
        frame_s[place.solver].append(row.frame_s)
    usual_s = {solver: statistics.mean(times) for solver, times in frame_s.items()}
    jobs, fresh = [], []
    for place in dict.fromkeys(
        (*wanted, *sorted(others, key=lambda place: (place.task, place.detections, place.solver)))
    ):
        known, n = standing.get(place), tasks[place.task]
        why = _why(known, n)
        if why:
            each_s = usual_s.get(place.solver) if known is None else known.frame_s
            seconds = None if each_s is None else n * each_s
            jobs.append(Job(place, why, n, seconds, revision=None if known is None else known.revision))
        else:
            fresh.append(place)
    return Plan(tuple(jobs), tuple(fresh))


def _why(row: Standing | None, n_frames: int) -> str:
    """Why a row is to be run; empty where it is not."""
    if row is None:
        return "missing"
    if row.n_frames < n_frames:
        return f"has {row.n_frames} frames"
    if row.age is None or row.age.state is State.TODAY:
        return ""
    return row.age.words
