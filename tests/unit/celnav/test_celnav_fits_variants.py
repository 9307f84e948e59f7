"""FITS images as other programs write them: headers of many kinds, colours, compressed tiles, pixels without a value."""

from __future__ import annotations

import bz2
import gzip
from datetime import UTC, datetime

import numpy as np
import pytest
from astropy.io import fits

import celnav
from celnav.__main__ import main
from celnav.command.exif import read_tags
from celnav.command.exposure_time import exposure_time
from celnav.errors import ImageError, TimeError
from celnav.reading import fits_file
from celnav.reading.fits_file import read_fits
from celnav.reading.image_file import read_mask, without_blanks
from celnav.sky.fits_times import exposure_in

PIXELS = np.arange(600, dtype=np.uint16).reshape(20, 30) + 40000
START = datetime(2018, 9, 14, 11, 53, 22, 844000, tzinfo=UTC)


@pytest.mark.parametrize(
    "header",
    [
        {"DATE-OBS": "2018-09-14T11:53:22.844Z"},
        {"DATE-OBS": "2018-09-14T13:53:22.844+02:00"},
        {"DATE-OBS": "2018-09-14 11:53:22.844"},
        {"DATE-OBS": "2018-09-14", "TIME-OBS": "11:53:22.844"},
        {"DATE-OBS": "2018/09/14", "UT": "11:53:22.844"},
        {"DATE-OBS": "2018-09-14T11:53:22.844", "TIMESYS": "UTC"},
        {"DATE-OBS": "2018-09-14T11:53:22.844", "TIMESYS": "UTC(NIST)"},
        {
            "MJD-OBS": 58375.0
            + (START - START.replace(hour=0, minute=0, second=0, microsecond=0)).total_seconds() / 86400
        },
        {"DATE-BEG": "2018-09-14T11:53:22.844", "DATE-OBS": "2018-09-14T00:00:00"},
    ],
)
@pytest.mark.parametrize("length", [{"EXPTIME": 60.0}, {"EXPTIME": "60"}, {"EXPTIME": "long", "EXPOSURE": 60}])
def test_the_time_of_a_header_is_read(header, length):
    found = exposure_in(header | length, {}, "a.fits")
    assert abs((found.begun - START).total_seconds()) < 1e-5
    assert (found.middle - found.begun).total_seconds() == 30.0
    assert found.lacks == ""


@pytest.mark.parametrize(
    ("header", "words"),
    [
        ({}, "no DATE-OBS"),
        ({"DATE-OBS": "2018-09-14"}, "without a time of day"),
        ({"DATE-OBS": "20180914"}, "without a time of day"),
        ({"DATE-OBS": "2018-W37-5"}, "without a time of day"),
        ({"DATE-OBS": "14/09/18", "UT": "11:53:22"}, "DATE-OBS is '14/09/18'"),
        ({"DATE-OBS": "9999-12-31T23:59:59"}, "9999"),
        ({"DATE-OBS": "2018-09-14T11:53:22", "TIMESYS": "TAI"}, "'TAI' \\(TIMESYS\\)"),
        ({"DATE-OBS": "2018-09-14T11:53:22", "TIMESYS": "UT1"}, "'UT1' \\(TIMESYS\\)"),
        ({"DATE-OBS": "2018-09-14T11:53:22", "EXPTIME": -1.0}, "EXPTIME is -1.0"),
        ({"DATE-OBS": "2018-09-14T11:53:22", "EXPTIME": "nan"}, "EXPTIME is 'nan'"),
        ({"MJD-OBS": 1e300}, "MJD-OBS is 1e\\+300"),
        ({"MJD-OBS": "nan"}, "MJD-OBS is 'nan'"),
    ],
)
def test_what_a_header_lacks_is_said(tmp_path, capsys, header, words):
    path = tmp_path / "frame.fits"
    fits.PrimaryHDU(PIXELS, fits.Header(header)).writeto(path)
    found = read_fits(path).exposure
    assert found.middle is None
    with pytest.raises(TimeError, match=words):
        exposure_time(read_tags(path), None, None)
    assert main(["calibrate", str(path), "--lat", "1", "--lon", "2", "--out", str(tmp_path / "x.json")]) == 2
    assert found.lacks in capsys.readouterr().err


@pytest.mark.parametrize(
    "options",
    [("--time-zone", "Europe/Berlin"), ("--exif-time-is", "end"), ("--time-zone", "Z", "--exif-time-is", "end")],
)
@pytest.mark.parametrize("command", ["solve", "calibrate"])
def test_options_for_photographs_clocks_do_not_move_the_time_of_a_header(tmp_path, capsys, command, options):
    path = tmp_path / "frame.fits"
    header = fits.Header({"DATE-OBS": "2018-09-14T11:53:22.844", "EXPTIME": 60.0})
    fits.PrimaryHDU(PIXELS, header).writeto(path)
    place = ("--lat", "1", "--lon", "2", "--out", str(tmp_path / "x.json")) if command == "calibrate" else ()
    assert main([command, str(path), *place, *options]) == 2
    said = capsys.readouterr().err
    assert all(word in said for word in (*options[::2], str(path), "UTC", "DATE-OBS", "leave"))


def test_a_time_scale_of_the_first_header_holds_for_the_image():
    found = exposure_in({"DATE-OBS": "2018-09-14T11:53:22.844", "EXPTIME": 1.0}, {"TIMESYS": "TAI"}, "a.fits")
    assert "'TAI' (TIMESYS)" in found.lacks


def test_a_start_without_a_length_is_named_as_such(tmp_path):
    path = tmp_path / "frame.fits"
    fits.PrimaryHDU(PIXELS, fits.Header({"DATE-OBS": "2018-09-14T11:53:22.844"})).writeto(path)
    assert read_fits(path).exposure.lacks == "its header has no EXPTIME"
    found = exposure_time(read_tags(path), None, None)
    assert found.utc == "2018-09-14T11:53:22.844Z"
    assert "FITS header" in found.assumed[0]
    assert "no stated length" in found.assumed[1]


def test_an_exposure_ends_where_its_header_says_so(tmp_path):
    path = tmp_path / "frame.fits"
    ends = {"DATE-OBS": "2018-09-14T11:53:22.844", "DATE-END": "2018-09-14T11:54:22.844"}
    fits.PrimaryHDU(PIXELS, fits.Header(ends)).writeto(path)
    assert read_fits(path).exposure.length_s == 60.0
    assert exposure_time(read_tags(path), None, None).utc == "2018-09-14T11:53:52.844Z"
    assert exposure_in(ends | {"DATE-END": "2018-09-14T11:52:00"}, {}, "a.fits").middle is None


@pytest.mark.parametrize(("order", "turned"), [("BOTTOM-UP", True), ("bottom-up ", True), ("TOP-DOWN", False)])
def test_rows_that_are_said_to_run_upwards_are_turned_over(tmp_path, order, turned):
    path = tmp_path / "frame.fits"
    for image in (PIXELS, np.stack([PIXELS, PIXELS + 1, PIXELS + 2])):
        fits.PrimaryHDU(image, fits.Header({"ROWORDER": order})).writeto(path, overwrite=True)
        found = celnav.read_image(path)
        first = found if found.ndim == 2 else found[:, :, 0]
        assert (first == (PIXELS[::-1] if turned else PIXELS)).all()


@pytest.mark.parametrize("order", [(3, 20, 30), (20, 30, 3), (1, 3, 20, 30)])
def test_three_planes_are_colours(tmp_path, order):
    colours = np.stack([PIXELS, PIXELS + 1, PIXELS + 2])
    cube = colours.reshape(order) if order[-1] != 3 else np.moveaxis(colours, 0, 2)
    fits.PrimaryHDU(cube).writeto(tmp_path / "colours.fits")
    image = celnav.read_image(tmp_path / "colours.fits")
    assert image.shape == (20, 30, 3)
    assert (image[:, :, 2] == PIXELS + 2).all()
    tags = read_tags(tmp_path / "colours.fits")
    assert (tags.width, tags.height) == (30, 20)


def test_one_plane_and_compressed_tiles_are_an_image(tmp_path):
    fits.PrimaryHDU(PIXELS[None]).writeto(tmp_path / "plane.fits")
    fits.HDUList([fits.PrimaryHDU(), fits.CompImageHDU(PIXELS)]).writeto(tmp_path / "tiles.fits.fz")
    for name in ("plane.fits", "tiles.fits.fz"):
        assert (celnav.read_image(tmp_path / name) == PIXELS).all()


def test_pixels_without_a_value_are_hidden():
    image = PIXELS.astype(np.float32)
    image[3, 4] = np.nan
    filled, hidden = without_blanks(image, None)
    assert np.isfinite(filled).all()
    assert np.argwhere(hidden).tolist() == [[3, 4]]
    mask = np.zeros(PIXELS.shape, dtype=bool)
    mask[0, 0] = True
    assert np.argwhere(without_blanks(image, mask)[1]).tolist() == [[0, 0], [3, 4]]
    assert without_blanks(PIXELS, None) == (PIXELS, None)


def test_a_mask_of_another_size_or_of_everything_is_refused(tmp_path):
    from PIL import Image

    path = str(tmp_path / "mask.png")
    Image.fromarray(np.full((20, 30), 255, np.uint8)).save(path)
    with pytest.raises(ImageError, match="hides every pixel"):
        read_mask(path)
    Image.fromarray(np.zeros((20, 30), np.uint8)).save(path)
    assert not read_mask(path, PIXELS.shape).any()
    with pytest.raises(ImageError, match="30 x 20 px, the image 30 x 21"):
        read_mask(path, (21, 30))


@pytest.mark.parametrize("compress", [bz2.compress, gzip.compress])
@pytest.mark.parametrize("rest", [b"", b"\0\0 what follows the last stream"])
def test_a_file_in_several_streams_is_read_whole(tmp_path, compress, rest):
    """As pbzip2, bgzip and pigz -i write it; streams may be empty."""
    plain = tmp_path / "a.fits"
    fits.PrimaryHDU(PIXELS).writeto(plain)
    data = plain.read_bytes()
    parts = [data[:1000], b"", data[1000:1001], data[1001:]]
    packed = tmp_path / "b.fits"
    packed.write_bytes(b"".join(map(compress, parts)) + rest)
    np.testing.assert_array_equal(read_fits(packed).pixels, read_fits(plain).pixels)
    packed.write_bytes(b"".join(map(compress, parts))[:-6])
    with pytest.raises(ImageError, match=r"cut short|damaged"):
        read_fits(packed)


def test_a_bomb_in_many_streams_is_not_unpacked(tmp_path, monkeypatch):
    monkeypatch.setattr(fits_file, "MAX_BYTES", 5_000_000)
    (tmp_path / "a.fits").write_bytes(30 * bz2.compress(bytes(1_000_000)))
    with pytest.raises(ImageError, match="is larger than 5 MB unpacked"):
        read_fits(tmp_path / "a.fits")


@pytest.mark.parametrize("compress", [bz2.compress, gzip.compress])
def test_a_file_of_very_many_empty_streams_is_refused(tmp_path, compress):
    """Each takes time and none adds a byte, so that the limit of the unpacked size does not stop them."""
    (tmp_path / "a.fits").write_bytes(20_001 * compress(b""))
    with pytest.raises(ImageError, match="more than 20000 compressed streams"):
        read_fits(tmp_path / "a.fits")


def test_solve_unpacks_a_fits_file_once(tmp_path, monkeypatch, capsys):
    path, unpacked, unpack = tmp_path / "a.fits", [], fits_file.unpacked_bytes
    header = fits.Header({"DATE-OBS": "2018-09-14T11:53:22.844", "EXPTIME": 60.0})
    fits.PrimaryHDU(PIXELS, header).writeto(path)
    camera = tmp_path / "camera.json"
    camera.write_text(celnav.Camera("pinhole", 30, 20, 40.0).to_json(), encoding="utf-8")
    monkeypatch.setattr(fits_file, "unpacked_bytes", lambda name: unpacked.append(name) or unpack(name))
    main(["solve", str(path), "--camera", str(camera), "--attitude", "zenith", "--json"])
    assert "2018-09-14T11:53:52.844Z" in capsys.readouterr().out
    assert len(unpacked) == 1


def test_a_day_takes_its_time_from_the_julian_date_of_the_same_day():
    day = {"DATE-OBS": "2018-09-14", "EXPTIME": 10.0}
    found = exposure_in(day | {"MJD-OBS": 58375.4954}, {}, "a.fits")
    assert (found.lacks, f"{found.begun:%Y-%m-%dT%H:%M}") == ("", "2018-09-14T11:53")
    assert "without a time of day" in exposure_in(day | {"MJD-OBS": 58376.4954}, {}, "a.fits").lacks
