"""Commands `skybench bench run` and `skybench bench report`."""

from pathlib import Path
from typing import Annotated, NoReturn

import typer
from rich.console import Console

from benchmark import submission_cli
from benchmark.errors import BenchmarkError

app = typer.Typer(help="Run solvers over a rendered dataset and report how they did.", no_args_is_help=True)
submission_cli.add_to(app)

_DEFAULT_OUT = Path("results/demo")
_Out = Annotated[Path, typer.Option("--out", help="Results folder.")]


@app.command()
def run(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Dataset folder that `skybench render` wrote.")],
    solver: Annotated[list[str], typer.Option("--solver", help="Name of a solver; repeat for several.")],
    out: _Out = _DEFAULT_OUT,
    jobs: Annotated[int, typer.Option("--jobs", min=1, help="Processes to share the frames among.")] = 1,
) -> None:
    """Run solvers over all frames of DIR and write their results."""
    from benchmark.run import run_benchmark  # loads the solvers, which --help need not wait for

    try:
        summaries = run_benchmark(folder, solver, out, jobs=jobs)
    except BenchmarkError as error:
        _fail(error)
    for name, summary in summaries.items():
        counts = f"{summary.n_frames} frames, {summary.n_fixes} fixes, {summary.n_refused} refused"
        typer.echo(f"{name}: {counts}, {summary.n_errors} errors")
    typer.echo(f"results in {out}; next: skybench bench report --out {out}")


@app.command()
def report(out: _Out = _DEFAULT_OUT) -> None:
    """Print the table of results and write report.html."""
    from benchmark.report import result_table, write_report  # loads the chart engine

    try:
        table = result_table(out)
        console = Console()
        console.print(table)
        with Console(stderr=True).status("drawing the report"):
            path = write_report(out)
    except BenchmarkError as error:
        _fail(error)
    typer.echo(str(path))


def _fail(error: BenchmarkError) -> NoReturn:
    typer.echo(f"skybench: {error}", err=True)
    raise typer.Exit(2)
