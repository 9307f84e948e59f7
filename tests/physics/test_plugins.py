"""The Mitsuba plugins: usable in a scene of the user's own, and in agreement with Mitsuba's own integrator."""

import numpy as np
import pytest
from scipy import stats
from small_scenes import small_scenario

from generator import plugins
from generator.frame.exposure.expected import render_expected
from generator.frame.plan import plan_frame
from generator.frame.scene import scene_dict
from generator.plugins.scene_tensors import array, tensor


@pytest.fixture(scope="module")
def mi():
    return plugins.start()


def test_scene_dict_loads_the_registered_plugins(mi) -> None:
    scene = mi.load_dict(scene_dict(plan_frame(small_scenario(), 0)))
    assert "NightSkyCamera[270 x 180" in str(scene.sensors()[0])
    assert "DiffuseSkyEmitter" in str(scene.environment())
    assert "NightSkyIntegrator" in str(scene.integrator())
    image = np.array(mi.render(scene))
    assert image.shape == (180, 270, 1)
    assert image.min() > 0


def test_sky_agrees_with_mitsuba_s_path_integrator(mi) -> None:
    """Random wavelengths and film positions, 4,096 samples in each of 12 batches: every pixel within its noise.

    z-test with Sidak's correction over 96 pixels, false-alarm rate 1e-4 overall.
    """
    plan = plan_frame(
        small_scenario(
            camera__width=12,
            camera__height=8,
            camera__hfov_deg=90,
            sky={"bortle": 4, "components": ["airglow", "zodiacal", "skyglow"]},
            stars={"limiting_magnitude": -2.0},
        ),
        0,
    )
    scene = scene_dict(plan)
    ours = np.array(mi.load_dict(scene).integrator().render(mi.load_dict(scene)))[:, :, 0]
    path = mi.load_dict({"type": "path", "max_depth": 2})
    del scene["stars"]
    batches = np.array([np.array(path.render(mi.load_dict(scene), seed=seed, spp=4096))[:, :, 0] for seed in range(12)])
    mean, error = batches.mean(axis=0), batches.std(axis=0, ddof=1) / np.sqrt(12)
    # A ray through the centre stands for the mean over these very large pixels (7.5 deg): 0.3 % of curvature is allowed.
    deviation = np.maximum(np.abs(mean - ours) - 3e-3 * ours, 0) / error
    p_value = 2 * stats.t.sf(deviation.max(), df=11)
    assert 1 - (1 - p_value) ** 96 > 1e-4
    assert np.abs(mean / ours - 1).max() < 0.02


def test_geometry_hides_sky_and_stars(mi) -> None:
    """A wall over the image's left half (the east): black there, untouched elsewhere."""
    plan = plan_frame(small_scenario(stars={"limiting_magnitude": 4.0}), 0)
    open_sky = scene_dict(plan)
    half = mi.ScalarTransform4f().translate([50, 0, 10]).rotate([1, 0, 0], 180).scale([50, 500, 1])
    walled = open_sky | {"wall": {"type": "rectangle", "to_world": half}}
    free = np.array(mi.render(mi.load_dict(open_sky)))[:, :, 0]
    hidden = np.array(mi.render(mi.load_dict(walled)))[:, :, 0]
    assert hidden[:, :125].max() == 0
    np.testing.assert_array_equal(hidden[:, 145:], free[:, 145:])


def test_wavelength_sampling_is_converged() -> None:
    """Four times the wavelengths change no pixel's sky by more than 0.1 % and no star's light by more than 0.2 %."""
    mi = plugins.start()
    plan = plan_frame(small_scenario(stars={"limiting_magnitude": 5.0}), 0)
    coarse = render_expected(plan)
    description = scene_dict(plan)
    description["integrator"]["wavelength_groups"] = 132
    scene = mi.load_dict(description)
    camera = scene.sensors()[0]
    camera.film().prepare([])
    fine_sky = np.array(scene.integrator().diffuse(scene, camera))[:, :, 0]
    np.testing.assert_allclose(coarse.sky_electrons, fine_sky, rtol=1e-3)
    emitter = next(emitter for emitter in scene.emitters() if emitter.id() == "stars")
    fine_stars = scene.integrator().electrons_by_band(camera, emitter, 1)[:, 0, 0]
    boresight = plan.spec.R_cam[2]
    in_front = plan.middle.enu @ boresight > 0.1
    ratio = coarse.star_electrons[in_front] / (fine_stars * (plan.middle.enu @ boresight))[in_front]
    np.testing.assert_allclose(ratio, 1, atol=2e-3)


def test_attitude_may_change_during_the_exposure(mi) -> None:
    """A camera that rolls by 20 deg: stars sweep arcs, whose flux-weighted middle is the mid-exposure position."""
    plan = plan_frame(
        small_scenario(camera__width=540, camera__height=360, sky=None, stars={"limiting_magnitude": 2.0}), 0
    )
    description = scene_dict(plan)
    angles = np.radians(np.linspace(-10, 10, 21))
    turned = [[[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]] @ plan.spec.R_cam for a in angles]
    description["camera"]["attitude"] = mi.TensorXf(np.array(turned, dtype=np.float32))
    rolled = np.array(mi.render(mi.load_dict(description)))[:, :, 0].astype(np.float64)
    still = render_expected(plan).electrons.astype(np.float64)
    v, u = np.mgrid[0:360, 0:540]
    radius = np.hypot(u - 269.5, v - 179.5)
    rings = [(radius >= r) & (radius < r + 30) for r in range(0, 150, 30)]
    for ring in rings:
        assert rolled[ring].sum() == pytest.approx(still[ring].sum(), rel=0.02, abs=still.sum() * 1e-3)
    assert rolled.max() < 0.3 * still.max()


def test_bad_parameters_are_refused(mi) -> None:
    description = scene_dict(plan_frame(small_scenario(), 0))
    description["camera"]["model"] = "mirror"
    with pytest.raises(RuntimeError, match="mirror"):
        mi.load_dict(description)
    description = scene_dict(plan_frame(small_scenario(), 0))
    description["sky"]["spectra"] = mi.TensorXf(np.ones((1, 5), np.float32))
    with pytest.raises(RuntimeError, match="spectral table"):
        mi.load_dict(description)


def test_three_stars_and_three_attitudes_leave_the_terminal_in_peace(mi, capfd) -> None:
    """Mitsuba tries tensors of three rows as colours, and would complain."""
    plan = plan_frame(small_scenario(sky=None, motion={"rate_deg_s": [0.0, 0.0, 1.0], "samples": 3}), 0)
    description = scene_dict(plan)
    stars = description["stars"]
    brightest = np.argsort(array(stars["v_mag"], 1))[:3]
    for name in ("directions", "v_mag", "colour_row", "colour_column", "airmass"):
        stars[name] = tensor(array(stars[name], 3 if name == "directions" else 1)[brightest])
    light = np.array(mi.render(mi.load_dict(description)))
    assert light.sum() > 0
    assert capfd.readouterr().err == ""
