"""Commands `skybench import photos` and `skybench import rms`."""

from __future__ import annotations

import shlex
import tempfile
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from benchmark.cli.errors import fail
from benchmark.cli.output import AsJson, print_json
from benchmark.cli.progress import progress_bars, working
from benchmark.errors import BenchmarkError
from generator.errors import GeneratorError

if TYPE_CHECKING:
    from benchmark.importing.write import Import, Imported

app = typer.Typer(
    help="Make datasets of photographs, whose truth is place, time and the stars that follow from them.",
    no_args_is_help=True,
)


class Stamp(StrEnum):
    """What the EXIF time marks."""

    START = "start"
    MIDDLE = "middle"
    END = "end"


Out = Annotated[Path, typer.Option("--out", help="Folder of the dataset; empty or new.")]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace a dataset of other photographs.")]
Name = Annotated[str, typer.Option("--name", help="Name of the dataset; default: that of the folder.")]
Gain = Annotated[
    float | None,
    typer.Option("--gain", min=0, help="Electrons per DN of the files, where known; the stars' electrons follow."),
]


@app.command(
    epilog="Examples: skybench import photos night --site 34.4773 -111.4332 2361 --camera camera.json --out out/night; "
    "skybench import photos holiday --site 52 4.36 0 --camera phone.json --attitude azimuth=120,altitude=45,roll=3 "
    "--time-zone Europe/Berlin.  Then: skybench bench run out/night --solver skybench"
)
def photos(
    folder: Annotated[
        Path,
        typer.Argument(
            metavar="DIR",
            help="Folder of photographs of one camera: FITS (also .bz2, .gz, .fz), PNG, TIFF, JPEG, HEIC, raw files.",
        ),
    ],
    site: Annotated[
        tuple[float, float, float],
        typer.Option("--site", metavar="LAT LON HEIGHT", help="WGS84, degrees, east positive; height in metres."),
    ],
    camera: Annotated[
        Path,
        typer.Option("--camera", help="Lens and attitude, as `celnav calibrate` writes them (or any camera file)."),
    ],
    out: Out = Path("out/photos"),
    attitude: Annotated[
        str | None,
        typer.Option("--attitude", help="As for `celnav solve`, where the camera's file has none or another."),
    ] = None,
    time_zone: Annotated[
        str | None, typer.Option("--time-zone", help="Of EXIF times without one: +02:00, Europe/Berlin.")
    ] = None,
    stamp: Annotated[Stamp, typer.Option("--stamp", help="What EXIF's time marks.")] = Stamp.START,
    exposure_s: Annotated[
        float | None, typer.Option("--exposure-s", min=0, max=86400, help="Exposure of files that do not say.")
    ] = None,
    times: Annotated[
        Path | None, typer.Option("--times", help="CSV with the columns file, utc_mid, exposure_s; comes before tags.")
    ] = None,
    gain: Gain = None,
    name: Name = "",
    overwrite: Overwrite = False,
    as_json: AsJson = False,
) -> None:
    """Make a dataset from photographs taken at one place."""
    from benchmark.importing.given_files import read_given_camera, read_given_times
    from benchmark.importing.photographs import Clock, check_names, photographs_in
    from benchmark.importing.write import Import
    from benchmark.place import Place

    try:
        files = photographs_in(folder)
        clock = Clock(time_zone, stamp.value, exposure_s, {} if times is None else read_given_times(times))
        if times is not None:
            check_names(clock.table, files, times)
        given = Import(
            name or folder.resolve().name,
            files,
            Place(*site),
            read_given_camera(camera, attitude),
            clock,
            gain,
        )
        _make(given, out, overwrite, as_json)
    except (BenchmarkError, GeneratorError) as error:
        fail(error)


@app.command(epilog="Example: skybench import rms CapturedFiles/UK0006_20230421 --camera camera.json --out out/meteors")
def rms(
    folder: Annotated[
        Path,
        typer.Argument(metavar="DIR", help="A night of a Global Meteor Network station: FF files, .config, platepars."),
    ],
    camera: Annotated[
        Path | None,
        typer.Option(
            "--camera",
            help="Lens and attitude, as `celnav calibrate` writes them; default: calibrated on the night's own centroids.",
        ),
    ] = None,
    site: Annotated[
        tuple[float, float, float] | None,
        typer.Option("--site", metavar="LAT LON HEIGHT", help="Where neither .config nor platepars say it."),
    ] = None,
    centroids: Annotated[
        bool,
        typer.Option(
            "--centroids", help="Frames of the centroids that RMS measured, drawn as pictures, in place of FF files."
        ),
    ] = False,
    out: Out = Path("out/meteors"),
    name: Name = "",
    overwrite: Overwrite = False,
    as_json: AsJson = False,
) -> None:
    """Make a dataset from a meteor camera's night."""
    from benchmark.importing.given_files import read_given_camera
    from benchmark.importing.rms import calibrate_night, read_night
    from benchmark.importing.write import Import
    from benchmark.place import Place

    try:
        with tempfile.TemporaryDirectory(prefix="skybench-centroids-") as drawn:
            night = read_night(folder, None if site is None else Place(*site), Path(drawn) if centroids else None)
            if camera is None:
                with working("calibrating the camera on the night's centroids"):
                    told = calibrate_night(folder, night.place)
            else:
                told = read_given_camera(camera)
            _make(Import(name or night.station, night.files, night.place, told), out, overwrite, as_json)
    except (BenchmarkError, GeneratorError) as error:
        fail(error)


def _make(given: Import, out: Path, overwrite: bool, as_json: bool) -> None:
    """Make the dataset and report the result."""
    from benchmark.importing.write import import_photographs

    with progress_bars(hidden=as_json) as bar:
        line = bar.add_task("photographs", total=len(given.photographs))
        done = import_photographs(given, out, overwrite, lambda made: bar.advance(line))
    if as_json:
        print_json({"out": out, "photographs": len(given.photographs), "made": done})
        return
    for made in done:
        typer.echo(_words(made))
    typer.echo(f"{len(given.photographs)} photographs in {out}" + ("" if done else " (made before, whole)"))
    typer.echo(f"next: skybench bench run {shlex.quote(str(out))} --solver skybench")


def _words(made: Imported) -> str:
    if made.stars:
        found = f"attitude by {made.stars} stars, {made.rms_px:.2f} px rms, {made.turned_deg:.3f} deg from the one told"
    else:
        found = "too few stars agree to find its attitude; none is named"
    return f"{made.frame_id}  {made.file}  {made.utc_mid}  {found}"
