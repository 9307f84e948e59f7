"""`skybench demo`: frames, solvers and a page with one command."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from benchmark.cli import completion
from benchmark.cli.errors import fail
from benchmark.cli.output import AsJson, print_json, print_tables
from benchmark.cli.progress import progress_bars, working
from benchmark.cli.rendering import SCENARIO_HELP
from benchmark.errors import BenchmarkError
from generator.errors import GeneratorError
from generator.folder_lock import only_writer

if TYPE_CHECKING:
    from rich.table import Table

    from benchmark.report.demo_page import Demo
    from generator.scenario.file import Scenario

SOLVERS = ("skybench", "thesis-adaptive", "thesis-baseline")
RIVALS = ("tetra3rs",)
"""Other projects' solvers, from optional packages."""


def add_to(app: typer.Typer) -> None:
    """Add the command."""
    app.command(epilog="Examples: skybench demo; skybench demo --scenario demo_small")(demo)


def demo(
    scenario: Annotated[
        Path, typer.Option("--scenario", help=SCENARIO_HELP, autocompletion=completion.scenarios)
    ] = Path("demo"),
    frames: Annotated[Path, typer.Option("--frames", help="Folder for the rendered frames.")] = Path("out/demo"),
    out: Annotated[Path, typer.Option("--out", help="Folder for results and report.")] = Path("results/demo"),
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace the frames that the folder holds, of whatever scenario.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Render a small dataset, solve it with the default solver and others, and write a page about it."""
    from generator.scenario.file import load_scenario
    from generator.scenario.shipped import find_scenario

    try:
        loaded = load_scenario(find_scenario(scenario))
        made, page, details = _render_and_solve(loaded, frames, out, overwrite)
    except (BenchmarkError, GeneratorError) as error:
        fail(error)
    if as_json:
        print_json({"page": page, "details": details, "frames": frames, "solvers": made.rows})
        return
    print_tables(_table(made))
    typer.echo(f"open {page}")


def _render_and_solve(loaded: Scenario, frames: Path, out: Path, overwrite: bool) -> tuple[Demo, Path, Path]:
    """Return the content of the page, the path of the page, and that of the page with all numbers."""
    # Mitsuba and the solvers are loaded here, so that an invalid scenario need not wait for them.
    from benchmark.cli.running import Request, obstacles, run_solvers
    from benchmark.frames.opening import open_frames
    from benchmark.frames.task_frames import FrameChoice
    from benchmark.report.demo_page import make_demo, write_demo
    from benchmark.report.site.commands import Places
    from benchmark.report.site.pages import make_boards, write_site
    from generator.frame.render import render_dataset

    left_out = obstacles(RIVALS)
    for obstacle in left_out.values():
        typer.echo(f"left out: {obstacle}", err=True)
    solvers = (*SOLVERS, *(name for name in RIVALS if name not in left_out))
    with only_writer(frames), progress_bars() as bar:
        line = bar.add_task("rendering", total=loaded.frame_count)
        render_dataset(loaded, frames, lambda index: bar.advance(line), overwrite=overwrite)
    _, runs = run_solvers(Request([str(frames)], solvers, FrameChoice(), "own", out, 1), lambda words: None)
    with working("writing the pages"):
        boards = make_boards(out)
        details = write_site(boards, Places(out))
        folders = {run.folder for run in runs}
        board = next(one for one in boards if folders & {entry.stored.folder for entry in one.entries})
        made = make_demo(loaded, frames, open_frames(str(frames)).frames, board, list(left_out.values()))
        return made, write_demo(made, out, details), details


def _table(made: Demo) -> Table:
    from rich.table import Column, Table

    from benchmark.report.formatting import number

    table = Table(
        Column("solver", no_wrap=True),
        "place found",
        "how far off",
        "refused",
        "wrong",
        "time",
        title=f"{made.scenario.frame_count} rendered skies; found: less than {made.limit_km:g} km off; medians",
        title_justify="left",
    )
    for row in made.rows:
        found, time = f"{row.found} of {row.frames}", number(row.median_ms, "ms")
        table.add_row(row.name, found, row.distance, str(row.refused), str(row.wrong), time)
    return table
