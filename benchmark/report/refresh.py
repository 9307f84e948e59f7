"""Bringing a leaderboard up to today's code: existing rows are kept, missing or older rows are run."""

from __future__ import annotations

import dataclasses
import itertools
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from multiprocessing import get_context
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
from generator.processes import follow_parent

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


def count_as_before(
    plan: Plan, request: BoardsRequest, progress: Callable[[int], None] = lambda frames: None
) -> tuple[Plan, dict[str, Notes]]:
    """Determine for each row how many of its frames are unchanged; unknown for frames that are not rendered yet.

    Parameters
    ----------
    plan : Plan
    request : BoardsRequest
        Its number of jobs is the number of tasks whose frames are compared in parallel.
    progress : callable
        Called with the number of further frames that are compared.

    Returns
    -------
    tuple of (Plan, dict of str to Notes)
        The plan with these numbers; by label of the task, what is known about each frame, for `run_plan`.

    Raises
    ------
    BenchmarkError
        Frames or a result are damaged, or a process ended.
    """
    tasks, counted, notes = _tasks(request), dict[Place, Job](), dict[str, Notes]()
    calls = [(label, tasks[label][0], tuple(jobs), request) for label, jobs in _comparable(plan, request).items()]
    for label, jobs, found in _in_parallel(calls, request.jobs):
        notes[label] = found
        counted |= {job.place: job for job in jobs}
        progress(jobs[0].n_frames)
    return Plan(tuple(counted.get(job.place, job) for job in plan.jobs), plan.fresh), notes


_Call = tuple[str, str, tuple[Job, ...], BoardsRequest]
_Compared = tuple[str, tuple[Job, ...], Notes]


def _in_parallel(calls: Sequence[_Call], processes: int) -> Iterator[_Compared]:
    """Compare the frames of several tasks in processes, since reading and hashing keep a core busy."""
    if min(processes, len(calls)) < 2:
        yield from map(_compared, calls)
        return
    try:
        with ProcessPoolExecutor(min(processes, len(calls)), get_context("spawn"), follow_parent) as pool:
            for done in as_completed([pool.submit(_compared, call) for call in calls]):
                yield done.result()
    except BrokenProcessPool as error:
        raise ResultsError("a process that compared frames has ended (out of memory?); use fewer --jobs") from error


def _compared(call: _Call) -> _Compared:
    """Count the frames of one task that are as before, for each of its rows."""
    label, target, jobs, request = call
    frames = open_frames(target, request.choice)
    notes: Notes = {}
    return label, tuple(_counted(job, request, frames, notes) for job in jobs), notes


def _counted(job: Job, request: BoardsRequest, frames: FrameSet, notes: Notes) -> Job:
    contestant, detections = contestant_of(job.place.solver), job.place.detections
    facts = contestant.facts("", detections)  # its version is only known after a start, and the revision says more
    wanted = provenance_of(contestant.name, facts, frames.facts, detections, request.jobs)
    row = earlier_row(request.out, contestant.name, wanted)
    if row is None:
        return job
    same = frames_as_before(row, frames.frames, lambda frame: noted(frame, notes).identity)
    seconds = None if job.seconds is None else job.seconds * (1.0 - len(same) / len(frames.frames))
    return dataclasses.replace(job, n_as_before=len(same), seconds=seconds)


def run_plan(
    plan: Plan, request: BoardsRequest, known: Mapping[str, Notes], progress: Callable[[str, int], None]
) -> Made:
    """Run the rows of a plan; existing answers to unchanged frames are kept.

    Parameters
    ----------
    plan : Plan
    request : BoardsRequest
    known : mapping of str to Notes
        What is known about the frames of tasks, by label; see `count_as_before`.
    progress : callable
        Called with a solver and the number of its frames that are done.

    Raises
    ------
    BenchmarkError
        Frames cannot be rendered, or a result cannot be written.
    """
    tasks = _tasks(request)
    opened: dict[str, FrameSet] = {}
    notes: defaultdict[str, Notes] = defaultdict(dict, known)
    wanted: defaultdict[tuple[DetectionsMode, str], list[str]] = defaultdict(list)
    for job in plan.jobs:
        wanted[job.place.detections, job.place.solver].append(job.place.task)
    renewed, left = [], []
    for (detections, solver), labels in wanted.items():
        contestant = contestant_of(solver)
        if obstacle := contestant.obstacle():
            left.append(obstacle)
            continue
        for label in labels:
            if label not in opened:
                opened[label] = open_frames(tasks[label][0], request.choice)
        sets, noticed = [opened[label] for label in labels], [notes[label] for label in labels]
        runs = run_all([contestant], sets, request.out, detections, request.jobs, progress, noticed, renew=True)
        for label, done in zip(labels, runs, strict=True):
            if done.n_kept:
                renewed.append(f"{label}, {detections} detections: {_renewed_words(done)}")
            if done.failed_throughout:
                left.append(f"{solver}: every answer of {done.summary.n_frames} is an error ({done.folder})")
    return Made(tuple(renewed), tuple(dict.fromkeys(left)))


def _renewed_words(done: SolverRun) -> str:
    n_frames = done.summary.n_frames
    return f"{done.solver}: {done.n_kept} of {n_frames} frames as before, {n_frames - done.n_kept} solved again"


def compared_frames(plan: Plan, request: BoardsRequest) -> int:
    """Number of frames that `count_as_before` compares."""
    return sum(jobs[0].n_frames for jobs in _comparable(plan, request).values())


def _comparable(plan: Plan, request: BoardsRequest) -> dict[str, list[Job]]:
    """Jobs by task whose frames are at hand, and whose existing rows are of the solver's revision: others keep no answer."""
    tasks = _tasks(request)
    found: defaultdict[str, list[Job]] = defaultdict(list)
    for job in plan.jobs:
        today = contestant_of(job.place.solver).facts("", job.place.detections).revision
        if today is not None and job.revision == today and at_hand(tasks[job.place.task][1], request.choice):
            found[job.place.task].append(job)
    return found


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
            stored.age,
            len(stored.frames),
            float(stored.frames["time_ms"].mean()) / 1000.0,
            stored.provenance.solver.revision,
        )
        for group in groups
        for stored in group
        if stored.split == SPLIT
    }
