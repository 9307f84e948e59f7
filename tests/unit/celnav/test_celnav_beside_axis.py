"""A window cut from one side of a fisheye's picture: its axis is found beside it; residuals that are a pattern are told."""

import numpy as np
import pytest

import celnav
from celnav import unknown_camera
from celnav.calibrating import all_frames, beside_axis, blind_start
from celnav.calibrating.beside_axis import FALSE_ALARM, patterned, starts_beside
from celnav.calibrating.blind_start import WORK, Pass, Start
from celnav.camera import Camera
from celnav.errors import CalibrationError
from tests.calibration_sky import LAT_DEG, LON_DEG, apparent_stars
from tests.star_images import add_star

UTC = "2021-08-05T05:30:00Z"
SIZE, F_PX, AWAY_DEG = 190, 340.0, 38.0
FRAMES = 400


def window_camera():
    """Equidistant, its axis 38 deg to the left and above of the window's middle."""
    middle, off = (SIZE - 1) / 2, np.radians(AWAY_DEG) * F_PX * np.sqrt(0.5)
    return Camera("equidistant", SIZE, SIZE, F_PX, F_PX, middle - off, middle - off)


def window():
    """The picture, with stars to V 6.2, and its camera; the axis is in the zenith."""
    rng = np.random.default_rng(4)
    dirs, v_mag = apparent_stars(UTC, 6.2)
    camera = window_camera()
    uv = camera.project(dirs)
    seen = np.isfinite(uv).all(axis=1) & (uv > -5).all(axis=1) & (uv < SIZE + 5).all(axis=1)
    image = rng.normal(100.0, 2.0, (SIZE, SIZE))
    for (u, v), mag in zip(uv[seen], v_mag[seen], strict=True):
        add_star(image, u, v, 1000 * 10 ** (-0.4 * (mag - 4.5)), 0.9)
    return image, camera


@pytest.fixture
def short_search(monkeypatch):
    for module in (all_frames, blind_start, unknown_camera):
        monkeypatch.setattr(module, "PASSES", (Pass(0.35, 1.6, 2.0, 1.12, WORK, 1),))


@pytest.mark.usefixtures("short_search")
def test_the_axis_is_found_beside_the_picture() -> None:
    image, camera = window()
    found = celnav.find_camera(image, UTC)
    assert found.scatter_px < 0.3
    points = np.array([[0.5, 0.5], [0.2, 0.2], [0.8, 0.2], [0.2, 0.8], [0.8, 0.8]]) * SIZE
    turns = found.R_icrs_to_camera.T @ found.camera.to_rays(points).T
    between = np.degrees(np.arccos(np.clip(turns.T @ turns, -1, 1)))
    true = camera.to_rays(points)
    assert np.abs(between - np.degrees(np.arccos(np.clip(true @ true.T, -1, 1)))).max() < 0.1


@pytest.mark.usefixtures("short_search")
def test_without_other_starts_it_is_refused(monkeypatch) -> None:
    monkeypatch.setattr(beside_axis, "_AWAY_RAD", (0.0001,))
    with pytest.raises(CalibrationError, match="stars are identified near the middle"):
        celnav.find_camera(window()[0], UTC)


def calibration_of_window():
    image, camera = window()
    frame = celnav.CalibrationFrame(celnav.detect(image), UTC, (SIZE, SIZE), "window")
    return celnav.calibrate([frame], LAT_DEG, LON_DEG, models=("kannala_brandt", "equidistant")), camera


@pytest.mark.usefixtures("short_search")
def test_a_calibration_finds_the_axis_beside_the_picture() -> None:
    found, camera = calibration_of_window()
    assert found.rms_px < 0.3
    points = np.array([[0.5, 0.5], [0.2, 0.2], [0.8, 0.2], [0.2, 0.8], [0.8, 0.8]]) * SIZE
    # The axis of the true camera is in the zenith, with the same axes as the place: east, north, up.
    turns = found.camera.to_rays(points) @ found.mount.R_cam
    assert np.degrees(np.arccos(np.clip((turns * camera.to_rays(points)).sum(axis=1), -1, 1))).max() < 0.1


@pytest.mark.usefixtures("short_search")
def test_without_other_starts_a_calibration_is_refused(monkeypatch) -> None:
    monkeypatch.setattr(beside_axis, "_AWAY_RAD", (0.0001,))
    with pytest.raises(CalibrationError, match="no lens follows them outwards"):
        calibration_of_window()


@pytest.mark.parametrize("stars", [20, 60, 400])
@pytest.mark.parametrize("pattern", [0.0, 1.0])
def test_false_alarms_are_as_rare_as_stated(stars, pattern) -> None:
    """Even of patterns as large as the scatter: more than 4 of 400 would be one run of several thousand at 1 in 1000."""
    rng = np.random.default_rng(stars)
    alarms = 0
    for _ in range(FRAMES):
        uv, wave = rng.uniform(0, 1000, (stars, 2)), rng.normal(0, 0.003, (2, 2))
        shared = np.sin(uv @ wave + rng.uniform(0, 2 * np.pi, 2))
        shared *= pattern / np.sqrt((shared**2).mean())
        alarms += patterned(uv, shared + rng.normal(0, 1, (stars, 2)))
    assert alarms <= 10 * FALSE_ALARM * FRAMES


def test_a_pattern_three_times_the_scatter_is_told() -> None:
    rng = np.random.default_rng(2)
    told = 0
    for _ in range(100):
        uv = rng.uniform(0, 200, (45, 2))
        along = np.sin(uv / 60)
        told += patterned(uv, 3 * along / along.std() + rng.normal(0, 1, (45, 2)))
    assert told > 90


def test_few_stars_tell_no_pattern() -> None:
    uv = np.random.default_rng(1).uniform(0, 200, (16, 2))
    assert not patterned(uv, uv)


def test_other_starts_see_the_middle_as_the_first_does() -> None:
    camera = Camera("equidistant", SIZE, SIZE, F_PX)
    start = Start(camera, np.eye(3), 100.0, 30)
    middle = [[(SIZE - 1) / 2, (SIZE - 1) / 2]]
    beside = list(starts_beside(start))
    assert len(beside) == beside_axis.STARTS
    for one in beside:
        assert one.rotation.T @ one.camera.to_rays(middle)[0] == pytest.approx([0, 0, 1], abs=1e-9)
