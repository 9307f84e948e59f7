"""The horizon of an observer in the air, and the sky and stars between it and the horizontal."""

import numpy as np
import pytest
from small_scenes import small_scenario

from generator.errors import ScenarioError
from generator.frame.exposure.expected import render_expected
from generator.frame.plan import airmass_to, plan_frame
from generator.frame.record import frame_record, star_table
from generator.light.atmosphere import airmass, usual_pressure_hpa, usual_temperature_c
from generator.places.astrometry import Air, Site
from generator.places.horizon import LEVEL, horizon_of

RADIUS_M = 6378120.0


def seen_from(height_m, *, bends=True, ground_m=0.0):
    pressure = float(usual_pressure_hpa(height_m)) if bends else 0.0
    return horizon_of(Site(45.0, 0.0, height_m), Air(pressure, float(usual_temperature_c(height_m)), 0.3), ground_m)


@pytest.mark.parametrize("height_m", [2.0, 10.0, 100.0, 500.0])
def test_the_dip_is_the_navigators(height_m) -> None:
    """1.76 arcmin times the root of the height in metres (Nautical Almanac, table of dip): within 1.5 %."""
    assert -60 * seen_from(height_m).altitude_deg == pytest.approx(1.76 * np.sqrt(height_m), rel=0.015)


@pytest.mark.parametrize("height_m", [10.0, 1000.0, 12000.0, 20000.0])
def test_without_air_the_dip_is_geometric(height_m) -> None:
    """arccos(R / (R + h)); with air it is less, by 8 to 10 % near the ground."""
    geometric = np.degrees(np.arccos(RADIUS_M / (RADIUS_M + height_m)))
    assert -seen_from(height_m, bends=False).altitude_deg == pytest.approx(geometric, rel=1e-6)
    less = 1 + seen_from(height_m).altitude_deg / geometric
    assert 0.04 < less < 0.1
    if height_m <= 1000:
        assert less > 0.08


def test_on_the_ground_the_horizon_is_level() -> None:
    assert seen_from(4000.0, ground_m=4000.0) is LEVEL
    assert seen_from(0.0) is LEVEL
    assert plan_frame(small_scenario(site__height_m=4000), 0).horizon is LEVEL
    assert plan_frame(small_scenario(site__height_m=4000, site__ground_height_m=0), 0).horizon.dips
    assert plan_frame(small_scenario(site__height_m=10000), 0).horizon.dips


@pytest.mark.parametrize("height_m", [300.0, 3000.0, 6000.0, 12000.0])
def test_a_ray_that_grazes_the_sea_passes_the_air_of_the_horizontal_twice(height_m) -> None:
    """All of it twice 37.92 sea-level airmasses (Kasten & Young 1989), what lies behind the observer included: within 5 %."""
    horizon = seen_from(height_m)
    at_height = 2 * float(airmass(-horizon.altitude_deg)) + horizon.further_airmass[0]
    at_sea = at_height * float(usual_pressure_hpa(height_m)) / 1010.0
    assert at_sea == pytest.approx(2 * 37.92, rel=0.05)
    assert np.all(np.diff(horizon.further_airmass) < 0)
    assert horizon.further_airmass[-1] == pytest.approx(0, abs=1e-3)


LOW = {
    "attitude": {"azimuth_deg": 250, "altitude_deg": 0},
    "camera": {
        "width": 120,
        "height": 160,
        "hfov_deg": 9,
        "aperture_mm": 20,
        "bloom": {"share": 0},
        "veiling_glare": 0,
    },
    "sky": {"components": ["airglow", "zodiacal", "milky_way", "starlight"]},
    "time__exposure_s": 5,
}


@pytest.fixture(scope="module")
def from_12_km():
    plan = plan_frame(small_scenario(site__height_m=12000, **LOW), 0)
    return plan, render_expected(plan)


def altitudes(plan):
    """Apparent altitude of the rows' middles, deg."""
    camera = plan.spec.camera
    return -np.degrees(np.arctan((np.arange(camera.height) - camera.projection.cy_px) / camera.f_px))


def test_the_sky_goes_down_to_the_horizon(from_12_km) -> None:
    """From 12 km 3.3 deg below the horizontal, by less than 8 % a row of 0.07 deg, darker downwards; the ground is black."""
    plan, frame = from_12_km
    assert plan.horizon.altitude_deg == pytest.approx(-3.3, abs=0.05)
    row, light = altitudes(plan), frame.sky_electrons[:, 60].astype(float)
    assert np.all(light[row > plan.horizon.altitude_deg + 0.1] > 0)
    assert np.all(light[row < plan.horizon.altitude_deg - 0.1] == 0)
    steps = np.abs(np.diff(np.log(light[row > -3.2])))
    assert steps.max() < 0.08
    below = light[(row < 0) & (row > -3.2)]
    assert np.all(np.diff(below) < 0)
    assert below[-1] < 0.5 * below[0]


def test_stars_shine_down_to_the_horizon_through_more_air(from_12_km) -> None:
    plan, frame = from_12_km
    low = plan.middle.altitude_deg < 0
    assert low.sum() > 100
    assert plan.middle.altitude_deg.min() > plan.horizon.altitude_deg
    assert np.all(plan.airmass[low] > 37.92)
    assert np.abs(np.diff(airmass_to(plan.horizon, np.array([-0.01, 0.0, 0.01])), 2))[0] < 0.1
    lit = frame.star_electrons[low & (plan.middle.altitude_deg > -1)]
    assert np.all(lit > 0)
    truth = star_table(plan, frame)
    assert np.min(truth["altitude_deg"].to_numpy()) < -2
    record = frame_record(plan, frame, truth)
    assert record["sky"]["horizon_altitude_deg"] == plan.horizon.altitude_deg
    assert record["site"]["ground_height_m"] == 0.0


def test_ground_of_the_camera_s_own_height_ends_the_sky_at_the_horizontal() -> None:
    plan = plan_frame(small_scenario(site={"latitude_deg": 52, "longitude_deg": 4.36, "height_m": 4000}, **LOW), 0)
    light = render_expected(plan).sky_electrons
    assert np.all(light[altitudes(plan) < -0.1] == 0)
    assert np.all(light[altitudes(plan) > 0.1] > 0)


def test_a_site_below_its_ground_is_refused() -> None:
    with pytest.raises(ScenarioError, match=r"ground_height_m: 200 lies above height_m, 100"):
        small_scenario(site__height_m=100, site__ground_height_m=200)
