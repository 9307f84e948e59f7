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
    from benchmark.place import Place


def add_to(app: typer.Typer) -> None:
    """Add the command."""
    app.command(
        epilog="Examples: skybench twin nights/*.fits.bz2 --scene observatory_allsky --out out/twins; "
        "skybench twin nights/*.fits --scene mine.yaml --ground ground.png; "
        "skybench twin FF_*.fits.gz --scene meteor --mask mask.bmp"
    )(twin)


def twin(
    photographs: Annotated[
        list[Path], typer.Argument(metavar="FITS…", help="Raw photographs of one fixed camera, with place and time.")
    ],
    scene: Annotated[
        Path,
        typer.Option(
            "--scene",
            help="Scenario of the camera: lens, sensor, pointing, ground, cities; or a name that comes with skybench.",
            autocompletion=completion.scenarios,
        ),
    ],
    out: Annotated[Path, typer.Option("--out", help="Folder for scenarios, pictures and tables.")] = Path("out/twins"),
    ground: Annotated[
        Path | None,
        typer.Option("--ground", help="Write what is not sky as a landscape picture (PNG) for the scene, and end."),
    ] = None,
    mask: Annotated[
        Path | None,
        typer.Option("--mask", help="Picture of the photographs' size (PNG, BMP): what is black is not sky."),
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
    """
    from benchmark.place import Place
    from benchmark.twin.photograph import check_names, read_photograph
    from benchmark.twin.render_twin import make_twin
    from benchmark.twin.report import TABLES, numbers_of_twin, tables_of, write_picture, write_report
    from benchmark.twin.scene import read_passing, read_scene
    from benchmark.twin.video_twin import make_video_twin
    from benchmark.twin.view import not_sky_of
    from generator.scenario.shipped import find_scenario

    try:
        camera_scene = read_scene(find_scenario(scene))
        site = camera_scene.spec.site
        place = Place(site.latitude_deg, site.longitude_deg, site.height_m)
        hidden = None if mask is None else not_sky_of(mask, camera_scene.camera)
        trails = {} if passing is None else read_passing(passing)
        if ground is not None:
            _check_writable(ground.parent)
            _write_ground(photographs, scene, place, ground)
            typer.echo(str(ground))
            return
        check_names(photographs)
        _check_writable(out)
        rows = []
        for path in photographs:
            with working(f"{path.name}: twin"):
                photograph = read_photograph(path, place)
                make = make_twin if photograph.stack is None else make_video_twin
                made = make(camera_scene, photograph, out, not_sky=hidden, passing=trails.get(photograph.name, ()))
            if not math.isfinite(made.alignment.rms_px):
                typer.echo(f"{path.name}: too few stars for an attitude; the twin has the scene's", err=True)
            write_picture(made, out)
            rows.append(numbers_of_twin(made))
            write_report(rows, out)
    except (BenchmarkError, GeneratorError) as error:
        fail(error)
    if as_json:
        print_json({"twins": rows, "out": out})
        return
    typer.echo(tables_of(rows), nl=False)
    typer.echo(str(out / TABLES))


def _check_writable(folder: Path) -> None:
    """Refuse a folder that cannot be written to, before minutes of rendering."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise PhotographError(f"{folder}: cannot be written ({error.strerror}); choose another folder") from error


def _write_ground(photographs: list[Path], scene: Path, place: Place, target: Path) -> None:
    import io

    from PIL import Image

    from benchmark.twin.ground import ground_mask, ground_reflectance, landscape_picture
    from benchmark.twin.photograph import read_photograph
    from benchmark.twin.scene import read_scene
    from benchmark.twin.video_twin import stack_dn
    from benchmark.twin.view import dark_plane, view_of
    from generator.files import write_bytes
    from generator.scenario.shipped import find_scenario

    fixed = read_scene(find_scenario(scene))
    camera, circle_px, sensor = fixed.camera, fixed.spec.camera.image_circle_px, fixed.spec.sensor
    frames = []
    for path in photographs:
        with working(f"{path.name}: reading"):
            photograph = read_photograph(path, place)
            pixels = photograph.pixels
            fixed.check_size(path.name, pixels.shape)
            black_dn = sensor.black_level_dn * (1.0 if photograph.stack is None else stack_dn(fixed, photograph.name))
            frames.append(pixels - dark_plane(pixels, camera, circle_px, float(black_dn)))
    with working("comparing"):
        view = view_of(camera, fixed.spec.R_cam)
        mask = ground_mask(frames, view)
        picture = landscape_picture(mask, ground_reflectance(frames, view, mask), camera, fixed.spec.R_cam)
    if not mask.any():
        typer.echo("no ground is found: the picture is empty; --mask names a picture of what is not sky", err=True)
    stream = io.BytesIO()
    Image.fromarray(picture).save(stream, format="PNG", optimize=True)
    write_bytes(target, stream.getvalue())
