"""`skybench bench list`, and `skybench bench run` on tasks."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table

from benchmark.errors import SolverError
from benchmark.frames.task_frames import TaskFrames, make_task_frames
from benchmark.run.task_run import DetectionsMode, TaskRun, run_task, solver_pool
from benchmark.solvers.definition import SolverFolder
from benchmark.solvers.registry import known_solvers, missing_packages, solver_folder
from benchmark.tasks.definition import SplitName, load_task, task_names, widest_half_width_points

DEFAULT_OUT = Path("results/leaderboard")
DEFAULT_DATA = Path("out/tasks")


def task_table() -> Table:
    """All tasks with what is graded, sizes and the width of interval that these buy."""
    table = Table(
        title="Tasks (metric: part of the frames with a fix nearer than 10 km; higher is better)", title_justify="left"
    )
    for heading in ("task", "asks", "graded", "from easy to hard", "frames", "at one condition", "over all"):
        table.add_column(heading, overflow="fold", no_wrap=heading == "task")
    for name in task_names():
        task = load_task(name)
        definition = task.definition
        condition = definition.condition
        frames = definition.frames_per_condition * len(condition.values)
        table.add_row(
            task.label,
            definition.title,
            condition.name,
            " ".join(f"{value:g}" for value in condition.values) + (f" {condition.unit}" if condition.unit else ""),
            f"{len(condition.values)} x {definition.frames_per_condition}",
            f"± {definition.half_width_points:.1f} points",
            f"± {widest_half_width_points(frames):.1f} points",
        )
    return table


def solver_table() -> Table:
    """All solvers that come with skybench, and whether they can run here."""
    table = Table(title="Solvers", title_justify="left")
    for heading in ("solver", "what it is", "licence", "here"):
        table.add_column(heading, overflow="fold", no_wrap=heading == "solver")
    for name in known_solvers():
        solver = solver_folder(name)
        table.add_row(name, solver.spec.title, solver.spec.licence, _obstacle(solver) or "ready")
    return table


def _obstacle(solver: SolverFolder) -> str:
    """Why a solver cannot run here, or nothing."""
    missing = missing_packages(solver)
    if missing:
        return f"install with: {solver.spec.install}"
    try:
        solver.command  # noqa: B018 - raises where the environment is missing
    except SolverError as error:
        return str(error)
    return ""


def run_on_tasks(
    tasks: Sequence[str],
    solvers: Sequence[str],
    split: SplitName,
    detections: DetectionsMode,
    frames: int | None,
    out: Path,
    data: Path,
    jobs: int,
) -> None:
    """Render what is missing of the tasks' frames, and run what is missing of the solvers on them.

    Parameters
    ----------
    tasks, solvers : sequence of str
        Names; no solvers: all that can run here.
    split : str
    detections : str
    frames : int or None
        Per condition; None for the tasks' own number.
    out, data : Path
        Folders of results and of frames.
    jobs : int
        Processes.

    Raises
    ------
    BenchmarkError
        A task or solver that is not there, or cannot run here.
    """
    chosen = [load_task(name) for name in tasks]
    contestants = [solver_folder(name) for name in solvers or known_solvers()]
    if not solvers:
        for solver in contestants:
            if obstacle := _obstacle(solver):
                typer.echo(f"left out: {solver.name}: {obstacle}", err=True)
        contestants = [solver for solver in contestants if not _obstacle(solver)]
    for solver in contestants:
        if obstacle := _obstacle(solver):
            raise SolverError(f"{solver.name}: {obstacle}")
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True)) as bar:
        sets: list[TaskFrames] = []
        for task in chosen:
            per_condition = task.definition.frames_per_condition if frames is None else frames
            scenario = task.scenario_of(split)
            line = bar.add_task(f"frames of {task.label}", total=per_condition * scenario.combination_count)
            sets.append(make_task_frames(task, split, per_condition, data, jobs, partial(bar.advance, line)))
        total = sum(len(one.frames) for one in sets)
        for solver in contestants:
            line = bar.add_task(solver.name, total=total)
            _run_solver(solver, sets, detections, out, jobs, partial(bar.advance, line))
    typer.echo(f"results in {out}")


def _run_solver(
    solver: SolverFolder,
    sets: Sequence[TaskFrames],
    detections: DetectionsMode,
    out: Path,
    jobs: int,
    progress: Callable[[int], None],
) -> None:
    started, solved = time.monotonic(), 0
    with solver_pool(solver, jobs) as pool:
        for frames in sets:
            if run_task(TaskRun(frames, solver, pool.version, detections), pool, out, progress):
                solved += len(frames.frames)
    seconds = time.monotonic() - started
    if solved:
        typer.echo(f"{solver.name}: {solved} frames in {seconds:.0f} s, {solved / seconds:.1f} frames/s")
    else:
        typer.echo(f"{solver.name}: done before")
