"""How commands end when the input is not acceptable."""

from __future__ import annotations

from typing import Any, NoReturn

import typer
from typer.core import TyperGroup

from benchmark.cli import interrupt

EXIT_BAD_INPUT = 2


def fail(error: Exception) -> NoReturn:
    """Print an error as it is and exit 2."""
    typer.echo(f"skybench: {error}", err=True)
    raise typer.Exit(EXIT_BAD_INPUT)


class InterruptibleGroup(TyperGroup):
    """Commands that Ctrl-C and SIGTERM end with one line and exit status 130 or 143."""

    def invoke(self, ctx: Any) -> object:
        """Run the command that was asked for."""
        try:
            return super().invoke(ctx)
        except BaseException as error:
            if not interrupt.interrupted(error):
                raise
            interrupt.say_so()
            raise typer.Exit(interrupt.exit_status()) from None
