"""Distributions in scenarios: what they draw, that they are refused when malformed, that each is independent."""

import copy

import numpy as np
import pytest
import yaml
from scipy import stats
from small_scenes import BASE, small_scenario

from generator.errors import ScenarioError
from generator.places.sun import sun_altitude_deg
from generator.places.times import Instant
from generator.scenario.file import parse_scenario
from generator.scenario.variation import describe, find_variations

FALSE_ALARM = 1e-4


def values(scenario, *path):
    found = []
    for index in range(scenario.frame_count):
        value = scenario.frame(index)
        for key in path:
            value = getattr(value, key)
        found.append(value)
    return np.array(found)


def test_uniform_normal_and_sphere_follow_their_laws() -> None:
    """Kolmogorov-Smirnov tests, false-alarm rate 1e-4 each."""
    scenario = small_scenario(
        frames=800,
        site={"latitude_deg": {"sphere_latitude": [-90, 90]}, "longitude_deg": {"uniform": [-180, 180]}},
        camera__psf_sigma_px={"normal": [1.0, 0.2], "limits": [0.7, 1.4]},
        sky={"bortle": {"integer": [1, 9]}},
        camera__aperture_mm={"choice": [2.0, 4.0]},
    )
    sine = np.sin(np.radians(values(scenario, "site", "latitude_deg")))
    assert stats.kstest(sine, stats.uniform(-1, 2).cdf).pvalue > FALSE_ALARM
    assert stats.kstest(values(scenario, "site", "longitude_deg"), stats.uniform(-180, 360).cdf).pvalue > FALSE_ALARM
    truncated = stats.truncnorm(-1.5, 2.0, loc=1.0, scale=0.2)
    assert stats.kstest(values(scenario, "camera", "psf_sigma_px"), truncated.cdf).pvalue > FALSE_ALARM
    counts = np.bincount(values(scenario, "sky", "bortle"), minlength=10)[1:]
    assert stats.chisquare(counts).pvalue > FALSE_ALARM
    assert (
        stats.chisquare(np.unique(values(scenario, "camera", "aperture_mm"), return_counts=True)[1]).pvalue
        > FALSE_ALARM
    )


def test_times_keep_the_sun_below() -> None:
    scenario = small_scenario(
        frames=60,
        site={"latitude_deg": {"uniform": [-90, 90]}, "longitude_deg": {"uniform": [-180, 180]}},
        time__utc_start={"utc": ["2000-01-01T00:00:00Z", "2025-12-31T00:00:00Z"], "sun_below_deg": -6},
    )
    years = set()
    for index in range(60):
        frame = scenario.frame(index)
        instant = Instant.parse(frame.time.utc_start)
        assert sun_altitude_deg(instant, frame.site.latitude_deg, frame.site.longitude_deg) < -6
        years.add(frame.time.utc_start[:4])
    assert len(years) > 10


def test_sun_altitude_against_astropy() -> None:
    """Within 0.01 deg of astropy's get_sun and AltAz without refraction, at five sites and times."""
    from astropy import units as u
    from astropy.coordinates import AltAz, EarthLocation, get_sun
    from astropy.time import Time
    from astropy.utils import iers

    with iers.conf.set_temp("auto_download", False):
        for text, latitude, longitude in [
            ("2000-06-21T12:00:00Z", 52.0, 4.0),
            ("2010-12-21T06:30:00Z", -33.9, 18.4),
            ("2020-03-20T18:45:00Z", 0.0, 179.0),
            ("2023-09-01T01:02:03Z", 78.2, 15.6),
            ("2015-02-03T23:59:59Z", -77.8, -166.0),
        ]:
            time = Time(text[:-1], scale="utc")
            place = EarthLocation.from_geodetic(longitude * u.deg, latitude * u.deg)
            wanted = get_sun(time).transform_to(AltAz(obstime=time, location=place)).alt.deg
            assert sun_altitude_deg(Instant.parse(text), latitude, longitude) == pytest.approx(wanted, abs=0.01)


def test_midnight_sun_is_an_error_that_says_so() -> None:
    scenario = small_scenario(
        site__latitude_deg=80.0,
        time__utc_start={"utc": ["2020-06-01T00:00:00Z", "2020-06-10T00:00:00Z"], "sun_below_deg": -6},
    )
    with pytest.raises(ScenarioError, match=r"time.utc_start: frame 0: the Sun is not below -6 deg at latitude 80"):
        scenario.frame(0)


def test_frames_multiply_with_sweeps_and_differ() -> None:
    scenario = small_scenario(frames=3, sky={"bortle": {"sweep": [2, 6]}}, site__latitude_deg={"uniform": [0, 60]})
    assert scenario.frame_count == 6
    assert values(scenario, "sky", "bortle").tolist() == [2, 2, 2, 6, 6, 6]
    assert len(set(values(scenario, "site", "latitude_deg"))) == 6


def test_values_inside_lists_vary_too() -> None:
    """A sweep and a distribution of items of lists; the hash sees them, and not what they gave."""
    trail = {
        "kind": "satellite",
        "start": {"azimuth_deg": {"uniform": [0, 360]}, "altitude_deg": 70},
        "end": {"azimuth_deg": 120, "altitude_deg": 75},
        "v_mag": {"sweep": [1.0, 3.0]},
    }
    values = {"foreground": {"trails": [trail]}, "motion": {"rate_deg_s": [{"uniform": [-1, 1]}, 0, 0]}}
    scenario = small_scenario(**values, frames=3)
    assert scenario.frame_count == 6
    frames = [scenario.frame(index) for index in range(6)]
    assert [frame.foreground.trails[0].v_mag for frame in frames] == [1, 1, 1, 3, 3, 3]
    assert len({frame.foreground.trails[0].start.azimuth_deg for frame in frames}) == 6
    assert len({frame.motion.rate_deg_s[0] for frame in frames}) == 6
    other = copy.deepcopy(values)
    other["motion"]["rate_deg_s"][0]["uniform"] = [-1, 2]
    assert small_scenario(**other, frames=3).sha256 != scenario.sha256
    assert small_scenario(**values, frames=3).sha256 == scenario.sha256
    trail["v_mag"] = {"uniform": [1, 99]}
    with pytest.raises(ScenarioError, match=r"foreground\.trails\.0\.v_mag"):
        small_scenario(**values)


def test_one_distribution_does_not_disturb_another() -> None:
    alone = small_scenario(frames=4, site__latitude_deg={"uniform": [0, 60]})
    beside = small_scenario(
        frames=4, site__latitude_deg={"uniform": [0, 60]}, camera__aperture_mm={"uniform": [2.0, 5.0]}
    )
    assert values(alone, "site", "latitude_deg").tolist() == values(beside, "site", "latitude_deg").tolist()


def test_hash_sees_distributions() -> None:
    hashes = {
        small_scenario(site__latitude_deg={"uniform": [0, 60]}).sha256,
        small_scenario(site__latitude_deg={"uniform": [0, 61]}).sha256,
        small_scenario(site__latitude_deg={"sphere_latitude": [0, 60]}).sha256,
        small_scenario(site__latitude_deg={"uniform": [0, 60]}, frames=2).sha256,
    }
    assert len(hashes) == 4


@pytest.mark.parametrize(
    ("where", "value", "message"),
    [
        ("latitude_deg", {"uniform": [60, 0]}, "site.latitude_deg.uniform.*lower limit first"),
        ("latitude_deg", {"uniform": [0]}, "expected .low, high."),
        ("latitude_deg", {"uniform": [0, 95]}, "site.latitude_deg: found float 95.0, expected a value <= 90"),
        ("latitude_deg", {"uniform": [0, 10], "sigma": 1}, "site.latitude_deg.sigma: unknown key"),
        ("latitude_deg", {"normal": [0, -1]}, "positive"),
        ("latitude_deg", {"choice": []}, "at least one value"),
        ("height_m", {"integer": [0.5, 2]}, "expected .low, high."),
        ("latitude_deg", {"utc": ["2020-01-01", "2021-01-01"]}, "ending in Z"),
        ("latitude_deg", {"utc": ["2021-01-01T00:00:00Z", "2020-01-01T00:00:00Z"]}, "earlier time first"),
    ],
)
def test_malformed_distributions_are_refused(where, value, message) -> None:
    tree = BASE | {"site": BASE["site"] | {where: value}}
    with pytest.raises(ScenarioError, match=message):
        parse_scenario(yaml.safe_dump(tree), "bad.yaml")


@pytest.mark.parametrize(("where", "written"), [
    ("time.exposure_s", "{normal: [.nan, 1]}"),
    ("time.exposure_s", "{normal: [.inf, 1]}"),
    ("time.exposure_s", "{normal: [1, .inf]}"),
    ("time.exposure_s", "{normal: [1, 1" + 400 * "0" + "]}"),
    ("time.exposure_s", "{normal: [1, 1.0e-310]}"),
    ("time.exposure_s", "{uniform: [1, 1" + 400 * "0" + "]}"),
    ("time.exposure_s", "{uniform: [0x1" + 5000 * "0" + ", 1]}"),
    ("time.exposure_s", "{uniform: [[0x1" + 5000 * "0" + "], 1]}"),
    ("camera.cx_px", "{uniform: [-1.7e+308, 1.7e+308]}"),
    ("camera.cx_px", "{normal: [1, 1], limits: [.nan, 1]}"),
    ("sensor.unit", "{integer: [0, 9223372036854775808]}"),
])  # fmt: skip
def test_distributions_of_numbers_that_nothing_draws_are_refused_with_their_key(where, written) -> None:
    tree = copy.deepcopy(BASE)
    section, key = where.split(".")
    tree.setdefault(section, {})[key] = "HERE"
    with pytest.raises(ScenarioError, match=rf"^bad\.yaml: {where}\."):
        parse_scenario(yaml.safe_dump(tree).replace("HERE", written), "bad.yaml")


def test_infinite_limits_leave_a_side_open() -> None:
    scenario = small_scenario(frames=20, sky__airglow_factor={"normal": [1.0, 0.3], "limits": [1.0, float("inf")]})
    assert min(scenario.frame(index).sky.airglow_factor for index in range(20)) >= 1.0


def test_the_largest_integer_is_drawn() -> None:
    assert small_scenario(sensor={"unit": {"integer": [0, 2**63 - 1]}}).frame(0).sensor.unit > 2**40


def test_a_number_of_frames_that_python_does_not_print_is_refused() -> None:
    text = yaml.safe_dump(BASE | {"sky": {"bortle": {"sweep": [1, 2]}}}) + "frames: " + "9" * 4300
    with pytest.raises(ScenarioError, match=r"it makes more than 10\^50 frames, expected at most 10000000"):
        parse_scenario(text, "many.yaml")


def test_a_sweep_of_more_values_than_anybody_checks_is_refused() -> None:
    with pytest.raises(ScenarioError, match=r"sweep: found 10001 values, at most 10000 are swept"):
        find_variations({"sky": {"bortle": {"sweep": [3] * 10_001}}}, "s.yaml")


def test_a_number_of_more_digits_than_can_be_printed_gets_its_message() -> None:
    assert describe(16**5000) == "int of more than 50 digits"
    assert describe(12) == "int 12"
    assert describe([16**5000]) == "list with a number of more than 50 digits"


@pytest.mark.parametrize("limits", [[2, 3], [-3, -2]])
def test_limits_without_a_part_of_the_gaussian_are_refused(limits) -> None:
    with pytest.raises(ScenarioError, match=r"sky.airglow_factor.limits: .*more than 6 sigma"):
        small_scenario(sky__airglow_factor={"normal": [0, 0.1], "limits": limits})
