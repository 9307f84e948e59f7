"""How commands end when the input is not acceptable."""

from __future__ import annotations

from typing import NoReturn

import typer

EXIT_BAD_INPUT = 2


def fail(error: Exception) -> NoReturn:
    """Print an error as it is and exit 2."""
    typer.echo(f"skybench: {error}", err=True)
    raise typer.Exit(EXIT_BAD_INPUT)
