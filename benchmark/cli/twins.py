"""Command `skybench twin`."""

from __future__ import annotations

import math
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from benchmark.cli import completion
from benchmark.cli.errors import fail
from benchmark.cli.output import AsJson, print_json
from benchmark.cli.progress import working
from benchmark.errors import BenchmarkError, PhotographError
from generator.errors import GeneratorError

if TYPE_CHECKING:
    from benchmark.twin.scene import Scene
    from benchmark.twin.sources import Source


def add_to(app: typer.Typer) -> None:
    """Add the command."""
    app.command(
        epilog="Examples: skybench twin nights/*.fits.bz2 --scene observatory_allsky --out out/twins; "
        "skybench twin nights/*.fits --scene mine.yaml --ground ground.png; "
        "skybench twin FF_*.fits.gz --scene meteor --mask mask.bmp; "
        "skybench twin out/night --scene observatory_allsky"
    )(twin)


def twin(
    photographs: Annotated[
        list[Path],
        typer.Argument(
            metavar="PHOTOGRAPHS…",
            help="Raw FITS files of one fixed camera, with place and time; or a folder that `skybench import` wrote.",
        ),
    ],
    scene: Annotated[
        Path,
        typer.Option(
            "--scene",
            help="Scenario of the camera: lens, sensor, pointing, ground, cities; or a name that comes with skybench.",
            autocompletion=completion.scenarios,
        ),
    ],
    out: Annotated[Path, typer.Option("--out", help="Folder for scenarios, pictures, tables and frames.")] = Path(
        "out/twins"
    ),
    ground: Annotated[
        Path | None,
        typer.Option("--ground", help="Write what is not sky as a landscape picture (PNG) for the scene, and end."),
    ] = None,
    mask: Annotated[
        Path | None,
        typer.Option(
            "--mask",
            help="Picture of the photographs' size (PNG, BMP): black is not sky; where it is dark on the photograph, the "
            "twin has ground, unless the scene has a landscape.",
        ),
    ] = None,
    passing: Annotated[
        Path | None,
        typer.Option(
            "--passing", help="What flew through: trails of a scenario's foreground by the photographs' names (YAML)."
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Render the twin of each photograph, its weather fitted by up to four numbers, and compare the two.

    Photographs are raw FITS images, or stacks of a meteor camera's video (FF files), whose place is taken from the scene.
    In a folder that `skybench import` wrote, the records state place, time, lens and attitude; the scene has the sensor.
    The twins with their truth are a dataset in OUT/frames.
    """
    from benchmark.twin.given_files import read_given_passing
    from benchmark.twin.of_source import twin_of
    from benchmark.twin.report import TABLES, numbers_of_twin, tables_of, write_picture, write_report
    from benchmark.twin.scene import read_scene
    from benchmark.twin.sources import check_names, sources_of
    from benchmark.twin.truth import FRAMES, TruthFolder
    from generator.scenario.shipped import find_scenario

    try:
        given = read_scene(find_scenario(scene))
        trails = {} if passing is None else read_given_passing(passing)
        sources = sources_of(photographs)
        if ground is not None:
            _check_alone(ground, {"--mask": mask, "--passing": passing})
            _check_writable(ground.parent)
            _write_ground(sources, given, ground)
            typer.echo(str(ground))
            return
        check_names(sources)
        _check_writable(out)
        frames = TruthFolder(out / FRAMES)
        rows = []
        for source in sources:
            with working(f"{source.name}: twin"):
                made = twin_of(given, source, out, mask, trails.get(source.name, ()))
            if not math.isfinite(made.alignment.rms_px):
                whose = "scene's" if source.imported is None else "record's"
                typer.echo(f"{source.name}: too few stars for an attitude; the twin has the {whose}", err=True)
            write_picture(made, out)
            frames.add(made)
            rows.append(numbers_of_twin(made))
            write_report(rows, out)
    except (BenchmarkError, GeneratorError) as error:
        fail(error)
    if as_json:
        print_json({"twins": rows, "out": out, "frames": out / FRAMES})
        return
    typer.echo(tables_of(rows), nl=False)
    typer.echo(str(out / FRAMES))
    typer.echo(str(out / TABLES))


def _check_writable(folder: Path) -> None:
    """Refuse a folder that cannot be written to, before minutes of rendering."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise PhotographError(f"{folder}: cannot be written ({error.strerror}); choose another folder") from error


def _check_alone(ground: Path, others: dict[str, Path | None]) -> None:
    """Refuse options that a picture of the ground has no use for, which would seem to be heard."""
    for name, given in others.items():
        if given is not None:
            raise PhotographError(f"--ground {ground}: is found from the photographs alone; leave {name} {given} out")


def _write_ground(sources: list[Source], given: Scene, target: Path) -> None:
    from benchmark.photographed.view import dark_plane, view_of
    from benchmark.twin.ground import check_fixed, ground_mask, ground_reflectance, landscape_picture
    from benchmark.twin.scene import png_bytes
    from benchmark.twin.video_twin import stack_dn
    from generator.files import write_bytes

    fixed, frames = given, []
    for number, source in enumerate(sources):
        with working(f"{source.name}: reading"):
            own, photograph = source.read(given)
            # The view of the first photograph is that of all.
            fixed = own if number == 0 else fixed
            pixels, sensor = photograph.pixels, fixed.spec.sensor
            fixed.check_size(source.path.name, pixels.shape)
            check_fixed(source.name, (own.camera, own.spec.R_cam), (fixed.camera, fixed.spec.R_cam))
            factor = stack_dn(fixed, photograph.name) if photograph.mean_of_video else 1.0
            black_dn = float(sensor.black_level_dn * factor)
            frames.append(pixels - dark_plane(pixels, fixed.camera, fixed.spec.camera.image_circle_px, black_dn))
    with working("comparing"):
        camera = fixed.camera
        view = view_of(camera, fixed.spec.R_cam)
        mask = ground_mask(frames, view)
        picture = landscape_picture(mask, ground_reflectance(frames, view, mask), camera, fixed.spec.R_cam)
    if not mask.any():
        typer.echo("no ground is found: the picture is empty; --mask names a picture of what is not sky", err=True)
    write_bytes(target, png_bytes(picture))
