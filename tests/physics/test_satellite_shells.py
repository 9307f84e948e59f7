"""Trains and shells of satellites: against SGP4, geometry and hand computation."""

import numpy as np
import pytest
from sgp4.api import WGS72, Satrec
from small_scenes import small_scenario

from generator.errors import ScenarioError
from generator.frame.exposure.expected import render_expected
from generator.frame.flying.planning import plan_objects
from generator.frame.object_table import object_table
from generator.frame.plan import plan_frame
from generator.places.satellite_shells import EQUATORIAL_KM, Shell, sunlit

NORTH = {"azimuth_deg": 0.0, "altitude_deg": 20.0}
TRAIN = {
    "start": {"azimuth_deg": 90.0, "altitude_deg": 60.0}, "end": {"azimuth_deg": 90.0, "altitude_deg": 70.0},
    "end_s": 20.0, "count": 5, "gap_s": 4.0, "v_mag": 3.0,
}  # fmt: skip


def test_a_shell_moves_as_sgp4_moves_its_elements() -> None:
    """Over one day, plane and place of a circular orbit keep to SGP4 without drag within 0.15 deg (periodic terms, J4)."""
    shell = Shell(550.0, 53.0, 1, 1, node_deg=40.0, argument_deg=10.0)
    radius = EQUATORIAL_KM + 550.0
    # SGP4's mean motion is Kozai's, which contains J2's part of the mean anomaly's rate.
    motion = np.sqrt(398600.4418 / radius**3)
    flat = 1.5 * 1.08262668e-3 * (EQUATORIAL_KM / radius) ** 2
    cosine = np.cos(np.radians(53.0))
    kozai = motion * (1 + 0.5 * flat * (3 * cosine**2 - 1))
    orbit = Satrec()
    orbit.sgp4init(
        WGS72,
        "i",
        1,
        18263.5,
        0.0,
        0.0,
        0.0,
        1e-6,
        0.0,
        np.radians(53.0),
        np.radians(10.0),
        kozai * 60,
        np.radians(40.0),
    )
    seconds = np.linspace(0, 86400, 49)
    _, position, _ = orbit.sgp4_array(np.full(49, orbit.jdsatepoch), orbit.jdsatepochF + seconds / 86400)
    ours = shell.positions_km(seconds)[0]
    cosines = (ours * position).sum(axis=1) / np.linalg.norm(ours, axis=1) / np.linalg.norm(position, axis=1)
    assert np.degrees(np.arccos(np.clip(cosines, -1, 1))).max() < 0.15


def test_a_shell_has_its_planes_and_its_shadow() -> None:
    shell = Shell(550.0, 53.0, 8, 5)
    place = shell.positions_km(np.array([0.0, 1000.0]))
    assert place.shape == (40, 2, 3)
    np.testing.assert_allclose(np.linalg.norm(place, axis=2), EQUATORIAL_KM + 550)
    assert np.abs(place[..., 2]).max() <= (EQUATORIAL_KM + 550) * np.sin(np.radians(53)) + 1e-6
    sun = np.array([1.0, 0, 0])
    spots = np.array([[7000.0, 0, 0], [-7000.0, 0, 0], [-7000.0, 6379.0, 0], [0.0, 7000.0, 0]])
    assert sunlit(spots, sun).tolist() == [True, False, True, True]
    # Around a whole orbit, the shadow takes asin(R / r) / pi of it where the Sun lies in the plane.
    around = Shell(550.0, 0.0, 1, 3600).positions_km(np.zeros(1))[:, 0]
    assert 1 - sunlit(around, sun).mean() == pytest.approx(
        np.arcsin(EQUATORIAL_KM / (EQUATORIAL_KM + 550)) / np.pi, abs=1e-3
    )


@pytest.mark.parametrize(
    ("utc", "dark_longitude_deg", "ra_deg", "dec_deg"),
    [
        ("2026-03-20T14:46:00Z", 138.0, 0.0, 0.0),
        ("2026-06-21T08:25:00Z", -126.0, 90.0, 23.436),
        ("2026-09-23T00:05:00Z", -1.0, 180.0, 0.0),
    ],
)
def test_the_shadow_lies_opposite_the_sun_of_date(monkeypatch, utc, dark_longitude_deg, ra_deg, dec_deg) -> None:
    """Equinoxes and solstice of 2026 (U.S. Naval Observatory, Earth's Seasons), at which the Sun of date has these places by
    definition. 23.436 deg is the mean obliquity of 2026; nutation and aberration are below 0.01 deg."""
    seen = []

    def watched(spec, watch):
        seen.append(watch)
        return plan_objects(spec, watch)

    monkeypatch.setattr("generator.frame.plan.plan_objects", watched)
    place = {"site__latitude_deg": 0.0, "site__longitude_deg": dark_longitude_deg}
    plan_frame(small_scenario(foreground={"shells": [{}]}, time__utc_start=utc, **place), 0)
    ra, dec = np.radians([ra_deg, dec_deg])
    published = np.array([np.cos(ra) * np.cos(dec), np.sin(ra) * np.cos(dec), np.sin(dec)])
    assert np.degrees(np.arccos(min(seen[0].sun @ published, 1.0))) < 0.02


def test_satellites_of_a_shell_are_seen_in_the_evening_and_not_at_midnight() -> None:
    """At 52 deg in winter: dozens in twilight; at midnight the Sun is 59 deg down and all 550 km satellites are dark."""
    shells = {"shells": [{}]}
    counts = {}
    for hour in ("17:00", "23:40"):
        scenario = small_scenario(foreground=shells, time__utc_start=f"2020-01-15T{hour}:00Z", time__exposure_s=1.0)
        counts[hour] = len(plan_frame(scenario, 0).objects)
    assert counts["17:00"] > 10
    assert counts["23:40"] == 0
    plan = plan_frame(small_scenario(foreground=shells, time__utc_start="2020-01-15T17:00:00Z"), 0)
    assert (plan.objects.directions[:, :, 2].max(axis=1) > 0).all()
    # Overhead at 550 km: 7.2 + 5 log10(0.55) and 0.2 mag of air; none can be brighter.
    assert plan.objects.v_mag.min() > 7.2 + 5 * np.log10(0.55)
    other = plan_frame(small_scenario(foreground=shells, time__utc_start="2020-01-15T17:00:00Z", seed=8), 0)
    assert not np.array_equal(plan.objects.number, other.objects.number)


def test_cloud_dims_the_satellites_of_shells() -> None:
    """Each by the cloud's transmission in the middle of its path; without it they are as under a clear sky."""
    evening = {"foreground": {"shells": [{}]}, "time__utc_start": "2020-01-15T17:00:00Z"}
    clear = plan_frame(small_scenario(**evening), 0)
    cloudy = plan_frame(small_scenario(**evening, sky={"clouds": {"mean_optical_depth": 1.0, "coverage": 0.7}}), 0)
    assert cloudy.sky.clouds is not None
    middle = cloudy.objects.directions[:, cloudy.objects.directions.shape[1] // 2]
    wanted = -2.5 * np.log10(cloudy.sky.clouds.point_transmission(middle))
    np.testing.assert_allclose(cloudy.objects.v_mag - clear.objects.v_mag, wanted, atol=1e-9)
    assert wanted.max() > 1
    assert wanted.min() < 0.1


def test_numbers_of_false_stars_and_lamps_follow_all_satellites_of_shells() -> None:
    """Seen or not: one number denotes the same lamp in the evening and at midnight, and nothing else."""
    lamp = {"azimuth_deg": 0.0, "altitude_deg": 5.0, "distance_m": 100.0, "intensity_cd": 100.0, "kind": "LED"}
    foreground = {
        "trains": [TRAIN],
        "shells": [{}, {"planes": 2, "per_plane": 3}],
        "glints": {"count": 4},
        "lamps": [lamp],
    }
    first = 5 + 72 * 22 + 6
    for hour in ("17:00", "23:40"):
        utc = f"2020-01-15T{hour}:00Z"
        scene = {"foreground": foreground, "time__utc_start": utc, "attitude": NORTH, "stars__planets": False}
        plan = plan_frame(small_scenario(**scene), 0)
        glints = plan.objects.number[np.array(plan.objects.kind) == "glint"]
        assert glints.tolist() == [first, first + 1, first + 2, first + 3]
        table = object_table(plan, render_expected(plan))
        lamps = [row["object"] for row in table.to_pylist() if row["kind"] == "lamp"]
        assert lamps == [first + 4]
        assert len(set(plan.objects.number.tolist())) == len(plan.objects)


def test_a_train_s_satellites_follow_each_other() -> None:
    """The third is where the first was 8 s before: at half a degree per second, 4 deg behind."""
    plan = plan_frame(small_scenario(foreground={"trains": [TRAIN]}, time__exposure_s=10.0), 0)
    assert len(plan.objects) == 5
    altitude = np.degrees(np.arcsin(plan.objects.directions[:, 0, 2]))
    np.testing.assert_allclose(altitude, [60, 58, 56, 54, 52], atol=1e-9)
    assert plan.objects.number.tolist() == [0, 1, 2, 3, 4]
    assert (plan.objects.light_curve == 1).all()
    with pytest.raises(ScenarioError, match="end_s must come after start_s"):
        plan_frame(small_scenario(foreground={"trains": [TRAIN | {"end_s": -1.0}]}), 0)
