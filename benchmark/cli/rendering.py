"""Commands that produce pictures: `skybench render`, `bake` and `gallery`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from benchmark.cli import completion
from benchmark.cli.errors import fail
from benchmark.cli.output import AsJson, print_json, print_warnings
from benchmark.cli.progress import progress_bars, working
from generator.errors import GeneratorError
from generator.folder_lock import only_writer

SCENARIO_HELP = "Scenario file (YAML), or the name of a scenario that comes with skybench (`skybench scenes`)."
Scenario = Annotated[Path, typer.Argument(metavar="SCENARIO", help=SCENARIO_HELP, autocompletion=completion.scenarios)]


def add_to(app: typer.Typer) -> None:
    """Add the commands."""
    app.command(epilog="Examples: skybench render 00_hello --out out/hello; skybench render mine.yaml --out out/mine")(
        render
    )
    app.command()(bake)
    app.command()(gallery)


def render(
    scenario: Scenario,
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
    as_json: AsJson = False,
) -> None:
    """Render all frames of a scenario: image, expected electrons, frame record, truth of the stars.

    Existing frames of the same scenario in the folder are kept, so the same command continues an interrupted run, and frames
    that `skybench verify DIR` names are rendered again.
    """
    from generator.scenario.contradictions import contradictions_of
    from generator.scenario.file import load_scenario
    from generator.scenario.shipped import find_scenario

    try:
        loaded = load_scenario(find_scenario(scenario))
        print_warnings(contradictions_of(loaded))
        from generator.frame.render import render_dataset  # loads Mitsuba, for which an invalid scenario need not wait

        with only_writer(out), progress_bars() as progress:
            task = progress.add_task("rendering", total=loaded.frame_count)
            mended = render_dataset(
                loaded, out, lambda index: progress.advance(task), layers=layers, exr=exr, overwrite=overwrite
            )
    except GeneratorError as error:
        fail(error)
    if as_json:
        identity = {"scenario": loaded.name, "sha256": loaded.sha256}
        print_json(identity | {"frames": loaded.frame_count, "out": out, "mended": mended})
        return
    for place in mended:
        typer.echo(f"{place}: was damaged or missing, and is made again")
    typer.echo(f"{loaded.frame_count} {'frame' if loaded.frame_count == 1 else 'frames'} in {out}")


def bake(
    what: Annotated[
        str,
        typer.Argument(
            help="moon, city, ground, twilight or all.",
            autocompletion=lambda: ["moon", "city", "ground", "twilight", "all"],
        ),
    ] = "all",
    as_json: AsJson = False,
) -> None:
    """Recompute the maps of Moon, city, ground light and twilight by radiative transfer (some ten minutes on two cores)."""
    from generator.bake import make_maps

    tasks = {
        "moon": make_maps.bake_moon,
        "city": make_maps.bake_city,
        "ground": make_maps.bake_ground,
        "twilight": make_maps.bake_twilight,
    }
    if what not in (*tasks, "all"):
        fail(ValueError(f"found {what!r}, expected one of all, {', '.join(tasks)}"))
    errors = {}
    try:
        for name in tasks if what == "all" else [what]:
            with working(f"baking {name}"):
                errors[name] = tasks[name]()
    except GeneratorError as error:
        fail(error)
    if as_json:
        print_json({"median_monte_carlo_error": errors})
        return
    for name, share in errors.items():
        typer.echo(f"{name}: median Monte Carlo error {share:.2%}")


def gallery(
    out: Annotated[Path, typer.Option("--out", help="Folder for the pictures.")] = Path("docs/gallery"),
    as_json: AsJson = False,
) -> None:
    """Make the gallery: all-sky views in true colour, and plots next to published numbers."""
    from generator.gallery.make_gallery import make_gallery

    made = list(make_gallery(out))
    if as_json:
        print_json({"pictures": made})
        return
    for path in made:
        typer.echo(path)
