"""A night of a camera that stands still: coverage of what it claims, wander, a moving mount, a wrong clock."""

import dataclasses
import math
import tracemalloc

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import celnav
from benchmark.fields.solver_fields import HEIGHT, WIDTH
from benchmark.judge.geodesy import east_north_km
from celnav.horizon import rotation_vector
from celnav.sequences.fixed_mount import EARTH_RAD_S, combine
from celnav.sky.astrometry import apparent_enu, enu_rotation
from celnav.sky.catalog import load_catalog
from celnav.sky.utc import Utc, parse_utc

CAMERA = celnav.Camera.pinhole(WIDTH, HEIGHT, 90)
START = parse_utc("2022-09-14T20:00:00Z")
LAT_DEG, LON_DEG = 51.883, -1.306
R_CAM = Rotation.from_euler("ZXZ", [40, 35, 20], degrees=True).as_matrix() @ np.diag([-1.0, -1.0, 1.0])
NOISE_PX = 0.4
UP = celnav.Attitude.up(R_CAM[:, 2])


def later(seconds):
    return Utc(START.mjd_day, START.second_of_day_s + seconds)


def frame(utc, rng, R_cam=R_CAM, noise_px=NOISE_PX):
    """Positions and fluxes of the stars to V 4.5 that a camera on the ground sees."""
    stars = load_catalog()
    stars = stars.take(stars.v_mag < 4.5)
    enu = apparent_enu(stars, utc, LAT_DEG, LON_DEG, pressure_hpa=1010.0, temperature_c=10.0)
    uv = CAMERA.project(enu @ R_cam.T)
    seen = (enu[:, 2] > 0.3) & np.isfinite(uv[:, 0]) & CAMERA.in_frame(np.nan_to_num(uv, nan=-1e9))
    uv = uv[seen] + noise_px * rng.standard_normal((int(seen.sum()), 2))
    return np.clip(uv, 0, [WIDTH - 1, HEIGHT - 1]), 10 ** (-0.4 * stars.v_mag[seen])


def night_of(seconds, rng, attitude=UP, clock=lambda s: s, mount=lambda s: np.eye(3), **options):
    """A night whose clock reads `clock(s)` at the second s, and whose mount is turned by `mount(s)`."""
    night = celnav.Night(CAMERA, attitude, **options)
    for second in seconds:
        uv, flux = frame(later(second), rng, mount(second) @ R_CAM)
        night.add(uv, later(clock(second)), flux=flux)
    return night.fix()


def offset_km(found):
    return np.array(east_north_km(LAT_DEG, LON_DEG, found.lat_deg, found.lon_deg))


def turned(about, degrees):
    return Rotation.from_rotvec(np.radians(degrees) * np.asarray(about, dtype=float)).as_matrix()


def test_a_night_is_as_good_as_it_says():
    """30 nights of 6 frames: chi-squared of 60 and of 90 degrees of freedom; each bound fails once in 5,000 runs."""
    squares, turns, ratios = [], [], []
    for seed in range(30):
        rng = np.random.default_rng([1, seed])
        found = night_of(np.linspace(0, 10800, 6), rng)
        assert found.ok
        assert len(found.used) == 6
        error = offset_km(found)
        squares.append(error @ np.linalg.solve(found.cov_km2, error))
        turns.append(found.turn_chance)
        ratios.append((found.rate.value - 1) / found.rate.sigma)
    assert 27.5 < np.sum(squares) < 106  # chi2.ppf([1e-4, 0.9999], 60) = 27.5, 107
    # Probabilities are uniform: Kolmogorov's statistic of 30 exceeds 0.38 once in 5,000 runs.
    assert np.max(np.abs(np.sort(turns) - (np.arange(30) + 0.5) / 30)) < 0.38
    assert 10.8 < np.sum(np.square(ratios)) < 67  # the same quantiles of 30 degrees of freedom


def test_frames_average_noise_and_not_the_vertical():
    """A tilt of 0.1 deg is 11 km, in one frame as in a night; noise of a night of nine is a third of a frame's."""
    rng = np.random.default_rng(2)
    sharp = night_of(np.linspace(0, 9000, 9), rng)
    single = night_of([0.0], rng)
    assert np.sqrt(np.trace(sharp.cov_km2) / np.trace(single.cov_km2)) == pytest.approx(1 / 3, rel=0.25)
    tilted = night_of(np.linspace(0, 9000, 9), rng, celnav.Attitude.up(R_CAM[:, 2], tilt_deg=0.1))
    assert np.sqrt(np.diag(tilted.cov_km2)) == pytest.approx(11.1, rel=0.02)


def test_a_clock_that_is_off_is_a_longitude():
    """60 s are 0.2507 deg of longitude (15.041 arcsec a second) and no latitude; clock_sigma_s holds them."""
    found = night_of(np.linspace(0, 7200, 5), np.random.default_rng(3), clock=lambda s: s + 60, clock_sigma_s=60.0)
    east, north = offset_km(found)
    assert abs(found.lon_deg - LON_DEG) == pytest.approx(0.2507, abs=0.01)
    assert abs(north) < 1.5
    assert math.sqrt(found.cov_km2[0, 0]) == pytest.approx(abs(east), rel=0.1)
    assert found.latitude_deg.value == pytest.approx(LAT_DEG, abs=4 * found.latitude_deg.sigma)
    assert found.turn_chance > 1e-3
    assert any("clock" in sentence for sentence in found.untold)


def test_a_clock_that_runs_fast_shows_as_the_rate_of_the_sky():
    """One per cent fast: in an hour 36 s, 0.15 deg; the sky seems to turn by a hundred and first less."""
    found = night_of(np.linspace(0, 7200, 6), np.random.default_rng(4), clock=lambda s: 1.01 * s)
    assert found.rate.value == pytest.approx(1 / 1.01, abs=4 * found.rate.sigma)
    assert found.turn_chance < 1e-3
    assert any("clock runs wrong" in sentence for sentence in found.told)


def test_a_mount_that_turns_moves_the_axis():
    """0.05 deg an hour about the boresight."""
    found = night_of(
        np.linspace(0, 7200, 6), np.random.default_rng(5), mount=lambda s: turned([0, 0, 1], 0.05 * s / 3600)
    )
    assert found.turn_chance < 1e-6
    assert any("the mount moved" in sentence for sentence in found.told)


def test_the_axis_of_the_turning_sky_is_the_pole():
    """Without absolute times: the axis from the turning alone, and the latitude from it and the vertical."""
    found = night_of(np.linspace(0, 14400, 8), np.random.default_rng(6))
    pole = R_CAM @ [0, math.cos(math.radians(LAT_DEG)), math.sin(math.radians(LAT_DEG))]
    away_deg = math.degrees(math.acos(found.axis_camera @ pole))
    assert away_deg < 4 * found.axis_sigma_deg < 0.2
    assert found.latitude_deg.value == pytest.approx(LAT_DEG, abs=4 * found.latitude_deg.sigma)


def test_without_a_vertical_the_place_gives_the_attitude():
    found = night_of(np.linspace(0, 7200, 5), np.random.default_rng(7), attitude=None, pressure_hpa=0.0)
    assert (found.ok, found.reason) == (False, "vertical_required")
    attitude = found.attitude_at(LAT_DEG, LON_DEG)
    # The frames have refraction, which a pressure of 0 leaves: half an arcminute at most in the mean over this field.
    assert np.degrees(np.linalg.norm(rotation_vector(attitude.R_cam @ R_CAM.T))) < 0.03
    assert 0 < attitude.tilt_deg < 0.02
    empty = celnav.Night(CAMERA, UP).fix()
    assert (empty.ok, empty.reason) == (False, "too_few_detections")
    with pytest.raises(celnav.CelnavError, match="no frame"):
        empty.attitude_at(LAT_DEG, LON_DEG)


def attitude_error_deg(found, R_cam=R_CAM):
    """Error of the attitude at the known place about east, north and up, over its standard deviations and in degrees."""
    attitude = found.attitude_at(LAT_DEG, LON_DEG)
    off = np.degrees(R_cam.T @ rotation_vector(attitude.R_cam @ R_cam.T))
    return off / [attitude.tilt_deg, attitude.tilt_deg, attitude.heading_deg], off


def test_the_place_removes_the_refraction_of_a_night_without_a_vertical():
    """Refraction tilts this camera's nights by 0.02 deg, seven standard deviations; chi-squared of 24 degrees of freedom."""
    errors = [
        attitude_error_deg(night_of(np.linspace(0, 10800, 5), np.random.default_rng([8, seed]), attitude=None))
        for seed in range(8)
    ]
    assert np.abs(np.mean([off for _, off in errors], axis=0)).max() < 0.004
    assert np.sum(np.square([z for z, _ in errors])) < 57  # chi2.ppf(0.9999, 24) = 56.8


def test_an_attitude_at_a_place_contains_the_error_of_the_clock():
    """60 s are 0.25 deg about the Earth's axis."""
    found = night_of(
        np.linspace(0, 7200, 5),
        np.random.default_rng(9),
        attitude=None,
        clock=lambda s: s + 60,
        sigmas=celnav.ToldSigmas(utc_s=60.0),
    )
    z, off = attitude_error_deg(found)
    assert np.linalg.norm(off) == pytest.approx(0.2507, abs=0.01)
    assert np.abs(z).max() < 1.6


def test_an_attitude_at_a_place_holds_through_a_night_of_drift():
    """0.05 deg an hour about the camera's x axis, for three hours."""
    found = night_of(
        np.linspace(0, 10800, 6),
        np.random.default_rng(10),
        attitude=None,
        mount=lambda s: turned([1, 0, 0], 0.05 * s / 3600),
    )
    for second in (0, 10800):
        z, off = attitude_error_deg(found, turned([1, 0, 0], 0.05 * second / 3600) @ R_CAM)
        assert np.linalg.norm(off) == pytest.approx(0.075, abs=0.01)
        assert np.abs(z).max() < 3


def draws(n, rng, sigma_rad, wander_rad, correlated=False):
    """Orientations around one, with noise and wander of the mount."""
    wander = wander_rad * rng.standard_normal((n, 3))
    if correlated:  # one value for each quarter of the frames
        wander = np.repeat(wander[:4], math.ceil(n / 4), axis=0)[:n]
    turn = sigma_rad * rng.standard_normal((n, 3)) + wander
    rotations = np.stack([Rotation.from_rotvec(one).as_matrix() for one in turn]) @ R_CAM
    return rotations, np.broadcast_to(sigma_rad**2 * np.eye(3), (n, 3, 3))


@pytest.mark.parametrize("correlated", [False, True])
def test_wander_is_in_the_covariance(correlated):
    """120 means of 40 frames: chi-squared of 360 where each wanders alone, at most 1.3 times (its 0.9999 quantile).

    Where wander goes on for ten frames at a time it is not averaged at all: the covariance is then too wide, not too narrow.
    """
    rng = np.random.default_rng(8)
    squares, wanders = [], []
    for _ in range(120):
        found = combine(*draws(40, rng, 1e-4, 3e-4, correlated), np.arange(40.0))
        error = rotation_vector(found.rotation @ R_CAM.T)
        squares.append(error @ np.linalg.solve(found.cov, error))
        wanders.append(found.wander_rad)
    assert np.median(wanders) == pytest.approx(3e-4, rel=0.5 if correlated else 0.1)
    assert np.mean(squares) < 3.9  # chi2.ppf(0.9999, 360) / 120
    assert np.mean(squares) > (0.3 if correlated else 2.2)


def test_a_frame_that_is_named_wrongly_is_left_out():
    rng = np.random.default_rng(9)
    rotations, covs = draws(9, rng, 1e-4, 0.0)
    rotations[4] = turned([0, 1, 0], 25.0) @ rotations[4]
    found = combine(rotations, covs, np.arange(9.0))
    assert 4 not in found.used
    assert len(found.used) == 8
    assert np.linalg.norm(rotation_vector(found.rotation @ R_CAM.T)) < 4e-4


def test_a_mount_that_drifts_steadily_keeps_its_frames():
    """0.3 deg within 20 frames of 0.006 deg of noise each: all count, but for one that is named wrongly."""
    rng = np.random.default_rng(11)
    rotations, covs = draws(20, rng, 1e-4, 0.0)
    rotations = np.stack([turned([0.6, 0, 0.8], 0.3 * k / 19) @ one for k, one in enumerate(rotations)])
    rotations[7] = turned([0, 1, 0], 3.0) @ rotations[7]
    found = combine(rotations, covs, 600.0 * np.arange(20))
    assert set(range(20)) - set(found.used.tolist()) == {7}
    speed_deg = math.degrees(np.linalg.norm(found.turn_rad_s)) * 600 * 19
    assert speed_deg == pytest.approx(0.3, abs=0.01)
    assert math.degrees(math.sqrt(np.trace(found.drift_cov))) == pytest.approx(0.3 / math.sqrt(12), rel=0.05)


def test_half_of_the_frames_cannot_spoil_the_line():
    """Of five frames two are named wrongly."""
    rng = np.random.default_rng(12)
    rotations, covs = draws(5, rng, 1e-4, 0.0)
    rotations[1], rotations[3] = turned([0, 1, 0], 40.0) @ rotations[1], turned([1, 0, 0], 90.0) @ rotations[3]
    assert combine(rotations, covs, np.arange(5.0)).used.tolist() == [0, 2, 4]


def test_a_heading_that_a_night_contradicts_widens_the_vertical():
    """A mount that was turned by 0.3 deg about an oblique axis since its attitude was told: tilt and heading alike."""
    told = celnav.Attitude.with_sigma(turned([1, 1, 1], 0.3) @ R_CAM, tilt_deg=0.01, heading_deg=0.01)
    found = night_of(np.linspace(0, 7200, 5), np.random.default_rng(13), told)
    error = offset_km(found)
    assert np.hypot(*error) > 10
    assert error @ np.linalg.solve(found.cov_km2, error) < 9.2  # two degrees of freedom, one in 100


def test_a_night_accepts_the_headings_that_its_frames_accept():
    """A mount turned by 3 deg since its attitude was told: up to 5 deg, one whose tilt is uncertain counts as moved."""
    told = celnav.Attitude.with_sigma(turned([0, 0, 1], 3.0) @ R_CAM, tilt_deg=0.05, heading_deg=0.1)
    night = celnav.Night(CAMERA, told)
    for second in (0, 3600):
        uv, flux = frame(later(second), np.random.default_rng([17, second]))
        assert night.add(uv, later(second), flux=flux).ok
    found = night.fix()
    assert found.ok, found.message
    error = offset_km(found)
    assert error @ np.linalg.solve(found.cov_km2, error) < 9.2  # two degrees of freedom, one in 100
    strict = celnav.SkybenchSolver(celnav.SkybenchConfig(max_moved_deg=1.0))
    assert celnav.Night(CAMERA, told, solver=strict, _frames=night._frames).fix().reason == "inconsistent"


def test_the_most_central_of_many_frames_takes_little_memory():
    """6,000 frames: 400 of them are compared with all, 19 MB; all with all would be 288 MB."""
    rotations, covs = draws(6000, np.random.default_rng(18), 1e-4, 0.0)
    tracemalloc.start()
    found = combine(rotations, covs, np.arange(6000.0))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 150e6
    assert len(found.used) > 5900


def test_a_time_outside_the_table_needs_dut1():
    """In 2090 no table says UT1-UTC; a night and cameras that are told it give a place."""
    late = Utc(START.mjd_day + 24838, START.second_of_day_s)
    uv, flux = frame(START, np.random.default_rng(19))
    for dut1_s in (None, 0.1):
        night, view = celnav.Night(CAMERA, UP, dut1_s=dut1_s), celnav.CameraView(uv, CAMERA, UP, flux=flux)
        if dut1_s is None:
            with pytest.raises(celnav.CelnavError, match="dut1_s"):
                night.add(uv, late, flux=flux)
            continue
        night.add(uv, late, flux=flux)
        alone, found = night.fix(), celnav.solve_cameras([view], late, dut1_s=dut1_s)
        assert (found.lat_deg, found.lon_deg) == pytest.approx((alone.lat_deg, alone.lon_deg), abs=1e-6)


def test_a_frame_of_few_stars_is_found_by_the_others():
    """Seven stars and 60 false lights, alone refused; the night's orientation finds them, and they count."""
    rng = np.random.default_rng(14)
    night = celnav.Night(CAMERA, UP)
    for second in (0, 1800, 3600, 5400):
        uv, flux = frame(later(second), rng)
        night.add(uv, later(second), flux=flux)
    uv, flux = frame(later(2700), rng)
    few = rng.choice(len(uv), 7, replace=False)
    false = np.column_stack((rng.uniform(0, WIDTH - 1, 60), rng.uniform(0, HEIGHT - 1, 60)))
    uv, flux = np.vstack((uv[few], false)), np.concatenate((flux[few], rng.choice(flux, 60)))
    assert night.add(uv, later(2700), flux=flux).reason in ("no_hypothesis", "effort_spent")
    found = night.fix()
    assert night.fixes[4].ok
    assert found.used == (0, 1, 2, 3, 4)
    assert len(night.fixes[4].matches) >= 5


def test_the_rate_is_that_of_the_earth_rotation_angle():
    """360 deg of Earth rotation angle take 86164.0989 s of UT1 (IERS Conventions 2010, stellar day)."""
    assert 2 * math.pi / EARTH_RAD_S == pytest.approx(86164.098903691, abs=1e-6)


def test_a_site_is_where_the_night_puts_it():
    """The terrestrial orientation is that of the place and the attitude."""
    found = night_of(np.linspace(0, 7200, 4), np.random.default_rng(10))
    true = R_CAM @ enu_rotation(LAT_DEG, LON_DEG)
    error = rotation_vector(found.R_terrestrial_to_camera @ true.T)
    assert error @ np.linalg.solve(found.cov_rad2, error) < 21.1  # three degrees of freedom, once in 10,000 runs


def test_told_sigmas_enter_a_night_once():
    """10 nights whose lens, air, attitude and clock err as they are told, alike in all frames: chi-squared of 20 degrees of
    freedom; each bound fails once in 5,000 runs."""
    sigmas = celnav.ToldSigmas(utc_s=0.5, focal=1e-3, centre_px=1.0, pressure_hpa=10.0, temperature_c=5.0)
    squares = []
    for seed in range(10):
        rng = np.random.default_rng(900 + seed)
        off = rng.standard_normal(6)
        longer = 1 + 1e-3 * off[0]
        told = dataclasses.replace(
            CAMERA, f_px=CAMERA.f_px * longer, fy_px=CAMERA.fy_px * longer,
            cx_px=CAMERA.cx_px + off[1], cy_px=CAMERA.cy_px + off[2],
        )  # fmt: skip
        wrong = Rotation.from_rotvec(np.radians([0.01, 0.01, 0.2]) * rng.standard_normal(3)).as_matrix()
        night = celnav.Night(
            told, celnav.Attitude.with_sigma(R_CAM @ wrong, tilt_deg=0.01, heading_deg=0.2), sigmas=sigmas,
            pressure_hpa=1010.0 + 10.0 * off[3], temperature_c=10.0 + 5.0 * off[4],
        )  # fmt: skip
        for second in (0.0, 1800.0):
            uv, flux = frame(later(second), rng)
            night.add(uv, later(second + 0.5 * off[5]), flux=flux)
        found = night.fix()
        squares.append(offset_km(found) @ np.linalg.solve(found.cov_km2, offset_km(found)))
    assert 5.4 < np.sum(squares) < 48.6
