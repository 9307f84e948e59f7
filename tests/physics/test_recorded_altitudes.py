"""Altitudes of Sun and Moon in a frame's record: apparent where their light can arrive, true where the Earth hides them."""

from typing import Any

import pytest
from small_scenes import small_scenario

from generator.frame.plan import plan_frame
from generator.places.sun import sun_altitude_deg
from generator.sky.state import SkyState


def sky_at(utc: str, height_m: float = 0.0) -> tuple[SkyState, float]:
    overrides: dict[str, Any] = {
        "time__utc_start": utc,
        "site__height_m": height_m,
        "sky__bortle": None,
        "camera__width": 16,
    }
    plan = plan_frame(small_scenario(**overrides, camera__height=16, stars={"limiting_magnitude": 0.0}), 0)
    site = plan.spec.site
    return plan.sky, sun_altitude_deg(plan.utc_mid, site.latitude_deg, site.longitude_deg)


@pytest.mark.parametrize("height_m", [0.0, 12000.0])
@pytest.mark.parametrize("utc", ["2020-01-15T20:00:00Z", "2020-01-15T16:40:00Z"])
def test_below_the_horizon_the_sun_s_altitude_is_that_of_its_true_place(utc: str, height_m: float) -> None:
    sky, true_deg = sky_at(utc, height_m)
    assert true_deg < -5.0
    assert sky.sun_altitude_deg == pytest.approx(true_deg, abs=0.02)  # the other routine is good to 0.01 deg
    assert sky.sun_altitude_deg == -sky.sun_depression_deg


def test_a_moon_in_the_sky_is_lifted_by_the_air_and_one_below_is_not() -> None:
    low, _ = sky_at("2020-01-15T22:30:00Z")
    assert 0 < low.moon_altitude_deg < 20
    assert 0.04 < low.moon_altitude_deg + low.moon_depression_deg < 0.5
    hidden, _ = sky_at("2020-01-15T20:00:00Z")
    assert hidden.moon_altitude_deg == -hidden.moon_depression_deg < -1


def test_from_the_air_the_sun_is_seen_below_the_horizontal() -> None:
    """From 12 km the lowest ray comes from 3 deg below the horizontal (the dip of 3.5 deg less refraction)."""
    sky, true_deg = sky_at("2020-01-15T16:17:00Z", 12000.0)
    assert -4.0 < true_deg < -2.5
    assert 0.5 < sky.sun_altitude_deg - true_deg < 1.5
    ground, true_deg = sky_at("2020-01-15T16:17:00Z")
    assert ground.sun_altitude_deg == pytest.approx(true_deg, abs=0.02)
