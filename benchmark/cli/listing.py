"""What `skybench bench list` shows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from rich.table import Table

from benchmark.real_tasks.definition import load_real_task, real_task_names
from benchmark.run.contestants import contestant_of
from benchmark.solvers.registry import known_solvers
from benchmark.tasks.definition import load_task, task_names, widest_half_width_points


@dataclass(frozen=True)
class ListedTask:
    """A task: what is graded, the error below which a fix counts, sizes, and half of the interval that they buy, points."""

    task: str
    title: str
    condition: str
    unit: str
    values: tuple[float, ...]
    limit_km: float
    frames_per_condition: int
    half_width_points: float
    half_width_over_all_points: float


@dataclass(frozen=True)
class ListedRealTask:
    """A task of photographs; `licence` is that of the photographs."""

    task: str
    title: str
    condition: str
    unit: str
    values: tuple[float, ...]
    photographs: int
    licence: str


@dataclass(frozen=True)
class ListedSolver:
    """A solver that comes with skybench; `obstacle` is empty where it can run here."""

    solver: str
    title: str
    licence: str
    obstacle: str


def listed_tasks() -> list[ListedTask]:
    """All tasks."""
    found = []
    for name in task_names():
        task = load_task(name)
        definition, condition = task.definition, task.definition.condition
        found.append(
            ListedTask(
                task.label,
                definition.title,
                condition.name,
                condition.unit,
                condition.values,
                task.limit_km,
                definition.frames_per_condition,
                definition.half_width_points,
                widest_half_width_points(definition.frames_per_condition * len(condition.values)),
            )
        )
    return found


def listed_real_tasks() -> list[ListedRealTask]:
    """All tasks of photographs."""
    found = []
    for task in map(load_real_task, real_task_names()):
        definition, graded = task.definition, task.definition.condition
        count = len(definition.sources)
        found.append(
            ListedRealTask(
                task.label, definition.title, graded.name, graded.unit, graded.values, count, definition.licence
            )
        )
    return found


def listed_solvers() -> list[ListedSolver]:
    """All solvers that come with skybench, and whether they can run here."""
    found = []
    for name in known_solvers():
        solver = contestant_of(name)
        assert solver.definition is not None
        spec = solver.definition.spec
        found.append(ListedSolver(name, spec.title, spec.licence, solver.obstacle() or ""))
    return found


def task_table(tasks: Sequence[ListedTask]) -> Table:
    """The tasks as a table."""
    table = Table(
        title="Tasks (metric: part of the frames with a fix nearer than the task's limit; higher is better)",
        title_justify="left",
    )
    for heading in ("task", "asks", "graded", "from easy to hard", "limit", "frames", "at one condition", "over all"):
        table.add_column(heading, overflow="fold", no_wrap=heading == "task")
    for task in tasks:
        table.add_row(
            task.task,
            task.title,
            task.condition,
            " ".join(f"{value:g}" for value in task.values) + (f" {task.unit}" if task.unit else ""),
            f"{task.limit_km:.4g} km",
            f"{len(task.values)} x {task.frames_per_condition}",
            f"± {task.half_width_points:.1f} points",
            f"± {task.half_width_over_all_points:.1f} points",
        )
    return table


def real_task_table(tasks: Sequence[ListedRealTask]) -> Table:
    """The tasks of photographs as a table."""
    table = Table(title="Tasks of photographs (skybench fetch TASK brings them)", title_justify="left")
    for heading in ("task", "asks", "graded", "from easy to hard", "frames", "licence"):
        table.add_column(heading, overflow="fold", no_wrap=heading == "task")
    for task in tasks:
        values = " ".join(f"{value:g}" for value in task.values)
        table.add_row(
            task.task, task.title, task.condition, f"{values} {task.unit}", str(task.photographs), task.licence
        )
    return table


def solver_table(solvers: Sequence[ListedSolver]) -> Table:
    """The solvers as a table."""
    table = Table(title="Solvers", title_justify="left")
    for heading in ("solver", "what it is", "licence", "here"):
        table.add_column(heading, overflow="fold", no_wrap=heading == "solver")
    for solver in solvers:
        table.add_row(solver.solver, solver.title, solver.licence, solver.obstacle or "ready")
    return table
