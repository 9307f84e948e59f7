"""What `celnav calibrate` writes beside the calibration: OpenCV's file, a scenario, the map of residuals, and its verdict."""

from __future__ import annotations

import dataclasses
import io
import json
import math
import re
from contextlib import redirect_stdout
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from calibration_sky import apparent_stars, fisheye_positions, frame_of, perspective_positions
from PIL import Image

import celnav
from celnav.__main__ import main
from celnav.calibrating.calibration import CameraCalibration, FrameAttitude, Residuals
from celnav.calibrating.lens_form import LensForm
from celnav.calibrating.mount import Mount, turned
from celnav.calibrating.scatter.noise import Noise
from celnav.calibrating.scatter.pixel_phase import PixelPhase
from celnav.calibrating.scatter.residual_pattern import residual_pattern
from celnav.calibrating.verdict import report, verdict
from celnav.command.pointing import Pointing
from celnav.command.residual_map import check_map_path, draw_residual_map
from celnav.errors import ConfigError
from celnav.sky.utc import parse_utc

PERSPECTIVE = (890.0, 630.0, 362.0, 0.0, 0.0, 0.0008, -0.0006)
FISHEYE = (330.0, 612.0, 441.0, -0.012, 0.004, 0.0, 0.0)
MOVED_DEG = 0.2
# A map is 1430 pixels wide; the picture of stars reaches at least to the first of these columns, that of means begins before
# the second.
LEFT, RIGHT = 650, 780


def star_file(path, positions, lens, size, nights, v_max):
    """Write centroids as RMS does, one frame for each time and attitude; blocks of 10.24 s around 5.12 s past the minute."""
    content = {}
    for number, (minute, R_cam) in enumerate(nights):
        utc = f"{minute}:05.120000+00:00"
        enu, v_mag = apparent_stars(utc, v_max, 51.88, -1.3)
        uv, front = positions(enu, R_cam, lens), (R_cam @ enu.T)[2] > (0.5 if positions is perspective_positions else 0)
        rng = np.random.default_rng(number)
        found = frame_of(utc, uv, v_mag, size, rng, sigma_px=0.1, false=3, visible=front)[0].detections
        rows = [[0.0, v, u, 1e5 * flux] for (u, v), flux in zip(found.uv.tolist(), found.flux.tolist(), strict=True)]
        stamp = minute.replace("-", "").replace(":", "").replace("T", "_") + "00_000"
        platepar = {"auto_recalibrated": True, "X_res": size[0], "Y_res": size[1], "star_list": rows}
        content[f"FF_XX0001_{stamp}_0000000.fits"] = platepar
    path.write_text(json.dumps(content), encoding="utf-8")
    return str(path)


def calibrate_by_command(folder, stars, guess, opencv):
    """Run the command with every output, and name its files."""
    (folder / "guess.json").write_text(json.dumps(guess), encoding="utf-8")
    made = SimpleNamespace(
        out=folder / "camera.json", opencv=folder / opencv, scenario=folder / "scenario.yaml", map=folder / "map.png"
    )
    place = ["--lat", "51.88", "--lon", "-1.3", "--height-m", "80"]
    given = ["--camera", str(folder / "guess.json"), "--models", guess["model"]]
    outputs = [word for name, path in vars(made).items() for word in (f"--{name}", str(path))]
    with redirect_stdout(io.StringIO()) as said:
        assert main(["calibrate", stars, *place, *given, *outputs]) == 0
    made.report = said.getvalue()
    return made


@pytest.fixture(scope="module")
def perspective(tmp_path_factory):
    folder = tmp_path_factory.mktemp("perspective")
    nights = (("2022-09-14T20:10", Pointing(237.0, 41.0, -3.0).R_cam),)
    stars = star_file(folder / "stars.json", perspective_positions, PERSPECTIVE, (1280, 720), nights, 5.5)
    return calibrate_by_command(
        folder, stars, {"model": "pinhole", "width": 1280, "height": 720, "f_px": 900.0}, "lens.yml"
    )


@pytest.fixture(scope="module")
def fisheye(tmp_path_factory):
    """A camera of two nights, whose mount moved between them."""
    folder = tmp_path_factory.mktemp("fisheye")
    first = Pointing(180.0, 88.0, 5.0).R_cam
    nights = (("2022-09-14T20:10", first), ("2022-10-03T21:20", turned(first, np.array([MOVED_DEG, 0.0, 0.0]))))
    stars = star_file(folder / "stars.json", fisheye_positions, FISHEYE, (1200, 900), nights, 4.5)
    guess = {"model": "kannala_brandt", "width": 1200, "height": 900, "f_px": 335.0}
    return calibrate_by_command(folder, stars, guess, "lens.json")


@pytest.mark.parametrize("lens", ["perspective", "fisheye"])
def test_opencv_projects_by_the_file_as_the_calibration_does(request, lens):
    made = request.getfixturevalue(lens)
    file = cv2.FileStorage(str(made.opencv), cv2.FILE_STORAGE_READ)
    matrix, coefficients = file.getNode("camera_matrix").mat(), file.getNode("distortion_coefficients").mat()
    camera = celnav.read_camera_file(made.out).camera
    assert (file.getNode("image_width").real(), file.getNode("image_height").real()) == (camera.width, camera.height)
    rays = camera.to_rays(np.random.default_rng(1).uniform(0.2, 0.8, (50, 2)) * [camera.width, camera.height])[:, None]
    if lens == "fisheye":
        assert file.getNode("fisheye_model").real() == 1
        theirs = cv2.fisheye.projectPoints(rays, np.zeros(3), np.zeros(3), matrix, coefficients)[0][:, 0]
    else:
        theirs = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), matrix, coefficients)[0][:, 0]
    assert theirs == pytest.approx(camera.project(rays[:, 0]), abs=1e-6)
    # The lens is the one that drew the stars, not the guess.
    assert matrix[0, 0] == pytest.approx(FISHEYE[0] if lens == "fisheye" else PERSPECTIVE[0], abs=1.0)


@pytest.mark.parametrize("lens", ["perspective", "fisheye"])
def test_the_generator_reads_the_scenario(request, lens):
    from generator.scenario.file import load_scenario

    made = request.getfixturevalue(lens)
    frame = load_scenario(made.scenario).frame(0)
    content = json.loads(made.out.read_text())
    camera = celnav.read_camera_file(made.out).camera
    assert (frame.camera.width, frame.camera.height) == (camera.width, camera.height)
    numbers = [frame.camera.f_px, frame.camera.principal_u_px, frame.camera.principal_v_px]
    assert numbers == pytest.approx([camera.f_px, camera.cx_px, camera.cy_px])
    for name in ("k", "p", "s"):
        given = getattr(camera, name)
        assert getattr(frame.camera, name)[: len(given)] == pytest.approx(given)
    assert frame.R_cam == pytest.approx(np.array(content["attitude"]["R_cam"]), abs=1e-9)
    assert (frame.site.latitude_deg, frame.site.longitude_deg, frame.site.height_m) == (51.88, -1.3, 80.0)
    assert frame.time.exposure_s == 10.24
    assert content["attitude"]["tilt_sigma_deg"] > 0
    assert "sigma" not in made.scenario.read_text()  # a scenario has the attitude alone
    # The block begins at its name's time.
    assert "utc_start: 2022-09-14T20:10:00.000Z" in made.scenario.read_text()


def test_the_report_says_between_which_nights_the_mount_moved(fisheye):
    said = fisheye.report.splitlines()[0]
    found = re.search(r"mount moved by ([0-9.]+) deg between (\S+) and (\S+?)(,|$)", said)
    assert found is not None, said
    assert found.groups()[1:3] == ("2022-09-14", "2022-10-03")
    assert float(found[1]) == pytest.approx(MOVED_DEG, abs=0.01)


def pixels_of(path):
    return np.asarray(Image.open(path).convert("RGB")).astype(int)


@pytest.mark.parametrize("lens", ["perspective", "fisheye"])
def test_the_command_draws_a_map(request, lens):
    picture = pixels_of(request.getfixturevalue(lens).map)
    assert 500 <= picture.shape[0] <= picture.shape[1] == 1430
    for half in (picture[:, :715], picture[:, 715:]):
        inked = (half < 200).any(axis=2).mean()
        assert 0.01 < inked < 0.5


@pytest.fixture(scope="module")
def calibrated():
    """A calibration of one frame, put together by hand: 300 stars, of which neighbours share what a cubic term leaves."""
    camera, R_cam = celnav.Camera("pinhole", 1280, 720, 890.0), Pointing(200.0, 50.0, 4.0).R_cam
    rng = np.random.default_rng(3)
    uv, sigma_px = rng.uniform(0, 1, (300, 2)) * [1279, 719], np.full(300, 0.1)
    off_px = rng.normal(0, 0.1, (300, 2)) + 0.2 * ((uv - [640, 360]) / 640) ** 3
    zeros = np.zeros(300, dtype=np.intp)
    seen = Residuals(uv, off_px, sigma_px, zeros, np.arange(300, dtype=np.int32), zeros)
    form = LensForm("pinhole")
    values = form.values_of(camera)
    utc = "2021-08-05T05:30:00Z"
    return CameraCalibration(
        camera=camera, form=form, values=values, cov=1e-4 * np.eye(len(values)),
        attitudes=(FrameAttitude(utc, parse_utc(utc), 0, R_cam, 0.01, 0.01, 300, 0.1, 6.0),),
        one_attitude_per="frame", steady=True, mount=Mount(R_cam, 0.01, 0.01, math.nan, math.nan), noise=Noise(0.1, 0.0),
        pixel_phase=PixelPhase(), rms_px=0.1, plain_rms_px=0.12, median_px=0.1,
        pattern=residual_pattern(seen, off_px, (1280, 720)), judged=(), left_out=(), residuals=seen, R_by_group=R_cam[None],
    )  # fmt: skip


def drawn(found, path: Path):
    draw_residual_map(found, str(path))
    return pixels_of(path)


def test_the_map_shows_residuals_and_means(calibrated, tmp_path):
    plain = drawn(calibrated, tmp_path / "plain.png")
    assert np.array_equal(drawn(calibrated, tmp_path / "again.png"), plain)
    seen, pattern = calibrated.residuals, calibrated.pattern
    turned_round = dataclasses.replace(calibrated, residuals=dataclasses.replace(seen, off_px=-seen.off_px))
    changed = (drawn(turned_round, tmp_path / "stars.png") != plain).any(axis=2)
    assert changed[:, :LEFT].sum() > 500
    assert not changed[:, RIGHT:].any()
    other = dataclasses.replace(calibrated, pattern=dataclasses.replace(pattern, mean_px=-pattern.mean_px))
    changed = (drawn(other, tmp_path / "means.png") != plain).any(axis=2)
    assert not changed[:, :LEFT].any()
    assert changed[:, RIGHT:].sum() > 100


def test_arrows_stand_where_their_stars_do(calibrated, tmp_path):
    """Stars of the frame's upper left, and those of its lower right, of which a picture's rows count downwards."""
    seen, middles = calibrated.residuals, {}
    corner = (seen.uv < [640, 360]).all(axis=1)
    for name, rows in (("upper left", corner), ("lower right", (seen.uv > [640, 360]).all(axis=1))):
        fields = {field.name: getattr(seen, field.name)[rows] for field in dataclasses.fields(seen)}
        found = dataclasses.replace(calibrated, residuals=dataclasses.replace(seen, **fields))
        left = drawn(found, tmp_path / "map.png")[:400, :715]
        colourful = np.ptp(left, axis=2) > 60
        assert colourful.sum() > 100
        middles[name] = np.argwhere(colourful).mean(axis=0)
    down, right = middles["lower right"] - middles["upper left"]
    assert down > 80
    assert right > 150


@pytest.mark.parametrize(("suffix", "start"), [("svg", b"<?xml"), ("pdf", b"%PDF")])
def test_maps_are_drawn_in_other_formats(calibrated, tmp_path, suffix, start):
    path = tmp_path / f"map.{suffix}"
    draw_residual_map(calibrated, str(path))
    assert path.read_bytes().startswith(start)
    assert path.stat().st_size > 10_000
    with pytest.raises(ConfigError, match="must end in"):
        check_map_path(str(tmp_path / "map.jpg"))
    with pytest.raises(ConfigError, match="folder does not exist"):
        check_map_path(str(tmp_path / "none" / "map.png"))


def of_nights(calibrated, *turns):
    """The calibration as one of several frames: time, number of the night, and rotation about east, north and up, deg."""
    attitudes = tuple(
        FrameAttitude(
            utc, parse_utc(utc), night, turned(calibrated.mount.R_cam, np.array(turn)), 0.01, 0.01, 90, 0.1, 6.0
        )
        for utc, night, turn in turns
    )
    return dataclasses.replace(calibrated, attitudes=attitudes, one_attitude_per="frame")


def test_the_verdict_names_the_two_nights_that_differ_most(calibrated):
    found = of_nights(
        calibrated,
        ("2022-09-14T23:50:00Z", 0, (0.01, 0.0, 0.0)),
        ("2022-09-15T03:00:00Z", 0, (-0.01, 0.0, 0.0)),
        ("2022-09-20T22:00:00Z", 1, (0.03, 0.0, 0.0)),
        ("2022-12-01T04:00:00Z", 2, (0.0, -0.04, 0.0)),
    )
    # Night 0 stands at zero in the mean and is named by its first frame; night 1 and 2 are sqrt(0.03^2 + 0.04^2) apart.
    assert "mount moved by 0.050 deg between 2022-09-20 and 2022-12-01" in verdict(found)
    assert report(found).splitlines()[0].startswith("verdict")
    assert "in 4 frame(s) of 3 night(s)" in report(found)
    two = of_nights(
        calibrated, ("2022-09-14T23:50:00Z", 0, (0.0, 0.0, 0.0)), ("2022-09-15T22:00:00Z", 1, (0.0, 0.0, 0.02))
    )
    assert "mount moved by 0.020 deg between 2022-09-14 and 2022-09-15" in verdict(two)


def test_the_verdict_of_one_frame_or_one_night_names_no_dates(calibrated):
    assert "mount" not in verdict(calibrated)
    night = of_nights(
        calibrated, ("2022-09-14T22:00:00Z", 0, (0.0, 0.0, 0.0)), ("2022-09-15T00:30:00Z", 0, (0.0, 0.03, 0.0))
    )
    assert "mount moved within 0.030 deg in 2.5 h" in verdict(night)
    assert "between" not in verdict(night)
