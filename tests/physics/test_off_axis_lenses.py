"""Decentring, thin prism and tilt of the sensor, of pinholes and fisheyes: generator, solver and study against OpenCV."""

import dataclasses
import math

import cv2
import numpy as np
import pytest
from small_scenes import small_scenario

import celnav
from benchmark.frames.dataset import load_image, open_dataset
from benchmark.studies.calibration.lens import derivatives, project
from celnav.command.camera_file import read_camera_file
from generator import plugins
from generator.frame.plan import plan_frame
from generator.frame.record import camera_object
from generator.frame.render import render_dataset
from generator.scenario.projection import Projection

WIDTH, HEIGHT = 1392, 1040
SCALE = {"f_px": 480.0, "fy_px": 482.0, "cx_px": 690.3, "cy_px": 525.1}
TERMS = {
    "decentring": {"p": (0.00065, -0.0003)},
    "prism": {"p": (0.0004, 0.0002), "s": (2e-3, -3e-4, -1e-3, 4e-4)},
    "tilt": {"tilt_rad": (0.013, -0.021)},
    "all": {"p": (0.00065, -0.0003), "s": (2e-3, -3e-4, -1e-3, 4e-4), "tilt_rad": (0.013, -0.021)},
}
LENSES = {
    "pinhole": {"model": "pinhole", "f_px": 900.0, "fy_px": 905.0},
    "brown_conrady": {
        "model": "brown_conrady",
        "f_px": 900.0,
        "fy_px": 905.0,
        "k": (-0.21, 0.05, -0.004, 0.01, 0.002, 5e-4),
    },
    "kannala_brandt": {"model": "kannala_brandt", "k": (-0.02, 0.004, -0.001, 1e-4)},
    "equidistant": {"model": "equidistant"},
    "equisolid": {"model": "equisolid"},
    "stereographic": {"model": "stereographic"},
    "orthographic": {"model": "orthographic", "f_px": 1000.0, "fy_px": 990.0},
}
LAWS = {
    "equidistant": lambda t: t,
    "equisolid": lambda t: 2 * np.sin(t / 2),
    "stereographic": lambda t: 2 * np.tan(t / 2),
    "orthographic": np.sin,
    "kannala_brandt": lambda t: t * np.polyval((1e-4, -0.001, 0.004, -0.02, 1), t * t),
}
BOTH = [(model, terms) for model in LENSES for terms in TERMS]


def lens(model, terms):
    return Projection(**(SCALE | LENSES[model] | TERMS[terms]))


def rays(largest_deg):
    theta, phi = (
        axis.ravel() for axis in np.meshgrid(np.radians(np.linspace(0.01, largest_deg, 40)), np.linspace(0, 6.2, 36))
    )
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=1)


def by_opencv(directions, projection):
    """cv2.projectPoints; of a fisheye, of the points that its law puts into the plane z = 1."""
    p, s, tilt = (projection.full_p or (0, 0)), (projection.full_s or (0,) * 4), (projection.full_tilt_rad or (0, 0))
    k = (0.0,) * 6
    if projection.model == "brown_conrady":
        k = projection.full_k
    elif projection.model != "pinhole":
        theta = np.arccos(directions[:, 2])
        radius = LAWS[projection.model](theta) / np.sin(theta)
        directions = np.column_stack((directions[:, :2] * radius[:, None], np.ones(len(directions))))
    coefficients = np.array([k[0], k[1], *p, *k[2:], *s, *tilt], dtype=float)
    matrix = np.array([[projection.f_px, 0, projection.cx_px], [0, projection.fy_px, projection.cy_px], [0, 0, 1.0]])
    return cv2.projectPoints(directions, np.zeros(3), np.zeros(3), matrix, coefficients)[0][:, 0]


def generated(projection):
    mi = plugins.start()
    import drjit as dr

    from generator.plugins.lens import make_lens

    number = dr.float64_array_t(mi.Float)
    return make_lens(projection, number), number


def solver_camera(projection):
    return celnav.Camera(
        width=WIDTH, height=HEIGHT,
        **{field.name: getattr(projection, field.name) for field in dataclasses.fields(projection)},
    )  # fmt: skip


@pytest.mark.parametrize(("model", "terms"), BOTH)
def test_against_opencv(model, terms) -> None:
    """Generator, solver and study, each with code of its own: less than 1e-6 px within 40 deg, of fisheyes 85 deg."""
    projection = lens(model, terms)
    directions = rays(40 if model in ("pinhole", "brown_conrady") else 85)
    expected = by_opencv(directions, projection)
    made, number = generated(projection)
    u, v, valid = made.project(*(number(np.ascontiguousarray(axis)) for axis in directions.T))
    assert np.array(valid).all()
    np.testing.assert_allclose(np.stack([np.array(u), np.array(v)], axis=1), expected, atol=1e-6)
    np.testing.assert_allclose(solver_camera(projection).project(directions), expected, atol=1e-6)
    np.testing.assert_allclose(project(directions, projection), expected, atol=1e-6)


@pytest.mark.parametrize(("model", "terms"), BOTH)
def test_there_and_back_everywhere_in_the_frame(model, terms) -> None:
    """Generator's rays into the solver's projection and the other way: less than 1e-4 px."""
    projection = lens(model, terms)
    v, u = (axis.ravel().astype(float) for axis in np.mgrid[-0.5:HEIGHT:13, -0.5:WIDTH:13])
    made, number = generated(projection)
    *ray, valid = made.unproject(number(u), number(v))
    seen = np.array(valid)
    assert seen.mean() > 0.95
    ours = np.stack([np.array(part) for part in ray], axis=1)[seen]
    theirs = solver_camera(projection)
    uv = np.column_stack((u, v))[seen]
    assert np.abs(theirs.project(ours) - uv).max() < 1e-4
    back = theirs.to_rays(uv)
    again_u, again_v, _ = made.project(*(number(np.ascontiguousarray(axis)) for axis in back.T))
    assert np.hypot(np.array(again_u) - uv[:, 0], np.array(again_v) - uv[:, 1]).max() < 1e-4


@pytest.mark.parametrize("model", sorted(LENSES))
def test_derivatives_and_scale_of_the_solver_s_camera(model) -> None:
    projection = lens(model, "all")
    camera, directions = solver_camera(projection), rays(35)
    uv, by_direction = camera.project_with_derivatives(directions)
    np.testing.assert_allclose(by_direction, derivatives(directions, projection), atol=1e-3)
    made, number = generated(projection)
    wanted = np.sqrt(np.array(made.solid_angle(*(number(np.ascontiguousarray(axis)) for axis in directions.T))))
    np.testing.assert_allclose(camera.radians_per_px(uv), wanted, rtol=1e-5)


def test_decentring_of_a_real_fisheye_is_of_the_size_that_was_measured() -> None:
    """p1 = 0.00065 at f = 480 px moves stars by 0.3 px 60 deg off axis: p1 (q + 2 b^2) f, q = (pi/3)^2."""
    straight, decentred = Projection("equidistant", **SCALE), Projection("equidistant", **SCALE, p=(0.00065,))
    theta = math.radians(60)
    across = np.array([[math.sin(theta), 0.0, math.cos(theta)], [0.0, math.sin(theta), math.cos(theta)]])
    moved = solver_camera(decentred).project(across) - solver_camera(straight).project(across)
    np.testing.assert_allclose(moved[:, 1], 0.00065 * theta**2 * 482.0 * np.array([1, 3]), atol=1e-9)


@pytest.mark.parametrize("count", [12, 14])
def test_calibrations_of_opencv_with_prism_and_tilt(tmp_path, count) -> None:
    coefficients = np.array(
        [-0.2, 0.05, 1e-3, -8e-4, -0.004, 0.01, 0.002, 5e-4, 2e-3, -3e-4, -1e-3, 4e-4, 0.01, -0.02]
    )[:count]
    matrix = np.array([[900.0, 0, 650.0], [0, 905.0, 500.0], [0, 0, 1]])
    file = cv2.FileStorage(str(tmp_path / "lens.yml"), cv2.FileStorage_WRITE)
    file.write("image_width", WIDTH)
    file.write("image_height", HEIGHT)
    file.write("camera_matrix", matrix)
    file.write("distortion_coefficients", coefficients.reshape(-1, 1))
    file.release()
    camera = read_camera_file(tmp_path / "lens.yml").camera
    directions = rays(35)
    expected = cv2.projectPoints(directions, np.zeros(3), np.zeros(3), matrix, coefficients)[0][:, 0]
    np.testing.assert_allclose(camera.project(directions), expected, atol=1e-6)


def test_a_frame_of_such_a_lens_through_record_dataset_and_solver(tmp_path) -> None:
    """Stars' positions in the table are where the solver's camera, read from the record, has them; and so are the pixels'."""
    scenario = small_scenario(
        camera__model="kannala_brandt", camera__hfov_deg=None, camera__f_px=120.0, camera__k=[-0.02],
        camera__p=[0.002, -0.001], camera__s=[0.002, 0.0, -0.001, 0.0], camera__tilt_rad=[0.02, -0.03],
        atmosphere__refraction=False, stars={"limiting_magnitude": 5.0},
    )  # fmt: skip
    render_dataset(scenario, tmp_path, exr=False)
    camera = celnav.Camera.from_json(tmp_path / "frame-00000.json")
    assert camera.s == (0.002, 0.0, -0.001, 0.0)
    assert camera.tilt_rad == (0.02, -0.03)
    plan = plan_frame(scenario, 0)
    spec = camera_object(plan.spec.camera)
    assert spec["p"] == [0.002, -0.001]
    frame = open_dataset(tmp_path).frames[0]
    given = celnav.Camera.from_dict(frame.observation.camera.as_given())
    assert given == camera
    enu = {int(star): direction for star, direction in zip(plan.stars.star_id, plan.middle.enu, strict=True)}
    wanted = camera.project(np.array([enu[int(star)] for star in frame.truth.star_id]) @ plan.motion.R_mid.T)
    np.testing.assert_allclose(frame.truth.uv, wanted, atol=1e-4)


@pytest.mark.parametrize("model", ["kannala_brandt", "brown_conrady"])
def test_the_solver_finds_the_site_through_such_a_lens(tmp_path, model) -> None:
    """Stars detected in a noise-free frame: the true lens gives the site within 1 km, without its terms it is 3 km off.

    The terms move stars by 1 to 5 px.
    """
    scenario = small_scenario(
        camera__width=1080, camera__height=720, camera__model=model, camera__hfov_deg=None, camera__f_px=380.0,
        camera__p=[0.003, -0.002], camera__s=[0.004, 0.0, -0.003, 0.0], camera__tilt_rad=[0.01, -0.02],
        sensor={"noise": False}, sky={"bortle": 1}, stars={"limiting_magnitude": 6.5},
    )  # fmt: skip
    render_dataset(scenario, tmp_path, exr=False)
    frame = open_dataset(tmp_path).frames[0]
    seen = frame.observation
    camera = celnav.Camera.from_dict(seen.camera.as_given())
    found = celnav.detect(load_image(frame))

    def error_km(lens: celnav.Camera) -> float:
        fix = celnav.solve(found, lens, seen.utc, celnav.Attitude.exact(seen.R_cam))
        if not fix.ok:
            return math.inf
        north = fix.lat_deg - 52.0
        east = (fix.lon_deg - 4.36) * math.cos(math.radians(52.0))
        return math.hypot(north, east) * 111.2

    assert error_km(camera) < 1.0
    assert error_km(dataclasses.replace(camera, p=(), s=(), tilt_rad=())) > 3.0
