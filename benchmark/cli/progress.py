"""Progress display of all commands, on standard error, so that their output can be used by other commands."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.progress import Progress, ProgressColumn
    from rich.status import Status


def progress_bars(unit: str = "frames", *more: ProgressColumn, hidden: bool = False) -> Progress:
    """Bars with a description, a count of units, the elapsed time and the remaining time.

    Parameters
    ----------
    unit : str
        Name of the unit that is counted.
    *more : ProgressColumn
        Columns to place before the times.
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
    """An indicator that work of unknown length is going on."""
    from rich.console import Console

    return Console(stderr=True).status(description)
