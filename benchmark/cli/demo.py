"""`skybench demo`: frames, solvers and a page in one go."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from benchmark.cli import completion
from benchmark.cli.errors import fail
from benchmark.cli.output import AsJson, print_json, print_tables
from benchmark.cli.progress import progress_bars, working
from benchmark.cli.rendering import SCENARIO_HELP
from benchmark.errors import BenchmarkError
from generator.errors import GeneratorError

SOLVERS = ("skybench", "thesis-adaptive", "thesis-baseline")
RIVALS = ("tetra3rs",)
"""Solvers of others, which optional packages bring."""


def add_to(app: typer.Typer) -> None:
    """Add the command."""
    app.command(epilog="Examples: skybench demo; skybench demo --scenario demo_small")(demo)


def demo(
    scenario: Annotated[
        Path, typer.Option("--scenario", help=SCENARIO_HELP, autocompletion=completion.scenarios)
    ] = Path("demo"),
    frames: Annotated[Path, typer.Option("--frames", help="Folder for the rendered frames.")] = Path("out/demo"),
    out: Annotated[Path, typer.Option("--out", help="Folder for results and report.")] = Path("results/demo"),
    as_json: AsJson = False,
) -> None:
    """Render a small dataset, solve it with the default solver and others, and write a page about it."""
    from benchmark.cli.running import Request, run_solvers, runnable
    from benchmark.frames.task_frames import FrameChoice
    from benchmark.report.site.commands import Places
    from benchmark.report.site.pages import make_boards, write_site
    from benchmark.report.site.terminal import boards_document, result_table
    from generator.frame.render import render_dataset
    from generator.scenario.file import load_scenario
    from generator.scenario.shipped import find_scenario

    try:
        loaded = load_scenario(find_scenario(scenario))
        solvers = (*SOLVERS, *runnable(RIVALS))
        with progress_bars() as bar:
            line = bar.add_task("rendering", total=loaded.frame_count)
            render_dataset(loaded, frames, lambda index: bar.advance(line))
        run_solvers(
            Request([str(frames)], solvers, FrameChoice(), "own", out, 1), lambda words: typer.echo(words, err=True)
        )
        boards = make_boards(out)
        with working("writing the pages"):
            page = write_site(boards, Places(out, FrameChoice().data))
    except (BenchmarkError, GeneratorError) as error:
        fail(error)
    if as_json:
        print_json({"page": page, "frames": frames, "boards": boards_document(boards)})
        return
    print_tables(result_table(boards))
    typer.echo(f"open {page}")
