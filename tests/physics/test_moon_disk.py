"""The Moon's disk in a frame: its points, its motion, how the air bends it, and what it hides."""

import numpy as np
import pytest
from skyfield.api import Loader, load_file, wgs84
from small_scenes import small_scenario

from generator.frame.exposure.expected import render_expected
from generator.frame.moon import disk
from generator.frame.moon.disk import disk_grid, moon_lights
from generator.frame.moon.occultation import times_inside
from generator.frame.moon.path import disk_frame
from generator.frame.object_table import object_table
from generator.frame.plan import plan_frame
from generator.frame.record import star_table
from generator.places.ephemeris import KERNEL_PATH, MOON_RADIUS_KM

SATURN = 900_000_699
CLEAN = {"aperture_mm": 10, "bloom": {"share": 0}, "veiling_glare": 0}


@pytest.fixture(scope="module")
def skyfield(tmp_path_factory):
    kernel = load_file(str(KERNEL_PATH))
    yield kernel, Loader(str(tmp_path_factory.mktemp("skyfield"))).timescale(builtin=True)
    kernel.close()


def apparent(skyfield, body, site, when):
    """Azimuth and altitude, rad, and distance, km, by Skyfield, without air; `when` is (year, …, seconds)."""
    kernel, timescale = skyfield
    place = (kernel["earth"] + wgs84.latlon(*site)).at(timescale.utc(*when)).observe(kernel[body]).apparent()
    altitude, azimuth, distance = place.altaz()
    return azimuth.radians, altitude.radians, distance.km


def vector(azimuth, altitude):
    return np.array([np.sin(azimuth) * np.cos(altitude), np.cos(azimuth) * np.cos(altitude), np.sin(altitude)])


def towards_moon(offset_deg=0.0, **values):
    """Plan and picture of a scenario whose camera points to the Moon of its start, with its sky of moonlight alone."""
    values = {"sky": {"components": ["moonlight"]}, "stars": {"limiting_magnitude": 1.0}} | values
    east, north, up = plan_frame(small_scenario(**values | {"time__exposure_s": 0.001}), 0).sky.moon_enu
    attitude = {
        "azimuth_deg": float(np.degrees(np.arctan2(east, north))),
        "altitude_deg": float(np.degrees(np.arcsin(up))) + offset_deg,
    }
    plan = plan_frame(small_scenario(**values, attitude=attitude), 0)
    return plan, render_expected(plan, channels=False)


def moon_row(plan, expected):
    table = object_table(plan, expected).to_pandas()
    return table[table.kind == "moon"].iloc[0]


@pytest.mark.parametrize("across", [3, 4, 37, 300])
@pytest.mark.parametrize("phase_deg", [0.0, 45.0, 90.0, 150.0])
def test_lit_part_of_the_disk(phase_deg, across) -> None:
    """(1 + cos a)/2 of the disk's area; on the side of the Sun; all light there is, from all rows or from parts of them."""
    grid = disk_grid(across, phase_deg)
    x, y, share = grid.rows(0, across)
    assert share.sum() == pytest.approx(1.0)
    assert (x**2 + y**2 < 1).all()
    whole = (across / 2) ** 2 * np.pi
    if across > 30:
        assert (x > -np.cos(np.radians(phase_deg)) * np.sqrt(1 - y**2)).all()
        assert len(x) / whole == pytest.approx((1 + np.cos(np.radians(phase_deg))) / 2, abs=0.02)
        assert np.hypot(x, y).max() == pytest.approx(1.0, abs=2 / across)
    parts = [grid.rows(start, min(start + 5, across)) for start in range(0, across, 5)]
    np.testing.assert_array_equal(np.concatenate([part[0] for part in parts]), x)


def test_new_moon_has_a_point_that_is_lit() -> None:
    x, _, share = disk_grid(10, 179.9).rows(0, 10)
    assert share.sum() == pytest.approx(1.0)
    assert x.min() == x.max() > 0.85


def test_earthshine_lies_on_the_whole_disk() -> None:
    grid = disk_grid(120, 140.0, 0.01)
    _, _, share = grid.rows(0, 120)
    assert len(share) == len(disk_grid(120, 0.0).rows(0, 120)[2])
    assert share.sum() == pytest.approx(1.01)
    dark = share < share.max() / 2
    assert dark.mean() == pytest.approx((1 - np.cos(np.radians(140.0))) / 2, abs=0.02)
    np.testing.assert_allclose(share[dark], 0.01 / len(share))


def test_disk_is_as_wide_as_the_moon_and_faces_the_sun() -> None:
    """0.2590 deg at 384,400 km."""
    centre, sun = np.array([[0.0, 0.0, 1.0]]), np.array([[1.0, 0.0, -0.2]]) / np.hypot(1, 0.2)
    path = disk_frame(centre, sun, np.arcsin([MOON_RADIUS_KM / 384_400]))
    limb = path.points(np.array([1.0, 0.0]), np.array([0.0, -1.0]))
    assert np.degrees(np.arccos(limb[:, 0] @ centre[0])) == pytest.approx(0.2590, abs=1e-4)
    assert limb[0, 0, 0] == pytest.approx(np.sin(np.radians(0.2590)), rel=1e-3)
    places = path.offsets(limb)
    np.testing.assert_allclose(places[:, 0], [[1.0, 0.0], [0.0, -1.0]], atol=1e-12)


def test_moon_trails_as_skyfield_has_it(skyfield) -> None:
    """Ten minutes: 13.6 arcsec/s at a declination of 22 deg, where stars move by 13.9. The way within 0.05 px of Skyfield's,
    lifted by Saemundsson's formula (1986, Sky & Telescope 72, 70)."""
    site, clock = {"latitude_deg": 52.0, "longitude_deg": 4.36, "height_m": 0.0}, "2020-01-08T22:00:00Z"
    time = {"time__utc_start": clock, "time__exposure_s": 600.0}
    camera = {"width": 300, "height": 300, "hfov_deg": 15} | CLEAN
    plan, expected = towards_moon(site=site, camera=camera, **time)
    row = moon_row(plan, expected)
    f_px = 150 / np.tan(np.radians(7.5))
    ends = []
    for minute in (0, 10):
        azimuth, altitude, _ = apparent(skyfield, "moon", (52.0, 4.36, 0.0), (2020, 1, 8, 22, minute, 0))
        degrees = np.degrees(altitude)
        lift = 1.02 / np.tan(np.radians(degrees + 10.3 / (degrees + 5.11))) / 60
        x, y, z = plan.motion.R_mid @ vector(azimuth, np.radians(degrees + lift))
        ends.append((f_px * x / z + 149.5, f_px * y / z + 149.5))
    # Of a phase of 20 deg the lit part's middle lies a little beside the disk's, in the same way at both times.
    found = np.array([[row.start_u_px, row.start_v_px], [row.end_u_px, row.end_v_px]])
    assert np.diff(found, axis=0) == pytest.approx(np.diff(ends, axis=0), abs=0.05)
    assert found == pytest.approx(np.array(ends), abs=0.3)
    trail = float(np.hypot(*(found[1] - found[0])))
    assert np.degrees(trail / f_px) * 3600 / 600 == pytest.approx(13.6, abs=0.3)
    assert row.high_u_px - row.low_u_px == pytest.approx(trail + 10.6, abs=0.9)
    lit = np.argwhere(expected.electrons > 0.02 * expected.electrons.max())
    assert np.ptp(lit[:, 1]) == pytest.approx(trail + 10.6, abs=3)


@pytest.mark.parametrize("hfov_deg", [5.0, 1.5, 0.4])
def test_moon_of_any_size_is_smooth(hfov_deg) -> None:
    """Diameters of 43, 142 and 533 px, and the light that is not on the frame."""
    when = {"time__utc_start": "2020-01-10T23:00:00Z", "time__exposure_s": 0.01}
    camera = {"width": 400, "height": 400, "hfov_deg": hfov_deg, "psf_sigma_px": 0.8} | CLEAN
    plan, expected = towards_moon(camera=camera, **when)
    middle = expected.electrons[190:210, 190:210]
    assert middle.std() / middle.mean() < 2e-3
    assert middle.min() > 0
    radius_px = plan.spec.camera.f_px * np.arcsin(MOON_RADIUS_KM / plan.sky.moon.distance_km)
    row = moon_row(plan, expected)
    lit = (1 + np.cos(np.radians(plan.sky.moon.phase_angle_deg))) / 2
    assert row.electrons_e / (np.pi * radius_px**2 * lit) == pytest.approx(middle.mean(), rel=0.02)
    on_frame = min(1.0, 400**2 / (np.pi * radius_px**2))
    assert row.fraction_in_frame == pytest.approx(on_frame, abs=0.01)


def test_large_disk_is_drawn_in_blocks_of_the_same_light(monkeypatch) -> None:
    """Also where the Moon moves: the picture of many blocks is that of one, to the rounding of sums."""
    when = {"time__utc_start": "2020-01-10T23:00:00Z", "time__exposure_s": 20.0}
    camera = {"width": 200, "height": 200, "hfov_deg": 1.0} | CLEAN
    plan, whole = towards_moon(camera=camera, **when)
    count = sum(1 for _ in moon_lights(plan))
    monkeypatch.setattr(disk, "MOST_AT_ONCE", 2_000)
    monkeypatch.setattr(disk, "FEWEST_AT_ONCE", 500)
    assert sum(1 for _ in moon_lights(plan)) > count + 3
    parts = render_expected(plan, channels=False)
    np.testing.assert_allclose(parts.electrons, whole.electrons, rtol=1e-4, atol=1e-4 * whole.electrons.max())
    for name in ("start_px", "end_px", "centroid_px", "low_px", "high_px", "electrons", "fraction_in_frame"):
        np.testing.assert_allclose(getattr(parts.moon, name), getattr(whole.moon, name), rtol=1e-4)


def saemundsson_deg(true_deg):
    """Refraction at true altitudes at 1010 hPa and 10 deg C (Saemundsson 1986), some 0.1 arcmin."""
    return 1.02 / np.tan(np.radians(true_deg + 10.3 / (true_deg + 5.11))) / 60


@pytest.mark.parametrize("clock", ["2020-01-11T16:47:00Z", "2020-01-11T16:50:00Z", "2020-01-11T17:10:00Z"])
def test_rising_moon_is_flattened(clock) -> None:
    """Ratio of the axes against the formula of Saemundsson; 0.85 to 0.88 near the horizon, 0.96 at 3 deg (within 0.02)."""
    camera = {"width": 400, "height": 400, "hfov_deg": 3.0} | CLEAN
    plan, expected = towards_moon(camera=camera, time__utc_start=clock, time__exposure_s=0.1)
    row = moon_row(plan, expected)
    ratio = (row.high_v_px - row.low_v_px) / (row.high_u_px - row.low_u_px)
    radius = np.degrees(np.arcsin(MOON_RADIUS_KM / plan.sky.moon.distance_km))
    seen = plan.sky.moon_altitude_deg
    true = seen - saemundsson_deg(seen - 0.4)
    for _ in range(5):
        true = seen - saemundsson_deg(true)
    limb = np.array([true - radius, true + radius])
    flat = np.ptp(limb + saemundsson_deg(limb)) / (2 * radius)
    assert ratio == pytest.approx(flat, abs=0.02)
    assert ratio < 0.97


def test_moon_rises_bit_by_bit() -> None:
    """With its middle on the horizon its upper half is there, and nothing of it below; a row of the horizon's altitude."""
    camera = {"width": 400, "height": 400, "hfov_deg": 3.0} | CLEAN
    plan, expected = towards_moon(camera=camera, time__utc_start="2020-01-11T16:42:45Z", time__exposure_s=0.1)
    assert abs(plan.sky.moon_altitude_deg) < 0.03
    row = moon_row(plan, expected)
    horizon_v = 199.5 + plan.spec.camera.f_px * np.tan(np.radians(plan.sky.moon_altitude_deg))
    assert row.high_v_px == pytest.approx(horizon_v, abs=0.6)
    assert row.high_v_px - row.low_v_px == pytest.approx(0.42 * (row.high_u_px - row.low_u_px), rel=0.1)
    below = camera | {"width": 40, "height": 40}
    plan, expected = towards_moon(camera=below, time__utc_start="2020-01-11T16:36:00Z", time__exposure_s=0.1)
    assert len(expected.moon.electrons) == 0


def test_moon_that_rises_starts_at_the_horizon() -> None:
    """In an exposure over moonrise the first place is where its first light appears."""
    camera = {"width": 200, "height": 200, "hfov_deg": 12.0} | CLEAN
    plan, expected = towards_moon(camera=camera, time__utc_start="2020-01-11T16:36:00Z", time__exposure_s=900.0)
    row = moon_row(plan, expected)
    horizon_v = 99.5 + plan.spec.camera.f_px * np.tan(np.arcsin(plan.motion.R_mid[2, 2]))
    assert row.start_v_px == pytest.approx(horizon_v, abs=0.6)
    assert row.high_v_px == pytest.approx(horizon_v, abs=0.6)
    assert row.end_v_px < horizon_v - 13


def test_saturn_is_hidden_as_skyfield_has_it(skyfield) -> None:
    """Occultation of 21 August 2024 from London: Saturn is hidden while it is nearer to the Moon's middle than its radius."""
    site = (51.5, 0.0, 0.0)

    def inside(second):
        when = (2024, 8, 21, 3, 0, second)
        moon_az, moon_alt, distance = apparent(skyfield, "moon", site, when)
        saturn_az, saturn_alt, _ = apparent(skyfield, "saturn barycenter", site, when)
        apart = np.linalg.norm(vector(moon_az, moon_alt) - vector(saturn_az, saturn_alt))
        return 2 * np.arcsin(apart / 2) < np.arcsin(MOON_RADIUS_KM / distance)

    low, high = 4800.0, 5400.0
    assert inside(low)
    assert not inside(high)
    for _ in range(20):
        middle = (low + high) / 2
        low, high = (middle, high) if inside(middle) else (low, middle)
    leaves_s = low

    values = {
        "site": {"latitude_deg": 51.5, "longitude_deg": 0.0, "height_m": 0.0},
        "camera": {"width": 200, "height": 200, "hfov_deg": 3.0} | CLEAN,
    }

    def saturn(start_s, exposure_s):
        hour, rest = divmod(start_s, 3600)
        clock = f"2024-08-21T{3 + int(hour):02d}:{int(rest // 60):02d}:{rest % 60:06.3f}Z"
        plan, expected = towards_moon(**values, time__utc_start=clock, time__exposure_s=exposure_s)
        table = star_table(plan, expected).to_pandas()
        return table[table.star_id == SATURN].iloc[0]

    before, after = saturn(leaves_s - 10, 0.01), saturn(leaves_s + 10, 0.01)
    assert before.hidden_fraction == 1
    assert before.occluded
    assert before.electrons_e == 0
    assert before.snr == 0
    assert after.hidden_fraction == 0
    assert not after.occluded
    assert after.electrons_e > 1000
    # Half a minute of two is behind the Moon; both limbs are that of a sphere, so that times are good to a second.
    part = saturn(leaves_s - 30, 120.0)
    assert part.hidden_fraction == pytest.approx(0.25, abs=0.02)
    assert not part.occluded
    assert part.electrons_e == pytest.approx(0.75 * 12_000 * after.electrons_e, rel=0.03)


def test_low_star_is_hidden_behind_the_flattened_disk() -> None:
    """A light is hidden by its place above the air: the lower limb of a rising Moon hides what its image hides."""
    from generator.frame.moon.occultation import behind_moon
    from generator.light.points import PointLights

    plan = plan_frame(small_scenario(time__utc_start="2020-01-11T16:47:00Z", sky={"components": ["moonlight"]}), 0)
    east, north, up = plan.sky.moon_enu
    azimuth, altitude = np.arctan2(east, north), np.arcsin(up)
    down = np.radians(np.array([0.0, 0.215, 0.245, 0.265]))
    directions = np.stack([vector(azimuth, altitude - each) for each in down])[:, None].repeat(2, axis=1)
    nothing = np.zeros(4)
    hidden = behind_moon(plan, PointLights.in_the_open(directions, nothing, nothing, nothing, nothing)).hidden
    # The disk's lower half is 0.22 deg high there, 0.27 deg without air.
    assert np.isfinite(hidden[:, 0]).tolist() == [True, True, False, False]


def test_times_inside_a_circle() -> None:
    """Chords of a circle: through the middle, along an edge, from inside, at rest within and without, and past it."""
    ends = np.array(
        [[[-2, 0], [2, 0]], [[-2, 0.6], [2, 0.6]], [[0, 0], [4, 0]], [[0.5, 0], [0.5, 0]], [[2, 2], [2, 2]],
         [[-2, 1.1], [2, 1.1]]], dtype=float,
    )  # fmt: skip
    wanted = [[0.25, 0.75], [0.3, 0.7], [0.0, 0.25], [0.0, 1.0], [np.inf, np.inf], [np.inf, np.inf]]
    np.testing.assert_allclose(times_inside(ends), wanted)
    share = np.linspace(0, 1, 6)[:, None, None]
    many = np.concatenate([ends[:, :1] + one * np.diff(ends, axis=1) for one in share], axis=1)
    np.testing.assert_allclose(times_inside(many), wanted)
