"""Light of a rendered star: all of it lands on the pixels, whatever its place, and on geometry too."""

import numpy as np
import pytest
from scipy.stats import norm
from small_scenes import small_scenario

from generator import plugins
from generator.frame.exposure.expected import render_expected
from generator.frame.plan import plan_frame
from generator.frame.scene import scene_dict


def isolated(expected, reach):
    """Rows of stars that share their surroundings with no other star that could be drawn there."""
    u, v = expected.u_px, expected.v_px
    known = np.isfinite(u)
    rows = []
    for row in np.nonzero(known)[0]:
        close = np.hypot(u - u[row], v - v[row]) < 2 * reach
        if close.sum() == 1:
            rows.append(row)
    return np.array(rows)


def sum_around(image, u, v, reach):
    rows, columns = np.mgrid[0 : image.shape[0], 0 : image.shape[1]]
    return float(image[np.hypot(columns - u, rows - v) < reach].astype(np.float64).sum())


def test_electrons_over_a_star_s_pixels_are_its_flux() -> None:
    """Within 1 % anywhere in the field, and by the expected fraction across the frame's edge."""
    scenario = small_scenario(camera__width=540, camera__height=360, sky=None, stars={"limiting_magnitude": 3.5})
    plan = plan_frame(scenario, 0)
    expected = render_expected(plan)
    sigma = plan.spec.camera.psf_sigma_px
    reach = 8 * sigma + 2
    inside = outside = 0
    for row in isolated(expected, reach):
        u, v = expected.u_px[row], expected.v_px[row]
        if not (-3 < u < 542 and -3 < v < 362):
            continue
        across = norm.cdf((539.5 - u) / sigma) - norm.cdf((-0.5 - u) / sigma)
        down = norm.cdf((359.5 - v) / sigma) - norm.cdf((-0.5 - v) / sigma)
        wanted = expected.star_electrons[row] * across * down
        assert expected.fraction_in_frame[row] == pytest.approx(across * down, abs=1e-6)
        if across * down > 1e-3:
            assert sum_around(expected.electrons, u, v, reach) == pytest.approx(wanted, rel=0.01)
            inside += 1
            outside += across * down < 0.95
    assert inside > 30


def test_star_half_across_the_edge_leaves_its_expected_fraction() -> None:
    """The camera is turned until a bright star's centre lies on the frame's edge: half of its light remains, within 1 %."""
    base = small_scenario(sky=None, camera__hfov_deg=20, stars={"limiting_magnitude": 1.0})
    places = plan_frame(base, 0).middle
    brightest = int(np.argmax(places.altitude_deg))
    half_field = 10.0
    attitude = {
        "azimuth_deg": float(places.azimuth_deg[brightest]),
        "altitude_deg": float(places.altitude_deg[brightest]),
    }
    for roll in (0.0, 37.0):
        centred = small_scenario(
            sky=None,
            camera__hfov_deg=2 * half_field,
            stars={"limiting_magnitude": 1.0},
            attitude=attitude | {"roll_deg": roll},
        )
        plan = plan_frame(centred, 0)
        focal = plan.spec.camera.f_px
        whole = render_expected(plan)
        assert whole.u_px[brightest] == pytest.approx(134.5, abs=1e-3)
        assert whole.v_px[brightest] == pytest.approx(89.5, abs=1e-3)
        # The star moves to the right edge (u = 269.5) when the boresight turns left about the image's vertical.
        turn = np.arctan((269.5 - 134.5) / focal)
        right, down, ahead = plan.spec.R_cam
        boresight = np.cos(turn) * ahead - np.sin(turn) * right
        azimuth, altitude = np.degrees(np.arctan2(boresight[0], boresight[1])), np.degrees(np.arcsin(boresight[2]))
        up_there = np.array(
            [-np.sin(np.radians(azimuth)) * np.sin(np.radians(altitude)),
             -np.cos(np.radians(azimuth)) * np.sin(np.radians(altitude)), np.cos(np.radians(altitude))]
        )  # fmt: skip
        across_there = np.cross(boresight, up_there)
        new_roll = np.degrees(np.arctan2(-down @ across_there, -down @ up_there))
        edge = small_scenario(
            sky=None,
            camera__hfov_deg=2 * half_field,
            stars={"limiting_magnitude": 1.0},
            attitude={"azimuth_deg": float(azimuth), "altitude_deg": float(altitude), "roll_deg": float(new_roll)},
        )
        half = render_expected(plan_frame(edge, 0))
        assert half.u_px[brightest] == pytest.approx(269.5, abs=2e-3)
        assert half.fraction_in_frame[brightest] == pytest.approx(0.5, abs=2e-3)
        on_frame = sum_around(half.electrons, half.u_px[brightest], half.v_px[brightest], 12)
        assert on_frame == pytest.approx(0.5 * half.star_electrons[brightest], rel=0.01)


def test_psf_is_the_gaussian_that_galsim_users_expect() -> None:
    """Second moments of a rendered star: sigma^2 plus the pixel's 1/12, within 0.5 %."""
    scenario = small_scenario(sky=None, camera__width=540, camera__height=360, stars={"limiting_magnitude": 2.5},
                              camera__psf_sigma_px=1.3)  # fmt: skip
    expected = render_expected(plan_frame(scenario, 0))
    rows = isolated(expected, 25)
    rows = [row for row in rows if 20 < expected.u_px[row] < 520 and 20 < expected.v_px[row] < 340]
    assert len(rows) >= 5
    for row in rows:
        v, u = np.mgrid[0:360, 0:540]
        near = np.hypot(u - expected.u_px[row], v - expected.v_px[row]) < 14
        weight = expected.electrons[near].astype(np.float64)
        variance = np.average((u[near] - expected.u_px[row]) ** 2, weights=weight)
        assert variance == pytest.approx(1.3**2 + 1 / 12, rel=0.005)
        assert np.average(u[near], weights=weight) == pytest.approx(expected.u_px[row], abs=0.002)
        assert np.average(v[near], weights=weight) == pytest.approx(expected.v_px[row], abs=0.002)


def test_trailed_star_keeps_its_flux_and_fills_its_path() -> None:
    """A five-minute exposure: flux within 1 %, and the streak is as long as the star's path."""
    scenario = small_scenario(
        time__exposure_s=300.0,
        camera__hfov_deg=60,
        camera__width=540,
        camera__height=360,
        sky=None,
        stars={"limiting_magnitude": 4.0},
    )
    plan = plan_frame(scenario, 0)
    expected = render_expected(plan)
    length_px = 300 * 15.041 / 3600 / np.degrees(1 / plan.spec.camera.f_px)
    rows = isolated(expected, length_px)
    edge = length_px
    rows = [row for row in rows if edge < expected.u_px[row] < 539 - edge and edge < expected.v_px[row] < 359 - edge]
    assert len(rows) >= 5
    for row in rows:
        total = sum_around(expected.electrons, expected.u_px[row], expected.v_px[row], length_px)
        assert total == pytest.approx(expected.star_electrons[row], rel=0.01)
        v, u = np.mgrid[0:360, 0:540]
        near = np.hypot(u - expected.u_px[row], v - expected.v_px[row]) < length_px
        weight = expected.electrons[near].astype(np.float64)
        spread = np.sqrt(
            np.average((u[near] - expected.u_px[row]) ** 2 + (v[near] - expected.v_px[row]) ** 2, weights=weight)
        )
        ends = np.stack([plan.start.enu[row], plan.end.enu[row]]) @ plan.spec.R_cam.T
        (u0, v0), (u1, v1) = plan.spec.camera.f_px * ends[:, :2] / ends[:, 2:]
        path = np.hypot(u1 - u0, v1 - v0)
        assert spread == pytest.approx(np.hypot(path / np.sqrt(12), np.sqrt(2 * (0.8**2 + 1 / 12))), rel=0.01)


def test_stars_light_geometry_with_the_flux_that_they_are_drawn_with() -> None:
    """A white floor under the stars alone: radiance = sum of irradiance x cosine / pi, within 1 % (direct lighting)."""
    mi = plugins.start()
    plan = plan_frame(small_scenario(stars={"limiting_magnitude": 3.0}, atmosphere={"extinction": False}), 0)
    stars = scene_dict(plan)["stars"]
    scene = mi.load_dict(
        {
            "type": "scene",
            "stars": stars,
            "floor": {
                "type": "rectangle",
                "bsdf": {"type": "diffuse", "reflectance": {"type": "uniform", "value": 1.0}},
            },
        }
    )
    import drjit as dr

    samples = 400_000
    rays = mi.Ray3f(mi.Point3f(0, 0, 1), mi.Vector3f(0, 0, -1), mi.Float(0.5), mi.Spectrum(450, 550, 650, 750))
    si = scene.ray_intersect(rays)
    it = dr.gather(mi.SurfaceInteraction3f, si, dr.zeros(mi.UInt32, samples))
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(11, samples)
    ds, weight = scene.sample_emitter_direction(it, sampler.next_2d())
    wo = it.to_local(ds.d)
    value = it.bsdf().eval(mi.BSDFContext(), it, wo)
    radiance = np.array(value * weight).mean(axis=1)

    from generator.light.photometry import GRID_NM
    from generator.light.stellar_spectra import star_spectra

    spectra = star_spectra(plan.stars.v_mag, plan.stars.bv_mag, plan.stars.vi_mag)
    cosine = plan.middle.enu[:, 2]
    wanted = [
        float(np.sum(cosine * [np.interp(nm, GRID_NM, row) for row in spectra])) / np.pi for nm in (450, 550, 650, 750)
    ]
    np.testing.assert_allclose(radiance, wanted, rtol=0.01)


STRAY = {"share": 0.15, "core_px": 3.0, "slope": 2.5}


def test_stars_that_are_not_listed_shine_as_listed_ones() -> None:
    """The same image of a lens without stray light, to a thousandth of the noise; with wings and a ghost, in which they count
    in groups, to a twentieth of it. Only listed stars are in the truth."""
    ghost = {"share": 2e-3, "diameter_px": 20, "magnification": -1.0}
    for stray, share in (({}, 1e-3), ({"camera__bloom": STRAY, "camera__ghosts": [ghost]}, 0.05)):
        every, split = (
            render_expected(plan_frame(small_scenario(stars={"limiting_magnitude": 8} | more, **stray), 0), layers=True)
            for more in ({}, {"listed_magnitude": 5.5})
        )
        difference = split.electrons - every.electrons
        assert np.abs(difference / np.sqrt(every.electrons + 1)).max() < share
        assert split.electrons.mean() == pytest.approx(every.electrons.mean(), rel=2e-4)
        np.testing.assert_allclose(sum(split.layers.values()), split.electrons, rtol=2e-5, atol=1e-3)
        assert 100 < len(split.u_px) < len(every.u_px) / 5
        np.testing.assert_array_equal(split.star_electrons.max(), every.star_electrons.max())


def test_no_star_is_too_faint_to_be_listed_by_a_deep_limit() -> None:
    plan = plan_frame(small_scenario(stars={"limiting_magnitude": 6, "listed_magnitude": 12}), 0)
    assert len(plan.unlisted) == 0
    np.testing.assert_array_equal(
        render_expected(plan).electrons,
        render_expected(plan_frame(small_scenario(stars={"limiting_magnitude": 6}), 0)).electrons,
    )
