"""Distance ratios and accumulated angle: by hand, by brute force, and on skies."""

import math

import numpy as np
import pytest

import celnav
from celnav.errors import ConfigError
from celnav.matching import DaiConfig, DaiMatcher, DdrMatcher, Observation
from celnav.matching.ddr_dai import accumulated_angle, agree, load_ratios
from celnav.matching.patterns import load_patterns
from celnav.sky.astrometry import apparent_enu
from celnav.sky.catalog import load_catalog

CAMERA = celnav.Camera.pinhole(width=1080, height=720, hfov_deg=120)
R_CAM = np.diag([-1.0, -1.0, 1.0])
UTC_OK = "2015-06-01T00:00:00Z"
CONFIG = DaiConfig()


def test_features_by_hand():
    """10 deg at bearing 0 and 20 deg at bearing 91: ratio 0.5, angle 91; bins of 0.02 and 2 deg."""
    found = CONFIG.features(np.radians([10.0, 20.02]), np.radians([0.0, 91.0]))
    assert found.tolist() == [24 * 180 + 45]
    # Mirrored, the angle is 269 deg: another bin.
    assert CONFIG.features(np.radians([10.0, 20.02]), np.radians([0.0, -91.0])).tolist() == [24 * 180 + 134]
    assert len(CONFIG.features(np.radians([5.0, 10.0, 20.0, 30.0]), np.zeros(4))) == 6


def test_features_know_neither_scale_nor_rotation():
    rng = np.random.default_rng(1)
    theta, bearing = np.sort(rng.uniform(0.1, 0.7, 15)), rng.uniform(-np.pi, np.pi, 15)
    np.testing.assert_array_equal(
        CONFIG.features(theta, bearing), CONFIG.features(theta * 0.75, (bearing + 1.0) % (2 * np.pi))
    )


def test_accumulated_angle_by_hand():
    """Neighbours at 0, 90, 180 and 300 deg; the third does not agree: 300 to 0 and 0 to 90 remain, 150 of 360."""
    bearing = np.radians([0.0, 90.0, 180.0, 300.0])
    assert accumulated_angle(bearing, np.array([True, True, False, True])) == pytest.approx(150 / 360)
    assert accumulated_angle(bearing, np.ones(4, bool)) == pytest.approx(1.0)
    assert accumulated_angle(bearing, np.array([True, False, True, False])) == 0.0
    assert accumulated_angle(bearing[:1], np.array([True])) == 0.0


def test_votes_equal_brute_force_on_random_patterns():
    config = DaiConfig(limit_decimag=25, ratio_bin=0.05, angle_bin_deg=10.0)
    catalogue, table = load_patterns(config.patterns)[0], load_ratios(config)
    owned = []
    for star in range(len(catalogue)):
        rows = slice(catalogue.start[star], catalogue.start[star + 1])
        theta, bearing = catalogue.theta_rad[rows].astype(float), catalogue.bearing_rad[rows].astype(float)
        counts = np.zeros(config.n_ratio * config.n_angle, dtype=np.int64)
        for i in range(len(theta)):
            for j in range(i + 1, len(theta)):
                ratio, turn = theta[i] / theta[j], (bearing[j] - bearing[i]) % (2 * math.pi) / (2 * math.pi)
                counts[min(int(ratio / 0.05), 19) * 36 + int(turn * 36) % 36] += 1
        owned.append(counts)
    counts = np.array(owned)
    rng = np.random.default_rng(7)
    for _ in range(1000):
        bins = rng.integers(0, config.n_ratio * config.n_angle, rng.integers(1, 80))
        np.testing.assert_array_equal(table.votes(bins, len(catalogue)), counts[:, bins].sum(axis=1))


def test_agreement_finds_scale_and_rotation_and_refuses_the_mirror_image():
    rng = np.random.default_rng(9)
    theta = np.sort(np.radians(rng.uniform(5, 40, 30)))
    bearing = rng.uniform(-np.pi, np.pi, 30)
    found = agree(theta[4:] * 1.2, bearing[4:] + 2.5, theta, bearing, CONFIG)
    assert found.scale == pytest.approx(1.2, abs=0.002)
    np.testing.assert_array_equal(found.image + 4, found.pattern)
    assert len(found.image) == 26
    assert found.degree == pytest.approx(1.0)
    assert found.log10_false_alarm < -20
    mirrored = agree(theta, -bearing, theta, bearing, CONFIG)
    assert mirrored.log10_false_alarm > -4
    assert len(agree(theta[:5] * 3, bearing[:5], theta[:5], bearing[:5], CONFIG).image) <= 2


def stars_in_frame(v_max, lat, lon):
    catalog = load_catalog()
    stars = catalog.take(np.flatnonzero(catalog.v_mag <= v_max))
    enu = apparent_enu(stars, UTC_OK, lat, lon)
    uv = CAMERA.project(enu @ R_CAM.T)
    seen = np.isfinite(uv).all(axis=1)
    seen[seen] = CAMERA.in_frame(uv[seen])
    return uv[seen], 10 ** (-0.4 * stars.v_mag[seen]), stars.star_id[seen]


@pytest.mark.parametrize("flux_known", [True, False])
def test_names_the_right_stars(flux_known):
    uv, flux, star_id = stars_in_frame(3.5, 40.0, 10.0)
    fix = celnav.solve(uv, CAMERA, UTC_OK, R_CAM, "ddr-dai", flux=flux if flux_known else None)
    assert fix.ok, fix.message
    assert (star_id[fix.matches[:, 0]] == fix.matches[:, 1]).mean() > 0.95
    assert fix.details["scale"] == pytest.approx(1.0, abs=0.005)
    assert abs(fix.lat_deg - 40.0) < 0.01


def test_the_focal_length_need_not_be_right_to_name_stars():
    """Angles off by up to 5 %: the patterns still agree under another scale, where absolute distances do not."""
    uv, flux, star_id = stars_in_frame(3.5, 40.0, 10.0)
    wrong = celnav.Camera("pinhole", 1080, 720, f_px=CAMERA.f_px * 0.95)
    observation = Observation(uv, wrong.to_rays(uv), flux, wrong)
    found = DaiMatcher(DaiConfig(radius_deg=30.0, match_tolerance_deg=0.7)).identify(observation)
    assert found.reason == "ok"
    assert (star_id[found.matches[:, 0]] == found.matches[:, 1]).mean() > 0.9
    assert found.details["scale"] > 1.03
    assert DdrMatcher().identify(observation).reason != "ok"


def test_choices_out_of_range():
    for change in ({"neighbours": 2}, {"ratio_bin": 0.0}, {"largest_scale": 1.0}):
        with pytest.raises(ConfigError):
            DaiConfig(**change)
