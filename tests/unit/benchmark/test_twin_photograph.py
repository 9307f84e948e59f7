"""Photographs: what is read from FITS files, and what is refused."""

import bz2
import gzip
from pathlib import Path

import numpy as np
import pytest
from astropy.io import fits

from benchmark.errors import PhotographError
from benchmark.twin import photograph
from benchmark.twin.photograph import read_photograph

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
        ({"OBSLAT": None}, "OBSLAT"),
    ],
)
def test_a_header_without_time_or_place_is_refused(tmp_path: Path, changed: dict[str, object], words: str) -> None:
    with pytest.raises(PhotographError, match=words):
        read_photograph(write(tmp_path / "a.fits", HEADER | changed))


def test_what_is_no_image_is_refused(tmp_path: Path) -> None:
    cube = write(tmp_path / "cube.fits", HEADER, np.zeros((2, 3, 4), np.uint16))
    with pytest.raises(PhotographError, match="two axes"):
        read_photograph(cube)
    nan = write(tmp_path / "nan.fits", HEADER, np.full((3, 4), np.nan, np.float32))
    with pytest.raises(PhotographError, match="no numbers"):
        read_photograph(nan)
    for name, data in (("text.fits", b"not FITS"), ("text.fits.bz2", b"not bz2"), ("text.fits.gz", b"not gzip")):
        (tmp_path / name).write_bytes(data)
        with pytest.raises(PhotographError, match="cannot be read"):
            read_photograph(tmp_path / name)
    with pytest.raises(PhotographError, match="cannot be read"):
        read_photograph(tmp_path / "missing.fits")


def test_a_file_that_unpacks_to_more_than_the_limit_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    packed = write(tmp_path / "large.fits.bz2", HEADER)
    monkeypatch.setattr(photograph, "LARGEST_BYTES", 5000)
    with pytest.raises(PhotographError, match="larger than 5000 bytes"):
        read_photograph(packed)


def test_the_shipped_photographs_are_read() -> None:
    for name in ("005", "008"):
        read = read_photograph(SHIPPED / f"{name}.fits.bz2")
        assert read.pixels.shape == (1040, 1392)
        assert read.exposure_s == 60.0
        assert read.height_m == 2361.0
