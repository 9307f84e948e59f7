"""Progress display of all commands, on standard error, so that their output can be used by other commands."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

    from rich.progress import Progress, ProgressColumn
    from rich.status import Status

    from benchmark.report.site.boards import Board


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


def compared_boards(out: Path) -> list[Board]:
    """Compare the results in a folder, and say which of them are left out.

    Raises
    ------
    ResultsError
        There are no results, or a file is damaged.
    """
    import typer

    from benchmark.report.site.pages import make_boards
    from benchmark.report.site.words import left_out_words

    left_out: list[str] = []
    with progress_bars("boards") as bar:
        line = bar.add_task("comparing", total=None)
        boards = make_boards(
            out,
            lambda done, of: bar.update(line, completed=done, total=of),
            lambda part, whole: left_out.append(left_out_words(part, whole)),
        )
    for words in left_out:
        typer.echo(words, err=True)
    return boards
