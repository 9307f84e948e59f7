"""The attitude of a mount at a time: covariances over drawn wanderings, its limits, and calibration files that say it."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from scipy.special import chdtri

import celnav
from celnav.calibrating.mount import USUAL_WANDER_DEG, turned, turns_deg
from celnav.calibrating.mount_times import MEMORY_H, AttitudeInTime, attitude_at, read_attitude_at
from celnav.command.attitude_option import read_attitude
from celnav.command.calibration_frames import MAX_FRAMES
from celnav.errors import AttitudeError
from celnav.identification.verification import rotation_of
from celnav.sky.utc import parse_utc

NOW = parse_utc("2022-09-14T22:00:00Z")
MOUNT = rotation_of(np.array([0.6, -0.4, 1.1]))
FAR = celnav.Attitude.with_sigma(MOUNT, tilt_deg=0.017, heading_deg=0.017)
NOISE_DEG = 0.001


def in_time(turn_deg, hours, noise_deg=NOISE_DEG):
    return AttitudeInTime(turned(MOUNT, turn_deg), noise_deg, noise_deg, (NOW.mjd + hours / 24,))


def wandering(rng, hours, sigma_deg):
    """Angles, shape (n, 3), that wander by `sigma_deg` with the model's memory."""
    hours = np.asarray(hours)
    correlation = np.exp(-np.abs(hours[:, None] - hours) / MEMORY_H) + 1e-12 * np.eye(len(hours))
    return sigma_deg * np.linalg.cholesky(correlation) @ rng.normal(size=(len(hours), 3))


@pytest.mark.parametrize("hours", [[-0.1], [-2.0], [-3.0, -1.0, 0.5], [-6.0, -5.5, -5.0, -4.5, 4.0, 5.0]])
def test_standard_deviations_hold_drawn_wanderings(hours):
    """200 mounts: squares over variances are chi-squared of 600, but for one run in a thousand."""
    rng, squares = np.random.default_rng(len(hours)), 0.0
    for _ in range(200):
        turns = wandering(rng, [*hours, 0.0], USUAL_WANDER_DEG)
        measured = turns[:-1] + rng.normal(0, NOISE_DEG, (len(hours), 3))
        found = attitude_at([in_time(turn, hour) for turn, hour in zip(measured, hours, strict=True)], NOW, FAR)
        east, north, up = turns_deg(found.R_cam[None], turned(MOUNT, turns[-1]))[0]
        squares += (east**2 + north**2) / found.tilt_deg**2 + (up / found.heading_deg) ** 2
    # The variance of a few frames is estimated with a prior that is right here: squares vary a little less than chi-squared.
    least, most = chdtri(600, [1 - 0.0005, 0.0005])
    assert least < squares < most


def test_one_frame_is_known_best_at_its_own_time():
    """At its time by its own noise, after one memory by the wander's growth, on another night as the calibration says."""

    def sigma(hours):
        return attitude_at([in_time(np.zeros(3), hours)], NOW, FAR).tilt_deg

    assert sigma(0.0) == pytest.approx(NOISE_DEG)
    # Variance of the difference of two values of the process: 2 w^2 (1 - exp(-t / memory)).
    grown = 2 * USUAL_WANDER_DEG**2 * (1 - math.exp(-1))
    assert sigma(MEMORY_H) == pytest.approx(math.hypot(math.sqrt(grown), NOISE_DEG), rel=1e-6)
    assert attitude_at([in_time(np.zeros(3), 13.0)], NOW, FAR) is FAR
    assert attitude_at([], NOW, FAR) is FAR


def test_frames_that_wander_more_than_usual_widen_it():
    """A mount of 0.1 deg: the posterior of the variance follows the frames, and the mean lies between neighbours."""
    steady, loose = (
        attitude_at([in_time(np.full(3, s), -2.0), in_time(np.full(3, -s), 2.0)], NOW, FAR) for s in (1e-4, 0.1)
    )
    assert steady.tilt_deg < USUAL_WANDER_DEG < 3 * USUAL_WANDER_DEG < loose.tilt_deg
    assert np.abs(turns_deg(loose.R_cam[None], MOUNT)).max() < 1e-6


def test_calibration_files_say_it(tmp_path):
    path = tmp_path / "camera.json"
    frame = {"utc_mjd": NOW.mjd + 1 / 24, "R_cam": turned(MOUNT, np.array([0.01, 0.02, -0.01])).tolist(),
             "tilt_sigma_deg": 0.001, "heading_sigma_deg": 0.002}  # fmt: skip
    record = {"attitude": {"R_cam": MOUNT.tolist(), "tilt_sigma_deg": 0.017, "heading_sigma_deg": 0.017},
              "calibration": {"frames": [frame, frame | {"utc_mjd": NOW.mjd + 30}]}}  # fmt: skip
    path.write_text(json.dumps(record))
    near = read_attitude(str(path), None, "2022-09-14T23:00:00Z")
    assert near is not None
    assert (near.tilt_deg, near.heading_deg) == pytest.approx((0.001, 0.002))
    assert turns_deg(near.R_cam[None], MOUNT)[0] == pytest.approx([0.01, 0.02, -0.01], abs=1e-9)
    assert read_attitude_at(path, parse_utc("2022-09-20T00:00:00Z")) == celnav.Attitude.from_json(path)
    assert read_attitude(str(path)) == celnav.Attitude.from_json(path)
    del record["calibration"]
    path.write_text(json.dumps(record))
    assert read_attitude_at(path, NOW) == celnav.Attitude.from_json(path)


@pytest.mark.parametrize(
    ("changed", "words"),
    [({"R_cam": None}, "R_cam"), ({"R_cam": [[1, 0, 0]] * 3}, "not a rotation"), ({"utc_mjd": "now"}, "utc_mjd"),
     ({"tilt_sigma_deg": -1}, "tilt_sigma_deg"), ({"heading_sigma_deg": None}, "heading_sigma_deg")],
)  # fmt: skip
def test_malformed_frames_are_named(tmp_path, changed, words):
    path = tmp_path / "camera.json"
    frame = {"utc_mjd": 6e4, "R_cam": np.eye(3).tolist(), "tilt_sigma_deg": 0.1, "heading_sigma_deg": 0.1} | changed
    path.write_text(json.dumps({"R_cam": np.eye(3).tolist(), "calibration": {"frames": [frame]}}))
    with pytest.raises(AttitudeError, match=words) as refusal:
        read_attitude_at(path, NOW)
    assert f"{path}: calibration frame 0" in str(refusal.value)


def test_an_attitude_that_is_none_is_refused_with_the_name_of_its_file(tmp_path):
    path = tmp_path / "camera.json"
    path.write_text(json.dumps({"R_cam": [[1, 0, 0]] * 3}))
    for utc in (None, "2022-09-14T23:00:00Z"):
        with pytest.raises(AttitudeError, match="not a rotation") as refusal:
            read_attitude(str(path), None, utc)
        assert str(path) in str(refusal.value)


def test_calibrations_of_many_frames_say_it_too(tmp_path):
    """As many frames as a calibration takes."""
    path = tmp_path / "camera.json"
    frame = {"R_cam": MOUNT.tolist(), "tilt_sigma_deg": 0.001, "heading_sigma_deg": 0.001}
    frames = [frame | {"utc_mjd": NOW.mjd + k / 86400} for k in range(MAX_FRAMES)]
    path.write_text(
        json.dumps(
            {
                "attitude": {"R_cam": MOUNT.tolist(), "tilt_sigma_deg": 0.017, "heading_sigma_deg": 0.017},
                "calibration": {"frames": frames},
            }
        )
    )
    assert read_attitude_at(path, NOW).tilt_deg < 0.002
    path.write_text(json.dumps({"R_cam": MOUNT.tolist(), "calibration": {"frames": [*frames, frames[0]]}}))
    with pytest.raises(AttitudeError, match="more than 2000"):
        read_attitude_at(path, NOW)
