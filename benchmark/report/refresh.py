"""Bringing a leaderboard to today's code: what is there is read, what is missing or older is run."""

from __future__ import annotations

import itertools
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from benchmark.errors import ResultsError
from benchmark.frames.frame_set import FrameSet
from benchmark.frames.opening import open_frames
from benchmark.frames.task_frames import FrameChoice, split_folder
from benchmark.report.refresh_plan import Place, Plan, Standing, make_plan
from benchmark.report.site.tree import read_tree
from benchmark.run.contestants import contestant_of
from benchmark.run.engine import run_all
from benchmark.run.provenance import DetectionsMode
from benchmark.tasks.definition import TASK_SUFFIX, SplitName, Task, load_task, load_task_file

SPLIT: SplitName = "dev"
"""Of leaderboards."""


@dataclass(frozen=True)
class BoardsRequest:
    """Which rows a leaderboard is to have.

    Attributes
    ----------
    tasks : tuple of str
        Names, or files of tasks.
    solvers : tuple of str
        Names, or folders with a solver.yaml.
    out, data : Path
        Folders of results and of the tasks' frames.
    jobs : int
        Frames that are solved at the same time.
    per_condition : int or None
        Frames at each condition; None for the task's own number.
    """

    tasks: tuple[str, ...]
    solvers: tuple[str, ...]
    out: Path
    data: Path
    jobs: int
    per_condition: int | None

    @property
    def choice(self) -> FrameChoice:
        """The frames of a task that are wanted."""
        return FrameChoice(SPLIT, self.per_condition, None, self.data, self.jobs)


def plan_boards(request: BoardsRequest) -> Plan:
    """Find the rows that are missing or not of today's code.

    A fused solver has rows of tasks of sequences alone; elsewhere it answers as the solver that it asks.

    Raises
    ------
    BenchmarkError
        A task, a solver or a result is wrong.
    """
    tasks = {label: task for label, (_, task) in _tasks(request).items()}
    targets = {label: _size(task, request) for label, task in tasks.items()}
    fused = [solver for solver in request.solvers if (found := contestant_of(solver).definition) and found.fused]
    single = [label for label, task in tasks.items() if task.sequence_length == 1]
    left_out = set(itertools.product(single, fused))
    return make_plan(_standing(request.out), targets, request.solvers, ("own",), left_out)


def run_plan(plan: Plan, request: BoardsRequest, progress: Callable[[str, int], None]) -> list[str]:
    """Run the rows of a plan.

    Parameters
    ----------
    plan : Plan
    request : BoardsRequest
    progress : callable
        Called with a solver and the number of its frames done.

    Returns
    -------
    list of str
        Why solvers could not run here, or that all their answers are errors.

    Raises
    ------
    BenchmarkError
        Frames cannot be made, or a result cannot be written.
    """
    tasks = _tasks(request)
    wanted: defaultdict[tuple[DetectionsMode, str], list[str]] = defaultdict(list)
    for job in plan.jobs:
        wanted[job.place.detections, job.place.solver].append(tasks[job.place.task][0])
    opened: dict[str, FrameSet] = {}
    left = []
    for (detections, solver), targets in wanted.items():
        contestant = contestant_of(solver)
        if obstacle := contestant.obstacle():
            left.append(obstacle)
            continue
        sets = []
        for target in targets:
            if target not in opened:
                opened[target] = open_frames(target, request.choice)
            sets.append(opened[target])
        runs = run_all([contestant], sets, request.out, detections, request.jobs, progress)
        left += [
            f"{solver}: every answer of {done.summary.n_frames} is an error ({done.folder})"
            for done in runs
            if done.failed_throughout
        ]
    return list(dict.fromkeys(left))


def missing_frames(plan: Plan, request: BoardsRequest) -> int:
    """Frames of a plan's tasks that are to be rendered first, as far as none of a task is there."""
    tasks = _tasks(request)
    count = 0
    for label in dict.fromkeys(job.place.task for job in plan.jobs):
        task = tasks[label][1]
        folder = split_folder(task.label, SPLIT, task.scenario_of(SPLIT).sha256, request.data)
        count += 0 if folder.is_dir() else _size(task, request)
    return count


def _tasks(request: BoardsRequest) -> dict[str, tuple[str, Task]]:
    """Tasks by their labels, each with the name under which it was asked for."""
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
