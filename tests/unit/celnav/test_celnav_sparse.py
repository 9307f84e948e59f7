"""Few stars: the bound of chance by place and brightness, orientations of an exact attitude, and what they find."""

import itertools
import math

import numpy as np
import pytest

import celnav
from benchmark.fields.solver_bars import camera_of
from benchmark.fields.solver_fields import HEIGHT, WIDTH, Condition, make_field
from benchmark.judge.geodesy import geodesic_km
from celnav.identification.search import enu_rotations
from celnav.identification.sparse import ToldOrientation, log10_agreeing, log10_symmetric
from celnav.identification.verification import rotation_of

CAMERA = camera_of(Condition("few"))
AREA_PX = float(WIDTH * HEIGHT)


def test_symmetric_polynomial_is_the_sum_over_all_sets():
    chances = np.array([0.3, 0.01, 0.0, 0.2, 0.07])
    for k in range(1, 5):
        by_hand = sum(math.prod(chosen) for chosen in itertools.combinations(chances.tolist(), k))
        assert log10_symmetric(chances, k) == pytest.approx(min(math.log10(by_hand), 0.0))
    assert log10_symmetric(chances, 0) == 0.0
    assert log10_symmetric(chances, 5) == -math.inf


def test_bound_holds_for_detections_that_stand_anywhere():
    """Of 1,000 frames of chance no more than the bound says reach it, at three levels; crowded, so that some do."""
    rng = np.random.default_rng(5)
    star_mag = rng.uniform(0, 3, 40).astype(np.float32)
    predicted = rng.uniform(0, 1, (40, 2)) * 60.0
    reached = []
    for _ in range(1000):
        uv, seen_mag = rng.uniform(0, 1, (12, 2)) * 60.0, rng.uniform(-9, -6, 12)
        reached.append(min(log10_agreeing(seen_mag, star_mag, uv, predicted, 3600.0, 1.0).values()))
    for level in (-0.5, -1.0, -1.5):
        expected = 1000 * 10**level
        assert np.count_nonzero(np.array(reached) <= level) <= expected + 3 * math.sqrt(expected)
    assert min(reached) < 0


def test_brightness_is_evidence_and_unknown_brightness_is_none():
    rng = np.random.default_rng(6)
    star_mag = np.array([0.1, 0.8, 1.2, 1.8, 2.5, 2.9, 3.1, 3.3], dtype=np.float32)
    stars = rng.uniform(0, 1, (8, 2)) * [WIDTH, HEIGHT]
    uv = np.concatenate((stars[:4], rng.uniform(0, 1, (6, 2)) * [WIDTH, HEIGHT]))
    right = np.concatenate((star_mag[:4] - 11.0, np.full(6, -5.0)))
    mixed = np.concatenate((-11.0 - 2 * star_mag[:4], np.full(6, -5.0)))
    agree = log10_agreeing(right, star_mag, uv, stars, AREA_PX, 1.5)
    assert agree[0.3] < -15
    assert log10_agreeing(mixed, star_mag, uv, stars, AREA_PX, 1.5)[0.3] > agree[0.3] + 3
    assert set(log10_agreeing(np.full(10, np.nan), star_mag, uv, stars, AREA_PX, 1.5).values()) == {0.0}


def test_an_exact_attitude_leaves_one_orientation_to_each_place():
    rng = np.random.default_rng(7)
    local = rotation_of(rng.normal(0, 1, 3))
    told = ToldOrientation(local, rotation_of(rng.normal(0, 1, 3)))
    right = local @ enu_rotations(np.array([0.7]), np.array([-2.0]))[0] @ told.to_terrestrial
    uv = rng.uniform(0, 1, (5, 2)) * [WIDTH, HEIGHT]
    stars = CAMERA.to_rays(uv) @ right
    assert told.nearest(right) == pytest.approx(right, abs=1e-12)
    # A fit that was free to turn about the zenith, and to shift by two pixels.
    turned = rotation_of(local[:, 2] * 0.02 + local[:, 0] * 0.004) @ right
    assert told.fitted(CAMERA, uv, stars, turned) == pytest.approx(right, abs=1e-9)


def few_stars(number, n_stars, n_false, noise_px=0.15):
    """The brightest stars of a field, their fluxes good to 0.2 mag, and fainter false detections."""
    field = make_field(Condition("few", brightest=n_stars, noise_px=noise_px), 31, number)
    rng = np.random.default_rng([31, number, 1])
    false = rng.uniform(0, 1, (n_false, 2)) * [WIDTH - 1, HEIGHT - 1]
    flux = field.flux * 10 ** (0.08 * rng.normal(size=len(field.flux)))
    faint = 10 ** (-0.4 * 4.5) * rng.uniform(0.3, 1.5, n_false)
    return field, np.concatenate((field.uv, false)), np.concatenate((flux, faint))


@pytest.mark.parametrize(("n_stars", "n_false"), [(5, 10), (6, 15)])
def test_a_handful_of_bright_stars_is_a_position(n_stars, n_false):
    """Where the attitude is exact; without brightness all of these frames are refused."""
    for number in range(3):
        field, uv, flux = few_stars(number, n_stars, n_false)
        attitude = celnav.Attitude.exact(field.R_cam)
        fix = celnav.solve(uv, CAMERA, field.utc, attitude, flux=flux)
        assert fix.ok, fix.message
        assert geodesic_km(field.lat_deg, field.lon_deg, fix.lat_deg, fix.lon_deg) < 5.0
        assert fix.log10_false_alarm < -8
