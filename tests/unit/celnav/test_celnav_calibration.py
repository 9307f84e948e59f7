"""Calibration from the stars: forms of lenses, blind starts, what is refused, and what is written."""

from __future__ import annotations

import dataclasses
import json

import cv2
import numpy as np
import pytest
from calibration_sky import LAT_DEG, LON_DEG, apparent_stars, fisheye_positions, frame_of, perspective_positions

import celnav
from celnav.__main__ import main
from celnav.calibrating.calibrate import calibrate
from celnav.calibrating.camera_output import opencv_calibration, opencv_text, scenario_text
from celnav.calibrating.fixed_detections import moving
from celnav.calibrating.frames import CalibrationFrame
from celnav.calibrating.lens_form import LAWS, LensForm
from celnav.calibrating.mount import mean_rotation, turned, turns_deg
from celnav.calibrating.scatter.noise import measure_noise
from celnav.calibrating.verdict import report, verdict
from celnav.command import calibration_frames
from celnav.command.pointing import Pointing
from celnav.detections import Detections
from celnav.errors import CalibrationError, CameraError, ConfigError
from celnav.sky.utc import parse_utc

UTC = "2021-08-05T05:30:00+00:00"
SIZE = (1280, 720)
WIDE = (880.0, 630.0, 352.0, -0.30, 0.10, 0.0008, -0.0006)


@pytest.fixture(scope="module")
def tilted():
    """A perspective lens with distortion and decentring that looks at an altitude of 50 deg: its frame and the truth."""
    R_cam = Pointing(200.0, 50.0, 4.0).R_cam
    enu, v_mag = apparent_stars(UTC, 6.5)
    front = (R_cam @ enu.T)[2] > 0.55  # beyond, the polynomial turns back
    uv = perspective_positions(enu, R_cam, WIDE)
    frame, _ = frame_of(UTC, uv, v_mag, SIZE, np.random.default_rng(3), sigma_px=0.1, visible=front)
    return frame, R_cam


@pytest.fixture(scope="module")
def calibrated(tilted):
    return calibrate([tilted[0]], LAT_DEG, LON_DEG, models=("brown_conrady", "kannala_brandt"), opencv_only=True)


@pytest.mark.parametrize("model", LAWS)
def test_form_and_camera_hold_the_same_numbers(model):
    radial = {"brown_conrady": 3, "kannala_brandt": 2}.get(model, 0)
    form = LensForm(model, radial, aspect=True, decentring=True, prism=True, tilt=True)
    values = np.linspace(0.001, 0.01, len(form.names))
    values[:4] = 500.0, 510.0, 320.0, 240.0
    camera = form.camera(values, (640, 480))
    assert form.values_of(camera) == pytest.approx(values, rel=1e-12)
    assert sum(map(bool, camera.k)) == radial
    assert all([camera.fy_px != camera.f_px, *map(any, (camera.p, camera.s, camera.tilt_rad))])


def test_blind_calibration_predicts_where_opencv_puts_the_stars(tilted, calibrated):
    enu, _ = apparent_stars(UTC, 6.5)
    R_cam = calibrated.attitudes[0].R_cam
    truth = perspective_positions(enu, tilted[1], WIDE)
    inside = ((tilted[1] @ enu.T)[2] > 0.55) & (truth > 20).all(axis=1) & (truth < np.array(SIZE) - 20).all(axis=1)
    off = calibrated.camera.project(enu[inside] @ R_cam.T) - truth[inside]
    assert np.sqrt((off**2).mean()) < 0.03
    assert calibrated.rms_px == pytest.approx(0.1, rel=0.1)
    assert calibrated.form.decentring
    assert calibrated.form.model == "brown_conrady"


def test_verdict_names_what_matters(calibrated):
    assert "0.10 px rms" in verdict(calibrated)
    assert "decentring" in verdict(calibrated)
    assert "f_px" in report(calibrated)


def test_radial_model_leaves_what_decentring_takes(tilted):
    plain = calibrate([tilted[0]], LAT_DEG, LON_DEG, form=LensForm("brown_conrady", 2))
    assert plain.rms_px > 0.12


def test_solve_reads_the_calibration(tilted, calibrated, tmp_path):
    path = tmp_path / "camera.json"
    path.write_text(calibrated.to_json())
    camera, attitude = celnav.read_camera_file(path).camera, celnav.Attitude.from_json(path)
    assert camera == calibrated.camera
    assert attitude.tilt_deg == pytest.approx(calibrated.mount.tilt_sigma_deg)
    fix = celnav.solve(tilted[0].detections, camera, UTC, attitude)
    assert fix.ok
    assert fix.lat_deg == pytest.approx(LAT_DEG, abs=0.02)
    assert fix.lon_deg == pytest.approx(LON_DEG, abs=0.02)
    assert np.sqrt(fix.cov_km2[0, 0]) > 0.9  # a hundredth of a degree


@pytest.mark.parametrize("yaml", [True, False])
def test_opencv_reads_its_matrix_and_coefficients(calibrated, tmp_path, yaml):
    path = tmp_path / ("lens.yml" if yaml else "lens.json")
    path.write_text(opencv_text(calibrated.camera, yaml=yaml))
    file = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    matrix, coefficients = file.getNode("camera_matrix").mat(), file.getNode("distortion_coefficients").mat()
    camera = calibrated.camera
    dirs = np.random.default_rng(1).normal([0, 0, 1.5], 0.25, (50, 3))
    theirs = cv2.projectPoints(dirs, np.zeros(3), np.zeros(3), matrix, coefficients)[0][:, 0]
    assert theirs == pytest.approx(camera.project(dirs), abs=1e-6)
    again = celnav.read_camera_file(path).camera
    assert again.project(dirs) == pytest.approx(camera.project(dirs), abs=1e-9)


def test_opencv_fisheye_is_written_as_such_and_more_is_refused():
    fisheye = celnav.Camera("kannala_brandt", 640, 480, 200.0, k=(0.01, -0.002))
    matrix, coefficients, of_fisheye = opencv_calibration(fisheye)
    assert of_fisheye
    assert coefficients.tolist() == [0.01, -0.002, 0, 0]
    assert matrix[0, 2] == 319.5
    decentred = celnav.Camera("kannala_brandt", 640, 480, 200.0, p=(0.001, 0))
    with pytest.raises(CameraError, match="--opencv-only"):
        opencv_calibration(decentred)
    with pytest.raises(CameraError, match="orthographic"):
        opencv_calibration(celnav.Camera("orthographic", 640, 480, 200.0))


def test_generator_takes_the_scenario(calibrated, tmp_path):
    from generator.scenario.file import load_scenario

    pointing = Pointing.of(calibrated.mount.R_cam)
    angles = {"azimuth_deg": pointing.azimuth_deg, "altitude_deg": pointing.altitude_deg, "roll_deg": pointing.roll_deg}
    site = {"latitude_deg": LAT_DEG, "longitude_deg": LON_DEG, "height_m": 100.0}
    path = tmp_path / "scenario.yaml"
    path.write_text(scenario_text(calibrated.camera, angles, site, "2021-08-05T05:30:00Z", 1.0))
    frame = load_scenario(path).frame(0)
    assert frame.camera.f_px == pytest.approx(calibrated.camera.f_px)
    assert frame.R_cam == pytest.approx(calibrated.mount.R_cam, abs=1e-9)


def test_a_scenario_holds_numbers_that_yaml_would_take_for_text(tmp_path):
    from generator.scenario.file import load_scenario

    camera = celnav.Camera("brown_conrady", *SIZE, 900.0, k=(1e-05, -2e-07), p=(3e-05, 0.0))
    angles = {"azimuth_deg": 1e-05, "altitude_deg": 45.0, "roll_deg": 0.0}
    site = {"latitude_deg": 5e-06, "longitude_deg": 0.0, "height_m": 0.0}
    path = tmp_path / "scenario.yaml"
    path.write_text(scenario_text(camera, angles, site, "2021-08-05T05:29:59.500Z", 1e-05))
    frame = load_scenario(path).frame(0)
    assert frame.camera.k[:2] == (1e-05, -2e-07)
    assert frame.camera.p == (3e-05, 0.0)


@pytest.mark.journey
def test_mirrored_picture_is_named(tilted):
    frame = tilted[0]
    uv = frame.uv * [1, -1] + [0, SIZE[1] - 1]
    flipped = CalibrationFrame(
        Detections(uv, frame.detections.flux, SIZE[::-1], frame.detections.sigma_px), frame.utc, SIZE, "flipped"
    )
    with pytest.raises(CalibrationError, match="mirrored"):
        calibrate([flipped], LAT_DEG, LON_DEG)


def test_wrong_place_is_named(tilted):
    with pytest.raises(CalibrationError, match="below the horizon"):
        calibrate([tilted[0]], -LAT_DEG, LON_DEG + 180)


@pytest.mark.parametrize(("lat_deg", "lon_deg"), [(-LAT_DEG, LON_DEG), (LAT_DEG, -LON_DEG)])
def test_wrong_sign_of_the_place_is_seen_in_a_whole_sky(lat_deg, lon_deg):
    """The frame's middle stays above the wrong horizon, and half of its stars do not."""
    enu, v_mag = apparent_stars(UTC, 5.5)
    R_cam = np.diag([-1.0, -1.0, 1.0])
    uv = fisheye_positions(enu, R_cam, (330.0, 600.0, 450.0, 0, 0, 0, 0))
    frame, _ = frame_of(UTC, uv, v_mag, (1200, 900), np.random.default_rng(3))
    with pytest.raises(CalibrationError, match="stars are seen that stand more than 5 deg below the horizon"):
        calibrate([frame], lat_deg, lon_deg, camera=celnav.Camera("equidistant", 1200, 900, 330.0))


@pytest.mark.journey
def test_clutter_alone_is_refused():
    rng = np.random.default_rng(5)
    uv = rng.uniform(0, 1, (300, 2)) * (np.array(SIZE) - 1)
    frame = CalibrationFrame(
        Detections(uv, np.sort(rng.random(300))[::-1], SIZE[::-1], None), parse_utc(UTC), SIZE, "noise"
    )
    with pytest.raises(CalibrationError, match="no frame shows stars"):
        calibrate([frame], LAT_DEG, LON_DEG)


def test_pixels_that_a_guess_says_are_oblong_are_kept_so():
    """Pixels 1.1 times as wide as high, of which no lens with square pixels follows the stars."""
    R_cam = Pointing(200.0, 50.0, 4.0).R_cam
    enu, v_mag = apparent_stars(UTC, 6.5)
    guess = celnav.Camera("pinhole", *SIZE, 900.0, 990.0, 640.0, 350.0)
    uv = np.nan_to_num(guess.project(enu @ R_cam.T), nan=-1e6)
    frame, _ = frame_of(UTC, uv, v_mag, SIZE, np.random.default_rng(0), sigma_px=0.1)
    found = calibrate([frame], LAT_DEG, LON_DEG, form=LensForm("pinhole", aspect=True), camera=guess)
    assert found.camera.f_px == pytest.approx(900, abs=5 * found.sigmas["f_px"])
    assert found.camera.fy_px == pytest.approx(990, abs=5 * found.sigmas["fy_px"])


def test_a_law_that_no_star_follows_is_refused(tilted):
    with pytest.raises(
        CalibrationError, match=r"of the model orthographic .* follows the stars: .*; brown_conrady does"
    ):
        calibrate([tilted[0]], LAT_DEG, LON_DEG, models=("orthographic",))


def test_the_same_frame_twice_is_refused(tilted):
    with pytest.raises(CalibrationError, match="same time and detections"):
        calibrate([tilted[0], dataclasses.replace(tilted[0], name="copy")], LAT_DEG, LON_DEG)


@pytest.mark.parametrize("read", [celnav.Camera.from_json, celnav.Attitude.from_json])
def test_nested_json_is_refused_and_a_byte_order_mark_is_not(tmp_path, read):
    nested = tmp_path / "nested.json"
    nested.write_text("[" * 100_000)
    with pytest.raises(ValueError, match="is not JSON"):
        read(nested)
    nested.write_text("\ufeff{}", encoding="utf-8")
    with pytest.raises(ValueError, match=r"R_cam|model"):
        read(nested)


def test_options_are_checked(tilted):
    with pytest.raises(CalibrationError, match="no frames"):
        calibrate([], LAT_DEG, LON_DEG)
    with pytest.raises(ConfigError, match="mount"):
        calibrate([tilted[0]], LAT_DEG, LON_DEG, mount="week")
    with pytest.raises(ConfigError, match="not known"):
        calibrate([tilted[0]], LAT_DEG, LON_DEG, models=("thin",))
    with pytest.raises(ConfigError, match="lat_deg"):
        calibrate([tilted[0]], 91.0, LON_DEG)
    with pytest.raises(ConfigError, match="CalibrationFrame"):
        calibrate([tilted[0].detections], LAT_DEG, LON_DEG)
    with pytest.raises(ConfigError, match="form"):
        calibrate([tilted[0]], LAT_DEG, LON_DEG, form="pinhole")
    with pytest.raises(ConfigError, match="camera"):
        calibrate([tilted[0]], LAT_DEG, LON_DEG, camera="pinhole")
    with pytest.raises(ConfigError, match="models is empty"):
        calibrate([tilted[0]], LAT_DEG, LON_DEG, models=())
    with pytest.raises(CalibrationError, match="640 x 360 pixels and the frames have 1280 x 720"):
        calibrate([tilted[0]], LAT_DEG, LON_DEG, camera=celnav.Camera.pinhole(640, 360, 70))
    with pytest.raises(ConfigError, match="takes no"):
        LensForm("kannala_brandt", 5)


def test_turns_are_about_east_north_and_up():
    R_cam = Pointing(30.0, 60.0, 10.0).R_cam
    vector = np.array([0.02, -0.01, 0.03])
    assert turns_deg(turned(R_cam, vector)[None], R_cam)[0] == pytest.approx(vector, abs=1e-9)
    both = np.stack([turned(R_cam, vector), turned(R_cam, -vector)])
    assert mean_rotation(both) == pytest.approx(R_cam, abs=1e-9)


def test_noise_is_taken_apart():
    # 20,000 pairs: the components are found within 5 % (five standard deviations).
    rng = np.random.default_rng(4)
    own, pull = rng.choice([0.05, 0.1, 0.2], 20000), rng.choice([0.0, 0.3], 20000)
    sigma = np.sqrt(0.08**2 + (1.5 * own) ** 2 + (0.5 * pull) ** 2)
    square = (rng.normal(0, 1, (20000, 2)) ** 2).sum(axis=1) * sigma**2
    square[:300] = 25.0  # wrong matches
    noise = measure_noise(square, own, pull)
    assert [noise.floor_px, noise.factor, noise.blending] == pytest.approx([0.08, 1.5, 0.5], rel=0.05)


def test_what_stands_still_is_no_star():
    rng = np.random.default_rng(6)
    still = rng.uniform(0, 1000, (10, 2))
    frames = []
    for hour in range(6):
        uv = np.concatenate((still + rng.normal(0, 0.05, (10, 2)), rng.uniform(0, 1000, (200, 2))))
        utc = parse_utc(f"2021-08-05T0{hour}:00:00Z")
        frames.append(CalibrationFrame(Detections(uv, None, (1000, 1000), None), utc, (1000, 1000), str(hour)))
    for kept in moving(frames, 500.0):
        assert not kept[:10].any()
        assert kept[10:].sum() >= 199  # one false alarm in a hundred sets


@pytest.mark.journey
def test_two_frames_of_one_fixed_camera_share_an_attitude():
    R_cam = Pointing(180.0, 88.0, 5.0).R_cam
    lens = (330.0, 612.0, 441.0, -0.012, 0.004, 0.0, 0.0)
    frames = []
    for number, utc in enumerate((UTC, "2021-08-05T08:10:00+00:00")):
        enu, v_mag = apparent_stars(utc, 5.0)
        uv = fisheye_positions(enu, R_cam, lens)
        frames.append(
            frame_of(utc, uv, v_mag, (1200, 900), np.random.default_rng(number), visible=(R_cam @ enu.T)[2] > 0)[0]
        )
    found = calibrate(frames, LAT_DEG, LON_DEG, form=LensForm("kannala_brandt", 2))
    assert found.one_attitude_per == "night"
    assert "mount steady" in verdict(found)
    assert turns_deg(found.mount.R_cam[None], R_cam)[0] == pytest.approx(np.zeros(3), abs=0.02)
    assert json.loads(found.to_json())["calibration"]["parameters"] == ["f_px", "cx_px", "cy_px", "k1", "k2"]


@pytest.mark.journey
def test_mount_that_moves_within_a_night_is_noticed():
    # A fiftieth of a degree is 0.1 px, as much as one centroid scatters, and thirty standard deviations of an attitude.
    lens = (330.0, 612.0, 441.0, -0.012, 0.004, 0.0, 0.0)
    first = Pointing(180.0, 88.0, 5.0).R_cam
    moved = turned(first, np.array([0.02, 0.0, 0.0]))
    frames = []
    for number, (utc, R_cam) in enumerate(((UTC, first), ("2021-08-05T08:10:00+00:00", moved))):
        enu, v_mag = apparent_stars(utc, 5.0)
        uv = fisheye_positions(enu, R_cam, lens)
        rng, front = np.random.default_rng(number), (R_cam @ enu.T)[2] > 0
        frames.append(frame_of(utc, uv, v_mag, (1200, 900), rng, sigma_px=0.1, visible=front)[0])
    found = calibrate(frames, LAT_DEG, LON_DEG, form=LensForm("kannala_brandt", 2))
    assert found.one_attitude_per == "frame"
    move = turns_deg(np.stack([one.R_cam for one in found.attitudes]), found.mount.R_cam)
    assert move[1] - move[0] == pytest.approx([0.02, 0, 0], abs=0.005)
    assert "mount moved within 0.0" in verdict(found)
    together = calibrate(frames, LAT_DEG, LON_DEG, form=LensForm("kannala_brandt", 2), mount="night")
    assert "has one attitude" in verdict(together)


def test_camera_writes_what_it_reads(tmp_path):
    camera = celnav.Camera("kannala_brandt", 640, 480, 201.3, 201.4, k=(0.01,), p=(1e-3, 0), tilt_rad=(0.01, 0.02))
    path = tmp_path / "camera.json"
    path.write_text(camera.to_json())
    assert celnav.Camera.from_json(path) == camera


def test_the_scenario_has_the_exposure_of_its_frame_not_of_another_of_the_same_name(
    tilted, calibrated, tmp_path, monkeypatch
):
    """As night1/001.jpg, without stars to identify, and night2/001.jpg."""
    rng = np.random.default_rng(8)
    nothing = Detections(rng.uniform(0, 1, (12, 2)) * SIZE, np.linspace(9.0, 1.0, 12), SIZE[::-1])
    frames = [
        CalibrationFrame(nothing, UTC, SIZE, "001.jpg", 3.0),
        dataclasses.replace(tilted[0], name="001.jpg", exposure_s=20.0),
    ]
    monkeypatch.setattr(calibration_frames, "read_frames", lambda *_: frames)
    out, scenario = tmp_path / "camera.json", tmp_path / "scenario.yaml"
    guess = tmp_path / "guess.json"
    guess.write_text(calibrated.to_json(), encoding="utf-8")
    place = ["--lat", str(LAT_DEG), "--lon", str(LON_DEG), "--models", "brown_conrady", "--camera", str(guess)]
    files = ["night1/001.jpg", "night2/001.jpg", "--out", str(out), "--scenario", str(scenario)]
    assert main(["calibrate", *files, *place]) == 0
    assert json.loads(out.read_text())["calibration"]["left_out"] == ["001.jpg"]
    written = scenario.read_text()
    assert "exposure_s: 20.0" in written
    assert "05:29:50" in written
