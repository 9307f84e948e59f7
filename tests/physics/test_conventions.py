"""docs/conventions.md, rule by rule: what generator and celnav make of it, each on its own."""

import math

import cv2
import numpy as np
import pytest
from small_scenes import small_scenario

import celnav
from generator.frame.exposure.expected import render_expected
from generator.frame.plan import plan_frame
from generator.scenario.model import Pointing, pointing_matrix, pointing_of

WIDTH, HEIGHT = 270, 180


@pytest.fixture(scope="module")
def sky():
    plan = plan_frame(small_scenario(sky=None, stars={"limiting_magnitude": 4.5}), 0)
    return plan, render_expected(plan)


def test_zenith_north_up_puts_north_up_and_east_left(sky) -> None:
    plan, expected = sky
    inside = expected.fraction_in_frame > 0.99
    enu = plan.middle.enu
    north, east = inside & (enu[:, 1] > 0.1), inside & (enu[:, 0] > 0.1)
    assert north.sum() > 10
    assert east.sum() > 10
    assert (expected.v_px[north] < (HEIGHT - 1) / 2).all()
    assert (expected.u_px[east] < (WIDTH - 1) / 2).all()


def test_celnav_has_the_same_axes() -> None:
    camera = celnav.Camera.pinhole(width=WIDTH, height=HEIGHT, hfov_deg=120)
    R_cam = np.array([[-1.0, 0, 0], [0, -1, 0], [0, 0, 1]])
    north, east = np.array([0, 0.6, 0.8]), np.array([0.6, 0, 0.8])
    uv = camera.project(np.stack([R_cam @ north, R_cam @ east]))
    assert uv[0, 1] < (HEIGHT - 1) / 2
    assert uv[0, 0] == pytest.approx((WIDTH - 1) / 2)
    assert uv[1, 0] < (WIDTH - 1) / 2


def test_pixel_centres_are_at_integers(sky) -> None:
    """The brightest pixel of a well separated star is the rounded position, in image[v, u]."""
    plan, expected = sky
    checked = 0
    for row in np.argsort(plan.stars.v_mag)[:40]:
        u, v = expected.u_px[row], expected.v_px[row]
        if not (5 < u < WIDTH - 6 and 5 < v < HEIGHT - 6):
            continue
        if np.max(np.abs([u - np.rint(u), v - np.rint(v)])) > 0.4:
            continue
        patch = expected.electrons[int(np.rint(v)) - 2 : int(np.rint(v)) + 3, int(np.rint(u)) - 2 : int(np.rint(u)) + 3]
        assert np.unravel_index(np.argmax(patch), patch.shape) == (2, 2)
        checked += 1
    assert checked > 5


def test_field_of_view_is_from_edge_to_edge() -> None:
    camera = celnav.Camera.pinhole(width=1080, height=720, hfov_deg=120)
    assert camera.f_px == pytest.approx(1080 / 2 / math.tan(math.radians(60)))
    assert (camera.cx_px, camera.cy_px) == (539.5, 359.5)
    left, right = camera.to_rays(np.array([[-0.5, 359.5], [1079.5, 359.5]]))
    assert np.degrees(np.arccos(left @ right)) == pytest.approx(120)
    assert small_scenario().frame(0).camera.f_px == pytest.approx(WIDTH / 2 / math.tan(math.radians(60)))


def test_projection_is_opencv_s() -> None:
    camera = celnav.Camera.pinhole(width=1080, height=720, hfov_deg=120)
    matrix = np.array([[camera.f_px, 0, 539.5], [0, camera.f_px, 359.5], [0, 0, 1]])
    rays = np.random.default_rng(1).normal([0, 0, 4], 1, size=(50, 3))
    wanted = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), matrix, None)[0][:, 0]
    np.testing.assert_allclose(camera.project(rays), wanted, atol=1e-9)


def test_azimuth_runs_from_north_through_east(sky) -> None:
    plan, _ = sky
    azimuth = np.radians(plan.middle.azimuth_deg)
    flat = plan.middle.enu[:, :2] / np.linalg.norm(plan.middle.enu[:, :2], axis=1)[:, None]
    np.testing.assert_allclose(flat, np.stack([np.sin(azimuth), np.cos(azimuth)], axis=1), atol=1e-12)


def test_star_ids_are_hip_or_minus_hr(sky) -> None:
    plan, _ = sky
    stars = plan.stars
    assert (stars.star_id[stars.hip > 0] == stars.hip[stars.hip > 0]).all()
    assert (stars.star_id[stars.hip == 0] == -stars.hr[stars.hip == 0]).all()


@pytest.mark.parametrize(
    "angles", [(0, 0, 0), (120, 48, 7), (301.5, -20, -170), (180, 90, 0), (33, 89.9999, 12), (180, -90, 20)]
)
def test_pointing_means_the_same_to_both(angles) -> None:
    azimuth_deg, altitude_deg, roll_deg = map(float, angles)
    mine = Pointing(azimuth_deg=azimuth_deg, altitude_deg=altitude_deg, roll_deg=roll_deg)
    matrix = pointing_matrix(mine)
    np.testing.assert_allclose(celnav.Pointing(*angles).R_cam, matrix, atol=1e-14)
    theirs = celnav.Pointing.of(matrix)
    found = pointing_of(matrix)
    assert (found.azimuth_deg, found.altitude_deg, found.roll_deg) == pytest.approx(angles, abs=1e-7)
    assert (theirs.azimuth_deg, theirs.altitude_deg, theirs.roll_deg) == pytest.approx(angles, abs=1e-7)
