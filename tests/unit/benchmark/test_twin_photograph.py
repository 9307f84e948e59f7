"""Photographs: what is read from FITS files, and what is refused."""

import bz2
import gzip
from pathlib import Path

import numpy as np
import pytest
from astropy.io import fits
from photograph_files import write_ff
from typer.testing import CliRunner

from benchmark.cli.app import app
from benchmark.errors import PhotographError
from benchmark.twin.photograph import name_of, read_photograph
from benchmark.twin.scene import read_scene
from celnav.reading import fits_file
from generator.scenario.shipped import find_scenario

SHIPPED = Path(__file__).parents[2] / "data" / "allsky"
HEADER = {
    "DATE-OBS": "2020-01-02T03:04:05.5",
    "EXPTIME": 30.0,
    "OBSLAT": -30.5,
    "OBSLONG": -70.7,
    "OBSALT": 2400.0,
}


def write(path: Path, header: dict[str, object], pixels: np.ndarray | None = None) -> Path:
    """A FITS file, packed by its ending."""
    image = fits.PrimaryHDU(np.arange(12, dtype=np.uint16).reshape(3, 4) if pixels is None else pixels)
    image.header.update(header)
    plain = path.with_name("plain")
    image.writeto(plain, overwrite=True)
    pack = {".bz2": bz2.compress, ".gz": gzip.compress}.get(path.suffix, bytes)
    path.write_bytes(pack(plain.read_bytes()))
    return path


@pytest.mark.parametrize("name", ["Night_7.fits", "Night_7.fits.gz", "Night_7.fits.bz2"])
def test_pixels_place_and_time_are_read(tmp_path: Path, name: str) -> None:
    read = read_photograph(write(tmp_path / name, HEADER))
    assert read.name == "night_7"
    assert read.utc_start == "2020-01-02T03:04:05.5Z"
    assert (read.exposure_s, read.latitude_deg, read.longitude_deg, read.height_m) == (30.0, -30.5, -70.7, 2400.0)
    assert read.pixels.dtype == np.float32
    assert read.pixels[2, 1] == 9


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"DATE-OBS": "yesterday"}, "DATE-OBS"),
        ({"EXPTIME": "long"}, "EXPTIME"),
        ({"EXPTIME": -3.0}, "EXPTIME is -3.0"),
        ({"EXPTIME": 7200.0}, "EXPTIME is 7200"),
        ({"DATE-OBS": "0000-01-01T00:00:00"}, "DATE-OBS is '0000"),
        ({"DATE-OBS": "1905-01-01T00:00:00"}, "leap seconds"),
        ({"TIMESYS": "TT"}, "TIMESYS"),
        ({"OBSLAT": None}, "OBSLAT"),
        ({"OBSLAT": 91.0}, "OBSLAT is 91.0, expected a number from -90 to 90"),
        ({"OBSLONG": "west"}, "OBSLONG is 'west'"),
        ({"OBSALT": 1e9}, "OBSALT"),
    ],
)
def test_a_header_without_time_or_place_is_refused(tmp_path: Path, changed: dict[str, object], words: str) -> None:
    with pytest.raises(PhotographError, match=rf"a\.fits: .*{words}"):
        read_photograph(write(tmp_path / "a.fits", HEADER | changed))


@pytest.mark.parametrize(
    "words",
    [("SITELAT", "SITELONG", "SITEELEV"), ("LAT-OBS", "LONG-OBS", "ALT-OBS"), ("OBSGEO-B", "OBSGEO-L", "OBSGEO-H")],
)
def test_other_words_state_the_place_also_in_minutes_and_seconds(tmp_path: Path, words: tuple[str, str, str]) -> None:
    header = {name: value for name, value in HEADER.items() if not name.startswith("OBS")}
    read = read_photograph(
        write(tmp_path / "a.fits", header | dict(zip(words, ("-30 30 18", "-70:42:00", 2400), strict=True)))
    )
    assert read.latitude_deg == pytest.approx(-30.505)
    assert read.longitude_deg == pytest.approx(-70.7)
    assert read.height_m == 2400.0


def test_a_compressed_image_in_an_extension_is_read(tmp_path: Path) -> None:
    pixels = np.arange(10_000, dtype=np.uint16).reshape(100, 100)
    tiles = fits.CompImageHDU(pixels, fits.Header(HEADER))
    fits.HDUList([fits.PrimaryHDU(), tiles]).writeto(tmp_path / "a.fits.fz")
    read = read_photograph(tmp_path / "a.fits.fz")
    assert (read.pixels == pixels).all()
    assert read.utc_start == "2020-01-02T03:04:05.5Z"


def test_what_is_no_image_is_refused(tmp_path: Path) -> None:
    cube = write(tmp_path / "cube.fits", HEADER, np.zeros((2, 3, 4), np.uint16))
    with pytest.raises(PhotographError, match="two axes"):
        read_photograph(cube)
    nan = write(tmp_path / "nan.fits", HEADER, np.full((3, 4), np.nan, np.float32))
    with pytest.raises(PhotographError, match="no numbers"):
        read_photograph(nan)
    colours = write(tmp_path / "colours.fits", HEADER, np.zeros((3, 5, 4), np.uint16))
    with pytest.raises(PhotographError, match="three colours"):
        read_photograph(colours)
    for name, data in (
        ("text.fits", b"not FITS"),
        ("text.fits.bz2", b"BZh not bz2"),
        ("text.fits.gz", b"\x1f\x8bnot gzip"),
    ):
        (tmp_path / name).write_bytes(data)
        with pytest.raises(PhotographError, match=rf"{name} is (not a FITS file|damaged)"):
            read_photograph(tmp_path / name)
    with pytest.raises(PhotographError, match=r"missing\.fits cannot be read"):
        read_photograph(tmp_path / "missing.fits")


def test_a_file_that_unpacks_to_more_than_the_limit_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    packed = write(tmp_path / "large.fits.bz2", HEADER)
    monkeypatch.setattr(fits_file, "MAX_BYTES", 5000)
    with pytest.raises(PhotographError, match=r"large\.fits\.bz2 is larger than"):
        read_photograph(packed)


def test_photographs_have_names_of_their_own(tmp_path: Path) -> None:
    names = ("2021.03.04-001.fits", "2021.03.04-002.FITS.BZ2", "008.fits.bz2", "a.b.fit", "c.fits.fz")
    assert [name_of(Path(name)) for name in names] == ["2021-03-04-001", "2021-03-04-002", "008", "a-b", "c"]
    paths = [str(tmp_path / night / "001.fits") for night in ("one", "two")]
    told = CliRunner().invoke(app, ["twin", *paths, "--scene", "observatory_allsky", "--out", str(tmp_path / "out")])
    assert told.exit_code == 2
    assert "twin-001" in told.output
    assert not (tmp_path / "out").exists()


def test_a_ground_of_stacks_needs_a_scene_that_makes_them(tmp_path: Path) -> None:
    """The place of a stack is the scene's, and so are the grey values of its dark level."""
    stack = write_ff(tmp_path, "FF_XX0001_20200102_030405_000_0000000.fits", np.zeros((1040, 1392), np.uint8))
    arguments = ["twin", str(stack), "--scene", "observatory_allsky", "--ground", str(tmp_path / "ground.png")]
    told = CliRunner().invoke(app, arguments)
    assert told.exit_code == 2
    assert "needs a scene whose sensor makes video" in told.output.replace("\n", " ")


def test_a_ground_of_nothing_is_said(tmp_path: Path) -> None:
    """The place of a stack is the scene's."""
    camera = read_scene(find_scenario(Path("meteor"))).camera
    even = np.full((camera.height, camera.width), 60, np.uint8)
    stack = write_ff(tmp_path, "FF_XX0001_20200102_030405_000_0000000.fits", even)
    ground = tmp_path / "ground.png"
    told = CliRunner().invoke(app, ["twin", str(stack), "--scene", "meteor", "--ground", str(ground)])
    assert told.exit_code == 0, told.output
    assert "no ground is found" in told.output
    assert ground.is_file()


def test_the_shipped_photographs_are_read() -> None:
    for name in ("005", "008"):
        read = read_photograph(SHIPPED / f"{name}.fits.bz2")
        assert read.pixels.shape == (1040, 1392)
        assert read.exposure_s == 60.0
        assert read.height_m == 2361.0


def test_a_folder_that_cannot_be_written_is_refused_before_any_rendering(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"")
    photograph = str(SHIPPED / "008.fits.bz2")
    for option in (["--out", str(tmp_path / "file" / "out")], ["--ground", str(tmp_path / "file" / "ground.png")]):
        told = CliRunner().invoke(app, ["twin", photograph, "--scene", "observatory_allsky", *option])
        assert told.exit_code == 2
        assert "cannot be written (" in told.output
