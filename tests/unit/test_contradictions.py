"""Values of a frame that cannot both be true: what is said of them."""

import pytest
from small_scenes import small_scenario

from generator.scenario.contradictions import contradictions


@pytest.mark.parametrize(("air", "told"), [
    ({"pressure_hpa": 0, "aerosol_tau_550": 0}, True),
    ({"pressure_hpa": 0}, False),
    ({"pressure_hpa": 0, "aerosol_tau_550": 0, "extinction": False}, False),
])  # fmt: skip
@pytest.mark.parametrize(
    ("sky", "key"), [({"bortle": 5}, "bortle"), ({"zenith_mag_arcsec2": 20}, "zenith_mag_arcsec2")]
)
def test_a_brightness_needs_air_that_scatters(air, told, sky, key) -> None:
    said = contradictions(small_scenario(sky=sky, atmosphere=air).frame(0))
    assert [sentence.startswith(f"sky.{key}: makes no sky brighter without air") for sentence in said] == [True] * told


def test_a_sky_without_air_states_no_brightness() -> None:
    air = {"pressure_hpa": 0, "aerosol_tau_550": 0}
    assert not contradictions(small_scenario(sky={"components": ["airglow"]}, atmosphere=air).frame(0))
