"""Pixels that the Sun burnt: its path over a fixed camera, the traps' law and charge, truth, and a photograph's arc."""

import numpy as np
import pytest
from small_scenes import FISHEYE_CAMERA, small_scenario

from generator.errors import ScenarioError
from generator.frame.object_table import BURNT_PIXEL_OBJECT
from generator.frame.render import render_frame
from generator.scenario.file import load_scenario
from generator.scenario.shipped import find_scenario
from generator.seeds import unit_stream
from generator.sensor.sun_path import RADIUS_DEG, sun_minutes
from generator.sensor.sunburn import TrappedCharge, burnt_pixels

BURN = {
    "first_day": "2017-06-21", "last_day": "2017-06-21", "hours_utc": [[15, 1], [20, 1]], "latitude_deg": 34.4773,
    "longitude_deg": -111.4332, "azimuth_deg": 0, "altitude_deg": 90, "traps_per_min": 1.0, "trap_e": 40.0,
}  # fmt: skip


def burnt_scenario(**changes):
    sensor = {"sunburn": BURN | changes, "gain_e_per_dn": 0.5, "bits": 16}
    return small_scenario(camera=FISHEYE_CAMERA, sensor=sensor, attitude={"azimuth_deg": 0, "altitude_deg": 90})


def minutes_of(**changes):
    frame = burnt_scenario(**changes).frame(0)
    return sun_minutes(frame.sensor.sunburn, frame.camera), frame.camera.projection


def test_the_path_is_where_the_sun_stands() -> None:
    """At local noon of the June solstice the Sun stands as far south of the zenith as the latitude exceeds its declination.

    That is 34.4773 - 23.4349 deg (solstice of 2017, obliquity by the Astronomical Almanac); 120 px a radian.
    """
    minutes, lens = minutes_of(hours_utc=[[19.35, 1], [19.6, 1]])
    v, u = np.mgrid[0:400, 0:400]
    south = (minutes * (lens.cy_px - v)).sum() / minutes.sum()
    # North is up and east is left: the camera looks up, roll 0.
    assert abs(south) == pytest.approx(120 * np.radians(34.4773 - 23.4349), abs=0.1)
    assert abs((minutes * (u - lens.cx_px)).sum() / minutes.sum()) < 2.0


def test_all_minutes_are_those_of_the_hours() -> None:
    """Minutes times solid angle, over all pixels, is the disk's area times the time that it shines."""
    minutes, lens = minutes_of(hours_utc=[[14.5, 0], [15.5, 1], [19.5, 1], [20.5, 0]], last_day="2017-06-23")
    v, u = np.mgrid[0:400, 0:400]
    theta = np.hypot(u - lens.cx_px, v - lens.cy_px) / lens.f_px
    solid = np.sinc(theta / np.pi) / lens.f_px**2
    disk = 2 * np.pi * (1 - np.cos(np.radians(RADIUS_DEG)))
    assert (minutes * solid).sum() == pytest.approx(3 * 300 * disk, rel=0.01)


def test_the_sun_of_a_whole_day_takes_as_long_as_that_of_a_little_less() -> None:
    """Days by the Sun are up to 30 s shorter or longer than 24 h, so that it sweeps a little more or less than a turn."""
    year = {"first_day": "2020-01-01", "last_day": "2020-12-31"}
    whole, _ = minutes_of(hours_utc=[[0, 1], [24, 1]], **year)
    less, _ = minutes_of(hours_utc=[[0, 1], [23.99, 1]], **year)
    assert whole.sum() == pytest.approx(less.sum(), rel=0.01)
    assert whole.max() == pytest.approx(less.max(), rel=0.02)


def test_the_days_of_a_week_lie_apart_and_those_of_the_solstice_together() -> None:
    """In March declination rises by 0.39 deg a day (0.8 px), at the solstice by none: pixels crossed in seven days."""
    spring, _ = minutes_of(first_day="2017-03-17", last_day="2017-03-23")
    summer, _ = minutes_of(first_day="2017-06-18", last_day="2017-06-24")
    assert (spring > 0).sum() > 2.5 * (summer > 0).sum()
    assert summer.max() > 2.5 * spring.max()


def test_traps_are_full_before_charge_is_free_or_in_equilibrium_with_it() -> None:
    charge = np.array([[10.0, 50.0, 200.0, 5000.0]], np.float32)
    room = np.full(4, 100.0, np.float32)
    places = np.arange(4)
    left = TrappedCharge(places, room, 0.0).apply(charge, None)
    np.testing.assert_allclose(left, [[0, 0, 100, 4900]], atol=1e-3)
    slow = TrappedCharge(places, room, 25.0)
    free = slow.apply(charge, None)
    np.testing.assert_allclose((charge - free) / room, free / (free + 25), rtol=1e-3)


def test_traps_are_poisson_and_their_room_exponential() -> None:
    """Number and room of sixty sensors' traps, each within 4 standard errors."""
    frame = burnt_scenario(traps_per_min=3.0).frame(0)
    minutes = sun_minutes(frame.sensor.sunburn, frame.camera)
    burnt = [burnt_pixels(frame.camera, frame.sensor, lambda name, n=n: unit_stream(n, None, name)) for n in range(60)]
    wanted = float(3.0 * minutes.sum() * 60)
    rooms = sum(float(each.room_e.sum()) for each in burnt)
    # The sum of Poisson many exponential numbers has twice the variance of their number, in units of their mean.
    assert rooms / 40.0 == pytest.approx(wanted, abs=4 * np.sqrt(2 * wanted))
    untouched = np.exp(-3.0 * minutes[minutes > 0].astype(float))
    count = sum(len(each.places) for each in burnt)
    spread = np.sqrt(60 * (untouched * (1 - untouched)).sum())
    assert count == pytest.approx(60 * (1 - untouched).sum(), abs=4 * spread)


def test_burnt_pixels_have_rows_of_truth() -> None:
    """Each row's pixel lacks what the row says, to 6 standard deviations; frames of one sensor lack the same."""
    scenario = burnt_scenario(traps_per_min=20.0, trap_e=200.0)
    frame = render_frame(scenario, 0)
    rows = frame.objects.to_pandas()
    rows = rows[rows["object"] == BURNT_PIXEL_OBJECT]
    assert set(rows["kind"]) == {"burnt_pixel"}
    assert (rows["snr"] >= 5).all()
    assert len(rows) > 20
    sensor = frame.plan.spec.sensor
    u, v = rows["centroid_u_px"].to_numpy(int), rows["centroid_v_px"].to_numpy(int)
    read = (frame.dn[v, u].astype(float) - sensor.black_level_dn) * sensor.gain_e_per_dn
    light = frame.expected.electrons[v, u] + sensor.mean_dark_e_s * frame.plan.spec.time.exposure_s
    lacking = rows["electrons_e"].to_numpy()
    assert (lacking < 0).all()
    assert (np.abs(read - light - lacking) < 6 * np.sqrt(light + sensor.read_noise_e**2 + 1)).all()


def test_a_sensor_by_number_is_the_same_under_every_seed() -> None:
    def burnt(seed: int, unit: int | None) -> TrappedCharge:
        frame = burnt_scenario().frame(0)
        found = burnt_pixels(frame.camera, frame.sensor, lambda name: unit_stream(seed, unit, name))
        assert found is not None
        return found

    np.testing.assert_array_equal(burnt(1, 5).room_e, burnt(2, 5).room_e)
    assert len(burnt(1, None).room_e) != len(burnt(2, None).room_e)


ARC = {"008": (320, 23.9, 0.199, 0.072), "001": (876, 35.2, 0.239, 0.087), "010": (1692, 49.1, 0.243, 0.094)}
"""Of photographs that the scene's numbers are not fitted to: light and noise of a pixel, electrons, and the parts of the 3836
pixels that the Sun crossed for more than five minutes that lack more than 60 and 120 electrons."""


@pytest.mark.parametrize("photograph", sorted(ARC))
def test_the_arc_of_a_photograph(photograph) -> None:
    """As many pixels of the scene's arc are that dark, within 15 and 25 %: five and six standard deviations of the draw."""
    light, noise, part_60, part_120 = ARC[photograph]
    frame = load_scenario(find_scenario("observatory_allsky")).frame(0)
    minutes = sun_minutes(frame.sensor.sunburn, frame.camera).ravel()
    burnt = burnt_pixels(frame.camera, frame.sensor, lambda name: unit_stream(0, frame.sensor.unit, name))
    lacking = np.random.default_rng(2).normal(0, noise, minutes.size)
    lacking[burnt.places] += burnt.held_e(np.full(len(burnt.places), light, np.float32))
    arc = lacking[minutes > 5]
    assert (arc > 60).mean() == pytest.approx(part_60, rel=0.15)
    assert (arc > 120).mean() == pytest.approx(part_120, rel=0.25)


REFUSED = {
    "order": ({"last_day": "2017-06-20"}, "last_day"),
    "years": ({"last_day": "2019-06-20"}, "within 400 days"),
    "date": ({"first_day": "2017-06-31"}, "first_day"),
    "hours": ({"hours_utc": [[20, 1], [15, 1]]}, "hours must increase"),
    "night": ({"hours_utc": [[1, 1], [40, 1]]}, "within one day"),
    "rate": ({"traps_per_min": 0}, "traps_per_min"),
}


@pytest.mark.parametrize("case", sorted(REFUSED))
def test_bad_values_are_refused(case) -> None:
    changes, fragment = REFUSED[case]
    with pytest.raises(ScenarioError, match=fragment):
        burnt_scenario(**changes)
