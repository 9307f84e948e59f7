"""`celnav.find_camera`: one picture, of whose lens nothing is known."""

import json
import re

import numpy as np
import pytest
from PIL import Image

import celnav
from celnav import unknown_camera
from celnav.__main__ import main
from celnav.calibrating import blind_start
from celnav.calibrating.blind_start import WORK, Pass
from celnav.calibrating.joint_fit import NothingNamedError
from celnav.errors import CalibrationError
from celnav.sky.utc import parse_utc
from tests.calibration_sky import LAT_DEG, LON_DEG, apparent_stars, perspective_positions
from tests.star_images import add_star

UTC = "2021-08-05T05:30:00Z"
WIDTH, HEIGHT, F_PX = 420, 320, 300.0
WIDTH_DEG = 2 * np.degrees(np.arctan((WIDTH - 1) / 2 / F_PX))
ZENITH_NORTH_UP = np.diag([-1.0, -1.0, 1.0])


def picture(sigma_px=1.0, hot=0):
    """The sky over a pinhole of 70 deg in the zenith, 8 bits; `hot` lights are as sharp as interpolated hot pixels are."""
    rng = np.random.default_rng(7)
    dirs, v_mag = apparent_stars(UTC, 5.0)
    dirs, v_mag = dirs[dirs[:, 2] > 0.5], v_mag[dirs[:, 2] > 0.5]
    image = rng.normal(20.0, 1.0, (HEIGHT, WIDTH))
    for (u, v), mag in zip(
        perspective_positions(dirs, ZENITH_NORTH_UP, (F_PX, (WIDTH - 1) / 2, (HEIGHT - 1) / 2)), v_mag, strict=True
    ):
        add_star(image, u, v, 250 * sigma_px**2 * 10 ** (-0.4 * (mag - 4.5)), sigma_px)
    for u, v, light in zip(
        rng.uniform(0, WIDTH, hot), rng.uniform(0, HEIGHT, hot), rng.uniform(100, 900, hot), strict=True
    ):
        add_star(image, u, v, light, 0.55)
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def short_search(monkeypatch):
    """Only focal lengths near the true one."""
    for module in (blind_start, unknown_camera):
        monkeypatch.setattr(module, "PASSES", (Pass(0.35, 0.8, 1.1, 1.12, WORK, 1),))


@pytest.fixture(scope="module")
def found():
    return celnav.find_camera(picture(), UTC)


def test_field_and_orientation_from_one_picture(found) -> None:
    assert found.stars > 100
    assert found.scatter_px < 0.3
    across = found.camera.to_rays([[0.0, HEIGHT / 2], [WIDTH - 1.0, HEIGHT / 2]])
    assert np.degrees(np.arccos(across[0] @ across[1])) == pytest.approx(WIDTH_DEG, abs=0.1)
    free = celnav.SkybenchSolver(celnav.SkybenchConfig(calibrate="full"))
    fix = celnav.solve(found.detections, found.camera, UTC, ZENITH_NORTH_UP, free)
    assert (fix.lat_deg, fix.lon_deg) == pytest.approx((LAT_DEG, LON_DEG), abs=0.05)
    assert np.allclose(found.R_icrs_to_camera, fix.R_icrs_to_camera, atol=1e-3)


def test_command_finds_the_camera_where_tags_say_nothing(found, tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.setattr(unknown_camera, "find_camera", lambda image, utc, mask: found)
    path = tmp_path / "sky.png"
    Image.new("L", (WIDTH, HEIGHT)).save(path)
    assert main(["solve", str(path), "--utc", UTC, "--json"]) == 1
    answer = json.loads(capsys.readouterr().out)
    assert answer["reason"] == "vertical_required"
    assert np.allclose(answer["R_icrs_to_camera"], found.R_icrs_to_camera, atol=1e-3)
    assert answer["field_deg"][0] == pytest.approx(WIDTH_DEG, abs=0.3)
    assert "found from" in answer["assumed"][0]
    assert main(["solve", str(path), "--utc", UTC, "--camera", "unknown", "--attitude", "zenith-north-up"]) == 0
    latitude = re.search(r"latitude    ([0-9.]+) N", capsys.readouterr().out)
    assert latitude is not None
    assert float(latitude[1]) == pytest.approx(LAT_DEG, abs=0.05)


@pytest.mark.parametrize(
    "error", [NothingNamedError("no field explains the lights"), CalibrationError("the picture is mirrored")]
)
def test_a_picture_without_an_identification_is_a_refusal(tmp_path, monkeypatch, capsys, error) -> None:
    def fails(image, utc, mask):
        raise error

    monkeypatch.setattr(unknown_camera, "find_camera", fails)
    path, plot = tmp_path / "sky.png", tmp_path / "plot.png"
    Image.fromarray(picture()).save(path)
    words = ["solve", str(path), "--utc", UTC, "--camera", "unknown", "--attitude", "zenith-north-up"]
    assert main([*words, "--json", "--matches", "--plot", str(plot)]) == 1
    answer = json.loads(capsys.readouterr().out)
    assert (answer["ok"], answer["reason"], answer["message"]) == (False, "no_hypothesis", str(error))
    assert answer["camera"] is answer["field_deg"] is None
    assert answer["n_detections"] > 50
    assert plot.exists()
    assert main(words) == 1
    said = capsys.readouterr().out
    assert str(error) in said
    assert "not found from the stars" in said


def test_the_earth_s_rotation_is_not_needed_for_the_whole_sky() -> None:
    """In 2090, beyond the table of UT1-UTC; 70 years move no bright star but by its proper motion."""
    then, now = (unknown_camera.whole_sky(parse_utc(f"{year}-08-05T05:30:00Z"), 2.0) for year in (2090, 2021))
    assert np.abs(then.dirs - now.dirs).max() < 2e-3


def test_hot_pixels_that_outnumber_wider_stars(monkeypatch) -> None:
    image = picture(1.8, hot=600)
    short_search(monkeypatch)
    found = celnav.find_camera(image, UTC)
    fix = celnav.solve(found.detections, found.camera, UTC, ZENITH_NORTH_UP)
    assert (fix.lat_deg, fix.lon_deg) == pytest.approx((LAT_DEG, LON_DEG), abs=0.3)
    monkeypatch.setattr(unknown_camera, "WIDER_SIGMAS_PX", ())
    monkeypatch.setattr(unknown_camera, "is_mirrored", lambda frame, sky: False)
    with pytest.raises(NothingNamedError, match="no field, lens and orientation"):
        celnav.find_camera(image, UTC)


def test_mirrored_picture_is_named(monkeypatch) -> None:
    short_search(monkeypatch)
    monkeypatch.setattr(unknown_camera, "WIDER_SIGMAS_PX", ())
    with pytest.raises(CalibrationError, match="mirrored"):
        celnav.find_camera(picture()[::-1], UTC)
