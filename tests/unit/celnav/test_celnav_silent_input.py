"""What is not understood is refused by name, and never left out in silence: sigmas, masks, NaN, distortions, times."""

from __future__ import annotations

import json

import numpy as np
import pytest

import celnav
from celnav.detecting.flood_fill import FloodFillConfig
from celnav.errors import AttitudeError, CameraError, ConfigError, DetectionError, ImageError, TimeError
from celnav.sky.utc import parse_utc

UTC = "2023-03-10T21:00:00Z"
R_CAM = celnav.Pointing(150, 55, 5).R_cam
SIGMAS = {"tilt_sigma_deg": 0.5, "heading_sigma_deg": 1.0}


def attitude_of(tmp_path, record):
    path = tmp_path / "attitude.json"
    path.write_text(json.dumps(record))
    return celnav.Attitude.from_json(path)


@pytest.mark.parametrize("sigma", list(SIGMAS))
def test_one_sigma_of_an_attitude_file_needs_the_other(tmp_path, sigma) -> None:
    (other,) = SIGMAS.keys() - {sigma}
    with pytest.raises(AttitudeError, match=f"{sigma} without {other}"):
        attitude_of(tmp_path, {"R_cam": R_CAM.tolist(), sigma: 0.5})


@pytest.mark.parametrize("key", ["tilt_deg", "heading_deg", "tilt_sigma", "heading_sigma", "Tilt_sigma_deg"])
@pytest.mark.parametrize("inner", [False, True])
def test_unknown_keys_of_an_attitude_file_are_named(tmp_path, key, inner) -> None:
    record = {"R_cam": R_CAM.tolist(), **SIGMAS, key: 0.5}
    with pytest.raises(
        AttitudeError, match=f"attitude.json: '{key}' is not known.*tilt_sigma_deg and heading_sigma_deg"
    ):
        attitude_of(tmp_path, {"attitude": record} if inner else record)


def test_attitudes_of_frame_records_are_read(tmp_path) -> None:
    samples = {
        "sample_time_s": [0.0],
        "sample_R_cam": [R_CAM.tolist()],
        "azimuth_deg": 1.0,
        "imu_bias_deg_s": [0, 0, 0],
    }
    record = {"R_cam": R_CAM.tolist(), **samples}
    exact = celnav.Attitude.exact(R_CAM)
    assert attitude_of(tmp_path, {"frame_id": "a", "time": {}, "attitude": record}) == exact
    assert attitude_of(tmp_path, record | {"camera": {"model": "pinhole"}}) == exact
    uncertain = celnav.Attitude.with_sigma(R_CAM, tilt_deg=0.5, heading_deg=1.0)
    assert attitude_of(tmp_path, {"attitude": record | SIGMAS}) == uncertain
    unknown = attitude_of(tmp_path, {"attitude": record | SIGMAS | {"heading_sigma_deg": None}})
    assert unknown == celnav.Attitude.up(R_CAM[:, 2], 0.5)
    with pytest.raises(AttitudeError, match="tilt_deg"):
        attitude_of(tmp_path, record | SIGMAS | {"tilt_sigma_deg": None})


def picture():
    """Forty stars on noise, and a patch of light."""
    rng = np.random.default_rng(1)
    y, x = np.mgrid[:240, :320]
    values = rng.normal(100, 5, (240, 320))
    for u, v, height in rng.uniform([5, 5, 200], [315, 235, 1500], (40, 3)):
        values += height * np.exp(-((x - u) ** 2 + (y - v) ** 2) / 2.9)
    values[100:140, 100:140] += rng.uniform(0, 5000, (40, 40))
    mask = np.zeros(values.shape, dtype=bool)
    mask[95:145, 95:145] = True
    return values, mask


@pytest.mark.parametrize("config", [None, FloodFillConfig()])
def test_masks_of_masked_arrays_count(config) -> None:
    values, mask = picture()
    wanted = celnav.detect(values, mask, config).uv
    for image in (values, np.dstack([values] * 3)):
        masked = np.ma.array(image, mask=mask if image.ndim == 2 else np.dstack([mask] * 3))
        np.testing.assert_array_equal(celnav.detect(masked, config=config).uv, celnav.detect(image, mask, config).uv)
    half = mask.copy()
    half[:, 120:] = False
    np.testing.assert_array_equal(celnav.detect(np.ma.array(values, mask=half), mask & ~half, config).uv, wanted)
    unmasked = celnav.detect(np.ma.array(values), config=config).uv
    np.testing.assert_array_equal(unmasked, celnav.detect(values, config=config).uv)
    spoilt = np.where(mask, np.nan, values)
    found = celnav.detect(np.ma.masked_invalid(spoilt), config=config).uv
    outside = ~mask[found[:, 1].round().astype(int), found[:, 0].round().astype(int)]
    assert outside.all()
    assert len(celnav.detect(np.ma.array(values, mask=True), config=config)) == 0


def test_a_mask_is_learnt_from_masked_arrays() -> None:
    rng = np.random.default_rng(4)
    frames = [rng.normal(100.0, 2.0, (96, 128)) for _ in range(3)]
    hidden = np.zeros((96, 128), dtype=bool)
    hidden[10:20, 30:50] = True
    spoilt = [
        np.ma.array(np.where(hidden, value, frame), mask=hidden) for frame in frames for value in (np.nan, -9999.0)
    ]
    mask = celnav.sky_mask(spoilt)
    assert mask[hidden].all()
    assert mask.mean() < 0.05


def test_masked_entries_without_a_place_are_refused() -> None:
    values, mask = picture()
    with pytest.raises(ImageError, match="masked entries"):
        celnav.detect(values, np.ma.array(mask, mask=mask))
    camera = celnav.Camera.pinhole(1200, 900, 60)
    uv = np.random.default_rng(2).uniform(0, 900, (20, 2))
    hidden = np.ma.array(uv, mask=np.arange(40).reshape(20, 2) > 30)
    with pytest.raises(DetectionError, match="detections has masked entries"):
        celnav.solve(hidden, camera, UTC, None)
    with pytest.raises(DetectionError, match="flux has masked entries"):
        celnav.solve(uv, camera, UTC, None, flux=np.ma.array(np.ones(20), mask=np.arange(20) > 15))


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("kind", [np.float16, np.float32])
def test_floats_of_any_size_are_checked(kind, value) -> None:
    image = picture()[0].astype(kind)
    assert len(celnav.detect(image)) > 20
    image[0, 0] = value
    with pytest.raises(ImageError, match="NaN, infinity"):
        celnav.detect(image)


def camera_of(tmp_path, content):
    path = tmp_path / "camera.json"
    matrix = [[1039.0, 0, 599.5], [0, 1039.0, 449.5], [0, 0, 1]]
    path.write_text(json.dumps({"camera_matrix": matrix, "image_width": 1200, "image_height": 900} | content))
    return celnav.read_camera_file(path).camera


@pytest.mark.parametrize(
    "key",
    ["distortion_coeffs", "distCoeff", "distortion", "Distortion_Coefficients", "dist_coeff", "coeffs", "k1", "p2", "xi",
     "distortion_type", "radial_distortion"],
)  # fmt: skip
def test_distortions_under_unknown_keys_are_refused(tmp_path, key) -> None:
    for content in ({key: [-0.08, 0.02, 0, 0]}, {key: [-0.08, 0.02, 0, 0], "D": [0, 0, 0, 0, 0]}):
        with pytest.raises(CameraError, match=f"{key} looks like a distortion.*distortion_coefficients, distCoeffs"):
            camera_of(tmp_path, content)


def test_other_keys_of_calibrations_are_read_over(tmp_path) -> None:
    others = {
        "avg_reprojection_error": 0.2,
        "distance_mm": 300,
        "undistort": True,
        "P1": [1],
        "R": [1],
        "distortions": None,
    }
    known = {"distortion_coefficients": [-0.08, 0.02, 0, 0, 0], "distortion_model": "plumb_bob"}
    assert camera_of(tmp_path, others | known).k[:2] == (-0.08, 0.02)


def test_frames_of_a_calibration_take_times_as_solve_does() -> None:
    detections = celnav.Detections(np.zeros((1, 2)), None)
    assert celnav.CalibrationFrame(detections, UTC, (1200, 900), "x").utc == parse_utc(UTC)
    with pytest.raises(TimeError, match="zone"):
        celnav.CalibrationFrame(detections, "2023-03-10T21:00:00", (1200, 900), "x")


@pytest.mark.parametrize("config", [{"seed_sigma": 6}, 6.0, "sharp"])
def test_a_configuration_of_another_kind_is_refused(config) -> None:
    with pytest.raises(ConfigError, match=r"must be a celnav\.DetectionConfig"):
        celnav.detect(np.zeros((50, 50)), config=config)


def test_tracks_count_leap_seconds() -> None:
    track = celnav.Track()
    for utc, elapsed_s in (
        ("2016-12-31T23:59:59.5Z", 0), ("2016-12-31T23:59:60.5Z", 1), ("2017-01-01T00:00:00.25Z", 1.75)
    ):  # fmt: skip
        fix = celnav.Fix(True, celnav.Reason.OK, lat_deg=0.0, lon_deg=0.0, cov_km2=np.eye(2))
        assert track.update(fix, utc, 0.0).time_s == elapsed_s
    with pytest.raises(ConfigError, match="order of time"):
        track.update(fix, "2016-12-31T23:59:60.5Z", 0.0)
