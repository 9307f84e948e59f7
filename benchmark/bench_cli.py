"""Commands `skybench bench run` and `skybench bench report`."""

from pathlib import Path
from typing import Annotated, NoReturn

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

from benchmark import submission_cli
from benchmark.errors import BenchmarkError, ResultsError

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


@app.command(epilog="Example: skybench bench report --out results/tasks")
def report(
    out: _Out = _DEFAULT_OUT,
    data: Annotated[
        Path | None, typer.Option("--data", help="Folder of the tasks' rendered frames, for pictures.")
    ] = None,
    figure: Annotated[
        Path | None, typer.Option("--figure", help="Also write the leaderboard as one picture (SVG) to this file.")
    ] = None,
) -> None:
    """Report the results in a folder.

    Of one dataset: print the table and write report.html. Of tasks: write the folder `site`, whose index.html is the
    first of a few pages that need neither a server nor the network.
    """
    from benchmark.site.tree import is_tree

    try:
        path = _report_tasks(out, data, figure) if is_tree(out) else _report_dataset(out, figure)
    except BenchmarkError as error:
        _fail(error)
    typer.echo(str(path))


def _report_tasks(out: Path, data: Path | None, figure: Path | None) -> Path:
    from benchmark.site.pages import write_site

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TextColumn("boards"))
    with Progress(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task("comparing", total=None)
        return write_site(out, data, figure, lambda done, of: bar.update(task, completed=done, total=of))


def _report_dataset(out: Path, figure: Path | None) -> Path:
    from benchmark.report import result_table, write_report  # loads the chart engine

    if figure is not None:
        raise ResultsError(f"{out}: holds results of one dataset; --figure needs results of tasks")
    table = result_table(out)
    Console().print(table)
    with Console(stderr=True).status("drawing the report"):
        return write_report(out)


def _fail(error: BenchmarkError) -> NoReturn:
    typer.echo(f"skybench: {error}", err=True)
    raise typer.Exit(2)
