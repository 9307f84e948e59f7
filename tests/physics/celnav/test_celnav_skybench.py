"""The solver ``skybench`` on fields of the independent forward model (ERFA and OpenCV)."""

import dataclasses
import math

import cv2
import numpy as np
import pytest
import skyfield_data
from scipy.spatial.transform import Rotation
from skyfield.api import Loader

import celnav
from benchmark.fields.solver_bars import attitude_of, camera_of
from benchmark.fields.solver_fields import HEIGHT, WIDTH, Condition, make_field
from celnav.adjustment import CameraPriors
from celnav.sky.astrometry import apparent_enu, celestial_to_terrestrial, enu_rotation
from celnav.sky.catalog import load_catalog
from celnav.sky.earth_rotation import earth_orientation
from celnav.sky.planets import planet_directions, planet_ids, planet_name
from celnav.sky.refraction import bennett_arcmin, refract, refraction_rad, unrefract_rays
from celnav.sky.utc import parse_utc

CAMERA = celnav.Camera.pinhole(width=1080, height=720, hfov_deg=120)
UP = celnav.Attitude.up([0, 0, 1])


def error_km(sky, frame, fix):
    return sky.distance_km(frame.lat_deg, frame.lon_deg, fix.lat_deg, fix.lon_deg)


def solve(frame, attitude, n=150, **options):
    return celnav.solve(frame.uv[:n], CAMERA, frame.utc, attitude, flux=frame.flux[:n], **options)


def test_it_is_the_default():
    assert celnav.solvers()[0] == "skybench"
    fix = celnav.solve(np.zeros((0, 2)), CAMERA, "2020-01-01T00:00:00Z", None)
    assert (fix.solver, fix.reason) == ("skybench", "too_few_detections")


@pytest.mark.parametrize(
    "attitude", [UP, celnav.Attitude.zenith_north_up(), celnav.Attitude.up([0, 0, 1], tilt_deg=0.01)]
)
def test_noise_free_frames_are_fixed_within_20_m_and_all_stars_named(sky, frames, attitude):
    for frame in frames[:10]:
        fix = solve(frame, attitude)
        assert fix.ok, fix.message
        assert error_km(sky, frame, fix) < 0.02
        assert len(fix.matches) >= 145
        assert np.mean(frame.star_id[fix.matches[:, 0]] == fix.matches[:, 1]) > 0.98
        assert fix.log10_false_alarm < -50
        assert fix.residuals_px.shape == fix.matches.shape
        assert np.abs(fix.residuals_px).max() < 0.5


def test_without_brightness_in_random_order(sky, frames):
    rng = np.random.default_rng(1)
    for frame in frames[:5]:
        uv = rng.permutation(frame.uv[:400]) + rng.normal(0, 0.3, (400, 2))
        fix = celnav.solve(uv, CAMERA, frame.utc, UP)
        assert fix.ok, fix.message
        assert error_km(sky, frame, fix) < 2


def test_lost_in_space_gives_the_inertial_attitude_and_asks_for_the_vertical(sky, frames):
    frame = frames[0]
    fix = solve(frame, None)
    assert (fix.ok, fix.reason) == (False, "vertical_required")
    assert np.isnan(fix.lat_deg)
    known = solve(frame, UP)
    turn = known.R_icrs_to_camera @ fix.R_icrs_to_camera.T
    # Refraction, which is not taken off without a vertical, is symmetrical about the zenith: 0.02 deg is plenty.
    assert np.degrees(np.arccos((np.trace(turn) - 1) / 2)) < 0.02


def test_inertial_attitude_takes_apparent_places_to_pixels(sky, frames):
    frame = frames[2]
    fix = solve(frame, UP)
    catalog = celnav.sky.catalog.load_catalog()
    stars = catalog.take(catalog.rows_of(fix.matches[:, 1]))
    uv = CAMERA.project(stars.vectors @ fix.R_icrs_to_camera.T)
    # Aberration (20 arcsec), proper motion and refraction are not in the catalogue's places: a pixel is plenty.
    assert np.abs(uv - frame.uv[fix.matches[:, 0]]).max() < 1.0


def test_attitude_with_uncertainty_is_weighed(sky, frames):
    """With a heading uncertain by 5 deg the stars give it; with a tilt of 0.1 deg the fix is uncertain by 11 km."""
    frame = frames[3]
    turn = np.radians(3.0)
    off = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    attitude = celnav.Attitude.with_sigma(sky.ZENITH_NORTH_UP @ off, tilt_deg=0.0, heading_deg=5.0)
    fix = solve(frame, attitude)
    assert fix.ok
    assert error_km(sky, frame, fix) < 0.05
    assert abs(abs(fix.heading_off_deg) - 3.0) < 0.01
    tilted = solve(frame, celnav.Attitude.with_sigma(sky.ZENITH_NORTH_UP, tilt_deg=0.1, heading_deg=20))
    np.testing.assert_allclose(np.sqrt(np.diag(tilted.cov_km2)), 11.1, rtol=0.35)
    wrong = solve(frame, celnav.Attitude.with_sigma(sky.ZENITH_NORTH_UP @ off, tilt_deg=0.0, heading_deg=0.1))
    assert (wrong.ok, wrong.reason) in {(False, "no_hypothesis"), (False, "effort_spent"), (False, "inconsistent")}


def turned(axis, angle_deg):
    return Rotation.from_euler(axis, angle_deg, degrees=True).as_matrix()


@pytest.mark.parametrize("kind", ["exact", "with_sigma"])
@pytest.mark.parametrize(
    "error", [turned("z", 20), turned("y", 30), turned("y", 90), turned("x", 180)], ids=["heading", "30", "90", "180"]
)
def test_a_wrong_attitude_that_contradicts_the_stars_is_refused(kind, error):
    """Headings are given too, so that a tilt across the meridian does not fit any place."""
    condition = Condition("wrong", v_max=5.5, noise_px=0.3, tilt_deg=5.0)
    for number in range(3):
        frame = make_field(condition, 9, number)
        R_cam = frame.R_cam @ error
        attitude = (
            celnav.Attitude.exact(R_cam)
            if kind == "exact"
            else celnav.Attitude.with_sigma(R_cam, tilt_deg=0.5, heading_deg=1.0)
        )
        fix = celnav.solve(frame.uv, camera_of(condition), frame.utc, attitude, flux=frame.flux)
        assert not fix.ok
        assert fix.reason in {"no_hypothesis", "effort_spent", "inconsistent"}


@pytest.mark.parametrize("error", [turned("x", 90), turned("y", 90), turned("x", 180)], ids=["north", "east", "nadir"])
def test_a_vertical_that_puts_stars_below_the_horizon_is_refused(error):
    condition = Condition("wrong", v_max=5.5, noise_px=0.3, tilt_deg=5.0)
    for number in range(3):
        frame = make_field(condition, 9, number)
        up = celnav.Attitude.up((frame.R_cam @ error)[:, 2])
        fix = celnav.solve(frame.uv, camera_of(condition), frame.utc, up, flux=frame.flux)
        assert (fix.ok, fix.reason) == (False, "inconsistent")
        assert "below the horizon" in fix.message


def test_a_tilt_along_the_meridian_is_another_place(sky):
    """What no solver can tell: a camera tilted by 20 deg that is said to look at the zenith sees another latitude's sky.

    Only refraction differs, by an arcminute and a half at most. The fix is 20 deg away, and docs/solver.md says so.
    """
    condition = Condition("wrong", v_max=5.5, noise_px=0.3, tilt_deg=5.0)
    for number in range(3):
        frame = make_field(condition, 9, number)
        attitude = celnav.Attitude.exact(frame.R_cam @ turned("x", math.copysign(20.0, frame.lat_deg)))
        fix = celnav.solve(frame.uv, camera_of(condition), frame.utc, attitude, flux=frame.flux)
        assert fix.ok
        assert error_km(sky, frame, fix) == pytest.approx(20 * 111.2, rel=0.01)


def test_last_known_position(sky, frames):
    frame = frames[4]
    near = celnav.LastKnown(frame.lat_deg, frame.lon_deg, 200.0)
    assert error_km(sky, frame, solve(frame, UP, near=near)) < 0.05
    far = celnav.LastKnown(-frame.lat_deg, frame.lon_deg + 90, 500.0)
    assert solve(frame, UP, near=far).reason in {"no_hypothesis", "effort_spent", "inconsistent"}


@pytest.mark.parametrize("noise_px", [0.0, 0.1])
def test_aberration_of_a_long_lens(sky, noise_px):
    """20.5 arcsec are most of a pixel of 8 deg: far more than such centroids scatter, and the same for all of them."""
    condition = Condition("long", 8, 8.0, noise_px, tilt_deg=50.0)
    for number in range(4):
        field = make_field(condition, 31, number)
        fix = celnav.solve(field.uv, camera_of(condition), field.utc, attitude_of(condition, field), flux=field.flux)
        assert fix.ok, fix.message
        assert sky.distance_km(field.lat_deg, field.lon_deg, fix.lat_deg, fix.lon_deg) < 0.5


def test_blends_and_saturated_stars(sky):
    """Stars within two pixels are one detection between them, and the forty brightest are all as bright."""
    condition = Condition("blends", v_max=6.5, noise_px=0.3)
    for number in range(4):
        field = make_field(condition, 12, number)
        n = len(field.uv)
        close = np.linalg.norm(field.uv[:, None] - field.uv[None], axis=2) < 2.0
        leader = close.argmax(axis=1)  # brightest first: the brightest within two pixels
        flux = np.bincount(leader, weights=field.flux, minlength=n)
        uv = np.column_stack([np.bincount(leader, weights=field.flux * x, minlength=n) for x in field.uv.T])
        kept = flux > 0
        assert n - kept.sum() > 30
        uv, flux = uv[kept] / flux[kept, None], np.minimum(flux[kept], np.sort(flux)[-40])
        fix = celnav.solve(uv, camera_of(condition), field.utc, attitude_of(condition, field), flux=flux)
        assert fix.ok, fix.message
        assert sky.distance_km(field.lat_deg, field.lon_deg, fix.lat_deg, fix.lon_deg) < 1.0
        assert np.mean(field.star_id[kept][fix.matches[:, 0]] == fix.matches[:, 1]) > 0.97


@pytest.mark.parametrize("v_max", [4.0, 5.5])
def test_two_skies_in_one_frame_are_ambiguous(v_max):
    """Two exposures of equal depth, of which either alone is a good frame: the solver does not choose."""
    condition = Condition("two", v_max=v_max, noise_px=0.5)
    for number in range(4):
        one, other = make_field(condition, 6, 2 * number), make_field(condition, 6, 2 * number + 1)
        uv, flux = np.concatenate((one.uv, other.uv)), np.concatenate((one.flux, other.flux))
        fix = celnav.solve(uv, camera_of(condition), one.utc, attitude_of(condition, one), flux=flux)
        assert (fix.ok, fix.reason) == (False, "ambiguous"), fix
        assert "two orientations" in fix.message
        # A faint ghost of the other sky takes nothing away.
        kept = np.random.default_rng(number).random(len(other.uv)) < 0.2
        uv, flux = np.concatenate((one.uv, other.uv[kept])), np.concatenate((one.flux, other.flux[kept]))
        fix = celnav.solve(uv, camera_of(condition), one.utc, attitude_of(condition, one), flux=flux)
        assert fix.ok, fix.message


def test_limiting_magnitude_is_that_of_the_faintest_stars(frames):
    for frame in frames[:6]:
        faintest = -2.5 * np.log10(frame.flux[299])
        assert solve(frame, UP, n=300).limiting_mag == pytest.approx(faintest, abs=0.15)


@pytest.mark.parametrize("model", ["brown_conrady", "kannala_brandt"])
def test_distorted_cameras(sky, frames, model):
    """The frame's directions through OpenCV's projection; celnav is given the camera."""
    frame = frames[5]
    rays = CAMERA.to_rays(frame.uv[:250])
    matrix = np.array([[300.0, 0, 539.5], [0, 300.0, 359.5], [0, 0, 1]])
    if model == "brown_conrady":
        camera = celnav.Camera(model, 1080, 720, f_px=300.0, k=(-0.03, 0.004), p=(0.001, -0.001))
        uv = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), matrix, np.array([-0.03, 0.004, 0.001, -0.001]))[0][:, 0]
    else:
        camera = celnav.Camera(model, 1080, 720, f_px=300.0, k=(0.02, -0.003, 0.0, 0.0))
        plane = (rays[:, :2] / rays[:, 2:])[:, None]
        uv = cv2.fisheye.distortPoints(plane, matrix, np.array([0.02, -0.003, 0, 0]))[:, 0]
    seen = camera.in_frame(uv)
    fix = celnav.solve(uv[seen], camera, frame.utc, UP, flux=frame.flux[:250][seen])
    assert fix.ok, fix.message
    assert error_km(sky, frame, fix) < 0.03


def test_self_calibration_reports_focal_length_centre_and_distortion():
    """A camera 3 % off, its axis moved and its corners bent: the values come back within five of their sigmas.

    The attitude is exact, so that the principal point can be told from a tilt.
    """
    condition = Condition("x", noise_px=0.3, focal_error=0.03, exact_attitude=True, tilt_deg=5.0)
    field = make_field(condition, 8, 1)
    r2 = np.sum((field.uv - [539.5, 359.5]) ** 2, axis=1) / ((WIDTH**2 + HEIGHT**2) / 4)
    bent = [539.5, 359.5] + (field.uv - [539.5, 359.5]) * (1 + 0.01 * r2)[:, None] + [1.5, -1.0]
    inside = camera_of(condition).in_frame(bent)
    config = celnav.SkybenchConfig(calibrate="full", priors=CameraPriors(focal=0.03, centre_px=2.0, distortion=0.02))
    fix = celnav.solve(
        bent[inside], camera_of(condition), field.utc, attitude_of(condition, field),
        celnav.SkybenchSolver(config), flux=field.flux[inside],
    )  # fmt: skip
    assert fix.ok, fix.message
    expected = {"log_f": np.log(1.03), "q1": 0.01, "q2": 0.0}
    for name, value in expected.items():
        estimate = getattr(fix.calibration, name)
        assert abs(estimate.value - value) < 5 * estimate.sigma + 2e-3, name


def test_a_focal_length_that_is_off_is_reported(sky):
    condition = Condition("x", noise_px=0.5, focal_error=-0.03)
    field = make_field(condition, 3, 0)
    fix = celnav.solve(field.uv, camera_of(condition), field.utc, attitude_of(condition, field), flux=field.flux)
    assert sky.distance_km(field.lat_deg, field.lon_deg, fix.lat_deg, fix.lon_deg) < 2
    log_f = fix.calibration.log_f
    assert log_f.value == pytest.approx(np.log(0.97), abs=5 * log_f.sigma)
    told = celnav.solve(
        field.uv, dataclasses.replace(camera_of(condition), f_px=0.97 * condition.f_px, fy_px=float("nan")),
        field.utc, attitude_of(condition, field), flux=field.flux,
    )  # fmt: skip
    assert told.calibration == celnav.Calibration()


@pytest.mark.parametrize("number", [0, *(pytest.param(n, marks=pytest.mark.journey) for n in (1, 2))])
@pytest.mark.parametrize("equidistant", [False, True])
@pytest.mark.parametrize("exact_attitude", [False, True])
@pytest.mark.parametrize("focal_error", [-0.13, 0.12])
def test_a_focal_length_of_a_data_sheet(sky, focal_error, exact_attitude, equidistant, number):
    """The solver finds one that is off by more than its search bears with, unless it is told to trust the camera."""
    condition = Condition(
        "x", hfov_deg=80.0, noise_px=0.3, false=0.3, focal_error=focal_error, exact_attitude=exact_attitude,
        equidistant=equidistant, tilt_deg=5.0,
    )  # fmt: skip
    frame = make_field(condition, 17, number)
    options = (frame.uv, camera_of(condition), frame.utc, attitude_of(condition, frame))
    fix = celnav.solve(*options, flux=frame.flux)
    assert fix.ok, fix.message
    assert error_km(sky, frame, fix) < 1.0
    assert np.mean(frame.star_id[fix.matches[:, 0]] == fix.matches[:, 1]) > 0.97
    log_f = fix.calibration.log_f
    assert abs(log_f.value - np.log1p(focal_error)) < 5 * log_f.sigma
    trusting = celnav.SkybenchSolver(celnav.SkybenchConfig(calibrate="none"))
    assert not celnav.solve(*options, solver=trusting, flux=frame.flux).ok


def test_refraction_series_meets_bennett_and_the_literature():
    """58.294 tan z - 0.0668 tan^3 z arcsec at 1013.25 hPa and 10 C (Smart 1977, Spherical Astronomy): 58.04 at 1010."""
    assert np.degrees(refraction_rad(np.radians([45.0]), 1010, 10))[0] * 3600 == pytest.approx(58.04, abs=0.2)
    zenith_distance = np.radians([10.0, 40.0, 60.0, 75.0, 80.0, 88.0])
    ours = np.degrees(refraction_rad(zenith_distance, 1010, 10)) * 60
    np.testing.assert_allclose(ours, bennett_arcmin(90 - np.degrees(zenith_distance)), atol=0.08, rtol=0.03)
    ray = np.array([[0.6, 0.0, 0.8]])
    lowered = unrefract_rays(ray, np.array([0.0, 0.0, 1.0]), 1010, 10)
    assert np.degrees(np.arccos(lowered[0, 2]) - np.arccos(0.8)) * 3600 == pytest.approx(58.04 * 0.75, abs=0.3)


@pytest.mark.parametrize("year", [2000, 2012, 2025])
def test_planets_against_de421(year):
    from pathlib import Path

    loader = Loader(Path(skyfield_data.__file__).parent / "data", verbose=False)
    planets = loader("de421.bsp")
    try:
        time = loader.timescale(builtin=True).utc(year, 4, 5, 6, 7, 8)
        dirs = planet_directions(parse_utc(time.utc_iso()))
        for direction, star_id in zip(dirs, planet_ids(), strict=True):
            name = planet_name(star_id)
            target = planets[f"{name} barycenter" if name in {"Mars", "Jupiter", "Saturn"} else name]
            expected = planets["earth"].at(time).observe(target).apparent().position.au
            cosine = direction @ expected / np.linalg.norm(expected)
            assert np.degrees(np.arccos(min(cosine, 1.0))) * 60 < 1.0, name
    finally:
        planets.close()
    assert planet_name(32349) is None


def test_a_planet_is_named_and_leaves_the_fix_alone(sky, frames):
    for frame in frames:
        fix = solve(frame, UP)
        dirs = planet_directions(parse_utc(frame.utc))
        seen = refract(dirs @ fix.R_icrs_to_camera.T @ sky.ZENITH_NORTH_UP, 1010, 10)
        uv = CAMERA.project(seen @ sky.ZENITH_NORTH_UP.T)
        inside = np.flatnonzero(CAMERA.in_frame(np.nan_to_num(uv, nan=-1e9), -20))
        if len(inside):
            break
    planet = inside[0]
    uv_all = np.vstack((uv[planet], frame.uv[:150]))
    with_planet = celnav.solve(uv_all, CAMERA, frame.utc, UP, flux=np.append(99.0, frame.flux[:150]))
    assert with_planet.ok
    assert [0, planet_ids()[planet]] in with_planet.matches.tolist()
    assert sky.distance_km(fix.lat_deg, fix.lon_deg, with_planet.lat_deg, with_planet.lon_deg) < 0.005


@pytest.mark.parametrize("condition", [Condition("p", v_max=4.5), Condition("f", 180, 4.5, equidistant=True)])
def test_fields_of_the_benchmark_are_those_of_the_independent_model(sky, condition):
    """The benchmark's projection against OpenCV's, its apparent places against the other chain."""
    from celnav.sky.earth_rotation import earth_orientation

    field = make_field(condition, 1, 0)
    if not condition.equidistant:
        frame = sky.make_frame(
            field.utc, field.lat_deg, field.lon_deg, 4.5, earth_orientation(parse_utc(field.utc)), field.R_cam
        )
        common, ours, theirs = np.intersect1d(field.star_id, frame.star_id, return_indices=True)
        assert len(common) == len(frame.star_id)
        np.testing.assert_allclose(field.uv[ours], frame.uv[theirs], atol=1e-6)
    else:
        rays = camera_of(condition).to_rays(field.uv)
        front = rays[:, 2] > 0.2
        matrix = np.array([[condition.f_px, 0, 539.5], [0, condition.f_px, 359.5], [0, 0, 1]])
        plane = (rays[front, :2] / rays[front, 2:])[:, None]
        np.testing.assert_allclose(
            cv2.fisheye.distortPoints(plane, matrix, np.zeros(4))[:, 0], field.uv[front], atol=1e-6
        )


def test_planets_in_conjunction_do_not_share_a_detection():
    # 21 December 2020: Jupiter and Saturn 0.1 deg apart, a third of a pixel of this camera.
    utc = "2020-12-21T18:20:00Z"
    instant = parse_utc(utc)
    earth = celestial_to_terrestrial(instant, earth_orientation(instant))
    jupiter, saturn = planet_directions(instant)[3:5]
    assert planet_name(planet_ids()[3]) == "Jupiter"
    assert np.degrees(np.arccos(jupiter @ saturn)) < 0.12
    zenith = earth @ jupiter
    lat, lon = np.degrees(np.arcsin(zenith[2])) + 12.0, np.degrees(np.arctan2(zenith[1], zenith[0])) + 9.0
    stars = load_catalog()
    stars = stars.take(np.flatnonzero(stars.v_mag < 4.5))
    enu = np.vstack((enu_rotation(lat, lon) @ earth @ jupiter, apparent_enu(stars, utc, lat, lon, pressure_hpa=0.0)))
    uv = CAMERA.project(enu @ celnav.Attitude.zenith_north_up().R_cam.T)
    inside = (enu[:, 2] > 0.5) & CAMERA.in_frame(np.nan_to_num(uv, nan=-1e6))
    assert inside[0]
    flux = 10.0 ** (-0.4 * np.concatenate(([-2.0], stars.v_mag)))
    fix = celnav.solve(uv[inside], CAMERA, utc, UP, flux=flux[inside], pressure_hpa=0.0)
    assert fix.ok, fix.message
    assert (fix.matches[:, 0] == 0).sum() == 1
    assert fix.matches[fix.matches[:, 0] == 0, 1] == planet_ids()[3]
    assert len(np.unique(fix.matches[:, 0])) == len(fix.matches)
