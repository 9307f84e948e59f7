"""`skybench verify`: check files against their manifest."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from benchmark.cli.errors import fail
from benchmark.cli.output import AsJson, print_json, printable
from benchmark.cli.progress import working


def add_to(app: typer.Typer) -> None:
    """Add the command."""
    app.command(epilog="Exit status: 0 whole, 1 damaged, 2 no such folder, or a folder of something else.")(verify)


def verify(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Dataset, or folder of rendered frames.")],
    as_json: AsJson = False,
) -> None:
    """Check every file of a dataset, or of a folder of rendered frames, against its manifest."""
    from generator.dataset.layout import MANIFEST, SCENARIO_COPY
    from generator.dataset.verify import NOT_COVERED, problems
    from generator.errors import GeneratorError
    from generator.frame import verify as frames

    if not folder.is_dir():
        fail(GeneratorError(f"{folder}: no such folder"))
    of_frames = not (folder / MANIFEST).is_file() and frames.is_frames_folder(folder)
    # A run of `skybench generate` that has not ended has no manifest yet, but its scenario.
    if not of_frames and not any((folder / name).exists() for name in (MANIFEST, SCENARIO_COPY)):
        fail(GeneratorError(f"{folder}: neither a dataset of `skybench generate` nor a folder of `skybench render`"))
    with working("reading") as status:
        found = (frames.problems if of_frames else problems)(folder, lambda path: status.update(f"reading {path}"))
    if as_json:
        print_json({"folder": folder, "whole": not found, "problems": found})
        raise typer.Exit(1 if found else 0)
    for problem in found:
        typer.echo(printable(problem, kept=""))
    if not found:
        typer.echo(f"{folder}: whole" + ("" if of_frames else f" (not covered: {NOT_COVERED}/)"))
    raise typer.Exit(1 if found else 0)
