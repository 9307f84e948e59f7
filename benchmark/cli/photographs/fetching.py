"""Command `skybench fetch`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from benchmark.cli import completion
from benchmark.cli.errors import fail
from benchmark.cli.output import AsJson, print_json
from benchmark.cli.progress import working
from benchmark.errors import BenchmarkError


def add_to(app: typer.Typer) -> None:
    """Add the command."""
    app.command(
        epilog="Examples: skybench fetch allsky-real, then skybench bench run allsky-real --solver skybench; "
        "skybench fetch meteor-real --from ~/downloads"
    )(fetch)


def fetch(
    task: Annotated[
        str, typer.Argument(metavar="TASK", help="Task of photographs.", autocompletion=completion.real_tasks)
    ],
    folder: Annotated[
        Path | None,
        typer.Option("--from", help="Folder that has the files (also .gz, .bz2), in place of the network."),
    ] = None,
    data: Annotated[
        Path | None, typer.Option("--data", help="Folder of the frames of tasks. Default: out/tasks.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Fetch the missing photographs of a task; every file is checked against its SHA-256."""
    from benchmark.frames.task_frames import DEFAULT_DATA
    from benchmark.real_tasks.definition import load_real_task
    from benchmark.real_tasks.fetch import fetch_sources, sources_folder

    place = data or DEFAULT_DATA
    try:
        found = load_real_task(task)
        with working("fetching") as status:
            came = fetch_sources(found, place, folder, lambda file: status.update(f"fetching, {file} is there"))
    except BenchmarkError as error:
        fail(error)
    count, folder_of = len(found.definition.sources), sources_folder(found, place)
    if as_json:
        print_json({"task": found.label, "folder": folder_of, "photographs": count, "fetched": came})
        return
    typer.echo(f"{found.label}: {len(came)} fetched, {count} files in {folder_of}")
    typer.echo(f"licence {found.definition.licence}; {found.definition.credit}")
