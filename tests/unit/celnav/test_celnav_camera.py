import cv2
import numpy as np
import pytest

import celnav
from celnav.attitude import Attitude

CAMERA = celnav.Camera("pinhole", 1080, 720, f_px=311.7, fy_px=315.2, cx_px=530.0, cy_px=365.5)
TOLERANCE_PX = 1e-6


def grid():
    u, v = np.meshgrid(np.linspace(-0.5, 1079.5, 23), np.linspace(-0.5, 719.5, 17))
    return np.column_stack((u.ravel(), v.ravel()))


def test_round_trip():
    rays = CAMERA.to_rays(grid())
    np.testing.assert_allclose(np.linalg.norm(rays, axis=1), 1)
    np.testing.assert_allclose(CAMERA.project(3.7 * rays), grid(), atol=TOLERANCE_PX)


def test_projection_is_opencvs():
    dirs = np.random.default_rng(0).normal(0, 1, (200, 3))
    dirs[:, 2] = np.abs(dirs[:, 2]) + 0.1
    matrix = np.array([[CAMERA.f_px, 0, CAMERA.cx_px], [0, CAMERA.fy_px, CAMERA.cy_px], [0, 0, 1]])
    expected = cv2.projectPoints(dirs, np.zeros(3), np.zeros(3), matrix, None)[0][:, 0]
    np.testing.assert_allclose(CAMERA.project(dirs), expected, atol=TOLERANCE_PX, rtol=1e-12)


def test_behind_the_camera_is_nan():
    assert np.isnan(CAMERA.project([[0, 0, -1], [1, 0, 0]])).all()


def test_horizontal_field_of_view_is_edge_to_edge():
    camera = celnav.Camera.pinhole(width=1080, height=720, hfov_deg=120)
    left, right = camera.to_rays([[-0.5, 359.5], [1079.5, 359.5]])
    assert np.degrees(np.arccos(left @ right)) == pytest.approx(120)
    assert camera.f_px == pytest.approx(311.769, abs=1e-3)
    assert (camera.cx_px, camera.cy_px) == (539.5, 359.5)


def test_zenith_north_up_has_east_at_the_left_and_north_at_the_top():
    camera = celnav.Camera.pinhole(width=1080, height=720, hfov_deg=120)
    east, north = [0.3, 0, 0.95], [0, 0.3, 0.95]
    (u_east, v_east), (u_north, v_north) = camera.project(np.array([east, north]) @ Attitude.zenith_north_up().R_cam.T)
    assert u_east < 539.5
    assert v_east == pytest.approx(359.5)
    assert v_north < 359.5
    assert u_north == pytest.approx(539.5)


def test_solid_angle_is_the_integral_over_the_pixels():
    u, v = np.meshgrid((np.arange(1080) - CAMERA.cx_px) / CAMERA.f_px, (np.arange(720) - CAMERA.cy_px) / CAMERA.fy_px)
    integral = np.sum((1 + u**2 + v**2) ** -1.5) / CAMERA.f_px / CAMERA.fy_px
    assert pytest.approx(integral, rel=1e-5) == CAMERA.solid_angle_sr


def test_cameras_are_values():
    assert celnav.Camera.pinhole(10, 8, 60) == celnav.Camera.pinhole(10, 8, 60)
    assert len({celnav.Camera.pinhole(10, 8, 60), celnav.Camera.pinhole(10, 8, 60)}) == 1
