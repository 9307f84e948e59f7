"""Bringing a leaderboard up to today's code: existing rows are kept, missing or older rows are run."""

from __future__ import annotations

import dataclasses
import itertools
from collections import defaultdict
from collections.abc import Callable, MutableMapping
from dataclasses import dataclass
from pathlib import Path

from benchmark.errors import ResultsError
from benchmark.frames.frame_set import FrameSet
from benchmark.frames.opening import open_frames
from benchmark.frames.task_frames import FrameChoice, at_hand, split_folder
from benchmark.report.refresh_plan import Job, Place, Plan, Standing, make_plan
from benchmark.report.site.tree import read_tree
from benchmark.run.contestants import contestant_of
from benchmark.run.engine import Notes, SolverRun, noted, run_all
from benchmark.run.provenance import DetectionsMode, provenance_of
from benchmark.run.renewal import earlier_row, frames_as_before
from benchmark.tasks.definition import TASK_SUFFIX, SplitName, Task, load_task, load_task_file

SPLIT: SplitName = "dev"
"""Split of leaderboards."""


@dataclass(frozen=True)
class BoardsRequest:
    """Rows that a leaderboard is to have.

    Attributes
    ----------
    tasks : tuple of str
        Names, or files of tasks.
    solvers : tuple of str
        Names, or folders with a solver.yaml.
    out, data : Path
        Folders of results and of the tasks' frames.
    jobs : int
        Number of frames that are solved in parallel.
    per_condition : int or None
        Frames at each condition; None for the task's own number.
    existing : bool
        Whether only existing rows are renewed, and missing ones are not added.
    """

    tasks: tuple[str, ...]
    solvers: tuple[str, ...]
    out: Path
    data: Path
    jobs: int
    per_condition: int | None
    existing: bool = False

    @property
    def choice(self) -> FrameChoice:
        """The requested frames of a task."""
        return FrameChoice(SPLIT, self.per_condition, None, self.data, self.jobs)


@dataclass(frozen=True, eq=False)
class Opened:
    """Frames of a task, and what is known about each."""

    frames: FrameSet
    notes: Notes


@dataclass(frozen=True)
class Made:
    """Result of running a plan.

    Attributes
    ----------
    renewed : tuple of str
        For each row that holds answers of an earlier one, how many.
    obstacles : tuple of str
        Why solvers could not run here, or that all their answers are errors.
    """

    renewed: tuple[str, ...]
    obstacles: tuple[str, ...]


def plan_boards(request: BoardsRequest) -> Plan:
    """Find the rows that are missing or not of today's code.

    A fused solver only has rows for tasks of sequences; elsewhere it answers as the solver that it wraps.

    Raises
    ------
    BenchmarkError
        A task, a solver or a result is invalid.
    """
    tasks = {label: task for label, (_, task) in _tasks(request).items()}
    targets = {label: _size(task, request) for label, task in tasks.items()}
    fused = [solver for solver in request.solvers if (found := contestant_of(solver).definition) and found.fused]
    single = [label for label, task in tasks.items() if task.sequence_length == 1]
    left_out = set(itertools.product(*((tasks, request.solvers) if request.existing else (single, fused))))
    return make_plan(_standing(request.out), targets, request.solvers, ("own",), left_out)


def count_as_before(plan: Plan, request: BoardsRequest, opened: MutableMapping[str, Opened]) -> Plan:
    """Determine for each row how many of its frames are unchanged; unknown for frames that are not rendered yet.

    Parameters
    ----------
    plan : Plan
    request : BoardsRequest
    opened : mapping of str to Opened
        Tasks by label; those that are opened here are added, for `run_plan`.

    Raises
    ------
    BenchmarkError
        Frames or a result are damaged.
    """
    tasks = _tasks(request)
    there = {label for label in {job.place.task for job in plan.jobs} if at_hand(tasks[label][1], request.choice)}
    jobs = [
        _counted(job, request, _opened(job.place.task, tasks[job.place.task][0], request, opened))
        if job.place.task in there
        else job
        for job in plan.jobs
    ]
    return Plan(tuple(jobs), plan.fresh)


def _counted(job: Job, request: BoardsRequest, found: Opened) -> Job:
    contestant, detections, frames = contestant_of(job.place.solver), job.place.detections, found.frames
    facts = contestant.facts("", detections)  # its version is only known after a start, and the revision says more
    wanted = provenance_of(contestant.name, facts, frames.facts, detections, request.jobs)
    row = earlier_row(request.out, contestant.name, wanted)
    if row is None:
        return job
    same = frames_as_before(row, frames.frames, lambda frame: noted(frame, found.notes).identity)
    seconds = job.seconds * (1.0 - len(same) / len(frames.frames))
    return dataclasses.replace(job, n_as_before=len(same), seconds=seconds)


def _opened(label: str, target: str, request: BoardsRequest, opened: MutableMapping[str, Opened]) -> Opened:
    if label not in opened:
        opened[label] = Opened(open_frames(target, request.choice), {})
    return opened[label]


def run_plan(
    plan: Plan, request: BoardsRequest, opened: MutableMapping[str, Opened], progress: Callable[[str, int], None]
) -> Made:
    """Run the rows of a plan; existing answers to unchanged frames are kept.

    Parameters
    ----------
    plan : Plan
    request : BoardsRequest
    opened : mapping of str to Opened
        Tasks that are already open, by label; others are added.
    progress : callable
        Called with a solver and the number of its frames that are done.

    Raises
    ------
    BenchmarkError
        Frames cannot be rendered, or a result cannot be written.
    """
    tasks = _tasks(request)
    wanted: defaultdict[tuple[DetectionsMode, str], list[str]] = defaultdict(list)
    for job in plan.jobs:
        wanted[job.place.detections, job.place.solver].append(job.place.task)
    renewed, left = [], []
    for (detections, solver), labels in wanted.items():
        contestant = contestant_of(solver)
        if obstacle := contestant.obstacle():
            left.append(obstacle)
            continue
        found = [_opened(label, tasks[label][0], request, opened) for label in labels]
        sets, notes = [one.frames for one in found], [one.notes for one in found]
        runs = run_all([contestant], sets, request.out, detections, request.jobs, progress, notes, renew=True)
        for label, done in zip(labels, runs, strict=True):
            if done.n_kept:
                renewed.append(f"{label}, {detections} detections: {_renewed_words(done)}")
            if done.failed_throughout:
                left.append(f"{solver}: every answer of {done.summary.n_frames} is an error ({done.folder})")
    return Made(tuple(renewed), tuple(dict.fromkeys(left)))


def _renewed_words(done: SolverRun) -> str:
    n_frames = done.summary.n_frames
    return f"{done.solver}: {done.n_kept} of {n_frames} frames as before, {n_frames - done.n_kept} solved again"


def missing_frames(plan: Plan, request: BoardsRequest) -> int:
    """Number of frames that must be rendered first, for those of a plan's tasks of which no frame exists."""
    tasks = _tasks(request)
    count = 0
    for label in dict.fromkeys(job.place.task for job in plan.jobs):
        task = tasks[label][1]
        folder = split_folder(task.label, SPLIT, task.scenario_of(SPLIT).sha256, request.data)
        count += 0 if folder.is_dir() else _size(task, request)
    return count


def _tasks(request: BoardsRequest) -> dict[str, tuple[str, Task]]:
    """Tasks by their labels, each with the name under which it was requested."""
    found = {}
    for name in request.tasks:
        task = load_task_file(Path(name)) if name.endswith(TASK_SUFFIX) else load_task(name)
        found[task.label] = name, task
    return found


def _size(task: Task, request: BoardsRequest) -> int:
    per_condition = request.per_condition or task.definition.frames_per_condition
    return per_condition * len(task.definition.condition.values)


def _standing(out: Path) -> dict[Place, Standing]:
    try:
        groups = read_tree(out) if out.is_dir() else []
    except ResultsError:
        if any(out.glob("*@*/*")):
            raise
        groups = []
    return {
        Place(stored.task.key, stored.provenance.detections, stored.provenance.solver.target or ""): Standing(
            stored.age, len(stored.frames), float(stored.frames["time_ms"].mean()) / 1000.0
        )
        for group in groups
        for stored in group
        if stored.split == SPLIT
    }
