"""What photographs' pixels become: numbers and electrons of a frame, saturation, colours, and the mosaics of raw files."""

import json
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from photograph_files import (
    CAMERA,
    EXPOSURE_S,
    PLACE,
    R_MOUNT,
    UTC_MID,
    WANDER_DEG,
    standin,
    write_dng,
    write_fits,
    write_jpeg,
)
from PIL import Image

import celnav
from benchmark.errors import PhotographError
from benchmark.importing import raw_file
from benchmark.importing.photographs import (
    Clock,
    as_dn,
    full_pixels,
    read_photograph,
)
from benchmark.importing.told import told_by
from benchmark.importing.write import Import, import_photographs
from celnav.command.exif import read_raw_tags

OSLO = Clock(time_zone="Europe/Oslo")
TOLD = told_by(CAMERA, celnav.Attitude.with_sigma(R_MOUNT, tilt_deg=0.05, heading_deg=0.05))


@pytest.mark.parametrize(
    ("values", "dn", "scale", "offset"),
    [
        (np.array([[0, 255]], np.uint8), [0, 255], 1.0, 0.0),
        (np.array([[[1, 2, 3], [250, 250, 250]]], np.uint8), [6, 750], 1.0, 0.0),
        (np.array([[0.0, 0.5]]), [0, 32768], 65535.0, 0.0),
        (np.array([[-2.5, 1000.0]]), [0, 1003], 1.0, 3.0),
        (np.array([[-2.0, 100.0]]), [0, 102], 1.0, 2.0),
        # Stretched and calibrated pictures leave 0 to 1 by a little, and colours of 0 to 1 reach 3.
        (np.array([[-0.125, 0.5, 1.25]]), [0, 20480, 45056], 32768.0, 4096.0),
        (np.array([[[0.5, 0.5, 0.25], [1.0, 1.0, 1.0]]], np.float32), [20480, 49152], 16384.0, 0.0),
        (np.array([[0.5, 255.5]]), [128, 65408], 256.0, 0.0),
        (np.array([[5000.25, 5001.0]]), [40002, 40008], 8.0, 0.0),
    ],
)
def test_values_become_dn(values: np.ndarray, dn: list[int], scale: float, offset: float) -> None:
    pixels, bits, found_scale, found_offset = as_dn(values, Path("a.fits"))
    assert pixels.dtype == np.uint16
    assert pixels.ravel().tolist() == dn
    assert (found_scale, found_offset) == (scale, offset)
    assert max(dn) < 2**bits


@pytest.mark.parametrize(
    ("values", "dn", "told"),
    [
        (np.full((1, 2, 3), 60000, np.uint16), 45000, (16, 0.25, 0.0)),
        (np.full((1, 2, 3), 0.25, np.float32), 49151, (16, 65535.0, 0.0)),
        (np.full((1, 2, 3), -2, np.int16), 0, (8, 1.0, 6.0)),
        (np.array([[100.0, 131000.0]]), [50, 65500], (16, 0.5, 0.0)),
        (np.array([[-10.0, 131000.0]]), [0, 65505], (16, 0.5, 5.0)),
    ],
)
def test_colours_and_more_than_16_bits_are_fitted_into_a_frame(values: np.ndarray, dn: object, told: tuple) -> None:
    pixels, *stated = as_dn(values, Path("a.fits"))
    assert pixels.dtype == np.uint16
    assert (pixels == dn).all()
    assert tuple(stated) == told


@pytest.mark.parametrize(
    ("values", "words"),
    [
        (np.array([[0.0, np.nan]]), "no numbers"),
        (np.array([[0.0, 2e6]]), "at most 1.04856e\\+06"),
        (np.zeros((1, 16385), np.uint8), "16384"),
    ],
)
def test_values_that_fit_no_frame_are_refused(values: np.ndarray, words: str) -> None:
    with pytest.raises(PhotographError, match=words):
        as_dn(values, Path("a.fits"))


def test_stars_of_full_pixels_are_saturated(tmp_path: Path) -> None:
    """Colours are added, so that the sum of three full ones is far below the largest number of its bits."""
    write_jpeg(tmp_path / "a.jpg", "2020:01:15 21:00:00")
    import_photographs(Import("night", [tmp_path / "a.jpg"], PLACE, TOLD, OSLO), tmp_path / "out")
    stars = pq.read_table(tmp_path / "out/stars.parquet").to_pandas()
    known = stars[stars["snr"].notna()]
    assert known[known["v_mag"] < 2.5]["saturated"].all()
    # Some stand next to a bright one.
    assert known[known["v_mag"] > 6]["saturated"].mean() < 0.05
    one_colour = np.zeros((2, 3, 3), np.uint8)
    one_colour[1, 2] = 10, 255, 20
    assert np.argwhere(full_pixels(one_colour)).tolist() == [[1, 2]]
    assert np.argwhere(full_pixels(np.array([[0.5, 1.0]]))).tolist() == [[0, 1]]


def test_electrons_follow_from_the_files_numbers(tmp_path: Path) -> None:
    for name, factor in (("plain", 1), ("halved", 8)):
        path = write_fits(tmp_path / f"{name}.fits", standin().astype(np.int32) * factor)
        given = Import(name, [path], PLACE, TOLD, gain_e_per_dn=2.0 / factor)
        import_photographs(given, tmp_path / name)
    plain, halved = (pq.read_table(tmp_path / name / "stars.parquet").to_pandas() for name in ("plain", "halved"))
    record = json.loads((tmp_path / "halved/frame-00000.json").read_text())
    assert record["sensor"]["gain_e_per_dn"] == 0.25 / record["photograph"]["scale"]
    assert record["photograph"]["scale"] < 1
    bright = plain["v_mag"] < 4
    np.testing.assert_allclose(halved["electrons_e"][bright], plain["electrons_e"][bright], rtol=1e-3)


def test_the_sky_of_a_mosaic_may_be_coloured(tmp_path: Path) -> None:
    picture = standin().astype(np.float64)
    picture[0::2, 0::2] *= 0.5
    picture[1::2, 1::2] *= 0.4
    write_dng(tmp_path / "a.dng", np.clip(picture, 0, 4095).astype(np.uint16))
    clock = Clock(table={"a.dng": (UTC_MID, EXPOSURE_S)})
    (made,) = import_photographs(Import("raw", [tmp_path / "a.dng"], PLACE, TOLD, clock), tmp_path / "out")
    assert made.stars > 50
    assert made.turned_deg == pytest.approx(WANDER_DEG, abs=0.02)


def test_a_raw_file_gives_its_mosaic(tmp_path: Path) -> None:
    mosaic = np.random.default_rng(3).integers(0, 4000, (64, 96)).astype(np.uint16)
    write_dng(tmp_path / "a.dng", mosaic)
    clock = Clock(table={"a.dng": (UTC_MID, EXPOSURE_S)})
    read = read_photograph(tmp_path / "a.dng", clock)
    assert np.array_equal(read.pixels, mosaic)
    assert (read.bits, read.bayer_pattern, read.exposure_s) == (12, "RGGB", EXPOSURE_S)
    (tmp_path / "b.dng").write_bytes((tmp_path / "a.dng").read_bytes()[:300])
    with pytest.raises(PhotographError, match=r"b\.dng"):
        read_photograph(tmp_path / "b.dng", clock)


def test_raw_files_say_when_they_were_taken_whichever_way_they_were_held(tmp_path: Path) -> None:
    """As telephones write DNG, the mosaic first, and as others do, a preview first; with the tags of TIFF/EP and of Exif."""
    mosaic = np.random.default_rng(3).integers(0, 4000, (64, 96)).astype(np.uint16)
    tags = [(274, "H", 1, 8, True), (0x9003, "s", 20, "2020:01:15 21:00:00", True), (0x829A, "2I", 1, (10, 1), True)]
    read = read_photograph(write_dng(tmp_path / "a.dng", mosaic, tags), OSLO)
    assert (read.utc_mid, read.exposure_s, read.pixels.shape) == (UTC_MID, 10.0, (64, 96))
    exif = Image.Exif()
    exif[274] = 8
    exif.get_ifd(0x8769).update({0x9003: "2020:01:15 21:00:00", 0x829A: 10.0})
    Image.new("RGB", (16, 12)).save(tmp_path / "b.nef", format="TIFF", exif=exif.tobytes())
    found = read_raw_tags(tmp_path / "b.nef")
    assert (str(found.taken), found.exposure_s, found.orientation) == ("2020-01-15 21:00:00", 10.0, 1)
    (tmp_path / "c.raf").write_bytes(b"FUJIFILMCCD-RAW " * 9)
    assert read_raw_tags(tmp_path / "c.raf").taken is None


def test_a_large_raw_file_is_refused_before_it_is_decoded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_dng(tmp_path / "a.dng", np.zeros((64, 96), np.uint16))
    monkeypatch.setattr(raw_file, "MOST_PIXELS", 64 * 96 - 1)
    with pytest.raises(PhotographError, match="96 x 64 px"):
        raw_file.read_raw(tmp_path / "a.dng")
