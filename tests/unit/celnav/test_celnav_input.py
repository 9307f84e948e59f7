"""Input: what is read, and what is refused with a typed error of one line."""

import json
from datetime import UTC, datetime

import numpy as np
import pytest
from PIL import Image

import celnav
from celnav import errors
from celnav.reading.image_file import read_image
from celnav.sky.earth_rotation import default_table, earth_orientation
from celnav.sky.utc import parse_utc

CAMERA = celnav.Camera.pinhole(width=1080, height=720, hfov_deg=120)
R_CAM = np.diag([-1.0, -1.0, 1.0])
UTC_OK = "2020-01-01T00:00:00Z"


def refused(error, text, call, *args, **kwargs):
    with pytest.raises(error, match=text) as caught:
        call(*args, **kwargs)
    assert isinstance(caught.value, errors.CelnavError)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "mjd_day", "second"),
    [
        ("2020-01-01T00:00:00Z", 58849, 0.0),
        ("2020-01-01T12:30:15.25Z", 58849, 45015.25),
        ("2020-01-01 00:00:00Z", 58849, 0.0),
        ("2020-01-01T01:00:00+02:00", 58848, 82800.0),
        ("2016-12-31T23:59:60.5Z", 57753, 86400.5),
        ("1858-11-17T00:00:00Z", None, None),
    ],
)
def test_utc(text, mjd_day, second):
    if mjd_day is None:
        refused(errors.TimeError, "1972", parse_utc, text)
        return
    utc = parse_utc(text)
    assert (utc.mjd_day, utc.second_of_day_s) == (mjd_day, pytest.approx(second))


@pytest.mark.parametrize(
    "text",
    ["2020-01-01T00:00:00", "2020-13-01T00:00:00Z", "2020-02-30T00:00:00Z", "2020-01-01T24:00:00Z", "yesterday", "",
     "2019-12-31T23:59:60Z", "2020-01-01T00:00:00+99:00", "2020-01-01", "2020-01-01T00:00:00ZZ"],
)  # fmt: skip
def test_utc_refused(text):
    refused(errors.TimeError, "UTC", parse_utc, text)


def test_utc_of_datetimes():
    assert parse_utc(datetime(2020, 1, 1, 6, tzinfo=UTC)) == parse_utc("2020-01-01T06:00:00Z")
    refused(errors.TimeError, "zone", parse_utc, datetime(2020, 1, 1))
    refused(errors.TimeError, "string", parse_utc, 2020)


def test_tt_minus_utc_in_2020_is_69_184_s():
    day, fraction = parse_utc(UTC_OK).tt
    assert (day + fraction - 2458849.5) * 86400 == pytest.approx(69.184, abs=1e-4)


def test_ut1_across_a_leap_second_is_continuous():
    """UT1-UTC jumps by one second at the end of 2016 (IERS: -0.4084 s before, +0.5915 s after); UT1 does not."""
    before = earth_orientation(parse_utc("2016-12-31T23:59:59.999Z"))
    within = earth_orientation(parse_utc("2016-12-31T23:59:60.999Z"))
    after = earth_orientation(parse_utc("2017-01-01T00:00:00Z"))
    assert before.dut1_s == pytest.approx(-0.4084, abs=2e-3)
    assert within.dut1_s == pytest.approx(before.dut1_s, abs=1e-4)
    assert after.dut1_s == pytest.approx(before.dut1_s + 1, abs=1e-4)


def test_earth_rotation_outside_the_table():
    refused(errors.EarthRotationError, "dut1_s", earth_orientation, parse_utc("2090-01-01T00:00:00Z"))
    assert earth_orientation(parse_utc("2090-01-01T00:00:00Z"), 0.25).dut1_s == 0.25
    refused(errors.EarthRotationError, "impossible", earth_orientation, parse_utc(UTC_OK), 7.0)
    assert np.all(np.diff(default_table().mjd) == 1)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"model": "panini"}, "panini"), ({"width": 0}, "width"), ({"width": 10.5}, "width"), ({"f_px": -1.0}, "f_px"),
        ({"f_px": float("nan")}, "f_px"), ({"f_px": "100"}, "f_px"), ({"k": (0.1,)}, "distortion"),
        ({"cx_px": float("inf")}, "cx_px"),
    ],
)  # fmt: skip
def test_camera_refused(changes, text):
    values = {"model": "pinhole", "width": 100, "height": 80, "f_px": 90.0} | changes
    refused(errors.CameraError, text, lambda: celnav.Camera(**values))


def test_camera_files(tmp_path):
    bare = {"model": "pinhole", "width": 100, "height": 80, "f_px": 90.0, "fy_px": 91.0, "k": [], "p": []}
    path = tmp_path / "camera.json"
    path.write_text(json.dumps(bare))
    camera = celnav.Camera.from_json(path)
    assert (camera.cx_px, camera.cy_px, camera.fy_px) == (49.5, 39.5, 91.0)
    path.write_text(json.dumps({"camera": bare, "frame_id": "frame-00000"}))
    assert celnav.Camera.from_json(path) == camera
    assert hash(celnav.Camera.from_json(path)) == hash(camera)
    for text, message in (("{", "JSON"), ("[]", "object"), ("{}", "lacks"), (json.dumps(bare | {"fov": 3}), "fov")):
        path.write_text(text)
        refused(errors.CameraError, message, celnav.Camera.from_json, path)
    refused(errors.CameraError, "cannot read", celnav.Camera.from_json, tmp_path / "none.json")
    for fov in (0, 180, -3, float("nan")):
        refused(errors.CameraError, "hfov_deg", celnav.Camera.pinhole, 100, 80, fov)


@pytest.mark.parametrize(
    ("matrix", "text"),
    [(np.eye(2), "shape"), (2 * np.eye(3), "orthonormal"), (np.diag([1.0, 1.0, -1.0]), "reflection"),
     (np.full((3, 3), np.nan), "NaN"), ("north", "numbers")],
)  # fmt: skip
def test_attitude_refused(matrix, text):
    refused(errors.AttitudeError, text, celnav.Attitude.exact, matrix)


def test_attitude_kinds():
    up = celnav.Attitude.up([0, 0, 2.0], tilt_deg=0.1)
    assert up.rows == ((0.0, 0.0, 1.0),)
    refused(errors.AttitudeError, "heading", lambda: up.R_cam)
    refused(errors.AttitudeError, "length", celnav.Attitude.up, [0, 0, 0])
    refused(errors.AttitudeError, "tilt_deg", celnav.Attitude.with_sigma, R_CAM, tilt_deg=-1, heading_deg=0)
    assert hash(celnav.Attitude.exact(R_CAM)) == hash(celnav.Attitude.zenith_north_up())


@pytest.mark.parametrize("solver", ["thesis-baseline", "thesis-adaptive"])
@pytest.mark.parametrize("attitude", [None, celnav.Attitude.up([0, 0, 1])])
def test_a_solver_that_needs_the_attitude_says_so(solver, attitude):
    fix = celnav.solve(np.full((30, 2), 100.0), CAMERA, UTC_OK, attitude, solver)
    assert (fix.ok, fix.reason, fix.solver) == (False, "attitude_required", solver)
    assert fix.cov_km2 is None


@pytest.mark.parametrize(
    ("changes", "error", "text"),
    [
        ({"detections": [[1.0, np.nan]]}, errors.DetectionError, "NaN"),
        ({"detections": [[1.0, np.inf]]}, errors.DetectionError, "infinite"),
        ({"detections": [1.0, 2.0]}, errors.DetectionError, "shape"),
        ({"detections": np.zeros((4, 3))}, errors.DetectionError, "shape"),
        ({"detections": "stars"}, errors.DetectionError, "numbers"),
        ({"detections": [[5000.0, 10.0]]}, errors.CameraError, "outside"),
        ({"flux": [1.0, 2.0]}, errors.DetectionError, "flux"),
        ({"flux": [np.nan]}, errors.DetectionError, "flux"),
        ({"utc": "2020-01-01T00:00:00"}, errors.TimeError, "zone"),
        ({"attitude": np.ones((3, 3))}, errors.AttitudeError, "rotation"),
        ({"camera": {"width": 3}}, errors.CameraError, "Camera"),
        ({"solver": "magic"}, errors.ConfigError, "thesis-adaptive"),
        ({"pressure_hpa": -5.0}, errors.ConfigError, "pressure_hpa"),
        ({"pressure_hpa": float("nan")}, errors.ConfigError, "pressure_hpa"),
    ],
)
def test_solve_refuses_malformed_input(changes, error, text):
    question = {"detections": [[10.0, 10.0]], "camera": CAMERA, "utc": UTC_OK, "attitude": R_CAM} | changes
    refused(error, text, lambda: celnav.solve(**question))


def test_an_image_of_another_size_than_the_camera():
    seen = celnav.Detections(np.zeros((3, 2)), np.ones(3), (100, 100))
    refused(errors.CameraError, "1080 x 720", celnav.solve, seen, CAMERA, UTC_OK, R_CAM)


@pytest.mark.parametrize("solver", celnav.solvers())
@pytest.mark.parametrize("n", [0, 1, 4])
def test_too_few_detections(solver, n):
    fix = celnav.solve(np.zeros((n, 2)), CAMERA, UTC_OK, R_CAM, solver)
    assert (fix.ok, fix.reason) == (False, "too_few_detections")
    assert fix.matches.shape == (0, 2)


@pytest.mark.parametrize("solver", celnav.solvers())
def test_nonsense_is_refused(solver):
    """Stars on a line, on one spot, and thousands of random ones (with and without brightness)."""
    rng = np.random.default_rng(3)
    line = np.column_stack((np.linspace(0, 1079, 60), np.full(60, 300.0)))
    crowd = rng.uniform([0, 0], [1079, 719], (5000, 2))
    for uv, flux in ((line, None), (np.full((50, 2), 77.0), None), (crowd, None), (crowd, rng.random(5000))):
        fix = celnav.solve(uv, CAMERA, UTC_OK, R_CAM, solver, flux=flux)
        assert not fix.ok
        assert fix.reason in {"no_hypothesis", "effort_spent"}
        assert fix.work <= celnav.SkybenchConfig().max_work


def test_images(tmp_path):
    deep = (np.arange(12, dtype=np.uint16) * 5000).reshape(3, 4)
    Image.fromarray(deep).save(tmp_path / "deep.png")
    np.testing.assert_array_equal(read_image(tmp_path / "deep.png"), deep)
    colour = np.zeros((8, 9, 3), dtype=np.uint8)
    colour[2, 3] = (10, 20, 30)
    Image.fromarray(colour).save(tmp_path / "colour.png")
    np.testing.assert_array_equal(read_image(tmp_path / "colour.png"), colour)
    Image.fromarray(colour[:, :, 0]).save(tmp_path / "grey.jpg")
    assert read_image(tmp_path / "grey.jpg").shape == (8, 9)


def test_damaged_images(tmp_path):
    noise = np.random.default_rng(0).integers(0, 255, (64, 64), dtype=np.uint8)
    for suffix in ("png", "jpg"):
        whole = tmp_path / f"whole.{suffix}"
        Image.fromarray(noise).save(whole)
        cut = tmp_path / f"cut.{suffix}"
        cut.write_bytes(whole.read_bytes()[: whole.stat().st_size // 2])
        refused(errors.ImageError, "damaged", read_image, cut)
    (tmp_path / "text.png").write_text("not an image")
    refused(errors.ImageError, "not a PNG", read_image, tmp_path / "text.png")
    refused(errors.ImageError, "does not exist", read_image, tmp_path / "none.png")
    refused(errors.ImageError, "cannot be read|damaged", read_image, tmp_path)


def test_decompression_bomb(tmp_path):
    """A file of a few hundred kilobytes that claims 225 million pixels is refused before it is decoded."""
    Image.new("1", (15000, 15000)).save(tmp_path / "bomb.png")
    refused(errors.ImageError, "100 million", read_image, tmp_path / "bomb.png")


@pytest.mark.parametrize(
    ("image", "text"),
    [(np.zeros((5, 5, 2)), "shape"), (np.full((50, 50), np.nan), "NaN"), (np.zeros((1, 50)), "small"),
     (np.zeros((50, 50), dtype=complex), "real"), (np.array(["a"]), "numbers")],
)  # fmt: skip
def test_detect_refuses(image, text):
    refused(errors.ImageError, text, celnav.detect, image)


def test_detect_refuses_a_mask_that_does_not_fit():
    refused(errors.ImageError, "mask", celnav.detect, np.zeros((50, 50)), np.zeros((40, 50), dtype=bool))
