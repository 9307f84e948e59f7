"""The command `skybench speed`."""

from __future__ import annotations

import math
import statistics
from typing import TYPE_CHECKING, Annotated

import typer

from benchmark.cli.errors import fail
from benchmark.cli.output import AsJson, print_json, print_tables
from benchmark.cli.progress import working

if TYPE_CHECKING:
    from rich.table import Table

    from generator.speed.pairs import PairedTimes
    from generator.speed.report import SpeedReport

EPILOG = (
    "Examples: skybench speed; skybench speed --codec jxl --json > speed.json; "
    "skybench speed --limit floor=2 --limit everything=2.5; skybench speed --solver.  "
    "Exit status: 1 where a ratio exceeds its --limit. With --solver: 0 when every bar is reached and every hostile input "
    "refused within its bounds, 1 otherwise."
)


def add_to(app: typer.Typer) -> None:
    """Add the command."""
    app.command(epilog=EPILOG)(speed)


def speed(
    frames: Annotated[int, typer.Option("--frames", min=1, help="Frames to time by stage, and per process.")] = 30,
    pairs: Annotated[int, typer.Option("--pairs", min=1, help="Pairs of frames for each ratio.")] = 9,
    codec: Annotated[
        str, typer.Option("--codec", help="Image format: png or jxl.", autocompletion=lambda: ["png", "jxl"])
    ] = "png",
    as_json: AsJson = False,
    limit: Annotated[
        list[str] | None,
        typer.Option(
            "--limit",
            metavar="RATIO=VALUE",
            help="Largest ratio, of floor, sky, camera or everything; may be given several times.",
        ),
    ] = None,
    solver: Annotated[bool, typer.Option("--solver", help="Measure the default solver on random star fields.")] = False,
    fields: Annotated[int, typer.Option("--fields", min=1, help="With --solver: fields of each condition.")] = 100,
    hostile: Annotated[
        int, typer.Option("--hostile", min=1, help="With --solver: inputs without an answer that are to be refused.")
    ] = 1000,
    seed: Annotated[int, typer.Option("--seed", help="With --solver: seed of the fields and inputs.")] = 2026,
) -> None:
    """Time the rendering of frames, stage by stage, against a floor: drawing the noise and compressing the image alone."""
    if solver:
        from benchmark.fields.solver_effort import report_effort
        from benchmark.fields.solver_table import solver_speed

        tell = _silent if as_json else typer.echo
        rows = solver_speed(fields, seed, tell)
        tell("")
        effort = report_effort(hostile, seed, tell)
        if as_json:
            print_json({"rows": rows, "effort": effort.document()})
        raise typer.Exit(0 if effort.passed and all(row.reached for row in rows) else 1)
    from generator.dataset.layout import DatasetSpec
    from generator.errors import GeneratorError

    try:
        DatasetSpec(codec=codec)
        limits = dict(read_limit(text) for text in limit or ())
        from generator.speed.report import measure

        with working("measuring") as status:
            report = measure(frames, pairs, codec=codec, progress=lambda stage: status.update(f"measuring {stage}"))
    except GeneratorError as error:
        fail(error)
    if as_json:
        print_json(report.as_json() | {"limits": limits})
    else:
        print_tables(*tables(report))
        print(load_line(report))
    exceeded = {name: value for name, value in limits.items() if not report.limited[name] <= value}
    for name, value in exceeded.items():
        typer.echo(f"{name}: {report.limited[name]:.2f} is over the limit of {value:g}", err=True)
    raise typer.Exit(1 if exceeded else 0)


def read_limit(text: str) -> tuple[str, float]:
    """Parse name and value of a limit such as ``floor=2``.

    Raises
    ------
    GeneratorError
        The text is not a limit.
    """
    from generator.errors import GeneratorError
    from generator.speed.report import LIMITED

    name, _, value = text.partition("=")
    try:
        number = float(value)
    except ValueError:
        number = math.nan
    if name not in LIMITED or not number > 0:
        raise GeneratorError(f"--limit {text}: give one of {', '.join(LIMITED)} and a number above 0, as floor=2")
    return name, number


def load_line(report: SpeedReport) -> str:
    """Describe how busy the machine was."""
    load = report.load
    return (
        f"machine: {load.cores} cores, load average {load.before:.1f} before and {load.after:.1f} after; this process had "
        f"{100 * load.core_share:.0f} % of a core while it measured by itself"
    )


def _silent(words: str) -> None:
    """Say nothing."""


def tables(report: SpeedReport) -> list[Table]:
    """The report as tables for people."""
    from rich.table import Table

    size = report.size
    stages = Table("stage", "ms", title=f"one frame, {size.width} x {size.height}, {report.codec}, one process")
    for name, seconds in report.stages_s.items():
        stages.add_row(name, f"{1000 * seconds:.1f}")
    stages.add_row("together", f"{1000 * report.frame_s:.1f}", end_section=True)
    for name, seconds in report.floor_s.items():
        stages.add_row(f"floor: {name}", f"{1000 * seconds:.1f}")
    stages.add_row("floor together", f"{1000 * sum(report.floor_s.values()):.1f}")
    stages.add_row("frame over floor", f"{report.over_floor:.2f}")
    rates = Table("worker processes", "frames/s", title=f"steady state on {report.device} ({report.variant})")
    for workers, rate in report.frames_per_s.items():
        rates.add_row(str(workers), f"{rate:.1f}")
    rates.add_row("scaling", f"{report.scaling:.2f}")
    ratios = Table("", "plain, ms", "full, ms", "median ratio", title="in pairs, image included")
    for name, times in (
        ("sky", report.sky),
        ("camera", report.camera),
        ("everything", report.everything),
    ):
        ratios.add_row(name, *_milliseconds(times), f"{times.ratio:.2f}")
    return [stages, rates, ratios]


def _milliseconds(times: PairedTimes) -> tuple[str, str]:
    return (f"{1000 * statistics.median(times.plain_s):.0f}", f"{1000 * statistics.median(times.full_s):.0f}")
