"""The command `skybench`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from benchmark.cli import bench as bench_cli
from benchmark.cli import datasets as dataset_cli
from benchmark.cli import speed as speed_cli
from benchmark.cli import studies as study_cli
from benchmark.cli.errors import InterruptibleGroup, fail
from benchmark.cli.progress import progress_bars

app = typer.Typer(
    help="Render synthetic night skies, solve them, and compare solvers.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    cls=InterruptibleGroup,
)
app.add_typer(bench_cli.app, name="bench")
app.command(epilog="Example: skybench plan scenes/thesis_mag.yaml")(dataset_cli.plan)
app.command(epilog="Example: skybench generate scenes/thesis_mag.yaml --out out/thesis-mag")(dataset_cli.generate)
app.command(epilog="Exit status: 0 whole, 1 damaged.")(dataset_cli.verify)
app.command(epilog="Example: skybench export out/set --to coco --out out/coco")(dataset_cli.export)
app.command(epilog="Example: skybench show out/set, then open out/set-show/index.html")(dataset_cli.show)
app.command(epilog=speed_cli.EPILOG)(speed_cli.speed)
app.add_typer(study_cli.app, name="study")

DEMO_SOLVERS = ("thesis-baseline", "thesis-adaptive")


@app.command(epilog="Example: skybench render scenes/00_hello.yaml --out out/hello")
def render(
    scenario: Annotated[Path, typer.Argument(metavar="SCENARIO", help="Scenario file (YAML).")],
    out: Annotated[Path, typer.Option("--out", help="Folder to write; made if missing.")],
    layers: Annotated[
        bool, typer.Option("--layers", help="Write each component of the light as its own EXR too.")
    ] = False,
    exr: Annotated[
        bool | None,
        typer.Option(
            "--exr/--no-exr", help="Write the expected electrons; default: for images of up to 20 megapixels."
        ),
    ] = None,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace the frames that the folder holds, of whatever scenario.")
    ] = False,
) -> None:
    """Render all frames of a scenario: image, expected electrons, frame record, truth of the stars.

    Frames of the same scenario that the folder holds are kept, so an interrupted run is continued by the same command.
    """
    from generator.errors import GeneratorError
    from generator.scenario.file import load_scenario

    try:
        loaded = load_scenario(scenario)
        from generator.frame.render import render_dataset  # loads Mitsuba, which a bad scenario need not wait for

        with progress_bars() as progress:
            task = progress.add_task("rendering", total=loaded.frame_count)
            render_dataset(
                loaded, out, lambda index: progress.advance(task), layers=layers, exr=exr, overwrite=overwrite
            )
    except GeneratorError as error:
        fail(error)
    typer.echo(f"{loaded.frame_count} {'frame' if loaded.frame_count == 1 else 'frames'} in {out}")


@app.command()
def bake(
    what: Annotated[str, typer.Argument(help="moon, city or all.")] = "all",
) -> None:
    """Make the maps of moonlight and city light again, by radiative transfer (about four minutes on two cores)."""
    from generator.bake import make_maps
    from generator.errors import GeneratorError

    tasks = {"moon": make_maps.bake_moon, "city": make_maps.bake_city}
    if what not in (*tasks, "all"):
        fail(ValueError(f"found {what!r}, expected one of all, {', '.join(tasks)}"))
    try:
        for name in tasks if what == "all" else [what]:
            with Console(stderr=True).status(f"baking {name}"):
                error = tasks[name]()
            typer.echo(f"{name}: median Monte Carlo error {error:.2%}")
    except GeneratorError as error_:
        fail(error_)


@app.command()
def gallery(
    out: Annotated[Path, typer.Option("--out", help="Folder for the pictures.")] = Path("docs/gallery"),
) -> None:
    """Make the gallery: all-sky views in true colour, and plots beside published numbers."""
    from generator.gallery.make_gallery import make_gallery

    for path in make_gallery(out):
        typer.echo(path)


@app.command(epilog="Exit status: 0 when everything is ok, 1 otherwise.")
def doctor() -> None:
    """Check that skybench can run here, and say what to do where it cannot."""
    from benchmark.cli.doctor import check_all, check_table

    console = Console()
    with Console(stderr=True).status("checking"):
        checks = check_all()
    console.print(check_table(checks))
    raise typer.Exit(0 if all(check.ok for check in checks) else 1)


@app.command()
def demo(
    scenario: Annotated[Path, typer.Option("--scenario", help="Scenario to render.")] = Path("scenes/demo.yaml"),
    frames: Annotated[Path, typer.Option("--frames", help="Folder for the rendered frames.")] = Path("out/demo"),
    out: Annotated[Path, typer.Option("--out", help="Folder for results and report.")] = Path("results/demo"),
) -> None:
    """Render a small dataset, solve it with two solvers, and write the report."""
    render(scenario, frames, layers=False, exr=None, overwrite=False)
    bench_cli.run([str(frames)], list(DEMO_SOLVERS), out)
    bench_cli.report(out)


def main() -> None:
    """Entry point of the command."""
    app()


if __name__ == "__main__":
    main()
