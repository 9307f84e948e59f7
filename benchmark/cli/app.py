"""The command `skybench`.

The modules of commands import what they need only when they run, so that help, version and completion respond at once.
"""

from __future__ import annotations

import gc
import sys
from typing import Annotated

import typer

from benchmark.cli import bench, demo, rendering, scenes, speed, studies, twins
from benchmark.cli.datasets import exporting, generating, planning, showing, verifying
from benchmark.cli.errors import InterruptibleGroup
from benchmark.cli.output import AsJson, let_print, print_json, print_tables
from benchmark.cli.photographs import fetching, importing
from benchmark.cli.progress import working

OBJECTS_BETWEEN_COLLECTIONS = 10_000

app = typer.Typer(
    help="Render synthetic night skies, solve them, and compare solvers.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    cls=InterruptibleGroup,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _print_version(wanted: bool) -> None:
    if wanted:
        from generator import __version__

        typer.echo(f"skybench {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", help="Print the version and end.", is_eager=True, callback=_print_version)
    ] = False,
) -> None:
    """Render synthetic night skies, solve them, and compare solvers."""


demo.add_to(app)
rendering.add_to(app)
scenes.add_to(app)
for command in (planning, generating, verifying, exporting, showing):
    command.add_to(app)
app.add_typer(bench.app, name="bench")
app.add_typer(studies.app, name="study")
app.add_typer(importing.app, name="import")
fetching.add_to(app)
twins.add_to(app)
speed.add_to(app)


@app.command(epilog="Exit status: 0 when everything is ok, 1 otherwise.")
def doctor(as_json: AsJson = False) -> None:
    """Check that skybench can run here, and say what to do where it cannot."""
    from benchmark.cli.doctor import check_all, check_table

    with working("checking"):
        checks = check_all()
    healthy = all(check.ok for check in checks)
    if as_json:
        print_json({"ok": healthy, "checks": [{"ok": check.ok} | vars(check) for check in checks]})
    else:
        print_tables(check_table(checks))
    raise typer.Exit(0 if healthy else 1)


def main() -> None:
    """Entry point of the command."""
    # Loading modules creates a hundred thousand objects; collecting garbage after every 700 takes a tenth of the start-up
    # time.
    gc.set_threshold(OBJECTS_BETWEEN_COLLECTIONS)
    let_print(sys.stdout, sys.stderr)
    try:
        app()
    finally:
        # Python would otherwise scan all objects several times as it ends.
        gc.freeze()


if __name__ == "__main__":
    main()
