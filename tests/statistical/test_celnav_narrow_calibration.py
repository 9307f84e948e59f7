"""Cameras of 4 to 15 deg, calibrated from one frame and nothing else: real star counts, false detections, hot pixels."""

from __future__ import annotations

import math

import numpy as np
import pytest
from narrow_frames import PLACE, SIZE, UTC, NarrowCamera

import celnav
from celnav.calibrating.calibrate import calibrate
from celnav.calibrating.frames import CalibrationFrame
from celnav.detections import Detections
from celnav.errors import CalibrationError
from celnav.identification.effort import Effort
from celnav.identification.search_config import SearchConfig
from celnav.identification.triangles import find_narrow_field, triangles_of
from celnav.sky.utc import parse_utc

ANY_FOCAL_PX = 2.4 * SIZE[1], 26.0 * SIZE[1]


@pytest.mark.parametrize(
    ("hfov_deg", "fields", "least"),
    [
        (8, 1, 1),
        pytest.param(15, 5, 5, marks=pytest.mark.journey),
        pytest.param(10, 5, 5, marks=pytest.mark.journey),
        pytest.param(6, 3, 3, marks=pytest.mark.journey),
        pytest.param(5, 5, 5, marks=pytest.mark.journey),
        pytest.param(4, 3, 2, marks=pytest.mark.journey),
    ],
)
def test_focal_length_and_orientation_of_a_narrow_field_are_found_from_nothing(hfov_deg, fields, least):
    found = 0
    for seed in range(fields):
        camera = NarrowCamera(hfov_deg, seed)
        answer = find_narrow_field(camera.frames[0].uv, SIZE, ANY_FOCAL_PX, Effort(120_000_000), SearchConfig())
        if answer is not None:
            found += 1
            # The search knows no distortion; the calibration that starts from it tolerates 6 %.
            assert answer[0].f_px * math.exp(answer[1].log_f) == pytest.approx(camera.f_px, rel=5e-3)
            assert answer[1].log10_false_alarm <= -6
    assert found >= least


def test_clutter_is_no_narrow_field():
    for number in range(3):
        rng = np.random.default_rng(number)
        uv = rng.uniform(0, 1, (int(rng.integers(20, 200)), 2)) * (np.array(SIZE) - 1)
        effort = Effort(10_000_000)
        assert find_narrow_field(uv, SIZE, (6.0 * SIZE[1], 12.0 * SIZE[1]), effort, SearchConfig()) is None
        assert effort.work <= 10_000_000


def test_triangles_have_the_shape_that_they_are_listed_by():
    from celnav.identification.sky_index import load_deep_sky_index

    table, xyz = triangles_of(1600), load_deep_sky_index().xyz.astype(float)
    corners = xyz[table.stars]
    sides = [np.linalg.norm(corners[:, i] - corners[:, j], axis=1) for i, j in ((1, 2), (2, 0), (0, 1))]
    assert (sides[0] >= sides[1]).all()
    assert (sides[1] >= sides[2]).all()
    assert sides[0] == pytest.approx(table.longest_rad, rel=1e-5)
    assert np.abs(table.shape[:, 1]) == pytest.approx(sides[2] / sides[0], rel=1e-4)
    assert (np.sign(np.linalg.det(corners)) == np.sign(table.shape[:, 1])).all()
    assert (np.diff(table.cell) >= 0).all()


@pytest.mark.journey
@pytest.mark.parametrize("hfov_deg", [10, 5])
def test_a_narrow_camera_is_calibrated_from_one_frame(hfov_deg):
    camera = NarrowCamera(hfov_deg, 1)
    found = calibrate(camera.frames, *PLACE)
    assert camera.error_px(found) < 0.5
    assert found.camera.f_px == pytest.approx(camera.f_px, rel=2e-3)
    assert found.form.model in ("pinhole", "brown_conrady")
    # Centre and attitude are one in a narrow field: the centre is within what is expected of cameras, and says so.
    assert 10 < found.sigmas["cx_px"] < 65


@pytest.mark.journey
def test_frames_of_a_narrow_camera_share_an_attitude_and_a_guess_serves():
    camera = NarrowCamera(8, 2, frames=3)
    found = calibrate(camera.frames, *PLACE, camera=celnav.Camera("pinhole", *SIZE, 1.04 * camera.f_px))
    assert not found.left_out
    assert found.one_attitude_per == "night"
    assert camera.error_px(found) < 0.3


@pytest.mark.journey
def test_clutter_of_a_narrow_camera_is_refused():
    rng = np.random.default_rng(8)
    uv = rng.uniform(0, 1, (60, 2)) * (np.array(SIZE) - 1)
    found = Detections(uv, np.sort(rng.random(60))[::-1], SIZE[::-1], None)
    with pytest.raises(CalibrationError, match="no frame shows stars"):
        calibrate([CalibrationFrame(found, parse_utc(UTC[0]), SIZE, "clutter")], *PLACE)
