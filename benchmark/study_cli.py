"""Command `skybench study thesis`."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from benchmark.errors import BenchmarkError

app = typer.Typer(help="Replicate published work.", no_args_is_help=True)

DEFAULT_OUT = Path("results/studies/thesis")
DEFAULT_SITES = 100
EXIT_BAD_INPUT = 2


@app.callback()
def _group() -> None:
    """Replicate published work."""


@app.command(epilog="Example: skybench study thesis --frames 24")
def thesis(
    frames: Annotated[
        int | None,
        typer.Option("--frames", min=2, help="Frames per limiting magnitude; the scenario's 200 if left out."),
    ] = None,
    dataset: Annotated[
        Path | None, typer.Option("--dataset", help="Frames rendered before; rendered now if left out.")
    ] = None,
    out: Annotated[Path, typer.Option("--out", help="Folder for tables, figures and the page.")] = DEFAULT_OUT,
    scenario: Annotated[Path, typer.Option("--scenario", help="The thesis' sets.")] = Path("scenes/thesis_mag.yaml"),
    work: Annotated[Path, typer.Option("--work", help="Folder for rendered frames.")] = Path("out/thesis_mag"),
    sites: Annotated[int, typer.Option("--sites", min=2, help="Sites of the frames without pictures.")] = DEFAULT_SITES,
) -> None:
    """Run all variants of the thesis' solver on its sets, and hold the results beside the thesis' own."""
    from benchmark.studies.thesis_study import PAGE, run_study  # loads the solvers, which --help need not wait for
    from benchmark.studies.thesis_study import Progress as StudyProgress
    from generator.errors import GeneratorError

    if frames is not None and dataset is not None:
        typer.echo("skybench: --frames is for rendering; leave it out with --dataset", err=True)
        raise typer.Exit(EXIT_BAD_INPUT)
    command = _command(frames, dataset, sites)
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True)) as bar:
        tasks = []

        def begin(name: str, total: int) -> None:
            tasks.append(bar.add_task(name, total=total or None))

        try:
            study = run_study(
                scenario,
                frames,
                dataset,
                work,
                out,
                sites,
                command,
                StudyProgress(begin, lambda: bar.advance(tasks[-1])),
            )
        except (BenchmarkError, GeneratorError) as error:
            typer.echo(f"skybench: {error}", err=True)
            raise typer.Exit(EXIT_BAD_INPUT) from None
    for answer in study.answers:
        typer.echo(f"{answer.key:6} {answer.verdict}")
    typer.echo(str(out / PAGE))


def _command(frames: int | None, dataset: Path | None, sites: int) -> str:
    parts = ["skybench study thesis"]
    if frames is not None:
        parts.append(f"--frames {frames}")
    if dataset is not None:
        parts.append(f"--dataset {shlex.quote(dataset.name)}")
    if sites != DEFAULT_SITES:
        parts.append(f"--sites {sites}")
    return " ".join(parts)
