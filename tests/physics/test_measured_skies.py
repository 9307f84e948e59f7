"""The default places of the Bortle classes against skies that were measured: brightness by altitude and azimuth."""

import numpy as np
import pytest
from small_scenes import small_scenario

from generator.frame.plan import plan_frame
from generator.frame.scene import frame_layers
from generator.sky.city_light import BORTLE_NEARBY_MLM, STANDARD_AIR, bortle_city, bortle_layout, city_table
from generator.sky.component import SkyTable, total, v_band
from generator.sky.directions import sky_grid, unit_vectors

METER_FWHM_DEG = 20.0
"""Of the meter that measured (SQM-L), its beam taken as a Gaussian: a tenth of its response is left 18 deg off its axis,
where its maker states 19."""
NIGHTS = ("2020-03-24T22:30:00Z", "2020-04-18T22:00:00Z", "2020-04-22T23:00:00Z")
"""Without Moon and twilight at 52 deg north, the Milky Way low: overhead it makes the zenith the brightest place of a dark
sky."""


def beam_weights(altitude_deg: float, azimuth_deg: float) -> np.ndarray:
    """Weights of the sky's grid in the meter's beam; the part of the beam below the horizon sees nothing."""
    grid = sky_grid()
    axis = unit_vectors(np.array([altitude_deg]), np.array([azimuth_deg]))[0]
    off_deg = np.degrees(np.arccos(np.clip(grid.enu @ axis, -1, 1)))
    altitude = np.radians(grid.altitude_deg)
    area = (np.cos(altitude) * np.gradient(altitude))[:, None] * 2 * np.pi / grid.shape[1]
    response = np.exp(-4 * np.log(2) * (off_deg / METER_FWHM_DEG) ** 2)
    theta = np.radians(np.linspace(0, 90, 9001))
    along = np.exp(-4 * np.log(2) * (np.degrees(theta) / METER_FWHM_DEG) ** 2)
    return response * area / np.trapezoid(2 * np.pi * np.sin(theta) * along, theta)


def v_map(layers: list[SkyTable]) -> np.ndarray:
    return total(layers).weighted(v_band()[None])[0].astype(float)


def metered(sky: dict, altitude_deg: float) -> np.ndarray:
    """What the meter shows at 12 azimuths over what it shows at the zenith, mean of three nights."""
    azimuths = np.arange(15.0, 375.0, 30.0)
    weights = [beam_weights(altitude_deg, azimuth) for azimuth in azimuths]
    zenith = beam_weights(90.0, 0.0)
    ratios = []
    for utc in NIGHTS:
        plan = plan_frame(small_scenario(time__utc_start=utc, sky=sky), 0)
        assert plan.sky.sun_altitude_deg < -18
        assert plan.sky.moon_altitude_deg < 0
        light = v_map(list(frame_layers(plan).values()))
        ratios.append([np.sum(weight * light) / np.sum(zenith * light) for weight in weights])
    return np.mean(ratios, axis=0)


@pytest.mark.parametrize("bortle", [3, 4, 5, 6, 7, 8, 9])
def test_a_class_is_as_bright_low_down_as_measured_skies(bortle) -> None:
    """Maps of the sky by meters of 20 deg on 17 clear nights at Spanish sites with zeniths of 19.0 to 21.6 mag/arcsec^2: at
    20 deg of altitude 1.6 to 2.6 times the zenith in the mean over azimuth; the brightest azimuth 2.7 in a town and up to
    5.1 beside a city."""
    at_20 = metered({"bortle": bortle}, 20.0)
    assert 1.6 < at_20.mean() < 2.6
    assert at_20.max() < 5.1 * 1.05


def test_a_dark_place_falls_off_below_20_degrees() -> None:
    """Measured at dark sites: 1.91 times the zenith at 20 deg, 1.47 at 10 deg."""
    natural = {"components": ["airglow", "zodiacal", "milky_way", "starlight"]}
    at_20, at_10 = metered(natural, 20.0).mean(), metered(natural, 10.0).mean()
    assert at_20 == pytest.approx(1.91, rel=0.15)
    assert at_10 == pytest.approx(1.47, rel=0.15)


@pytest.mark.parametrize(
    "bortle", [1, 4, *(pytest.param(bortle, marks=pytest.mark.journey) for bortle in (2, 3, 5, 6))]
)
def test_settlements_around_give_four_fifths_of_the_artificial_light_overhead(bortle) -> None:
    city, nearby = (city_table(each, STANDARD_AIR).zenith_v() for each in bortle_layout(bortle))
    assert nearby / (city + nearby) == pytest.approx(0.8, abs=0.02)


def test_inside_a_city_there_is_the_city_alone() -> None:
    assert sorted(BORTLE_NEARBY_MLM) == [1, 2, 3, 4, 5, 6]
    assert bortle_layout(8) == (bortle_city(8),)
