"""Lens models: against OpenCV, there and back, solid angles, and nothing drawn outside of their range."""

import math

import cv2
import numpy as np
import pytest
from small_scenes import small_scenario

from generator import plugins
from generator.errors import ScenarioError
from generator.frame.exposure.expected import render_expected
from generator.frame.plan import plan_frame
from generator.frame.scene import scene_dict
from generator.scenario.projection import Projection

WIDTH, HEIGHT = 640, 480
CENTRE = {"cx_px": 311.3, "cy_px": 247.9}
OFF_AXIS = {"p": (1e-3, -8e-4), "s": (2e-3, -3e-4, -1e-3, 4e-4), "tilt_rad": (0.01, -0.02)}
CASES = {
    "pinhole": {"model": "pinhole", "f_px": 300.0, "fy_px": 310.0},
    "brown": {"model": "brown_conrady", "f_px": 400.0, "fy_px": 380.0, "k": (-0.21, 0.05, -0.004), "p": (1e-3, -8e-4)},
    "rational": {
        "model": "brown_conrady", "f_px": 350.0, "fy_px": 350.0, "k": (0.9, 0.3, 0.02, 1.2, 0.5, 0.06), "p": (-5e-4, 7e-4),
    },
    "kannala": {"model": "kannala_brandt", "f_px": 300.0, "fy_px": 290.0, "k": (-0.012, 0.006, -0.003, 2e-4)},
    "equidistant": {"model": "equidistant", "f_px": 190.0, "fy_px": 200.0},
    "equisolid": {"model": "equisolid", "f_px": 220.0, "fy_px": 220.0},
    "stereographic": {"model": "stereographic", "f_px": 150.0, "fy_px": 150.0},
    "orthographic": {"model": "orthographic", "f_px": 450.0, "fy_px": 440.0},
    "pinhole off axis": {"model": "pinhole", "f_px": 300.0, "fy_px": 310.0, **OFF_AXIS},
    "brown off axis": {
        "model": "brown_conrady", "f_px": 400.0, "fy_px": 380.0, "k": (-0.21, 0.05, -0.004), **OFF_AXIS,
    },
    "kannala off axis": {
        "model": "kannala_brandt", "f_px": 300.0, "fy_px": 290.0, "k": (-0.012, 0.006, -0.003, 2e-4), **OFF_AXIS,
    },
    "equidistant tilted": {"model": "equidistant", "f_px": 190.0, "fy_px": 200.0, "tilt_rad": (0.02, -0.03)},
    "equisolid off axis": {"model": "equisolid", "f_px": 220.0, "fy_px": 220.0, **OFF_AXIS},
    "stereographic decentred": {"model": "stereographic", "f_px": 150.0, "fy_px": 150.0, "p": (0.00065, 0.0003)},
    "orthographic prism": {"model": "orthographic", "f_px": 450.0, "fy_px": 440.0, "s": (1e-3, 0.0, -2e-3, 1e-4)},
}  # fmt: skip


def lens_of(case):
    mi = plugins.start()
    import drjit as dr

    from generator.plugins.lens import make_lens

    precise = dr.float64_array_t(mi.Float)
    projection = Projection(**(CENTRE | CASES[case]))
    return make_lens(projection, precise), projection, precise


def host(values):
    return [np.array(value) for value in values]


@pytest.mark.parametrize("case", sorted(CASES))
def test_there_and_back(case) -> None:
    """Every pixel of the frame, corners included: less than 1e-4 px."""
    lens, _, number = lens_of(case)
    v, u = (axis.ravel().astype(float) for axis in np.mgrid[-0.5:HEIGHT:4, -0.5:WIDTH:4])
    *direction, valid = lens.unproject(number(u), number(v))
    again_u, again_v, seen = lens.project(*direction)
    again_u, again_v, seen, valid = host([again_u, again_v, seen, valid])
    assert valid.all()
    assert seen.all()
    assert np.hypot(again_u - u, again_v - v).max() < 1e-4
    assert np.allclose(np.sum(np.square(host(direction)), axis=0), 1, atol=1e-12)


@pytest.mark.parametrize("case", ["pinhole", "brown", "rational", "kannala"])
def test_against_opencv(case) -> None:
    """Less than 1e-3 px over the whole frame."""
    lens, projection, number = lens_of(case)
    v, u = (axis.ravel().astype(float) for axis in np.mgrid[0:HEIGHT:7, 0:WIDTH:7])
    x, y, z, _ = lens.unproject(number(u), number(v))
    points = np.stack(host([x, y, z]), axis=1)
    matrix = np.array([[projection.f_px, 0, projection.cx_px], [0, projection.fy_px, projection.cy_px], [0, 0, 1.0]])
    if case == "kannala":
        image, _ = cv2.fisheye.projectPoints(
            points[:, None], np.zeros(3), np.zeros(3), matrix, np.array(projection.full_k)
        )
    else:
        k1, k2, k3, k4, k5, k6 = (projection.full_k + (0.0,) * 6)[:6]
        p1, p2 = (projection.full_p + (0.0,) * 2)[:2]
        image, _ = cv2.projectPoints(
            points, np.zeros(3), np.zeros(3), matrix, np.array([k1, k2, p1, p2, k3, k4, k5, k6])
        )
    ours = np.stack(host(lens.project(x, y, z)[:2]), axis=1)
    assert np.abs(ours - image.reshape(-1, 2)).max() < 1e-3
    assert np.abs(image.reshape(-1, 2) - np.stack([u, v], axis=1)).max() < 1e-3


@pytest.mark.parametrize(("model", "place"), [
    ("equidistant", lambda t: t), ("equisolid", lambda t: 2 * math.sin(t / 2)),
    ("stereographic", lambda t: 2 * math.tan(t / 2)), ("orthographic", math.sin),
])  # fmt: skip
def test_ideal_projections_by_hand(model, place) -> None:
    """Distances from the principal point at angles up to (and for some models beyond) 90 deg."""
    lens, projection, number = lens_of(model)
    for degrees in (0.0, 1e-5, 10.0, 45.0, 89.0, 120.0, 170.0):
        theta, around = math.radians(degrees), math.radians(37)
        x, y, z = math.sin(theta) * math.cos(around), math.sin(theta) * math.sin(around), math.cos(theta)
        u, v, valid = (np.array(value)[0] for value in lens.project(number(x), number(y), number(z)))
        if model == "orthographic" and degrees > 90:
            assert not valid
            continue
        assert valid
        assert u - projection.cx_px == pytest.approx(projection.f_px * place(theta) * math.cos(around), abs=1e-7)
        assert v - projection.cy_px == pytest.approx(projection.fy_px * place(theta) * math.sin(around), abs=1e-7)


def triangle_areas(a, b, c):
    """Solid angle of spherical triangles (Van Oosterom & Strackee 1983)."""
    triple = np.abs(np.einsum("ij,ij->i", a, np.cross(b, c)))
    dots = 1 + np.einsum("ij,ij->i", a, b) + np.einsum("ij,ij->i", b, c) + np.einsum("ij,ij->i", c, a)
    return 2 * np.arctan2(triple, dots)


@pytest.mark.parametrize("case", sorted(CASES))
def test_solid_angles_of_pixels_add_up_to_the_frame_s(case) -> None:
    """The sum over pixels is that of the spherical quadrilaterals that the pixels' corners span, within 1e-4."""
    lens, _, number = lens_of(case)
    v, u = (axis.ravel().astype(float) for axis in np.mgrid[0:HEIGHT, 0:WIDTH])
    x, y, z, _ = lens.unproject(number(u), number(v))
    total = np.array(lens.solid_angle(x, y, z)).sum()
    v, u = (axis.astype(float) for axis in np.mgrid[0 : HEIGHT + 1, 0 : WIDTH + 1])
    corner = np.stack(host(lens.unproject(number(u.ravel() - 0.5), number(v.ravel() - 0.5))[:3]), axis=1)
    corner = corner.reshape(HEIGHT + 1, WIDTH + 1, 3)
    corners = [corner[:-1, :-1], corner[:-1, 1:], corner[1:, 1:], corner[1:, :-1]]
    a, b, c, d = (part.reshape(-1, 3) for part in corners)
    wanted = triangle_areas(a, b, c).sum() + triangle_areas(a, c, d).sum()
    assert total == pytest.approx(wanted, rel=1e-4)


def test_nothing_is_folded_back() -> None:
    """Barrel distortion that turns around at tan(theta) = 1.29: what lies beyond is invalid, not drawn inside."""
    mi = plugins.start()
    import drjit as dr

    from generator.plugins.lens import make_lens

    number = dr.float64_array_t(mi.Float)
    projection = Projection("brown_conrady", 100, 100, 150, 150, k=(-0.2,))
    assert projection.limit == pytest.approx(math.sqrt(1 / 0.6), abs=2e-3)
    lens = make_lens(projection, number)
    tangent = np.array([0.5, 1.28, 1.30, 2.0, 50.0])
    *_, valid = lens.project(number(tangent), number(0 * tangent), number(0 * tangent + 1))
    assert np.array(valid).tolist() == [True, True, False, False, False]
    edge = 150 + 100 * projection.largest_radius
    *_, valid = lens.unproject(number([edge - 0.1, edge + 0.1]), number([150.0, 150.0]))
    assert np.array(valid).tolist() == [True, False]
    behind = lens.project(number([0.1]), number([0.1]), number([-1.0]))
    assert not np.array(behind[2])[0]


FISHEYE = {
    "camera__width": 240, "camera__height": 240, "camera__model": "equidistant", "camera__hfov_deg": None,
    "camera__f_px": 75.0,
}  # fmt: skip


def test_all_sky_fisheye_draws_a_disk_and_all_stars() -> None:
    """180 deg equidistant, looking up: black beyond the horizon's circle, and every star of the sky in the frame."""
    plan = plan_frame(small_scenario(**FISHEYE, stars={"limiting_magnitude": 4.0}), 0)
    expected = render_expected(plan)
    v, u = np.mgrid[0:240, 0:240]
    radius = np.hypot(u - 119.5, v - 119.5)
    horizon = 75.0 * math.pi / 2
    assert expected.sky_electrons[radius > horizon + 1].max() == 0
    assert expected.sky_electrons[radius < horizon - 1].min() > 0
    altitude = np.pi / 2 - np.hypot(expected.u_px - 119.5, expected.v_px - 119.5) / 75.0
    np.testing.assert_allclose(np.degrees(altitude), plan.middle.altitude_deg, atol=1e-4)
    low = (plan.middle.altitude_deg > 5) & (plan.middle.altitude_deg < 30)
    assert (expected.star_electrons[low] > 0).all()


def test_image_circle_and_vignetting_act_on_sky_and_stars_alike() -> None:
    """Ratio to the same frame without them: 0 outside the circle, 1 - 0.4 q inside, for both."""
    plain = render_expected(plan_frame(small_scenario(stars={"limiting_magnitude": 4.0}), 0))
    dimmed = render_expected(plan_frame(
        small_scenario(stars={"limiting_magnitude": 4.0}, camera__image_circle_px=100.0, camera__vignetting=[-0.4]), 0
    ))  # fmt: skip
    v, u = np.mgrid[0:180, 0:270]
    q = (np.square(u - 134.5) + np.square(v - 89.5)) / (135**2 + 90**2)
    wanted = np.where(q * (135**2 + 90**2) <= 100**2, 1 - 0.4 * q, 0)
    np.testing.assert_allclose(dimmed.sky_electrons / plain.sky_electrons, wanted, atol=1e-5)
    q = (np.square(plain.u_px - 134.5) + np.square(plain.v_px - 89.5)) / (135**2 + 90**2)
    inside = q * (135**2 + 90**2) < 99**2
    ratio = dimmed.star_electrons[inside] / plain.star_electrons[inside]
    np.testing.assert_allclose(ratio, 1 - 0.4 * q[inside], rtol=1e-3)
    outside = q * (135**2 + 90**2) > 101**2
    assert dimmed.star_electrons[outside & np.isfinite(q)].max() == 0


def test_plugin_takes_every_model() -> None:
    mi = plugins.start()
    for model in ("kannala_brandt", "stereographic", "equisolid", "orthographic", "brown_conrady"):
        plan = plan_frame(small_scenario(camera__model=model, camera__hfov_deg=None, camera__f_px=200.0), 0)
        image = np.array(mi.render(mi.load_dict(scene_dict(plan))))
        assert image.shape == (180, 270, 1)
        assert image.min() > 0


def test_a_steep_vignetting_within_a_small_image_circle() -> None:
    """1 - 3 q falls to 0 at 58 % of the corner's distance: allowed inside a circle of 50 %, dark outside it."""
    values = {"camera__vignetting": [-3.0], "stars": {"limiting_magnitude": 4.0}}
    corner_px = math.hypot(135, 90)
    with pytest.raises(ScenarioError, match="set image_circle_px below"):
        small_scenario(**values)
    with pytest.raises(ScenarioError, match="vignetting"):
        small_scenario(**values, camera__image_circle_px=0.6 * corner_px)
    dimmed = render_expected(plan_frame(small_scenario(**values, camera__image_circle_px=0.5 * corner_px), 0))
    plain = render_expected(plan_frame(small_scenario(stars={"limiting_magnitude": 4.0}), 0))
    v, u = np.mgrid[0:180, 0:270]
    q = (np.square(u - 134.5) + np.square(v - 89.5)) / corner_px**2
    wanted = np.where(q <= 0.25, 1 - 3 * q, 0)
    np.testing.assert_allclose(dimmed.sky_electrons / plain.sky_electrons, wanted, atol=1e-5)
    np.testing.assert_array_equal(dimmed.electrons[q > 0.4], 0)


REFUSED = {
    "folded by decentring": (
        {"camera__model": "equidistant", "camera__p": [0.5]},
        ["camera", "p, s, tilt_rad: the image folds over"],
    ),
    "folded by tilt": (
        {"camera__model": "equidistant", "camera__f_px": 30.0, "camera__tilt_rad": [0.4]},
        ["camera", "folds over"],
    ),
    "large tilt": ({"camera__tilt_rad": [0.0, 0.6]}, ["camera", "tilt_rad", "0.5"]),
    "long prism": ({"camera__s": [0.0] * 5}, ["camera", "s: found 5 numbers, expected at most 4"]),
    "folding": (
        {"camera__model": "brown_conrady", "camera__k": [-0.5]},
        ["camera", "k: the distortion stops increasing"],
    ),
    "too many": (
        {"camera__model": "pinhole", "camera__k": [0.1]},
        ["camera", "k: found 1 numbers, expected at most 0"],
    ),
    "no model": ({"camera__model": "mirror"}, ["camera.model", "mirror", "kannala_brandt"]),
    "bright vignetting": ({"camera__vignetting": [0.4]}, ["camera", "vignetting", "0 to 1"]),
    "two scales": ({"camera__hfov_deg": 60}, ["camera", "exactly one of hfov_deg"]),
    "preset": ({"camera__preset": "phone"}, ["camera.preset", "phone", "imx477-6mm"]),
}


@pytest.mark.parametrize("case", sorted(REFUSED))
def test_bad_lenses_are_refused(case) -> None:
    values, fragments = REFUSED[case]
    base = {"camera__hfov_deg": None, "camera__f_px": 100.0}
    with pytest.raises(ScenarioError) as caught:
        small_scenario(**(base | values))
    for fragment in fragments:
        assert fragment in str(caught.value)


@pytest.mark.parametrize("preset", ["thesis-720p", "imx477-6mm", "imx290-8mm", "imx462-fisheye", "machine-vision-mono"])
def test_presets_fill_camera_and_sensor(preset) -> None:
    spec = small_scenario(camera={"preset": preset}).frame(0)
    assert spec.camera.width >= 1080
    assert small_scenario(camera={"preset": preset, "aperture_mm": 1.5}).frame(0).camera.aperture_mm == 1.5
