"""Messages name the option, the file and the likely cause of what cannot be used."""

from __future__ import annotations

import json

import numpy as np
import pytest
from astropy.io import fits
from PIL import Image

import celnav
from celnav.__main__ import main
from celnav.command import solving
from celnav.detections import Detections
from celnav.errors import EarthRotationError
from celnav.fix import Fix, Reason
from celnav.sky.astrometry import apparent_enu
from celnav.sky.catalog import load_catalog
from tests.star_images import add_star

UTC = "2021-08-05T05:30:00Z"
DATE = {"DATE-OBS": "2021-08-05T05:30:00", "EXPTIME": 1.0}


@pytest.fixture
def photo(tmp_path):
    """A picture of 30 lights at random."""
    rng, path = np.random.default_rng(1), tmp_path / "sky.png"
    image = rng.normal(15.0, 1.0, (120, 160))
    for u, v in rng.uniform(5, 115, (30, 2)):
        add_star(image, u, v, 400.0, 1.0)
    Image.fromarray(np.clip(np.rint(image), 0, 255).astype(np.uint8)).save(path)
    return str(path)


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (("--sigma", "time=-1"), "--sigma 'time=-1': time = -1.0 must be"),
        (("--sigma", "focal=0.1,centre=1e9"), "centre = 1000000000.0 must be"),
        (("--near", "95,10,50"), "--near '95,10,50': lat_deg = 95.0 must be"),
        (("--near", "45,10,0"), "--near '45,10,0': radius_km = 0.0 must be"),
    ],
)
def test_numbers_out_of_range_name_their_option(photo, capsys, words, text) -> None:
    assert main(["solve", photo, "--utc", UTC, "--focal-length-mm", "24", "--sensor-width-mm", "36", *words]) == 2
    assert text in capsys.readouterr().err


def calibration(tmp_path, *frames, options=()):
    return ["calibrate", *map(str, frames), "--lat", "1", "--lon", "2", "--out", str(tmp_path / "x.json"), *options]


def test_a_calibration_s_mask_of_another_size_is_named(tmp_path, photo, capsys) -> None:
    mask = tmp_path / "mask.png"
    Image.new("L", (80, 60)).save(mask)
    assert main(calibration(tmp_path, photo, options=("--utc", UTC, "--mask", str(mask)))) == 2
    assert f"--mask {mask} has 80 x 60 px, the image 160 x 120" in capsys.readouterr().err


def test_a_calibration_frame_with_infinite_pixels_is_named(tmp_path, capsys) -> None:
    pixels = np.full((120, 160), 100.0, dtype=np.float32)
    paths = [tmp_path / "good.fits", tmp_path / "bad.fits"]
    for path, value in zip(paths, (100.0, np.inf), strict=True):
        pixels[5, 5] = value
        fits.PrimaryHDU(pixels, fits.Header(DATE)).writeto(path)
    assert main(calibration(tmp_path, *paths)) == 2
    assert f"image {paths[1]}:" in capsys.readouterr().err


def test_a_focal_length_in_millimetres_is_suspected() -> None:
    """An equidistant lens of 2.5 mm told as 2.5 px shows the whole sky within 8 px of the middle."""
    uv = np.random.default_rng(2).uniform(0, 900, (200, 2))
    fix = celnav.solve(uv, celnav.Camera("equidistant", 1200, 900, 2.5), UTC, None)
    assert (fix.ok, fix.reason) == (False, "too_few_detections")
    assert "of 200 detections lie outside the camera's image circle: is f_px in pixels?" in fix.message
    few = celnav.solve(uv[:2], celnav.Camera.pinhole(1200, 900, 60), UTC, None)
    assert "2 distinct detections are too few" in few.message


def test_a_hint_that_cannot_be_had_leaves_the_refusal(monkeypatch) -> None:
    refusal = Fix.refusal(Reason.NO_HYPOTHESIS, "no orientation")
    uv = np.random.default_rng(3).uniform(0, 100, (20, 2))
    seen = Detections(uv, np.ones(20), (120, 160), None)
    camera = celnav.Camera.pinhole(160, 120, 60)
    asked = []

    def fails(*words, **options):
        asked.append(options["dut1_s"])
        raise EarthRotationError("no Earth rotation data")

    monkeypatch.setattr(solving, "solve", fails)
    assert solving._with_hint_of_a_mirror(refusal, seen, camera, "2090-08-05T05:30:00Z", None, 0.1) is refusal
    assert asked == [0.1]


def test_dut1_lets_the_command_refuse_a_picture_beyond_the_table(photo, capsys) -> None:
    """Lights at random, in 2090: a refusal in JSON, not an error of the search for a mirror image."""
    lens = ("--focal-length-mm", "24", "--sensor-width-mm", "36")
    assert main(["solve", photo, "--utc", "2090-08-05T05:30:00Z", *lens, "--json", "--dut1-s", "0.1"]) == 1
    answer = json.loads(capsys.readouterr().out)
    assert answer["n_detections"] >= solving.FEWEST_TO_MIRROR
    assert answer["reason"] in solving.NAMES_NO_STAR


def test_planets_are_left_out_of_a_position() -> None:
    camera, R_cam = celnav.Camera.pinhole(1080, 720, 90), np.diag([-1.0, -1.0, 1.0])
    stars = load_catalog()
    stars = stars.take(stars.v_mag < 3.5)
    uv = camera.project(apparent_enu(stars, UTC, 40.0, 10.0, pressure_hpa=1010.0, temperature_c=10.0) @ R_cam.T)
    inside = np.isfinite(uv[:, 0]) & camera.in_frame(np.nan_to_num(uv, nan=-1e9))
    uv, ids = uv[inside], stars.star_id[inside]
    alone = celnav.fix_position(uv, ids, camera, UTC, R_cam)
    fix = celnav.fix_position(np.vstack(([[5.0, 5.0]], uv)), [-1000005, *ids], camera, UTC, R_cam)
    assert (fix.lat_deg, fix.lon_deg) == (alone.lat_deg, alone.lon_deg)
    assert np.array_equal(fix.matches - alone.matches, np.tile([1, 0], (len(uv), 1)))
    assert celnav.fix_position([[5.0, 5.0]], [-1000005], camera, UTC, R_cam).reason == "too_few_detections"


def test_calibrations_take_dut1_beyond_the_table() -> None:
    """Frames of 2090 come as far as the search when UT1-UTC is told."""
    frame = celnav.CalibrationFrame(
        Detections(np.empty((0, 2)), np.empty(0), (120, 160), None), "2090-08-05T05:30:00Z", (160, 120)
    )
    with pytest.raises(EarthRotationError, match="dut1_s"):
        celnav.calibrate([frame], 1.0, 2.0)
    with pytest.raises(celnav.CelnavError, match="no frame shows"):
        celnav.calibrate([frame], 1.0, 2.0, dut1_s=0.1)
