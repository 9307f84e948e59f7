"""The sky's light while the Moon sets, while twilight ends, and in air that scatters nothing."""

import numpy as np
import pytest
from small_scenes import small_scenario

from generator.errors import GeneratorError
from generator.frame.exposure.expected import render_expected
from generator.frame.plan import plan_frame
from generator.frame.scene import frame_layers
from generator.light.atmosphere import Atmosphere
from generator.light.photometry import BESSELL_V, GRID_NM
from generator.light.stellar_spectra import star_spectra
from generator.sky.assembly import whole_sky
from generator.sky.moon_irradiance import moon_spectrum
from generator.sky.moonlight import night_depression_deg
from generator.sky.sunlight import SUN_BV_MAG, SUN_VI_MAG
from generator.sky.twilight import NIGHT_DEPRESSION_DEG, SUN_V_MAG, light_from_below, twilight, twilight_field

AIR = Atmosphere(1010.0, 0.1, 1.3, 300.0)
NATURAL = ["airglow", "zodiacal", "milky_way", "starlight"]
DELFT = {"latitude_deg": 52.0, "longitude_deg": 4.36}


def below(depression_deg):
    """Direction of a body in the east, so deep below the horizon."""
    depth = np.radians(depression_deg)
    return np.array([np.cos(depth), 0.0, -np.sin(depth)])


def moonset(utc, height_m=0.0):
    """Altitude of the Moon, and radiance in V of the zenith, and of 45, 10 and 3 deg over it, with the natural sky alone."""
    site = DELFT | {"height_m": height_m, "ground_height_m": 0.0}
    plan = plan_frame(small_scenario(site=site, time__utc_start=utc, sky={"components": [*NATURAL, "moonlight"]}), 0)
    azimuth = float(np.degrees(np.arctan2(plan.sky.moon_enu[0], plan.sky.moon_enu[1])))
    sky = whole_sky(frame_layers(plan))
    return plan.sky.moon_altitude_deg, sky.v_mag_arcsec2(np.array([90.0, 45.0, 10.0, 3.0]), np.full(4, azimuth))


@pytest.mark.parametrize(
    ("before", "after", "altitude_deg"),
    [
        ("2020-01-08T05:18:50Z", "2020-01-08T05:19:10Z", 0.0),
        ("2020-01-08T04:52:20Z", "2020-01-08T04:52:40Z", 3.0),
    ],
)
@pytest.mark.parametrize("height_m", [0.0, 10_000.0])
def test_the_sky_does_not_jump_while_the_moon_sets(before, after, altitude_deg, height_m) -> None:
    """In 20 s the Moon sinks by 0.04 deg, of whose light low over it at most 1.5 magnitudes are lost in a degree."""
    (high, brighter), (low, fainter) = moonset(before, height_m), moonset(after, height_m)
    assert high == pytest.approx(altitude_deg, abs=0.5)
    assert low < high
    assert (np.abs(fainter - brighter) < 1.5 * (high - low) + 0.01).all()


def test_moonlight_fades_within_some_degrees_of_moonset() -> None:
    """Half a magnitude of light at the zenith is left as the gibbous Moon sets; 4 deg lower there is as good as none."""
    _, at_set = moonset("2020-01-08T05:19:00Z")
    _, later = moonset("2020-01-08T05:55:00Z")
    _, night = moonset("2020-01-08T06:40:00Z")
    assert 0.35 < night[0] - at_set[0] < 0.75
    assert np.abs(night[0] - later[0]) < 0.05


def test_the_moon_s_twilight_is_the_sun_s_of_its_magnitude() -> None:
    moon = light_from_below(below(4.0), 4.0, moon_spectrum(-12.0, 20.0), AIR, 0.0)
    sun = twilight(below(4.0), 4.0, AIR, 0.0)
    # The Moon's light is redder, and what is left overhead is blue.
    assert 2.5 * np.log10(sun.zenith_v() / moon.zenith_v()) == pytest.approx(-12.0 - SUN_V_MAG, abs=0.1)


def test_a_moon_below_its_night_adds_a_hundredth_to_a_dark_sky() -> None:
    for v_mag in (-12.7, -10.0):
        depression = night_depression_deg(v_mag)
        light = light_from_below(below(depression), depression, moon_spectrum(v_mag, 20.0), AIR, 0.0)
        assert (light.v_mag_arcsec2(np.array([90.0, 10.0, 3.0]), np.full(3, 90.0)) > 22.0 + 3.5).all(), v_mag


def test_twilight_falls_on_beyond_18_degrees_and_ends_without_a_step() -> None:
    altitudes, azimuths = np.array([0.0, 3.0, 10.0, 90.0]), np.array([0.0, 90.0, 180.0])
    v = int(np.searchsorted(GRID_NM, 550.0))
    depressions = (17.0, 17.99, 18.01, 19.0, NIGHT_DEPRESSION_DEG)
    light = [twilight_field(depression, AIR, 0.0, altitudes, azimuths)[..., v] for depression in depressions]
    np.testing.assert_allclose(light[2], light[1], rtol=0.05)
    np.testing.assert_allclose(light[3] / light[2], (light[2] / light[0]) ** (0.99 / 1.01), rtol=0.02)
    sun = star_spectra([SUN_V_MAG], [SUN_BV_MAG], [SUN_VI_MAG])[0]
    last = twilight(below(NIGHT_DEPRESSION_DEG - 0.01), NIGHT_DEPRESSION_DEG - 0.01, AIR, 0.0)
    assert float(BESSELL_V.mean(GRID_NM, sun)) > 0
    # A dark sky has V 20.5 there, at the end of the airglow's rise towards the horizon.
    assert (last.v_mag_arcsec2(np.array([3.0, 10.0, 90.0]), np.full(3, 90.0)) > 20.5 + 4.5).all()
    assert twilight(below(NIGHT_DEPRESSION_DEG), NIGHT_DEPRESSION_DEG, AIR, 0.0).zenith_v() == 0


def test_the_sun_above_the_horizon_is_refused() -> None:
    with pytest.raises(GeneratorError, match="the Sun is"):
        twilight(below(-1.0), -1.0, AIR, 0.0)


@pytest.mark.parametrize(("height_m", "up"), [(0.0, False), (10_000.0, True)])
def test_the_sun_above_a_horizon_that_dips_is_refused(height_m, up) -> None:
    """Ten kilometres up the horizon lies 3 deg below the horizontal, and the Sun, 1.9 deg below it, is in view.

    From the ground it is 2.5 deg below, without refraction.
    """
    site = DELFT | {"height_m": height_m, "ground_height_m": 0.0}
    plan = plan_frame(small_scenario(site=site, time__utc_start="2020-01-08T16:03:00Z"), 0)
    assert (-2.2 if up else -2.7) < plan.sky.sun_altitude_deg < (-1.5 if up else -2.3)
    if up:
        with pytest.raises(GeneratorError, match=r"above the horizon, which lies 3.\d deg below the horizontal, at"):
            frame_layers(plan)
    else:
        assert frame_layers(plan)["twilight"].zenith_v() > 0


def test_air_that_scatters_nothing_gives_a_sky_without_scattered_light() -> None:
    """City light, moonlight and twilight are scattered light; the natural sky above the air stays."""
    vacuum = {"pressure_hpa": 0.0, "aerosol_tau_550": 0.0}
    scenario = small_scenario(site=DELFT, time__utc_start="2020-01-08T22:00:00Z", atmosphere=vacuum, sky={"bortle": 5})
    plan = plan_frame(scenario, 0)
    layers = frame_layers(plan)
    assert layers["moonlight"].zenith_v() == 0
    assert "skyglow" not in layers
    assert layers["zodiacal"].zenith_v() > 0
    assert np.isfinite(render_expected(plan).electrons).all()
