"""Terminal output for boards: tables for people, a document for programs."""

from __future__ import annotations

from collections.abc import Sequence

from rich.markup import escape
from rich.table import Table

from benchmark.report.site import columns
from benchmark.report.site.boards import Board
from benchmark.report.site.overall import KEYS
from benchmark.report.site.site_view import matrices_of, overall_of, tasks_of
from benchmark.stats.intervals import Estimate

SIDE_BY_SIDE = 4
"""Number of solvers that fit side by side into a terminal of 80 characters."""


def result_tables(boards: Sequence[Board]) -> list[Table]:
    """Tables for the terminal: all numbers of one board, or the successes of several."""
    return board_tables(boards[0]) if len(boards) == 1 else [*overall_tables(boards), leaderboard_table(boards)]


def overall_tables(boards: Sequence[Board]) -> list[Table]:
    """The four numbers of each solver over all sets of frames, one table per mode of detection."""
    tables = []
    for overall in overall_of(boards):
        title = f"{overall.title}, {overall.n_sets} sets of frames (95 % intervals below)"
        table = Table(title=escape(title), title_justify="left", padding=(0, 0, 0, 1))
        table.add_column("solver", overflow="fold")
        for column in columns.LEADING:
            table.add_column(column.heading, justify="right", overflow="fold")
        for row in overall.complete:
            cells = [(column.value(row), column.interval(row)) for column in columns.LEADING]
            table.add_row(escape(row.label), *(f"{value}\n[dim]{limits}[/dim]" for value, limits in cells))
        notes = ["error / bound, NEES: each row of its own identified fixes; do not compare rows"]
        if overall.partial:
            notes.append(f"of fewer sets: {', '.join(f'{row.label} ({len(row.entries)})' for row in overall.partial)}")
        table.caption, table.caption_justify = f"[dim]{escape(chr(10).join(notes))}[/dim]", "left"
        tables.append(table)
    return tables


def board_tables(board: Board) -> list[Table]:
    """All numbers of one board with their intervals, for the terminal, SIDE_BY_SIDE solvers per table."""
    title = f"{board.task.title} ({board.title}): {board.n_frames} frames (95 % intervals in brackets)"
    tables = []
    for first in range(0, len(board.entries), SIDE_BY_SIDE):
        entries = board.entries[first : first + SIDE_BY_SIDE]
        table = Table(title=None if first else escape(title), title_justify="left")
        table.add_column("", no_wrap=True)
        for entry in entries:
            table.add_column(escape(entry.label), justify="left", overflow="fold")
        for column in columns.HEADLINE:
            shown = [(column.value(entry), column.interval(entry)) for entry in entries]
            table.add_row(column.heading, *(_with_limits(value, limits) for value, limits in shown))
        counts = [", ".join(str(count) for count in entry.statuses.values()) for entry in entries]
        table.add_row("fixes, refused, errors", *counts)
        tables.append(table)
    return tables


def _with_limits(value: str, limits: str) -> str:
    return f"{value} [dim]\\[{limits}][/dim]" if limits else value


def leaderboard_table(boards: Sequence[Board]) -> Table:
    """Success of each solver on each task with its interval, for the terminal."""
    tasks = tasks_of(boards)
    matrix = next(matrix for matrix in matrices_of(boards, tasks) if matrix.column is columns.SUCCESS)
    title = "Percentage of frames within the task's limit, and its 95 % interval"
    table = Table(title=title, title_justify="left", padding=(0, 0, 0, 1))
    table.add_column("solver", overflow="fold")
    table.add_column("by")
    for task in tasks:
        table.add_column(task.key, overflow="fold", justify="right", min_width=6)
    for row in matrix.rows:
        cells = ["not run" if entry is None else _in_percent(entry.success) for _, entry in row.cells]
        table.add_row(escape(row.label), row.detections, *cells)
    return table


def boards_document(boards: Sequence[Board]) -> list[dict[str, object]]:
    """All boards with the numbers of each solver, in the order of their ranks."""
    return [
        {
            "task": board.task.key,
            "title": board.task.title,
            "split": board.split,
            "detections": board.detections,
            "frames": board.n_frames,
            "sites": board.n_sites,
            "solvers": [
                {
                    "solver": entry.label,
                    "rank": entry.rank,
                    **{key: column.estimate(entry) for column, key in KEYS.items()},
                    "metrics": entry.metrics,
                    "break_point": entry.break_point,
                    "statuses": entry.statuses,
                    "reasons": entry.reasons,
                }
                for entry in board.entries
            ],
        }
        for board in boards
    ]


def overall_document(boards: Sequence[Board]) -> list[dict[str, object]]:
    """The four numbers of each solver over all sets of frames, in each mode of detection."""
    return [
        {
            "detections": overall.key,
            "sets": overall.n_sets,
            "solvers": [
                {"solver": row.label, "sets": len(row.entries), **row.metrics, "sets_without": dict(row.lacking)}
                for row in overall.rows
            ],
        }
        for overall in overall_of(boards)
    ]


def _in_percent(share: Estimate) -> str:
    low, value, high = (f"{100 * number:.0f}" for number in (share.low, share.value, share.high))
    return f"{value}\n[dim]{low}–{high}[/dim]"
