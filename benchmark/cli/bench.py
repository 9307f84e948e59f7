"""Commands `skybench bench list`, `skybench bench run` and `skybench bench report`."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated, NoReturn

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

from benchmark.cli import submissions as submission_cli
from benchmark.cli.submissions import Split
from benchmark.errors import BenchmarkError, ResultsError

app = typer.Typer(help="Run solvers over a rendered dataset and report how they did.", no_args_is_help=True)
submission_cli.add_to(app)


class DetectionsChoice(StrEnum):
    """Who detects."""

    OWN = "own"
    SHARED = "shared"


_DEFAULT_OUT = Path("results/demo")
_Out = Annotated[Path, typer.Option("--out", help="Results folder.")]


@app.command("list")
def list_all() -> None:
    """Show all tasks and solvers, and whether each solver can run here."""
    from benchmark.cli.tasks import solver_table, task_table  # loads the solvers

    console = Console()
    try:
        console.print(task_table())
        console.print(solver_table())
    except BenchmarkError as error:
        _fail(error)


@app.command(
    epilog="Examples: skybench bench run bortle --solver skybench --solver tetra3rs --frames 20 | "
    "skybench bench run --all --frames 50 --jobs 2 | skybench bench run out/demo --solver thesis-adaptive"
)
def run(
    target: Annotated[
        Path | None,
        typer.Argument(
            metavar="[TASK|DIR]", help="Task (see `bench list`), or a dataset that `skybench render` wrote."
        ),
    ] = None,
    solver: Annotated[
        list[str] | None,
        typer.Option("--solver", help="Name of a solver, or a folder with a solver.yaml; repeat for several."),
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", help="Results folder; default results/leaderboard or results/demo.")
    ] = None,
    jobs: Annotated[int, typer.Option("--jobs", min=1, help="Processes to share the frames among.")] = 1,
    split: Annotated[Split, typer.Option("--split", help="Of the task.")] = Split.DEV,
    detections: Annotated[
        DetectionsChoice,
        typer.Option("--detections", help="own: each solver detects by itself; shared: all get the same."),
    ] = DetectionsChoice.OWN,
    frames: Annotated[
        int | None, typer.Option("--frames", min=1, help="Frames a condition; default: the task's number.")
    ] = None,
    all_tasks: Annotated[
        bool, typer.Option("--all", help="All tasks; without --solver, all solvers that can run here.")
    ] = False,
    data: Annotated[
        Path, typer.Option("--data", help="Folder for the tasks' frames; what is there is used again.")
    ] = Path("out/tasks"),
) -> None:
    """Run solvers over a task's frames, all tasks', or those of a dataset; what is done is skipped."""
    if all_tasks == (target is not None):
        _fail(ResultsError("give either a task or dataset, or --all"))
    if not solver and not all_tasks:
        _fail(ResultsError("give at least one --solver"))
    try:
        if target is not None and (target.is_dir() or len(target.parts) > 1):
            _run_on_dataset(target, solver or [], out or _DEFAULT_OUT, jobs)
            return
        from benchmark.cli.tasks import DEFAULT_OUT, run_on_tasks  # loads the solvers, which --help need not wait for
        from benchmark.tasks.definition import task_names

        names = task_names() if target is None else [str(target)]
        run_on_tasks(names, solver or [], split.value, detections.value, frames, out or DEFAULT_OUT, data, jobs)
    except BenchmarkError as error:
        _fail(error)


def _run_on_dataset(folder: Path, solvers: list[str], out: Path, jobs: int) -> None:
    from benchmark.run.run import run_benchmark

    summaries = run_benchmark(folder, solvers, out, jobs=jobs)
    for name, summary in summaries.items():
        counts = f"{summary.n_frames} frames, {summary.n_fixes} fixes, {summary.n_refused} refused"
        typer.echo(f"{name}: {counts}, {summary.n_errors} errors")
    typer.echo(f"results in {out}; next: skybench bench report --out {out}")


@app.command(epilog="Example: skybench bench report --out results/tasks")
def report(
    out: _Out = _DEFAULT_OUT,
    data: Annotated[
        Path, typer.Option("--data", help="Folder of the tasks' frames; pictures come from there if it exists.")
    ] = Path("out/tasks"),
    figure: Annotated[
        Path | None, typer.Option("--figure", help="Also write the leaderboard as one picture (SVG) to this file.")
    ] = None,
) -> None:
    """Report the results in a folder.

    Of one dataset: print its table and write report.html. Of tasks: print the leaderboard and write the folder `site`;
    its pages need neither a server nor the network, and index.html is the first.
    """
    from benchmark.report.site.tree import is_tree  # reads tables, which --help need not wait for

    try:
        path = _report_tasks(out, data, figure) if is_tree(out) else _report_dataset(out, figure)
    except BenchmarkError as error:
        _fail(error)
    typer.echo(str(path))


def _report_tasks(out: Path, data: Path, figure: Path | None) -> Path:
    from benchmark.report.site.pages import leaderboard_table, make_boards, render_figure, write_site
    from benchmark.run.results import write_atomically

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TextColumn("boards"))
    with Progress(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task("comparing", total=None)
        boards = make_boards(out, lambda done, of: bar.update(task, completed=done, total=of))
    Console().print(leaderboard_table(boards))
    if figure is not None:
        write_atomically(figure, render_figure(boards).encode())
    with Console(stderr=True).status("writing the pages"):
        return write_site(boards, out, data)


def _report_dataset(out: Path, figure: Path | None) -> Path:
    from benchmark.report.report import result_table, write_report  # loads the chart engine

    if figure is not None:
        raise ResultsError(f"{out}: holds results of one dataset; --figure needs results of tasks")
    table = result_table(out)
    Console().print(table)
    with Console(stderr=True).status("drawing the report"):
        return write_report(out)


def _fail(error: BenchmarkError) -> NoReturn:
    typer.echo(f"skybench: {error}", err=True)
    raise typer.Exit(2)
