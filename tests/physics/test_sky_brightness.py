"""The diffuse sky: zenith brightness, van Rhijn's law, and what the renderer makes of them."""

import math

import numpy as np
import pytest
from generator.sky_brightness import BORTLE_ZENITH_MAG, airglow_shape, diffuse_sky, van_rhijn
from small_scenes import V_BAND_QE, small_scenario

from generator.atmosphere import Atmosphere
from generator.frame_plan import plan_frame
from generator.photometry import ARCSEC2_PER_SR, BESSELL_V, GRID_NM, surface_brightness_from_radiance
from generator.scene import quantum_efficiency, render_expected

ATMOSPHERE = Atmosphere(1010.0, 0.1, 1.3, 300.0)


@pytest.mark.parametrize("bortle", range(1, 10))
def test_zenith_brightness_measured_back_from_the_frame(bortle) -> None:
    """Electrons of the pixels at the zenith, through a V-band camera, give the class' mag/arcsec^2 within 0.05 mag."""
    scenario = small_scenario(
        camera__width=61,
        camera__height=61,
        camera__hfov_deg=10,
        camera__transmission=1.0,
        sensor={"quantum_efficiency": V_BAND_QE},
        sky={"bortle": bortle},
        stars={"limiting_magnitude": -2.0},
    )
    plan = plan_frame(scenario, 0)
    electrons = float(render_expected(plan).electrons[30, 30])
    area_cm2 = math.pi / 4 * 0.4**2
    pixel_arcsec2 = ARCSEC2_PER_SR / plan.spec.camera.f_px**2
    width_angstrom = np.trapezoid([point[1] for point in V_BAND_QE], [10 * point[0] for point in V_BAND_QE])
    mag = -2.5 * np.log10(electrons / 0.5 / area_cm2 / width_angstrom / pixel_arcsec2 / 995.9)
    assert mag == pytest.approx(BORTLE_ZENITH_MAG[bortle], abs=0.05)


@pytest.mark.parametrize(
    ("zenith_deg", "at_87_km", "at_250_km"),
    [
        (30, 1.150, 1.141),
        (45, 1.396, 1.365),
        (60, 1.924, 1.809),
        (70, 2.667, 2.342),
        (80, 4.223, 3.132),
        (90, 6.116, 3.676),
    ],
)
def test_van_rhijn(zenith_deg, at_87_km, at_250_km) -> None:
    assert float(van_rhijn(zenith_deg)) == pytest.approx(at_87_km, abs=6e-4)
    assert float(van_rhijn(zenith_deg, 250.0)) == pytest.approx(at_250_km, abs=6e-4)


def test_airglow_has_the_published_v_brightness() -> None:
    """ESO's sky model at 130 solar flux units, zenith: V 22.01 within 0.1 mag (Noll et al. 2012)."""
    per_cm2_angstrom_arcsec2 = float(BESSELL_V.mean(GRID_NM, airglow_shape()))
    assert -2.5 * np.log10(per_cm2_angstrom_arcsec2 / 995.9) == pytest.approx(22.01, abs=0.1)


def test_rendered_sky_is_the_reference_formula() -> None:
    """Every pixel of a frame down to the horizon against the same sky integrated in NumPy, within 0.3 %."""
    scenario = small_scenario(
        camera__width=90,
        camera__height=60,
        attitude={"azimuth_deg": 30, "altitude_deg": 35},
        stars={"limiting_magnitude": -2.0},
    )
    plan = plan_frame(scenario, 0)
    rendered = render_expected(plan).sky_electrons
    camera = plan.spec.camera
    v, u = np.mgrid[0:60, 0:90]
    rays = np.stack([(u - 44.5) / camera.f_px, (v - 29.5) / camera.f_px, np.ones_like(u, dtype=float)], axis=-1)
    norm = np.linalg.norm(rays, axis=-1)
    cosine = 1 / norm
    up = (rays / norm[..., None]) @ plan.spec.R_cam[:, 2]
    altitude = np.degrees(np.arcsin(up)).ravel()
    radiance = diffuse_sky(plan.spec.sky.zenith_mag, ATMOSPHERE).radiance(altitude)
    fine = np.arange(350, 1000.1, 1.0)
    response = np.interp(fine, GRID_NM, quantum_efficiency(plan.spec))
    band = np.array([np.trapezoid(np.interp(fine, GRID_NM, row) * response, fine) for row in radiance]).reshape(60, 90)
    wanted = band * math.pi / 4 * 0.004**2 * 0.5 * cosine * cosine**3 / camera.f_px**2
    clear_of_horizon = np.abs(np.degrees(np.arcsin(up))) > 0.5
    below = up < 0
    assert below.any()
    assert (rendered[below & clear_of_horizon] == 0).all()
    above = ~below & clear_of_horizon
    np.testing.assert_allclose(rendered[above], wanted[above], rtol=3e-3)


def test_darker_than_natural_scales_airglow_alone() -> None:
    dark = diffuse_sky(22.3, ATMOSPHERE)
    assert (dark.artificial == 0).all()
    zenith = float(BESSELL_V.mean(GRID_NM, dark.radiance([90.0]))[0])
    assert float(surface_brightness_from_radiance(zenith)) == pytest.approx(22.3, abs=0.001)


def test_black_sky_gives_no_electrons() -> None:
    plan = plan_frame(small_scenario(sky=None, stars={"limiting_magnitude": -2.0}), 0)
    assert render_expected(plan).electrons.max() == 0
