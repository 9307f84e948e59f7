"""Camera models against OpenCV, their inverses, and fields of 180 degrees and beyond."""

import cv2
import numpy as np
import pytest

import celnav

K_BROWN, P_BROWN = (-0.25, 0.08, -0.01, 0.01, 0.002, 0.0005), (0.001, -0.002)
K_FISHEYE = (0.05, -0.01, 0.002, -0.0003)
MATRIX = np.array([[300.0, 0, 540.0], [0, 310.0, 360.0], [0, 0, 1]])
IDEAL = {
    "equidistant": lambda t: t,
    "equisolid": lambda t: 2 * np.sin(t / 2),
    "stereographic": lambda t: 2 * np.tan(t / 2),
    "orthographic": np.sin,
}


def camera(model, k=(), p=()):
    return celnav.Camera(model, 1080, 720, f_px=300.0, fy_px=310.0, cx_px=540.0, cy_px=360.0, k=k, p=p)


def directions(n=400, least_z=0.4):
    dirs = np.random.default_rng(0).normal(size=(n, 3))
    dirs[:, 2] = np.abs(dirs[:, 2]) + least_z
    return dirs / np.linalg.norm(dirs, axis=1, keepdims=True)


def test_brown_conrady_is_opencvs():
    dirs = directions()
    ours = camera("brown_conrady", K_BROWN, P_BROWN).project(dirs)
    coefficients = np.array([*K_BROWN[:2], *P_BROWN, *K_BROWN[2:]])
    expected = cv2.projectPoints(dirs, np.zeros(3), np.zeros(3), MATRIX, coefficients)[0][:, 0]
    known = np.isfinite(ours[:, 0])
    assert known.mean() > 0.5
    np.testing.assert_allclose(ours[known], expected[known], atol=1e-9)


def test_kannala_brandt_is_opencvs_fisheye():
    dirs = directions()
    expected = cv2.fisheye.distortPoints((dirs[:, :2] / dirs[:, 2:])[:, None], MATRIX, np.array(K_FISHEYE))[:, 0]
    np.testing.assert_allclose(camera("kannala_brandt", K_FISHEYE).project(dirs), expected, atol=1e-9)


@pytest.mark.parametrize(("model", "law"), IDEAL.items())
def test_ideal_laws(model, law):
    theta = np.array([0.0, 0.3, 1.0, 1.5])
    dirs = np.column_stack((np.sin(theta), np.zeros(4), np.cos(theta)))
    np.testing.assert_allclose(camera(model).project(dirs)[:, 0], 540 + 300 * law(theta), atol=1e-9)


@pytest.mark.parametrize(
    ("model", "k", "p"),
    [("brown_conrady", K_BROWN, P_BROWN), ("kannala_brandt", K_FISHEYE, ()), *[(model, (), ()) for model in IDEAL]],
)
def test_round_trip(model, k, p):
    lens = camera(model, k, p)
    u, v = (axis.ravel() for axis in np.meshgrid(np.linspace(0, 1079, 40), np.linspace(0, 719, 30)))
    uv = np.column_stack((u, v))
    rays = lens.to_rays(uv)
    seen = np.isfinite(rays[:, 0])
    assert seen.mean() > 0.3
    np.testing.assert_allclose(np.linalg.norm(rays[seen], axis=1), 1)
    np.testing.assert_allclose(lens.project(rays[seen]), uv[seen], atol=1e-6)


@pytest.mark.parametrize("model", ["equidistant", "equisolid", "stereographic", "kannala_brandt"])
def test_a_fisheye_sees_behind_itself(model):
    lens = celnav.Camera(model, 1000, 1000, f_px=150.0, k=K_FISHEYE[:1] if model == "kannala_brandt" else ())
    theta = np.radians(110)
    back = np.array([[0.0, np.sin(theta), np.cos(theta)]])
    np.testing.assert_allclose(lens.to_rays(lens.project(back)), back, atol=1e-9)


def test_where_a_camera_cannot_see_is_nan():
    assert np.isnan(camera("orthographic").project([[1, 0, -0.1]])).all()
    assert np.isnan(camera("orthographic").to_rays([[0.0, 0.0]])).all()
    strong = camera("brown_conrady", (-0.5,))  # the radius turns back at 0.8165 of the focal length
    assert np.isnan(strong.project([[1.0, 0.0, 1.0]])).all()
    assert np.isfinite(strong.project([[0.8, 0.0, 1.0]])).all()


@pytest.mark.parametrize("model", celnav.camera.MODELS)
def test_scale_and_derivatives_are_those_of_the_projection(model):
    lens = camera(model, {"brown_conrady": K_BROWN, "kannala_brandt": K_FISHEYE}.get(model, ()))
    dirs = directions(50, 1.5)
    uv, by_direction = lens.project_with_derivatives(dirs)
    step = 1e-5 * np.random.default_rng(1).normal(size=dirs.shape)
    moved = lens.project(dirs + step) - uv
    np.testing.assert_allclose(np.einsum("nij,nj->ni", by_direction, step), moved, atol=1e-6)
    corners = lens.to_rays(np.concatenate([uv + np.array([a, b]) for a, b in ((-0.5, -0.5), (0.5, -0.5), (-0.5, 0.5))]))
    a, b, c = corners.reshape(3, -1, 3)
    solid = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    np.testing.assert_allclose(lens.radians_per_px(uv) ** 2, solid, rtol=2e-2)


@pytest.mark.parametrize(
    ("model", "k", "p"),
    [
        ("equidistant", (0.1,), ()),
        ("kannala_brandt", (), (0.1, 0.0, 0.1)),
        ("kannala_brandt", (0.1, 0.0, 0.0, 0.0, 0.1), ()),
        ("brown_conrady", (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.1), ()),
        ("brown_conrady", (np.nan,), ()),
    ],
)
def test_coefficients_that_a_model_does_not_take(model, k, p):
    with pytest.raises(celnav.CelnavError, match=r"camera"):
        camera(model, k, p)


def test_solid_angle_of_a_hemisphere():
    lens = celnav.Camera("equisolid", 2000, 2000, f_px=1000 / 2**0.5)
    # The circle of 180 degrees just fits; the corners beyond it see behind the camera: f^-2 per pixel everywhere.
    assert lens.solid_angle_sr == pytest.approx(4e6 / lens.f_px**2, rel=0.01)


def test_pixels_far_beyond_the_frame_have_rays_without_a_warning():
    """A camera that is being fitted may put the middle anywhere."""
    rays = celnav.Camera("brown_conrady", 100, 100, 100.0).to_rays([[1e14, 49.5]])
    np.testing.assert_allclose(rays, [[1.0, 0.0, 1e-12]], atol=1e-10)
