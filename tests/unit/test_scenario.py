"""Scenarios: what is accepted, what is refused and how, sweeps, hashes, attitudes."""

import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from small_scenes import BASE, small_scenario

from generator.errors import ScenarioError, TimeRangeError
from generator.light.atmosphere import usual_pressure_hpa
from generator.places import times
from generator.reading.strict_yaml import StrictLoader, strict_text
from generator.scenario.file import load_scenario, parse_scenario
from generator.scenario.model import NAMED_ATTITUDES, FrameSpec, Pointing, pointing_matrix, pointing_of
from generator.scenario.sequences.sequence import SequenceSpec, frame_of

ROOT = Path(__file__).parents[2]
TEXT = (ROOT / "scenes" / "00_hello.yaml").read_text()

REFUSED = {
    "unknown key": ("bortle: 5", "bortle: 5\nskyy: 3", ["skyy", "unknown key", "did you mean 'sky'"]),
    "wrong unit": ("hfov_deg: 120", "hfov_rad: 2.1", ["camera.hfov_rad", "'hfov_deg', in deg"]),
    "wrong unit of time": ("exposure_s: 0.5", "exposure_ms: 500", ["time.exposure_ms", "'exposure_s', in s"]),
    "unit in the value": ("hfov_deg: 120", "hfov_deg: 120 deg", ["camera.hfov_deg", "'120 deg'", "in deg"]),
    "no unit": ("aperture_mm: 4", "aperture: 4", ["camera.aperture", "'aperture_mm', in mm"]),
    "too large": ("hfov_deg: 120", "hfov_deg: 200", ["camera.hfov_deg", "200", "< 180"]),
    "class out of range": ("bortle: 5", "bortle: 11", ["sky.bortle", "11", "<= 9"]),
    "one swept value out of range": ("bortle: 5", "bortle: {sweep: [1, 2, 12]}", ["sky.bortle", "12", "<= 9"]),
    "fraction for an integer": ("bortle: 5", "bortle: 4.5", ["sky.bortle", "4.5", "integer"]),
    "dark current beyond any number": (
        "bortle: 5", "bortle: 5\nsensor: {temperature_c: 100, dark_reference_c: -100, dark_doubling_c: 1.001}",
        ["sensor: dark_current_e_s: 0.5 e/s at -100 deg C", "at temperature_c 100", "at most 1e+12", "dark_doubling_c"],
    ),
    "excess of hot pixels beyond any number": (
        "bortle: 5",
        "bortle: 5\nsensor: {temperature_c: 100, dark_reference_c: -100, dark_doubling_c: 50, hot_pixel_doubling_c: 2, "
        "hot_pixel_fraction: 0.01}",
        ["sensor: hot_pixel_e_s: 100 e/s at -100 deg C", "at most 1e+12", "raise hot_pixel_doubling_c"],
    ),
    "missing": ("latitude_deg: 52.0", "height_m: 2", ["site.latitude_deg", "missing"]),
    "missing of an optional section": (
        "bortle: 5", "bortle: 5\nsensor: {blinking_pixels: {fraction: 0.1}}",
        ["sensor.blinking_pixels.amplitude_e_s: missing; sensor.blinking_pixels needs it"],
    ),
    "missing section": (
        "camera:", "stars: {}\ncamera_: ", ["camera: missing; every scenario needs it"],
    ),
    "misspelt distribution": (
        "bortle: 5", "bortle: {unifrom: [1, 5]}",
        ["sky.bortle: found dict {'unifrom': [1, 5]}", "did you mean 'uniform'? A value that varies has one of: sweep,"],
    ),
    "misspelt sweep": ("hfov_deg: 120", "hfov_deg: {sweeep: [60, 90]}", ["camera.hfov_deg", "did you mean 'sweep'?"]),
    "misspelt range of times": (
        "utc_start: 2020-01-15T20:00:00Z", "utc_start: {range: [2020-01-15T20:00:00Z, 2020-01-16T20:00:00Z]}",
        ["time.utc_start", "; a value that varies has one of: sweep, uniform, integer, normal, choice, sphere_latitude, utc"],
    ),
    "time without zone": ("00:00Z", "00:00", ["time.utc_start", "2020-01-15T20:00:00", "ending in Z"]),
    "no such date": ("2020-01-15", "2020-02-30", ["time.utc_start", "2020-02-30"]),
    "not a number": ("latitude_deg: 52.0", "latitude_deg: .nan", ["site.latitude_deg", "nan", "finite"]),
    "text for a number": ("width: 1080", "width: wide", ["camera.width", "'wide'", "integer"]),
    "unknown attitude": ("zenith-north-up", "nadir", ["attitude", "'nadir'", "zenith-north-up"]),
    "unknown key in attitude": ("zenith-north-up", "{azimuth_deg: 1, altitude: 3}", ["attitude.altitude", "'altitude_deg'"]),
    "two brightnesses": ("bortle: 5", "bortle: 5\n  zenith_mag_arcsec2: 20", ["sky", "either"]),
    "key twice": ("bortle: 5", "bortle: 5\n  bortle: 6", ["line", "'bortle'", "twice"]),
    "negative seed": ("seed: 0", "seed: -1", ["seed", "-1"]),
    "bad name": ("name: hello", "name: ../hello", ["name", "../hello"]),
    "not YAML": ("site:", "site: [", ["line", "not valid YAML"]),
    "alias": ("seed: 0", "seed: &a 0\ndescription: *a", ["line", "aliases"]),
    "leading zero": (
        "attitude: zenith-north-up", "attitude: {azimuth_deg: 045, altitude_deg: 60}",
        ["mine.yaml, line", "found 045, a number with a leading zero", "write 45"],
    ),
    "negative with a leading zero": (
        "attitude: zenith-north-up", "attitude: {azimuth_deg: -090, altitude_deg: 60}", ["write -90"]
    ),
    "base 60": ("latitude_deg: 52.0", "latitude_deg: 52:30", ["site.latitude_deg: found str '52:30'"]),
    "fraction of base 60": ("latitude_deg: 52.0", "latitude_deg: 52:30:10.5", ["site.latitude_deg: found str '52:30:10.5'"]),
    "tag": ("seed: 0", "seed: !!int 0", ["mine.yaml, line", "tags are not allowed; remove !!int"]),
    "empty number by its tag": ("seed: 0", 'seed: !!float ""', ["tags are not allowed"]),
    "word by a tag of truth": ("seed: 0", "seed: !!bool x", ["tags are not allowed"]),
    "time by its tag": ("seed: 0", "seed: !!timestamp x", ["tags are not allowed"]),
    "set by its tag": ("sky:", "sky: !!set", ["tags are not allowed"]),
    "object": ("seed: 0", "seed: !!python/object/apply:os.getcwd []", ["not valid YAML"]),
    "empty sweep": ("bortle: 5", "bortle: {sweep: []}", ["sky.bortle.sweep", "list"]),
    "zip of unequal length": (
        "bortle: 5",
        "bortle: {sweep: [1, 2], zip: a}\nstars: {limiting_magnitude: {sweep: [5.0], zip: a}}",
        ["zipped as 'a'", "sky.bortle (2)", "stars.limiting_magnitude (1)"],
    ),
    "unknown curve": ("bortle: 5", "bortle: 5\nsensor: {quantum_efficiency: magic}", ["sensor.quantum_efficiency", "magic"]),
    "falling wavelengths": (
        "bortle: 5", "bortle: 5\nsensor: {quantum_efficiency: [[600, 0.1], [500, 0.2]]}", ["wavelengths must increase"],
    ),
    "key of nothing known": ("bortle: 5", "bortle: 5\nsensor: {zzz: 1}", ["sensor.zzz: unknown key; allowed: "]),
    "short list": (
        "bortle: 5", "bortle: 5\nsensor: {quantum_efficiency: []}", ["sensor.quantum_efficiency", "at least 2 of them"],
    ),
    "two short lists": (
        "bortle: 5", "bortle: 5\nsensor: {quantum_efficiency: [], sunburn: {hours_utc: []}}",
        ["quantum_efficiency: found", "sunburn.hours_utc: found", "sunburn.trap_e: missing"],
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", sorted(REFUSED))
def test_refusal_names_file_key_found_and_allowed(case) -> None:
    old, new, fragments = REFUSED[case]
    assert old in TEXT
    with pytest.raises(ScenarioError) as caught:
        parse_scenario(TEXT.replace(old, new), "mine.yaml")
    message = str(caught.value)
    assert message.startswith("mine.yaml")
    for fragment in fragments:
        assert fragment in message


LEVEL = {"start": {"azimuth_deg": 10, "altitude_deg": 0}, "end": {"azimuth_deg": 190, "altitude_deg": 0}}
TRAIL = {"kind": "satellite", "v_mag": 1} | LEVEL
RISING = TRAIL | {"end": {"azimuth_deg": 190, "altitude_deg": 0.001}}
SHELL = {"planes": 200, "per_plane": 200}
IMPOSSIBLE = {
    "opposite ends of a trail": (
        {"foreground": {"trails": [TRAIL]}}, "foreground.trails.0: end: is opposite to start, .* earlier end_s"
    ),
    "opposite ends of a train": (
        {"foreground": {"trains": [{"end_s": 60, "v_mag": 1} | LEVEL]}}, "foreground.trains.0: end: is opposite to start",
    ),
    "trail after the exposure": (
        {"foreground": {"trails": [RISING | {"start_s": 0.5}]}},
        "foreground.trails.0.start_s: 0.5 s is not before the end of the exposure, 0.5 s, .*; give an earlier",
    ),
    "one exposure too short for a trail": (
        {"foreground": {"trails": [RISING | {"start_s": 1}]}, "time__exposure_s": {"sweep": [2, 1]}},
        "foreground.trails.0.start_s",
    ),
    "trail after the exposures of a sequence": (
        {"foreground": {"trails": [RISING | {"start_s": 1}]}, "time__every_s": 1, "time__count": 2},
        "foreground.trails.0.start_s",
    ),
    "satellites beyond memory": (
        {"foreground": {"shells": [SHELL] * 3}}, "foreground: shells: found 120000 satellites, at most 100000; lower",
    ),
    "cosmic rays beyond memory": (
        {"sensor": {"cosmic_rays": {"rate_s": 1e6}}, "time__exposure_s": 3600},
        "sensor.cosmic_rays.rate_s: 1e.06 tracks per second of 4 px over 3600 s are more than 1e.07 px; lower",
    ),
    "cosmic rays of a sequence": (
        {"sensor": {"cosmic_rays": {"rate_s": 1e6, "length_px": 1000}}, "time__every_s": 1, "time__count": 2},
        "sensor.cosmic_rays.rate_s",
    ),
    "readings beyond a record": (
        {"motion": {"imu": {}}, "time__exposure_s": 600},
        "motion.imu.rate_hz: 200 Hz over 600 s are 1.2e.05 readings, and a frame record holds 50000; lower",
    ),
    "polynomial beyond numbers": (
        {"motion": {"polynomial_deg": [[], [], [1, 1e308]]}, "time__exposure_s": 100},
        r"motion.polynomial_deg.2.1: 1e\+308 deg/s\^2 turns the camera by more than 1.296e\+06 deg in 50 s",
    ),
    "field beyond numbers": ({"camera__hfov_deg": 1e-300}, "camera: hfov_deg: with it the focal length is .* 0.01 to 1e.09"),
    "field that is nothing": ({"camera__hfov_deg": 5e-324}, "camera: hfov_deg: with it the focal length is inf px"),
    "pitch beyond numbers": (
        {"camera__hfov_deg": None, "camera__focal_length_mm": 4, "camera__pixel_pitch_um": 1e-320},
        "camera: focal_length_mm: with it and pixel_pitch_um the focal length is inf px",
    ),
    "flat field": ({"camera__hfov_deg": 179.9999}, "camera: hfov_deg: with it the focal length is 0.000118 px"),
    "centre beyond numbers": ({"camera__cx_px": 1e308}, r"camera: cx_px: found 1e\+308, .* within 1e.07 px"),
    "centre above all numbers": ({"camera__cy_px": -1.1e7}, "camera: cy_px: found -1.1e"),
}  # fmt: skip


def separate(tree):
    """A copy without shared parts, for which YAML has aliases."""
    return json.loads(json.dumps(tree))


@pytest.mark.parametrize("case", sorted(IMPOSSIBLE))
def test_values_that_together_are_impossible_are_refused_with_key_and_remedy(case) -> None:
    changes, words = IMPOSSIBLE[case]
    with pytest.raises(ScenarioError, match=f"^test.yaml: {words}"):
        small_scenario(**separate(changes))


@pytest.mark.parametrize("changes", [
    {"foreground": {"trails": [RISING], "trains": [LEVEL | {"end": RISING["end"], "end_s": 60, "v_mag": 1}]}},
    {"foreground": {"trails": [TRAIL | {"end": TRAIL["start"]}]}},
    {"foreground": {"trails": [RISING | {"start_s": 1, "end_s": 2}]}},
    {"foreground": {"shells": [SHELL] * 2}},
    {"sensor": {"cosmic_rays": {"rate_s": 100}}, "time__exposure_s": 3600},
    {"motion": {"imu": {}}, "time__exposure_s": 250},
    {"motion": {"polynomial_deg": [[720], [], [0, -30]]}, "time__exposure_s": 30},
    {"camera__hfov_deg": 1e-4, "camera__cx_px": -1e7},
])  # fmt: skip
def test_values_at_the_limits_are_accepted(changes) -> None:
    assert small_scenario(**separate(changes)).frame(0)


@pytest.mark.parametrize(("written", "number"), [
    ("1e-1", 0.1), ("1e0", 1.0), ("1E0", 1.0), ("2.5e-1", 0.25), ("+1e0", 1.0), ("+.5", 0.5), ("1.e-1", 0.1), (".5e0", 0.5),
    ("0.5", 0.5), ("00.5", 0.5), ("1", 1.0),
])  # fmt: skip
def test_numbers_need_neither_a_point_nor_the_sign_of_their_exponent(written, number) -> None:
    frame = parse_scenario(TEXT.replace("exposure_s: 0.5", f"exposure_s: {written}"), "mine.yaml").frame(0)
    assert frame.time.exposure_s == number


@pytest.mark.parametrize("written", ["+10:00", "190:20:30", "12:30.5", "2020-01-15", "0o17", "e5", "1e", "."])
def test_what_only_looks_like_a_number_arrives_as_text(written) -> None:
    assert yaml.load(f"a: {written}", Loader=StrictLoader) == {"a": written}


@given(st.one_of(st.text("0123456789-+._:eEx", max_size=8), st.sampled_from(["1e-00042", "089", "1e3", "+.5"])))
def test_text_that_looks_like_a_number_is_written_so_that_it_stays_text(text) -> None:
    shared = [1e-5, text]
    tree = {"name": text, "value": shared, "count": 12, "again": shared}
    assert yaml.load(strict_text(tree), Loader=StrictLoader) == tree


@pytest.mark.parametrize("path", sorted((ROOT / "scenes").glob("*.yaml")), ids=lambda path: path.name)
def test_shipped_scenarios_are_valid(path) -> None:
    assert load_scenario(path).frame_count >= 1


def test_unreadable_files_are_refused(tmp_path) -> None:
    with pytest.raises(ScenarioError, match=r"nowhere\.yaml: cannot be read"):
        load_scenario(tmp_path / "nowhere.yaml")
    (tmp_path / "large.yaml").write_bytes(b"#" * 1_000_001)
    with pytest.raises(ScenarioError, match="larger than"):
        load_scenario(tmp_path / "large.yaml")
    (tmp_path / "binary.yaml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ScenarioError, match="UTF-8"):
        load_scenario(tmp_path / "binary.yaml")


@given(st.text(max_size=200))
def test_any_text_is_refused_cleanly(text) -> None:
    with pytest.raises(ScenarioError, match=r"^any\.yaml"):
        parse_scenario(text, "any.yaml")


def test_sweeps_multiply_and_zips_advance_together() -> None:
    scenario = small_scenario(
        site={
            "latitude_deg": {"sweep": [10.0, 20.0], "zip": "place"},
            "longitude_deg": {"sweep": [1.0, 2.0], "zip": "place"},
        },
        sky={"bortle": {"sweep": [3, 5, 7]}},
    )
    seen = [
        (frame.site.latitude_deg, frame.site.longitude_deg, frame.sky.bortle)
        for frame in map(scenario.frame, range(scenario.frame_count))
    ]
    assert seen == [(10, 1, 3), (10, 1, 5), (10, 1, 7), (20, 2, 3), (20, 2, 5), (20, 2, 7)]
    with pytest.raises(IndexError):
        scenario.frame(6)


def test_hash_is_of_the_meaning() -> None:
    """Comments, order and spelt-out defaults do not count; any value does, and so does the order of sweeps."""
    base = small_scenario()
    shuffled = yaml.safe_dump(dict(reversed(BASE.items())), sort_keys=False) + "# a comment\n"
    assert parse_scenario(shuffled, "other.yaml").sha256 == base.sha256
    assert small_scenario(camera__transmission=0.9).sha256 == base.sha256
    others = {
        small_scenario(seed=8).sha256,
        small_scenario(sky={"bortle": 5}).sha256,
        small_scenario(camera__transmission=0.8).sha256,
        small_scenario(sky={"bortle": {"sweep": [4, 5]}}).sha256,
        small_scenario(sky={"bortle": {"sweep": [5, 4]}}).sha256,
    }
    assert len(others | {base.sha256}) == 6
    place = BASE["site"] | {"height_m": {"sweep": [0, 4000]}}
    follows = small_scenario(site=place)
    assert follows.sha256 != small_scenario(site=place, atmosphere={"pressure_hpa": 1010}).sha256
    assert follows.sha256 == small_scenario(site=place, atmosphere={"pressure_hpa": None}).sha256


def test_zenith_north_up_is_the_documented_matrix() -> None:
    np.testing.assert_allclose(small_scenario().frame(0).R_cam, [[-1, 0, 0], [0, -1, 0], [0, 0, 1]], atol=1e-15)


@given(st.floats(-360, 360), st.floats(-90, 90), st.floats(-360, 360))
def test_attitudes_are_rotations_with_the_boresight_where_asked(azimuth, altitude, roll) -> None:
    matrix = pointing_matrix(Pointing(azimuth_deg=azimuth, altitude_deg=altitude, roll_deg=roll))
    np.testing.assert_allclose(matrix @ matrix.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(matrix) == pytest.approx(1)
    a, h = np.radians([azimuth, altitude])
    boresight = [np.sin(a) * np.cos(h), np.cos(a) * np.cos(h), np.sin(h)]
    np.testing.assert_allclose(matrix[2], boresight, atol=1e-12)


def test_level_camera_has_the_zenith_above_and_east_to_the_right_of_north() -> None:
    matrix = pointing_matrix(Pointing(azimuth_deg=0.0, altitude_deg=0.0))
    np.testing.assert_allclose(matrix @ [0, 0, 1], [0, -1, 0], atol=1e-15)
    np.testing.assert_allclose(matrix @ [1, 0, 0], [1, 0, 0], atol=1e-15)


def test_roll_turns_the_camera_clockwise() -> None:
    """Seen from behind, the camera turns to the right, so the zenith turns to the left in the image."""
    matrix = pointing_matrix(Pointing(azimuth_deg=0.0, altitude_deg=0.0, roll_deg=30.0))
    x, y, z = matrix @ [0, 0, 1]
    assert (x, y, z) == pytest.approx((-0.5, -np.sqrt(0.75), 0))


@given(st.floats(0, 359.9999), st.floats(-89.9999, 89.9999), st.floats(-179.9999, 180))
def test_pointing_of_a_matrix_is_the_one_it_was_made_of(azimuth, altitude, roll) -> None:
    found = pointing_of(pointing_matrix(Pointing(azimuth_deg=azimuth, altitude_deg=altitude, roll_deg=roll)))
    off = np.array([found.azimuth_deg - azimuth, found.altitude_deg - altitude, found.roll_deg - roll])
    np.testing.assert_allclose((off + 180) % 360 - 180, 0, atol=2e-8)
    assert 0 <= found.azimuth_deg < 360


@pytest.mark.parametrize("altitude", [90.0, -90.0])
def test_pointing_at_the_poles_has_the_azimuth_180(altitude) -> None:
    matrix = pointing_matrix(Pointing(azimuth_deg=33.0, altitude_deg=altitude, roll_deg=40.0))
    found = pointing_of(matrix)
    assert found.azimuth_deg == 180.0
    np.testing.assert_allclose(pointing_matrix(found), matrix, atol=1e-10)
    north_up = pointing_of(np.diag([-1.0, -1.0, 1.0])).model_dump()
    assert north_up == pytest.approx(NAMED_ATTITUDES["zenith-north-up"].model_dump(), abs=1e-12)


def local_air(site, atmosphere):
    tree = {"site": site, "time": {"utc_start": "2020-01-01T00:00:00Z", "exposure_s": 1.0}, "camera": CAMERA}
    return FrameSpec.model_validate(tree | ({} if atmosphere is None else {"atmosphere": atmosphere})).atmosphere


CAMERA = {"width": 32, "height": 24, "hfov_deg": 60, "aperture_mm": 4}
AT_4000_M = {"latitude_deg": 0, "longitude_deg": 0, "height_m": 4000}


@pytest.mark.parametrize("atmosphere", [None, {}, {"relative_humidity": 0.2}, {"pressure_hpa": None}])
def test_pressure_and_temperature_follow_the_height(atmosphere) -> None:
    """U.S. Standard Atmosphere 1976: 616.60 hPa at 4,000 m for 1013.25 at sea level; 6.5 K/km."""
    air = local_air(AT_4000_M, atmosphere)
    assert air.pressure_hpa == pytest.approx(616.60 * 1010 / 1013.25, rel=1e-4)
    assert air.temperature_c == pytest.approx(10 - 26)
    low = local_air({"latitude_deg": 0, "longitude_deg": 0}, atmosphere)
    assert (low.pressure_hpa, low.temperature_c) == (1010.0, 10.0)


def test_a_given_pressure_stays() -> None:
    air = local_air(AT_4000_M, {"pressure_hpa": 640, "temperature_c": 3})
    assert (air.pressure_hpa, air.temperature_c) == (640, 3)
    assert local_air(AT_4000_M, {"pressure_hpa": 0}).pressure_hpa == 0


def test_the_air_of_a_path_follows_its_height() -> None:
    """A camera that climbs: each frame has the air of its own height."""
    waypoints = [
        {"t_s": t_s, "latitude_deg": 50, "longitude_deg": 8 + t_s / 1e5, "height_m": height_m}
        for t_s, height_m in ((0, 0), (600, 6000))
    ]
    tree = {
        "time": {"utc_start": "2020-01-01T00:00:00Z", "exposure_s": 1.0, "every_s": 500, "count": 2},
        "path": {"waypoints": waypoints}, "camera": CAMERA,
    }  # fmt: skip
    sequence = SequenceSpec.model_validate(tree)
    low, high = (frame_of(sequence, step) for step in (0, 1))
    assert low.atmosphere.pressure_hpa > 1000
    assert high.atmosphere.pressure_hpa == pytest.approx(float(usual_pressure_hpa(high.site.height_m)))
    assert high.site.height_m > 4000


@pytest.mark.parametrize(("time", "index"), [
    ({"utc_start": "1965-01-01T00:00:00Z", "exposure_s": 0.5}, 0),
    ({"utc_start": {"sweep": ["2020-01-15T20:00:00Z", "1970-06-01T00:00:00Z"]}, "exposure_s": 0.5}, 1),
    ({"utc_start": "1973-01-01T12:00:00Z", "exposure_s": 0.5, "every_s": 60, "count": 3}, 2),
])  # fmt: skip
def test_a_time_beyond_the_table_of_earth_orientation_names_file_and_key(time, index, monkeypatch) -> None:
    # This table ends between the second and the third frame of the sequence.
    if "every_s" in time:
        monkeypatch.setattr(times, "finals2000a", lambda: np.array([[41683.0, 0, 0, 0], [41683.501, 0, 0, 0]]))
    scenario = parse_scenario(yaml.safe_dump(BASE | {"time": time}), "mine.yaml")
    for good in range(index):
        scenario.frame(good)
    with pytest.raises(
        TimeRangeError, match=rf"mine\.yaml: time\.utc_start: frame {index}: .* Earth orientation table"
    ):
        scenario.frame(index)
