"""How commands end when the input is invalid."""

from __future__ import annotations

import errno
from typing import Any, NoReturn

import typer
from typer.core import TyperGroup

from benchmark.cli import interrupt
from benchmark.cli.output import printable

EXIT_BAD_INPUT = 2
_OF_THE_MACHINE = frozenset(
    {
        errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EROFS, errno.ENOMEM, errno.EMFILE, errno.ENFILE,
    }
)  # fmt: skip
"""Errors by which a machine reports that a resource is exhausted or that its disk has failed."""


def fail(error: Exception) -> NoReturn:
    """Print an error as it is and exit with status 2."""
    typer.echo(printable(f"skybench: {error}"), err=True)
    raise typer.Exit(EXIT_BAD_INPUT)


def fault_of_machine(error: BaseException) -> str | None:
    """What a machine lacks and what to do about it, in one line; None for any other error."""
    if isinstance(error, MemoryError):
        return "out of memory; allow more (ulimit -v), or use fewer workers and smaller frames"
    if not isinstance(error, OSError):
        return None
    place = f"{error.filename}: " if error.filename else ""
    if error.errno in _OF_THE_MACHINE:
        return f"{place}{error.strerror}; mend it and run the same command again"
    if error.errno == errno.ENOENT and "temporary directory" in str(error.strerror):
        return f"{error.strerror}; free some space there, or name another folder in TMPDIR"
    return None


class InterruptibleGroup(TyperGroup):
    """Commands that Ctrl-C and SIGTERM end with one line and exit status 130 or 143, and a fault of the machine with 2."""

    def invoke(self, ctx: Any) -> object:
        """Run the requested command."""
        try:
            return super().invoke(ctx)
        except BaseException as error:
            if not interrupt.interrupted(error):
                if (fault := fault_of_machine(error)) is not None:
                    fail(RuntimeError(fault))
                raise
            interrupt.say_so()
            raise typer.Exit(interrupt.exit_status()) from None
