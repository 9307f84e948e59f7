"""Photographs of an observatory's all-sky camera, solved with a lens whose axis is elsewhere: no confident wrong place."""

import json
import math
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest

import celnav
from celnav.__main__ import main
from celnav.command.pointing import Pointing

ROOT = Path(__file__).parents[3]
SITE = 34.477, -111.433
UTC = {"005": "2018-08-06T05:17:34.752Z", "008": "2018-09-14T11:53:52.844Z"}
PHOTOGRAPH, ANOTHER = ((str(ROOT / f"tests/data/allsky/{name}.fits.bz2"), "--height-m", "2361") for name in UTC)
CAMERA_FILE = ROOT / "benchmark/real_tasks/allsky-real.camera.json"


@pytest.fixture(scope="module")
def seen():
    folder = ROOT / "tests/data/allsky"
    return {name: celnav.detect(celnav.read_image(folder / f"{name}.fits.bz2")) for name in UTC}


@pytest.fixture(scope="module")
def lens():
    return replace(celnav.Camera.from_json(CAMERA_FILE), uncertainty=None)


@pytest.fixture(scope="module")
def up():
    return np.array(json.loads(CAMERA_FILE.read_text())["attitude"]["R_cam"])[:, 2]


def solved(seen, camera, up, name, calibrate="auto"):
    solver = celnav.SkybenchSolver(celnav.SkybenchConfig(calibrate=calibrate))
    return celnav.solve(seen[name], camera, UTC[name], celnav.Attitude.up(up, tilt_deg=0.05), solver)


def vertical():
    pointing = Pointing.of(np.array(json.loads(CAMERA_FILE.read_text())["attitude"]["R_cam"]))
    return "--attitude", f"altitude={pointing.altitude_deg},roll={pointing.roll_deg},tilt_sigma=0.05"


def off_axis(lens, shift_px, towards_deg):
    turn = math.radians(towards_deg)
    return replace(lens, cx_px=lens.cx_px + shift_px * math.cos(turn), cy_px=lens.cy_px + shift_px * math.sin(turn))


def squared_error(fix):
    """Error of the place over its covariance; 30 is exceeded once in three million right covariances."""
    north = (fix.lat_deg - SITE[0]) * 111.2
    east = (fix.lon_deg - SITE[1]) * 111.2 * math.cos(math.radians(SITE[0]))
    error = np.array([east, north])
    return float(error @ np.linalg.solve(fix.cov_km2, error))


@pytest.mark.parametrize("name", sorted(UTC))
@pytest.mark.parametrize("shift_px", [6, 20, 40])
def test_a_principal_point_that_is_off_is_found_and_doubts_the_vertical(seen, lens, up, name, shift_px):
    """Each 10 px are 190 km; the vertical may be off as much as the lens."""
    found = []
    for towards_deg in (0, 35, 100, 180, 280):
        fix = solved(seen, off_axis(lens, shift_px, towards_deg), up, name)
        found.append(fix.ok)
        assert not fix.ok or squared_error(fix) < 30, (towards_deg, fix.lat_deg, fix.lon_deg)
    assert sum(found) >= 4


@pytest.mark.parametrize("name", sorted(UTC))
def test_stars_of_one_part_of_the_field_put_the_lens_in_doubt(seen, lens, up, name):
    """100 px off, 100 to 300 of 2,244 stars agree with a place 1,900 km away within 1 px or so."""
    doubted = 0
    for towards_deg in (0, 35, 100, 180, 215, 280):
        fix = solved(seen, off_axis(lens, 100, towards_deg), up, name)
        assert not fix.ok or squared_error(fix) < 30, (towards_deg, fix.lat_deg, fix.lon_deg)
        if "lens_doubt_deg" in fix.details:
            assert np.linalg.eigvalsh(fix.cov_km2)[0] > 630**2
            doubted += 1
    assert doubted >= 3


def test_the_command_warns_of_a_lens_in_doubt(lens, tmp_path, capsys):
    camera = tmp_path / "camera.json"
    camera.write_text(json.dumps(asdict(off_axis(lens, 100, 180))))
    assert main(["solve", *PHOTOGRAPH, "--camera", str(camera), *vertical(), "--json"]) == 0
    assert "the stars rule out the camera's lens" in json.loads(capsys.readouterr().out)["warnings"][0]


def test_a_lens_that_is_to_be_trusted_is_trusted_with_a_warning(seen, lens, up, tmp_path, capsys):
    """What a wrong lens does to the place can be studied; the command says that the stars contradict it."""
    centred = replace(lens, cx_px=(lens.width - 1) / 2, cy_px=(lens.height - 1) / 2)
    fix = solved(seen, centred, up, "008", "none")
    assert fix.ok
    assert squared_error(fix) > 1000
    camera = tmp_path / "camera.json"
    for given, warned in ((centred, True), (lens, False)):
        camera.write_text(json.dumps(asdict(given)))
        assert main(["solve", *ANOTHER, "--camera", str(camera), *vertical(), "--calibrate", "none", "--json"]) == 0
        warnings = json.loads(capsys.readouterr().out)["warnings"]
        assert any("about the camera's lens, which --calibrate none trusts" in text for text in warnings) == warned


def test_scatter_that_no_lens_explains_is_no_contradiction(seen, lens, up):
    blurred = seen["005"]
    noise = np.random.default_rng(5).normal(0, 2.0, blurred.uv.shape)
    fix = solved({"005": replace(blurred, uv=blurred.uv + noise)}, lens, up, "005")
    assert fix.ok, fix.message
    assert fix.residual_rms_px > 1.5
    assert squared_error(fix) < 30
