"""The differentiable star pass: the renderer's own image, derivatives as by differences, and a camera found by them."""

import math

import numpy as np
import pytest
from scipy import stats
from scipy.spatial.transform import Rotation
from small_scenes import small_scenario

from benchmark.studies.calibration.camera_by_gradient import difference, passed_share, recover_camera, spoiled
from generator import plugins
from generator.frame.exposure.expected import render_expected
from generator.frame.plan import plan_frame
from generator.frame.scene import scene_dict

LENS = {"model": "brown_conrady", "width": 270, "height": 180, "f_px": 180.0, "k": [-0.1], "aperture_mm": 4}


@pytest.fixture(scope="module")
def mi():
    return plugins.start()


def load(mi, plan):
    scene = mi.load_dict(scene_dict(plan))
    scene.sensors()[0].film().prepare([])
    return scene


def rendered(scene):
    emitter = next(one for one in scene.emitters() if one.id() == "stars")
    return np.array(scene.integrator().stars(scene, scene.sensors()[0], emitter), dtype=np.float64)[:, :, 0]


@pytest.mark.parametrize(
    ("lens", "exposure_s", "rolling"),
    [
        (LENS, 0.5, None),
        (LENS | {"model": "kannala_brandt", "k": [0.02]}, 20.0, None),
        (LENS, 0.5, {"line_time_us": 300}),
    ],
    ids=["still", "trailed fisheye", "rolling shutter"],
)
def test_it_renders_what_the_renderer_does(mi, lens, exposure_s, rolling) -> None:
    """Pixel by pixel to 1e-4 of the brightest: the renderer gives faint stars fewer moments and smaller stamps."""
    from generator.plugins.star_gradient import DifferentiableStars

    scene = load(
        mi, plan_frame(small_scenario(camera=lens, time__exposure_s=exposure_s, sensor__rolling_shutter=rolling), 0)
    )
    expected = rendered(scene)
    found = DifferentiableStars(scene).image(np.zeros(5), derivatives=False).electrons
    assert expected.max() > 500
    assert np.abs(found - expected).max() < 1e-4 * expected.max()
    assert found.sum() == pytest.approx(expected.sum(), rel=1e-4)


@pytest.mark.parametrize(
    "astray",
    [
        {},
        {"veiling_glare": 0.03, "haze": 0.02, "dew": {"share": 0.1}, "dust": {"specks": 40}},
    ],
    ids=["by default", "dewy and dusty"],
)
def test_the_light_of_a_frame_is_the_sky_and_what_the_lens_passes_of_the_stars(mi, astray) -> None:
    """The recovery's prediction is the frame without noise, to 1e-4 of the brightest pixel: it takes the rest for noise."""
    from generator.plugins.star_gradient import DifferentiableStars

    plan = plan_frame(small_scenario(camera=LENS | astray), 0)
    expected = render_expected(plan)
    stars = DifferentiableStars(load(mi, plan)).image(np.zeros(5), derivatives=False).electrons
    assert plan.spec.camera.direct_share < 0.95
    largest = 1e-4 * stars.max()
    assert np.abs(passed_share(plan) * stars + expected.sky_electrons - expected.electrons).max() < largest
    assert np.abs(stars + expected.sky_electrons - expected.electrons).max() > 100 * largest


def test_a_changed_camera_is_the_renderer_s_with_those_numbers(mi) -> None:
    """Values of the parameters mean what they say: the renderer's picture through a camera made with them."""
    from generator.plugins.star_gradient import DifferentiableStars

    plan = plan_frame(small_scenario(camera=LENS), 0)
    values = np.array([0.004, 0.01, 0.003, -0.002, 0.005])
    # The class takes twice a Gibbs vector, the plan a rotation vector.
    angle = 2 * math.atan(float(np.linalg.norm(values[2:])) / 2)
    change = np.concatenate((values[:2], values[2:] * angle / np.linalg.norm(values[2:])))
    through = rendered(load(mi, spoiled(plan, change)))
    found = DifferentiableStars(load(mi, plan)).image(values, derivatives=False).electrons
    assert np.abs(found - through).max() < 1e-4 * through.max()
    assert np.abs(found - rendered(load(mi, plan))).max() > 0.1 * through.max()


def test_derivatives_are_those_of_differences(mi) -> None:
    from generator.plugins.star_gradient import PARAMETERS, DifferentiableStars

    stars = DifferentiableStars(load(mi, plan_frame(small_scenario(camera=LENS), 0)))
    values = np.array([0.001, -0.002, 0.001, 0.002, -0.001])
    image = stars.image(values)
    assert image.derivatives.shape == (5, 180, 270)
    for place, (name, h) in enumerate(zip(PARAMETERS, (1e-5, 1e-5, 1e-6, 1e-6, 1e-6), strict=True)):
        step = np.zeros(5)
        step[place] = h
        ends = [stars.image(values + sign * step, derivatives=False).electrons for sign in (1, -1)]
        by_difference = (ends[0] - ends[1]) / (2 * h)
        largest = np.abs(by_difference).max()
        assert np.abs(image.derivatives[place] - by_difference).max() < 2e-4 * largest, name


def test_the_camera_is_the_scene_s_again_afterwards(mi) -> None:
    from generator.plugins.star_gradient import DifferentiableStars

    scene = load(mi, plan_frame(small_scenario(camera=LENS), 0))
    before = rendered(scene)
    DifferentiableStars(scene).image(np.full(5, 0.01))
    np.testing.assert_array_equal(rendered(scene), before)


@pytest.mark.parametrize(
    ("camera", "message"),
    [
        (LENS | {"model": "pinhole", "k": []}, "has no k1"),
        (LENS | {"psf": {"moffat": {"fwhm_px": 2.0, "beta": 3.0}}}, "Gaussian"),
    ],
)
def test_what_is_left_out_is_refused(mi, camera, message) -> None:
    from generator.plugins.star_gradient import DifferentiableStars

    with pytest.raises(ValueError, match=message):
        DifferentiableStars(load(mi, plan_frame(small_scenario(camera=camera), 0)))


def test_difference_undoes_spoiling() -> None:
    plan = plan_frame(small_scenario(camera=LENS), 0)
    change = np.array([0.01, -0.02, 0.003, 0.001, -0.004])
    told = spoiled(plan, change)
    np.testing.assert_allclose(difference(plan, told, np.zeros(5)), change, atol=1e-12)
    back = Rotation.from_rotvec(-change[2:]).as_quat()
    values = np.concatenate((-change[:2], 2 * back[:3] / back[3]))
    np.testing.assert_allclose(difference(plan, told, values), 0, atol=1e-12)


@pytest.mark.slow
def test_the_camera_is_found_to_its_bound_on_ten_frames() -> None:
    """The sum of 50 squared errors in the bound's metric is chi^2 with 50 degrees: false-alarm rate 1e-3.

    And each parameter's root mean square error is below three times the bound.
    """
    night = {"utc": ["2020-01-01T00:00:00Z", "2020-12-31T00:00:00Z"], "sun_below_deg": -18}
    scenario = small_scenario(
        camera=LENS,
        site={"latitude_deg": {"uniform": [-50, 50]}, "longitude_deg": {"uniform": [-180, 180]}},
        time={"utc_start": night, "exposure_s": 0.5},
        sky={"bortle": 3, "components": ["airglow", "zodiacal", "milky_way", "skyglow"]},
        stars={"limiting_magnitude": 6.0},
        frames=10,
    )
    found = [recover_camera(scenario, index) for index in range(10)]
    errors = np.array([one.error / one.sigma for one in found])
    assert (np.sqrt(np.mean(errors**2, axis=0)) < 3).all()
    low, high = stats.chi2.ppf([0.0005, 0.9995], 50)
    assert low < sum(one.nees for one in found) < high
    # The told camera is far outside what the bound allows.
    assert min(float(np.abs(one.start / one.sigma).max()) for one in found) > 20
    assert all(one.path_px[-1] < 0.05 * one.path_px[0] for one in found)
