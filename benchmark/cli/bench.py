"""Commands `skybench bench list`, `skybench bench run` and `skybench bench report`."""

from pathlib import Path
from typing import Annotated

import typer

from benchmark.cli import boards as boards_cli
from benchmark.cli import completion
from benchmark.cli import submissions as submission_cli
from benchmark.cli.choices import DetectionsChoice
from benchmark.cli.errors import fail
from benchmark.cli.output import AsJson, print_json, print_tables
from benchmark.cli.progress import compared_boards, working
from benchmark.cli.rounds import commands as rounds_cli
from benchmark.cli.submissions import Split
from benchmark.errors import BenchmarkError, ResultsError

app = typer.Typer(help="Run solvers over frames and report how they did.", no_args_is_help=True)
submission_cli.add_to(app)
boards_cli.add_to(app)
app.add_typer(rounds_cli.app, name="round")


_DEFAULT_OUT = Path("results/demo")
_DATA_HELP = "Folder for the frames of tasks and of datasets in shards; what is there is used again."


@app.command("list")
def list_all(as_json: AsJson = False) -> None:
    """Show all tasks and solvers, and whether each solver can run here."""
    from benchmark.cli.listing import (  # loads the solvers
        listed_real_tasks,
        listed_solvers,
        listed_tasks,
        real_task_table,
        solver_table,
        task_table,
    )

    try:
        tasks, real, solvers = listed_tasks(), listed_real_tasks(), listed_solvers()
    except BenchmarkError as error:
        fail(error)
    if as_json:
        print_json({"tasks": tasks, "tasks_of_photographs": real, "solvers": solvers})
    else:
        print_tables(task_table(tasks), real_task_table(real), solver_table(solvers))


@app.command(
    epilog="Examples: skybench bench run bortle --solver skybench --solver tetra3rs --frames 20 | "
    "skybench bench run bortle --condition 7 --solver skybench | skybench bench run out/demo --solver ./mine --try 3 | "
    "skybench bench run s3://skies/set --solver skybench --out results/set | "
    "skybench bench run --all --frames 50 --jobs 2.  "
    "Exit status: 0 done, 1 every answer of a solver is an error, 2 the input is not acceptable."
)
def run(
    targets: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[TASK|DIR|URL|TASKFILE]…",
            help="Task (see `bench list`), file of a task of your own (NAME.task.yaml), folder that `skybench render` "
            "wrote, folder or URL that `skybench generate` wrote.",
            autocompletion=completion.targets,
        ),
    ] = None,
    solver: Annotated[
        list[str] | None,
        typer.Option(
            "--solver",
            help="Name of a solver, or a folder with a solver.yaml; repeat for several.",
            autocompletion=completion.solvers,
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            help="Results folder; default: results/leaderboard for skybench's rendered tasks, results/part for a part of "
            "their frames, results/real for its photographs, else results/demo.",
        ),
    ] = None,
    jobs: Annotated[int, typer.Option("--jobs", min=1, help="Frames to solve at the same time.")] = 1,
    split: Annotated[Split, typer.Option("--split", help="Of a task.")] = Split.DEV,
    detections: Annotated[
        DetectionsChoice,
        typer.Option("--detections", help="own: each solver detects by itself; shared: all get the same."),
    ] = DetectionsChoice.OWN,
    frames: Annotated[
        int | None,
        typer.Option("--frames", min=1, help="Frames of a task at each condition; default: the task's number."),
    ] = None,
    condition: Annotated[
        float | None, typer.Option("--condition", help="Only the frames of this value of the task's condition.")
    ] = None,
    all_tasks: Annotated[
        bool, typer.Option("--all", help="All tasks; without --solver, all solvers that can run here but the fused.")
    ] = False,
    attempt: Annotated[
        int | None,
        typer.Option(
            "--try",
            min=1,
            metavar="N",
            help="Put N frames to one solver, show its answers and its standard error as they come, write no result.",
        ),
    ] = None,
    data: Annotated[Path | None, typer.Option("--data", help=f"{_DATA_HELP} Default: out/tasks.")] = None,
    as_json: AsJson = False,
) -> None:
    """Run solvers over frames; finished results are skipped, interrupted runs resume."""
    if all_tasks == bool(targets):
        fail(ResultsError("give tasks or frames to run on, or --all"))
    if not solver and not all_tasks:
        fail(ResultsError("give at least one --solver"))
    from benchmark.cli.running import (  # loads the solvers, for which --help need not wait
        Request,
        run_request,
        try_request,
    )
    from benchmark.frames.task_frames import DEFAULT_DATA, FrameChoice
    from benchmark.tasks.definition import task_names

    names = list(task_names()) if all_tasks else list(targets or ())
    choice = FrameChoice(split.value, frames, condition, data or DEFAULT_DATA, jobs)
    request = Request(names, solver or [], choice, detections.value, out, jobs)
    try:
        code = run_request(request, as_json) if attempt is None else try_request(request, attempt, as_json)
    except BenchmarkError as error:
        fail(error)
    if code:
        raise typer.Exit(code)


@app.command(epilog="Example: skybench bench report --out results/leaderboard")
def report(
    out: Annotated[Path, typer.Option("--out", help="Results folder.")] = _DEFAULT_OUT,
    data: Annotated[
        Path | None, typer.Option("--data", help="Folder of the frames, for pictures. Default: out/tasks.")
    ] = None,
    pictures: Annotated[
        int | None,
        typer.Option("--pictures", min=0, help="Most pictures of failures for each set of frames; default: 100."),
    ] = None,
    figure: Annotated[
        Path | None, typer.Option("--figure", help="Also write the leaderboard as one picture (SVG) to this file.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Print the table of the results in a folder and write their pages to its subfolder `site`.

    The pages need neither a server nor a network; index.html is the first page.
    """
    from benchmark.frames.task_frames import DEFAULT_DATA
    from benchmark.report.site.commands import Places
    from benchmark.report.site.pages import render_figure, write_site
    from benchmark.report.site.pictures import MOST_PICTURES
    from benchmark.report.site.terminal import boards_document, overall_document, result_tables
    from benchmark.report.superseded import superseded
    from generator.files import write_bytes

    try:
        boards = compared_boards(out)
        for folder, why in superseded(out).items():
            typer.echo(f"left out: {folder}: {why}; `skybench bench boards --remove-old` removes it", err=True)
        if not as_json:
            print_tables(*result_tables(boards))
        if figure is not None:
            write_bytes(figure, render_figure(boards, Places(out, data or DEFAULT_DATA), figure).encode())
        with working("writing the pages"):
            path = write_site(
                boards, Places(out, data or DEFAULT_DATA), MOST_PICTURES if pictures is None else pictures
            )
    except BenchmarkError as error:
        fail(error)
    if as_json:
        print_json({"page": path, "overall": overall_document(boards), "boards": boards_document(boards)})
    else:
        typer.echo(path)
