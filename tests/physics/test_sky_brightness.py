"""The diffuse sky as it is rendered: zenith brightness, the emitter against the tables, layers, black skies."""

import math

import numpy as np
import pytest
from small_scenes import V_BAND_QE, small_scenario

from generator.frame.exposure.expected import render_expected
from generator.frame.plan import plan_frame
from generator.frame.scene import frame_layers, quantum_efficiency
from generator.light.photometry import ARCSEC2_PER_SR, GRID_NM, radiance_from_surface_brightness
from generator.sky.assembly import whole_sky
from generator.sky.component import total
from generator.sky.zenith import BORTLE_ZENITH_MAG

NO_STARS = {"limiting_magnitude": -2.0, "planets": False}


def zenith_mag_of_frame(sky, **overrides) -> float:
    """Brightness of the zenith measured from the electrons of a V-band camera, mag/arcsec^2."""
    scenario = small_scenario(
        camera__width=61,
        camera__height=61,
        camera__hfov_deg=10,
        camera__transmission=1.0,
        sensor={"quantum_efficiency": V_BAND_QE},
        sky=sky,
        stars=NO_STARS,
        **overrides,
    )
    plan = plan_frame(scenario, 0)
    electrons = float(render_expected(plan).electrons[30, 30])
    area_cm2 = math.pi / 4 * 0.4**2
    pixel_arcsec2 = ARCSEC2_PER_SR / plan.spec.camera.f_px**2
    width_angstrom = np.trapezoid([point[1] for point in V_BAND_QE], [10 * point[0] for point in V_BAND_QE])
    return -2.5 * math.log10(electrons / 0.5 / area_cm2 / width_angstrom / pixel_arcsec2 / 1003.3)


@pytest.mark.parametrize(
    "bortle", [1, 4, 9, *(pytest.param(bortle, marks=pytest.mark.journey) for bortle in (2, 3, 5, 6, 7, 8))]
)
def test_zenith_of_a_bortle_class_is_the_table_s(bortle) -> None:
    """Natural light and the lamps of the class' place together, measured back from a frame: within 0.05 mag."""
    assert zenith_mag_of_frame({"bortle": bortle}) == pytest.approx(BORTLE_ZENITH_MAG[bortle], abs=0.05)


@pytest.mark.parametrize("bortle", [1, 3, 5])
def test_natural_light_leaves_the_rest_to_the_lamps(bortle) -> None:
    """Lamps shine only where this night's natural sky (measured alone) is darker than the class."""
    glow = frame_layers(plan_frame(small_scenario(sky={"bortle": bortle}), 0))["skyglow"]
    natural = zenith_mag_of_frame({"components": ["airglow", "zodiacal", "milky_way", "starlight"]})
    wanted = radiance_from_surface_brightness(BORTLE_ZENITH_MAG[bortle]) - radiance_from_surface_brightness(natural)
    assert glow.zenith_v() == pytest.approx(max(0.0, float(wanted)), rel=0.05, abs=0.0)


@pytest.mark.parametrize("wanted", [22.5, 21.0, 17.0, *BORTLE_ZENITH_MAG.values()])
def test_target_zenith_brightness_is_the_frame_s(wanted) -> None:
    """A brightness that is asked for directly is that of the very frame, natural light included."""
    assert zenith_mag_of_frame({"zenith_mag_arcsec2": wanted}) == pytest.approx(wanted, abs=0.05)


def test_rendered_sky_is_the_tables_integrated() -> None:
    """Every pixel of a frame down to the horizon against the uncompressed layers integrated in NumPy, within 0.3 %."""
    scenario = small_scenario(
        camera__width=90, camera__height=60, attitude={"azimuth_deg": 30, "altitude_deg": 35}, stars=NO_STARS
    )
    plan = plan_frame(scenario, 0)
    rendered = render_expected(plan).sky_electrons
    camera = plan.spec.camera
    v, u = np.mgrid[0:60, 0:90]
    rays = np.stack([(u - 44.5) / camera.f_px, (v - 29.5) / camera.f_px, np.ones_like(u, dtype=float)], axis=-1)
    norm = np.linalg.norm(rays, axis=-1)
    cosine = 1 / norm
    east, north, up = np.moveaxis((rays / norm[..., None]) @ plan.spec.R_cam, -1, 0)
    altitude, azimuth = np.degrees(np.arcsin(up)).ravel(), np.degrees(np.arctan2(east, north)).ravel()
    radiance = total(list(frame_layers(plan).values())).radiance(altitude, azimuth)
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


def test_layers_add_up_to_the_frame() -> None:
    """Moonlight, twilight and cloud too: the sum of all layers is the frame within 0.1 % of each pixel."""
    scenario = small_scenario(
        time__utc_start="2020-01-08T16:40:00Z",
        sky={"bortle": 6, "clouds": {"mean_optical_depth": 1.0}},
        stars={"limiting_magnitude": 5.0},
    )
    frame = render_expected(plan_frame(scenario, 0), layers=True)
    assert set(frame.layers) == {
        "airglow", "zodiacal", "milky_way", "starlight", "skyglow", "moonlight", "twilight", "clouds", "stars",
    }  # fmt: skip
    assert all(layer.sum() > 0 for layer in frame.layers.values())
    np.testing.assert_allclose(sum(frame.layers.values()), frame.electrons, rtol=1e-3)


def test_compression_keeps_the_spectra() -> None:
    """The few terms of the emitter against all terms: every radiance within 0.1 % of the spectrum's largest value."""
    layers = frame_layers(plan_frame(small_scenario(sky={"bortle": 5}), 0))
    full, few = total(list(layers.values())), whole_sky(layers)
    assert len(few.maps) < 30 < len(full.maps)
    altitude, azimuth = np.repeat([1.0, 10.0, 30.0, 80.0], 6), np.tile(np.arange(0, 360, 60.0), 4)
    wanted, found = full.radiance(altitude, azimuth), few.radiance(altitude, azimuth)
    assert (np.abs(found - wanted) / wanted.max(axis=1, keepdims=True)).max() < 1e-3


def test_black_sky_gives_no_electrons() -> None:
    plan = plan_frame(small_scenario(sky=None, stars=NO_STARS), 0)
    frame = render_expected(plan)
    assert frame.electrons.max() == 0
    assert frame.zenith_mag_arcsec2 is None
