"""The choices that the thesis leaves open: each by hand, by brute force or by finite differences."""

import math
from dataclasses import replace

import numpy as np
import pytest

import celnav
from celnav.errors import AttitudeError, ConfigError
from celnav.matching import (
    BRIGHTEST_N,
    EXTENDED_PATTERNS,
    THESIS_ADAPTIVE,
    THESIS_BASELINE,
    THESIS_BASELINE_SI,
    THESIS_BASELINE_SI_PR,
    THESIS_CATALOGUE_ONLY,
    DdrConfig,
    DdrMatcher,
    Observation,
    PatternConfig,
    patterns,
    thesis_config,
)
from celnav.matching.catalogue_choice import choose_catalogues, nearest_density, observed_density
from celnav.matching.confirmation import compare_differences
from celnav.matching.history import History
from celnav.matching.patterns import build_patterns, load_patterns, separations
from celnav.matching.polar import latitudes_of_star, position_determinant, smallest_determinant
from celnav.matching.votes import count_votes, similarities
from celnav.position import PositionConfig, robust_loss

CAMERA = celnav.Camera.pinhole(width=1080, height=720, hfov_deg=120)
R_CAM = np.diag([-1.0, -1.0, 1.0])
UTC_OK = "2015-06-01T00:00:00Z"


def direction(ra_deg, dec_deg):
    ra, dec = np.radians(ra_deg), np.radians(dec_deg)
    return np.column_stack((np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)))


def random_stars(rng, n):
    stars = rng.normal(size=(n, 3))
    return stars / np.linalg.norm(stars, axis=1, keepdims=True)


def frame(v_max, lat=40.0, lon=10.0):
    from celnav.sky.astrometry import apparent_enu
    from celnav.sky.catalog import load_catalog

    catalog = load_catalog()
    stars = catalog.take(np.flatnonzero(catalog.v_mag <= v_max))
    uv = CAMERA.project(apparent_enu(stars, UTC_OK, lat, lon) @ R_CAM.T)
    seen = np.isfinite(uv).all(axis=1)
    seen[seen] = CAMERA.in_frame(uv[seen])
    return uv[seen], 10 ** (-0.4 * stars.v_mag[seen]), stars.star_id[seen]


def test_variants_differ_in_what_their_names_say():
    assert {"thesis-baseline", "thesis-baseline+si", "thesis-baseline+si+pr", "thesis-catalogue-only"} <= set(
        celnav.solvers()
    )
    assert {"thesis-adaptive", "ddr-dai", "brightest-n"} <= set(celnav.solvers())
    assert replace(THESIS_BASELINE, iterate=True) == THESIS_BASELINE_SI
    assert replace(THESIS_BASELINE_SI, reject_polar_deg=75.0) == THESIS_BASELINE_SI_PR
    assert replace(THESIS_BASELINE_SI_PR, fixed_limit_decimag=None) == THESIS_ADAPTIVE
    assert replace(THESIS_BASELINE, fixed_limit_decimag=None) == THESIS_CATALOGUE_ONLY
    assert BRIGHTEST_N.patterns.limits_decimag == (45,)
    assert hash(BRIGHTEST_N) != hash(THESIS_ADAPTIVE)


@pytest.mark.parametrize(
    "change",
    [{"bearings": "sorted"}, {"vote_normalisation": "none"}, {"tolerance_bins": -1}, {"max_references": 0}],
)
def test_choices_that_do_not_exist_are_refused(change):
    with pytest.raises(ConfigError):
        DdrConfig(**change)
    with pytest.raises(ConfigError):
        PatternConfig(theta_max="frame")


def test_theta_max_of_pattern_or_of_radius():
    """Neighbours at 10.1, 20.1 and 30.2 deg: ratios to 30.2, or to the radius of 40."""
    stars = direction(np.array([0.0, 0.0, 20.1, 0.0]), np.array([0.0, 10.1, 0.0, -30.2]))
    own = PatternConfig(limits_decimag=(20,), radius_deg=40.0)
    fixed = replace(own, theta_max="radius")
    of_own = build_patterns(stars, np.arange(4), own)
    of_radius = build_patterns(stars, np.arange(4), fixed)
    assert of_own.votes(np.array([20 * 50 + 16, 40 * 50 + 33, 60 * 50 + 49]))[0] == 3
    assert of_radius.votes(np.array([20 * 50 + 12, 40 * 50 + 25, 60 * 50 + 37]))[0] == 3
    # Without the farthest neighbour the image's own ratios shift, the ratios to the radius do not.
    seen = np.radians([10.1, 20.1])
    assert count_votes(seen, of_own, DdrConfig(patterns=own))[0] == 0
    assert count_votes(seen, of_radius, DdrConfig(patterns=fixed))[0] == 2


def test_votes_with_tolerance_equal_brute_force_on_random_patterns():
    rng = np.random.default_rng(12)
    config = DdrConfig(patterns=PatternConfig(limits_decimag=(20,), radius_deg=40.0), tolerance_bins=1)
    patterns = config.patterns
    stars = random_stars(rng, 60)
    catalogue = build_patterns(stars, np.arange(60), patterns)
    owned = []
    for star in stars:
        theta = separations(star, stars)
        theta = theta[(theta > 1e-9) & (theta <= np.radians(40))]
        found = patterns.bins(theta, theta / theta.max())
        owned.append(set(zip((found // 50).tolist(), (found % 50).tolist(), strict=True)))
    for _ in range(1000):
        theta = np.sort(np.radians(rng.uniform(0.1, 40, rng.integers(2, 25))))
        rho = theta / theta[-1]
        features = [(int(np.degrees(t) / 0.5), min(int(r / 0.02), 49)) for t, r in zip(theta, rho, strict=True)]
        expected = [
            sum(any((a + i, b + j) in bins for i in (-1, 0, 1) for j in (-1, 0, 1)) for a, b in features)
            for bins in owned
        ]
        assert count_votes(theta, catalogue, config).tolist() == expected


def test_normalisation_by_hand():
    """Star 0 has three neighbours; two of four image features are its own."""
    stars = direction(np.array([0.0, 0.0, 20.1, 0.0]), np.array([0.0, 10.1, 0.0, -30.2]))
    catalogue = build_patterns(stars, np.arange(4), PatternConfig(limits_decimag=(20,), radius_deg=40.0))
    votes = np.array([2, 0, 0, 0])
    for choice, expected in (("image", 2 / 4), ("pattern", 2 / 3), ("larger", 2 / 4)):
        assert similarities(votes, 4, catalogue, DdrConfig(vote_normalisation=choice))[0] == pytest.approx(expected)
    assert similarities(votes, 2, catalogue, DdrConfig(vote_normalisation="larger"))[0] == pytest.approx(2 / 3)


def test_density_by_hand():
    """Five stars on the equator, 10 deg apart; within 15 deg the inner ones have two neighbours, the ends one."""
    rays = direction(np.arange(5) * 10.0, np.zeros(5))
    central = np.array([2, 1, 3, 0, 4])
    config = DdrConfig(patterns=PatternConfig(radius_deg=15.0))
    assert observed_density(rays, central, replace(config, density_references=3)) == 2
    assert observed_density(rays, central, replace(config, density_references=None)) == 2
    mean = replace(config, density_references=None, density_statistic="mean")
    assert observed_density(rays, central, mean) == pytest.approx((2 + 2 + 2 + 1 + 1) / 5)


def test_catalogues_probed():
    catalogues = load_patterns(PatternConfig())
    rays, central = random_stars(np.random.default_rng(1), 300), np.arange(300)
    near = nearest_density(observed_density(rays, central, THESIS_ADAPTIVE), catalogues)
    plain = choose_catalogues(rays, central, catalogues, THESIS_ADAPTIVE, None)
    assert plain.probed == (near - 1, near, near + 1)
    wide = choose_catalogues(rays, central, catalogues, replace(THESIS_ADAPTIVE, probe_steps=2), None)
    assert wide.probed == tuple(range(near - 2, near + 3))
    split = History(entries=[(20, 0.9)] * 4 + [(45, 0.9)] * 3)
    asked = choose_catalogues(rays, central, catalogues, THESIS_ADAPTIVE, split)
    assert asked.consensus == 0
    assert set(asked.probed) == {0, near - 1, near, near + 1}
    assert choose_catalogues(rays, central, catalogues, THESIS_BASELINE, split).probed == (20,)


def test_sorted_differences_keep_sense_and_forgive_a_missing_star():
    rng = np.random.default_rng(5)
    theta = np.sort(np.radians(rng.uniform(5, 40, 20)))
    bearing = rng.uniform(-np.pi, np.pi, 20)
    tolerance = np.radians(0.3)
    whole = compare_differences(theta, bearing + 1.0, theta, bearing, tolerance)
    np.testing.assert_array_equal(whole.image, whole.pattern)
    assert len(whole.image) == 20
    assert whole.rotation_rad == pytest.approx(1.0)
    assert whole.log10_false_alarm < -10
    missing = compare_differences(np.delete(theta, 7), np.delete(bearing, 7) + 1.0, theta, bearing, tolerance)
    assert len(missing.image) >= 18
    mirrored = compare_differences(theta, -bearing, theta, bearing, tolerance)
    assert mirrored.log10_false_alarm > -4


@pytest.mark.parametrize("lat_deg", [-70.0, -20.0, 0.0, 35.0, 80.0])
def test_determinant_against_finite_differences(lat_deg):
    """Altitude and azimuth times cos altitude, by latitude and longitude times cos latitude, central differences."""

    def horizontal(lat, hour, dec):
        east = -math.cos(dec) * math.sin(hour)
        north = math.sin(dec) * math.cos(lat) - math.cos(dec) * math.cos(hour) * math.sin(lat)
        up = math.sin(dec) * math.sin(lat) + math.cos(dec) * math.cos(hour) * math.cos(lat)
        return np.array([east, north, up])

    lat, step = math.radians(lat_deg), 1e-6
    rng = np.random.default_rng(3)
    for dec, hour in zip(rng.uniform(-1.5, 1.5, 20), rng.uniform(-np.pi, np.pi, 20), strict=True):
        enu = horizontal(lat, hour, dec)
        altitude = math.asin(enu[2])

        def angles(a, h, dec=dec):
            e, n, u = horizontal(a, h, dec)
            return math.asin(u), math.atan2(e, n)

        columns = []
        for plus, minus, scale in (
            (angles(lat + step, hour), angles(lat - step, hour), 1.0),
            (angles(lat, hour + step), angles(lat, hour - step), math.cos(lat)),
        ):
            turn = math.remainder(plus[1] - minus[1], 2 * math.pi)
            columns.append([(plus[0] - minus[0]) / (2 * step * scale), turn * math.cos(altitude) / (2 * step * scale)])
        numeric = abs(columns[0][0] * columns[1][1] - columns[0][1] * columns[1][0])
        assert position_determinant(enu, lat) == pytest.approx(numeric, abs=1e-6)
        assert position_determinant(enu, lat) == pytest.approx(
            abs(math.cos(dec) * math.cos(hour)) / math.cos(lat), abs=1e-12
        )
        latitudes = latitudes_of_star(enu, dec)
        assert min(abs(found - lat) for found in latitudes) < 1e-6
        assert smallest_determinant(enu, dec) <= position_determinant(enu, lat) + 1e-9


def test_a_star_can_fit_two_latitudes():
    """Altitude 80 deg due south and declination 30: latitude 40; due north of that nothing else within the poles."""
    south = np.array([0.0, -math.cos(math.radians(80)), math.sin(math.radians(80))])
    assert np.degrees(latitudes_of_star(south, math.radians(30))) == pytest.approx([40.0])
    # Seen at 20 deg altitude in the north with declination 80, from 10 N and, over the pole, from 30 N.
    north = np.array([0.0, math.cos(math.radians(20)), math.sin(math.radians(20))])
    assert np.degrees(latitudes_of_star(north, math.radians(80))) == pytest.approx([10.0, 30.0])
    assert latitudes_of_star(np.array([1.0, 0.0, 0.0]), math.radians(30)) == ()


def test_polar_rejection_by_determinant_needs_the_attitude_and_uses_it():
    uv, flux, _ = frame(4.2, lat=84.0)
    config = replace(THESIS_ADAPTIVE, polar_criterion="determinant")
    observation = Observation(uv, CAMERA.to_rays(uv), flux, CAMERA)
    with pytest.raises(AttitudeError):
        DdrMatcher(config).identify(observation)
    limit = math.cos(math.radians(75.0))
    differ = 0
    for lat in (72.0, 76.0, 80.0, 84.0, 88.0):
        uv, flux, _ = frame(4.2, lat=lat)
        fix = celnav.solve(uv, CAMERA, UTC_OK, R_CAM, celnav.ddr_solver(config), flux=flux)
        by_declination = celnav.solve(uv, CAMERA, UTC_OK, R_CAM, "thesis-adaptive", flux=flux)
        assert fix.ok
        reference = fix.details["reference_detection"]
        enu = CAMERA.to_rays(uv[[reference]])[0] @ R_CAM
        assert position_determinant(enu, math.radians(lat)) >= limit - 0.01
        differ += reference != by_declination.details["reference_detection"]
    assert differ


@pytest.mark.parametrize(
    "change",
    [
        {"bearings": "sorted-differences"},
        {"tolerance_bins": 1},
        {"vote_normalisation": "larger"},
        {"density_statistic": "mean", "density_references": None},
        {"reference_order": "brightness"},
        {"max_references": None},
        {"patterns": PatternConfig(theta_max="radius")},
        {"patterns": PatternConfig(radius_deg=35.0)},
        {"stars_in_fix": "one"},
        {"below_threshold": "accept"},
    ],
)
def test_every_choice_names_the_right_stars(change):
    uv, flux, star_id = frame(4.0)
    fix = celnav.solve(uv, CAMERA, UTC_OK, R_CAM, celnav.ddr_solver(replace(THESIS_ADAPTIVE, **change)), flux=flux)
    assert fix.ok, fix.message
    right = star_id[fix.matches[:, 0]] == fix.matches[:, 1]
    assert right.mean() > 0.95
    if change.get("stars_in_fix") == "one":
        assert len(fix.matches) == 1
    if "reference_order" in change:
        # The very brightest may be too near the edge; the first that works is still among the brightest.
        central = celnav.solve(uv, CAMERA, UTC_OK, R_CAM, "thesis-adaptive", flux=flux).details["reference_detection"]
        assert fix.details["reference_detection"] in np.argsort(-flux)[:3]
        assert central not in np.argsort(-flux)[:3]


def test_the_literal_thesis_always_claims_a_star():
    """Votes normalised by the image's features pass tau_c on random points, since a dense pattern has most of the bins."""
    rng = np.random.default_rng(2)
    nonsense = rng.uniform([0, 0], [1079, 719], (60, 2))
    literal = celnav.solve(nonsense, CAMERA, UTC_OK, R_CAM, celnav.ddr_solver(thesis_config.LITERAL_BASELINE))
    assert literal.ok
    assert literal.confidence > 0.45
    assert not celnav.solve(nonsense, CAMERA, UTC_OK, R_CAM, "thesis-baseline").ok


def test_robust_losses_are_scipys_and_their_weights_are_derivatives():
    scale = math.radians(0.1) ** 2
    z = np.array([0.0, 0.3, 0.999, 1.001, 7.0, 400.0])
    expected = {
        "soft-l1": 2 * (np.sqrt(1 + z) - 1),
        "huber": np.where(z <= 1, z, 2 * np.sqrt(z) - 1),
        "cauchy": np.log1p(z),
        "squares": z,
    }
    for name, values in expected.items():
        config = PositionConfig(loss=name)
        loss, weight = robust_loss(z * scale, config)
        np.testing.assert_allclose(loss, values * scale, rtol=1e-9, atol=1e-18)
        step = 1e-7 * scale
        slope = (robust_loss(z * scale + step, config)[0] - robust_loss(z * scale, config)[0]) / step
        np.testing.assert_allclose(weight, slope, rtol=1e-3)


@pytest.mark.parametrize("config", [PatternConfig(), pytest.param(EXTENDED_PATTERNS, marks=pytest.mark.slow)])
def test_tables_are_built_once_and_mapped_from_the_cache(config, monkeypatch):
    """A later process builds nothing, and reads of the file only what it uses: the arrays are views of a mapping."""
    built = load_patterns(config)
    load_patterns.cache_clear()
    monkeypatch.setattr(patterns, "build_patterns", lambda *_: pytest.fail("the tables are built again"))
    loaded = load_patterns(config)
    assert len(loaded) == len(built)
    for one, other in zip(loaded, built, strict=True):
        np.testing.assert_array_equal(one.theta_rad, other.theta_rad)
        assert not one.theta_rad.flags.owndata
        assert not one.theta_rad.flags.writeable


@pytest.mark.slow
def test_catalogues_on_to_magnitude_six_and_a_half():
    catalogues = load_patterns(EXTENDED_PATTERNS)
    assert len(catalogues) == 30
    # The Bright Star Catalogue has about 1,600 stars to 5.0 and about 8,400 to 6.5 (Hoffleit and Jaschek 1982: "mostly
    # brighter than 6.5").
    assert 1500 < len(catalogues[26]) < 1700
    assert 8000 < len(catalogues[-1]) < 9110
    uv, flux, star_id = frame(5.5)
    config = replace(THESIS_ADAPTIVE, patterns=EXTENDED_PATTERNS)
    fix = celnav.solve(uv, CAMERA, UTC_OK, R_CAM, celnav.ddr_solver(config), flux=flux)
    assert fix.ok
    assert fix.details["catalogue_limit_mag"] >= 5.0
    assert (star_id[fix.matches[:, 0]] == fix.matches[:, 1]).mean() > 0.95
