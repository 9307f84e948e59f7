"""Progress of all commands: on standard error, so that what a command prints can be used by another."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.progress import Progress, ProgressColumn
    from rich.status import Status


def progress_bars(unit: str = "frames", *more: ProgressColumn, hidden: bool = False) -> Progress:
    """Bars with a description, a count of units, the time that has passed and the time that is left.

    Parameters
    ----------
    unit : str
        What is counted.
    *more : ProgressColumn
        Columns to stand before the times.
    hidden : bool
        Show nothing.
    """
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn(unit),
        *more,
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=Console(stderr=True),
        disable=hidden,
    )


def working(description: str) -> Status:
    """A sign that work without a known end goes on."""
    from rich.console import Console

    return Console(stderr=True).status(description)
