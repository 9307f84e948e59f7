"""Commands that keep results up to date: `skybench bench boards`, `pack-results`, `confirm`, `stale`, `revisions`."""

from __future__ import annotations

from collections import Counter
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from benchmark.cli import completion
from benchmark.cli.errors import fail
from benchmark.cli.output import AsJson, print_json, print_tables
from benchmark.cli.progress import compared_boards, progress_bars
from benchmark.cli.submissions import Split
from benchmark.errors import BenchmarkError, ResultsError

if TYPE_CHECKING:
    from collections.abc import Callable

    from rich.progress import Progress, TaskID

    from benchmark.report.refresh import BoardsRequest
    from benchmark.report.refresh_plan import Plan
    from benchmark.report.stale import Rows

EXIT_PROBLEMS = 1
_LEADERBOARD = Path("results/leaderboard")
_Out = Annotated[Path, typer.Option("--out", help="Results folder.")]


def add_to(app: typer.Typer) -> None:
    """Add the commands."""
    app.command(
        "boards", epilog="Example: skybench bench boards --plan. Exit status: 0 all made, 1 some rows cannot run here."
    )(boards)
    app.command("pack-results", epilog="Example: skybench bench pack-results --out results/leaderboard")(pack_results)
    app.command("confirm", epilog="Example: skybench bench confirm motion@2 drift@1 --data out/tasks --workers 2")(
        confirm
    )
    app.command("stale", epilog="Example: skybench bench stale. Exit status: 0 all is as it says, 1 not.")(stale)
    app.command("revisions", epilog="Example: skybench bench revisions --tree ../checkout")(revisions)


def boards(
    tasks: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[TASK|TASKFILE]…", help="Default: all tasks of skybench.", autocompletion=completion.targets
        ),
    ] = None,
    solver: Annotated[
        list[str] | None,
        typer.Option(
            "--solver",
            help="Name or folder; repeat for several. Default: all that come with skybench.",
            autocompletion=completion.solvers,
        ),
    ] = None,
    out: _Out = _LEADERBOARD,
    plan: Annotated[bool, typer.Option("--plan", help="Print what would be run and an estimate, and end.")] = False,
    jobs: Annotated[int, typer.Option("--jobs", min=1, help="Frames to solve at the same time.")] = 1,
    frames: Annotated[
        int | None, typer.Option("--frames", min=1, help="Frames at each condition; default: the task's number.")
    ] = None,
    data: Annotated[
        Path, typer.Option("--data", help="Folder for the tasks' frames; missing ones are rendered.")
    ] = Path("out/tasks"),
    existing: Annotated[
        bool, typer.Option("--existing", help="Only bring rows up to date that are there; make none that are missing.")
    ] = False,
    figure: Annotated[
        Path | None, typer.Option("--figure", help="Also write the leaderboard as one picture (SVG) to this file.")
    ] = None,
    pictures: Annotated[
        int, typer.Option("--pictures", min=0, help="Most pictures of failures for each set of frames.")
    ] = 0,
    remove_old: Annotated[
        bool,
        typer.Option(
            "--remove-old",
            help="Remove results of retired tasks, of revisions with a later one beside them, and on older frames than the "
            "new rows.",
        ),
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Run the rows that are missing or not of today's code, pack all results and write the pages.

    If the solver of a row is of today's revision, only frames that have changed are solved again; of a sequence, all frames.
    """
    from benchmark.report.refresh import (
        BoardsRequest,
        compared_frames,
        count_as_before,
        plan_boards,
        run_plan,
    )  # loads the solvers
    from benchmark.report.superseded import outdated, remove_outdated
    from benchmark.run.packing import pack_tree
    from benchmark.solvers.registry import known_solvers
    from benchmark.tasks.definition import task_names

    request = BoardsRequest(
        tuple(tasks or task_names()), tuple(solver or known_solvers()), out, data, jobs, frames, existing
    )
    try:
        found = plan_boards(request)
        n_compared = compared_frames(found, request)
        with progress_bars(hidden=not n_compared) as bar:
            comparing = bar.add_task("comparing frames with those of the results", total=n_compared)
            found, notes = count_as_before(found, request, partial(bar.advance, comparing))
        if not as_json:
            _print_plan(found, request)
        old = outdated(out) if remove_old else {}
        if plan or not (found.jobs or old):
            if as_json:
                print_json(_document(found, request))
            return
        pack_tree(out, leave_others=True)
        with progress_bars() as bar:
            made = run_plan(found, request, notes, _lines(bar, found))
        for obstacle in made.obstacles:
            typer.echo(f"not made: {obstacle}", err=True)
        for line in () if as_json else made.renewed:
            typer.echo(line)
        for table in pack_tree(out, remove_others=remove_old):
            if table.removed:
                typer.echo(f"removed: {table.listing}: rows on older frames: {', '.join(table.removed)}", err=True)
        for folder, why in (remove_outdated(out) if remove_old else {}).items():
            typer.echo(f"removed: {folder}: {why}", err=True)
        page = _report(out, data, figure, pictures)
    except BenchmarkError as error:
        fail(error)
    if as_json:
        print_json(_document(found, request) | {"not_made": made.obstacles, "page": page})
    else:
        typer.echo(page)
    if made.obstacles:
        raise typer.Exit(EXIT_PROBLEMS)


def _lines(bar: Progress, plan: Plan) -> Callable[[str, int], None]:
    """A function to be called with a solver and the number of its further frames that are done; each solver gets a line."""
    from benchmark.run.contestants import contestant_of

    totals: Counter[str] = Counter()
    for job in plan.jobs:
        totals[contestant_of(job.place.solver).name] += job.n_frames
    lines: dict[str, TaskID] = {}

    def advance(solver: str, count: int) -> None:
        if solver not in lines:
            lines[solver] = bar.add_task(solver, total=totals[solver])
        bar.advance(lines[solver], count)

    return advance


def _document(found: Plan, request: BoardsRequest) -> dict[str, object]:
    from benchmark.report.refresh import missing_frames

    unrendered = missing_frames(found, request)
    rows = [
        vars(job.place) | {"why": job.why, "frames": job.n_frames, "as_before": job.n_as_before, "seconds": job.seconds}
        for job in found.jobs
    ]
    seconds = found.seconds(request.jobs, unrendered)
    return {"rows": rows, "of_today": found.fresh, "frames_to_render": unrendered, "seconds": seconds}


def _print_plan(found: Plan, request: BoardsRequest) -> None:
    from rich.box import SIMPLE_HEAD
    from rich.markup import escape
    from rich.table import Table

    from benchmark.report.formatting import duration
    from benchmark.report.refresh import missing_frames

    table = Table(title="Rows to be made", title_justify="left", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for heading in ("task, solver", "why", "frames", "estimate"):
        table.add_column(heading, overflow="fold", no_wrap=heading in ("frames", "estimate"))
    for job in found.jobs:
        place = job.place
        shared = "" if place.detections == "own" else f"\n[dim]{place.detections} detections[/dim]"
        table.add_row(
            f"{escape(place.task)}\n{escape(place.solver)}{shared}",
            escape(job.why),
            f"{job.n_frames - job.n_as_before} of {job.n_frames}",
            "unknown" if job.seconds is None else duration(job.seconds / request.jobs),
        )
    if found.jobs:
        print_tables(table)
    unrendered = missing_frames(found, request)
    whole = duration(found.seconds(request.jobs, unrendered))
    unknown = f", without {found.n_unknown} rows of solvers that have none yet" if found.n_unknown else ""
    typer.echo(
        f"{len(found.jobs)} rows to be made, {len(found.fresh)} of today's code; {unrendered} frames to be rendered; "
        f"about {whole} with {request.jobs} process{'es' if request.jobs != 1 else ''}{unknown}"
    )


def _report(out: Path, data: Path, figure: Path | None, pictures: int) -> Path:
    from benchmark.report.site.commands import Places
    from benchmark.report.site.pages import render_figure, write_site
    from generator.files import write_bytes

    made = compared_boards(out)
    if figure is not None:
        write_bytes(figure, render_figure(made, Places(out, data), figure).encode())
    return write_site(made, Places(out, data), pictures)


def pack_results(out: _Out = _LEADERBOARD, as_json: AsJson = False) -> None:
    """Put raw results into one table per task; a raw result replaces the packed one of the same solver.

    Positions, detections and the solvers' own timings are not kept; `bench run` with another --out reproduces them.
    """
    from benchmark.run.packing import pack_tree

    try:
        packed = pack_tree(out)
    except BenchmarkError as error:
        fail(error)
    if as_json:
        print_json({"tables": packed})
        return
    for table in packed:
        typer.echo(f"{table.listing}: {table.n_new} of {table.n_rows} rows new, {table.size_bytes / 1000:.0f} kB")
    if not packed:
        typer.echo(f"{out}: no raw results in it")


def confirm(
    tasks: Annotated[
        list[str],
        typer.Argument(
            metavar="TASK|DIR|TASKFILE…", help="Frames with packed results.", autocompletion=completion.targets
        ),
    ],
    out: _Out = _LEADERBOARD,
    split: Annotated[Split, typer.Option("--split", help="Of the tasks.")] = Split.DEV,
    data: Annotated[
        Path, typer.Option("--data", help="Folder for the tasks' frames; missing ones are rendered.")
    ] = Path("out/tasks"),
    workers: Annotated[int, typer.Option("--workers", min=1, help="Processes that render.")] = 1,
    as_json: AsJson = False,
) -> None:
    """Render all frames of tasks again; packed results of the same frames, to the byte, become results of today's frames.

    Use it after changes of the generator that do not affect a task. Frames that differ are named, and their results stay as
    they are. Results of a task that has gained conditions since are completed by the packed results of these conditions.
    """
    from benchmark.frames.opening import named_task, open_frames
    from benchmark.frames.task_frames import FrameChoice
    from benchmark.run.confirm import confirm as confirm_results
    from benchmark.run.confirm import packed_listing
    from benchmark.tasks.appended import earlier_definitions

    found = []
    try:
        with progress_bars() as bar:
            for task in tasks:
                line = bar.add_task(task, total=None)
                choice = FrameChoice(split=split.value, data=data, workers=workers)
                named = named_task(task)
                if named is not None:
                    packed_listing(out, Path(named.label) / split.value)  # before an hour of rendering
                frames = open_frames(task, choice, partial(bar.advance, line))
                found.append(confirm_results(out, frames, earlier_definitions(named) if named else None))
    except BenchmarkError as error:
        fail(error)
    if as_json:
        print_json({"confirmed": found})
        return
    for each in found:
        unchanged = "no row has changed" if each.lacking else "all rows are of today's already"
        what = f"now of today's: {', '.join(each.solvers)}" if each.solvers else unchanged
        typer.echo(f"{each.listing}: {each.n_frames} frames are the same bytes; {what}")
        if each.lacking:
            typer.echo(f"{each.listing}: no results of the new conditions: {', '.join(each.lacking)}", err=True)


def stale(
    root: Annotated[Path, typer.Option("--root", help="Folder of the repository.")] = Path(),
    stamp: Annotated[
        list[Path] | None,
        typer.Option("--stamp", help="Let a file say which of its numbers are not of today's code."),
    ] = None,
    measured: Annotated[
        list[Path] | None,
        typer.Option("--measured", help="The numbers in a file have just been measured: state today's revision."),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Check that all measured numbers are of the revision that is printed next to them.

    Results, pages, figures and tables of documents carry a mark; numbers of an older revision may stay where the mark says
    so.
    """
    from benchmark.report.stale import check_marks, stamp_file

    try:
        place = root.resolve()
        rows = _rows(place / _LEADERBOARD)
        changed = {}
        for paths, new in ((stamp or [], False), (measured or [], True)):
            for path in paths:
                changed[path] = stamp_file(place, path.resolve(), rows, new)
        problems = check_marks(place, rows)
    except BenchmarkError as error:
        fail(error)
    if as_json:
        print_json({"problems": problems, "marks_changed": changed})
        raise typer.Exit(EXIT_PROBLEMS if problems else 0)
    for path, count in changed.items():
        typer.echo(f"{path}: {count} marks changed")
    for problem in problems:
        typer.echo(f"skybench: {problem}", err=True)
    if problems:
        raise typer.Exit(EXIT_PROBLEMS)
    typer.echo("all measured numbers are of the revision that is printed beside them")


def _rows(leaderboard: Path) -> Rows:
    from benchmark.report.site.revisions import row_name, state_of
    from benchmark.report.site.tree import read_tree

    if not leaderboard.is_dir():
        return {}
    found = [stored for group in read_tree(leaderboard) for stored in group]
    return {row_name(stored): state_of(stored) for stored in found}


def revisions(
    tree: Annotated[
        Path | None,
        typer.Option("--tree", help="Folder that holds the packages, such as a checkout; default: as installed."),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Print the revision of every solver, and of the shared detector."""
    from benchmark.solvers.definition import FOLDER, solver_folders
    from benchmark.solvers.revision import PackageTree, installed_packages

    packages = installed_packages() if tree is None else PackageTree(tree)
    folder = FOLDER if tree is None else tree / "benchmark" / "solvers"
    try:
        if tree is not None:
            _check_tree(tree)
        found = {name: solver.revision_among(packages) for name, solver in solver_folders(folder).items()}
        found["the shared detector"] = packages.detector_revision
    except (BenchmarkError, OSError, KeyError, SyntaxError) as error:
        fail(error)
    if as_json:
        print_json({"revisions": found})
        return
    for name, revision in found.items():
        typer.echo(f"{revision}  {name}")


def _check_tree(tree: Path) -> None:
    """Refuse a folder that lacks a package. Raises ResultsError."""
    from benchmark.solvers.revision import PACKAGES

    absent = [name for name in PACKAGES if not (tree / name / "__init__.py").is_file()]
    if absent:
        what = f"has no package {', '.join(absent)}" if tree.is_dir() else "no such folder"
        raise ResultsError(
            f"--tree {tree}: {what}; give the folder that holds {', '.join(PACKAGES)}, such as a checkout"
        )
