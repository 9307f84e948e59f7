"""Output of `skybench bench list`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from rich.box import SIMPLE_HEAD
from rich.markup import escape
from rich.table import Table

from benchmark.real_tasks.definition import load_real_task, real_task_names
from benchmark.run.contestants import contestant_of
from benchmark.solvers.registry import known_solvers
from benchmark.tasks.definition import load_task, task_names, widest_half_width_points


@dataclass(frozen=True)
class ListedTask:
    """A task: graded quantity, error below which a fix counts, sizes, and half of their interval in percentage points."""

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
        count = len(definition.conditions)
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
    """The tasks as a table that fits into a terminal of 80 characters."""
    table = _table(
        "Tasks (metric: part of the frames with a fix nearer than the limit; higher is better)",
        ("task", "asks; graded, from easy to hard", "limit, frames", "\u00b1 points"),
    )
    for task in tasks:
        table.add_row(
            task.task,
            f"{escape(task.title)}\n[dim]{_graded(task)}[/dim]",
            f"{task.limit_km:.4g} km\n{len(task.values)} x {task.frames_per_condition}",
            f"{task.half_width_points:.1f} each\n{task.half_width_over_all_points:.1f} all",
        )
    table.caption = "\u00b1 points: half of the 95 % interval at one condition, and over all."
    table.caption_justify = "left"
    return table


def real_task_table(tasks: Sequence[ListedRealTask]) -> Table:
    """The tasks of photographs as a table."""
    table = _table(
        "Tasks of photographs (skybench fetch TASK brings them)",
        ("task", "asks; graded, from easy to hard", "frames", "licence"),
    )
    for task in tasks:
        asks = f"{escape(task.title)}\n[dim]{_graded(task)}[/dim]"
        table.add_row(task.task, asks, str(task.photographs), escape(task.licence))
    return table


def solver_table(solvers: Sequence[ListedSolver]) -> Table:
    """The solvers as a table; below it, what those need that cannot run here, each need once."""
    table = _table("Solvers", ("solver", "what it is", "licence"))
    for solver in solvers:
        mark = "\n[dim]not ready, see below[/dim]" if solver.obstacle else ""
        table.add_row(solver.solver, f"{escape(solver.title)}{mark}", escape(solver.licence))
    needs = dict.fromkeys(solver.obstacle for solver in solvers if solver.obstacle)
    if needs:
        table.caption = "\n".join(("Not ready:", *(escape(need) for need in needs)))
        table.caption_justify = "left"
    return table


def _table(title: str, headings: Sequence[str]) -> Table:
    table = Table(title=title, title_justify="left", show_lines=False, box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for heading in headings:
        table.add_column(heading, overflow="fold", no_wrap=heading in ("task", "solver"))
    return table


def _graded(task: ListedTask | ListedRealTask) -> str:
    values = " ".join(f"{value:g}" for value in task.values)
    return escape(f"{task.condition}: {values}{f' {task.unit}' if task.unit else ''}")
