"""Values of a frame that cannot both be true: what is said of them."""

import pytest
from small_scenes import small_scenario

from generator.scenario.contradictions import contradictions


@pytest.mark.parametrize(("air", "told"), [
    ({"pressure_hpa": 0, "aerosol_tau_550": 0}, True),
    ({"pressure_hpa": 0}, False),
    ({"pressure_hpa": 0, "aerosol_tau_550": 0, "extinction": False}, False),
])  # fmt: skip
@pytest.mark.parametrize(("sky", "key"), [
    ({"bortle": 5}, "bortle"),
    ({"zenith_mag_arcsec2": 20}, "zenith_mag_arcsec2"),
    ({"cities": [{"distance_km": 10, "azimuth_deg": 0, "radius_km": 3}]}, "cities"),
])  # fmt: skip
def test_a_brightness_needs_air_that_scatters(air, told, sky, key) -> None:
    said = contradictions(small_scenario(sky=sky, atmosphere=air).frame(0))
    assert [sentence.startswith(f"sky.{key}: makes no sky brighter without air") for sentence in said] == [True] * told


def test_a_sky_without_air_states_no_brightness() -> None:
    air = {"pressure_hpa": 0, "aerosol_tau_550": 0}
    assert not contradictions(small_scenario(sky={"components": ["airglow"]}, atmosphere=air).frame(0))


@pytest.mark.parametrize(("camera", "told"), [
    ({"hfov_deg": 120}, False),
    ({"hfov_deg": 150}, True),
    ({"hfov_deg": 150, "veiling_glare": 0}, False),
    ({"hfov_deg": 180, "model": "equidistant"}, False),
])  # fmt: skip
def test_veiling_glare_is_doubted_in_the_dark_corners_of_a_wide_rectilinear_lens(camera, told) -> None:
    frame = small_scenario(camera={"width": 270, "height": 180, "aperture_mm": 4} | camera).frame(0)
    said = contradictions(frame)
    assert [sentence.startswith("camera.veiling_glare: 0.01 of the light") for sentence in said] == [True] * told


@pytest.mark.parametrize(("sky", "told"), [
    ({"bortle": 5, "cities": []}, "bortle"),
    ({"zenith_mag_arcsec2": 20, "cities": []}, "zenith_mag_arcsec2"),
    ({"cities": [], "components": ["airglow"]}, None),
])  # fmt: skip
def test_a_brightness_needs_a_city(sky, told) -> None:
    said = contradictions(small_scenario(sky=sky).frame(0))
    assert len(said) == (told is not None)
    if told is not None:
        assert said[0].startswith("sky.cities: an empty list leaves no lamps")
        assert told in said[0]
