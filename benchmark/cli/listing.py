"""The tables of `skybench bench list`."""

from __future__ import annotations

from rich.table import Table

from benchmark.run.contestants import contestant_of
from benchmark.solvers.registry import known_solvers
from benchmark.tasks.definition import load_task, task_names, widest_half_width_points


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
        solver = contestant_of(name)
        assert solver.definition is not None
        spec = solver.definition.spec
        table.add_row(name, spec.title, spec.licence, solver.obstacle() or "ready")
    return table
