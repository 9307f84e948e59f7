"""Patterns, votes, alignment, consensus: small cases worked out by hand, and the look-up table against brute force."""

import numpy as np
import pytest

from celnav.errors import ConfigError
from celnav.matching import THESIS_ADAPTIVE, THESIS_BASELINE, DdrConfig
from celnav.matching.confirmation import align, log10_chance
from celnav.matching.history import History
from celnav.matching.patterns import PatternConfig, bearings, build_patterns, load_patterns, separations


def direction(ra_deg, dec_deg):
    ra, dec = np.radians(ra_deg), np.radians(dec_deg)
    return np.column_stack((np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)))


# One star at the origin of (ra, dec), neighbours at 10 deg north, 20 deg east and 30 deg south, one out of reach.
SMALL = direction(np.array([0.0, 0.0, 20.0, 0.0, 180.0]), np.array([0.0, 10.0, 0.0, -30.0, 0.0]))
CONFIG = PatternConfig(limits_decimag=(20,), radius_deg=40.0)


def test_pattern_of_a_small_catalogue():
    patterns = build_patterns(SMALL, np.arange(100, 105), CONFIG)
    rows = slice(patterns.start[0], patterns.start[1])
    np.testing.assert_allclose(np.degrees(patterns.theta_rad[rows]), [10, 20, 30], atol=1e-4)
    np.testing.assert_allclose(np.degrees(patterns.bearing_rad[rows]), [0, 90, 180], atol=1e-4)
    np.testing.assert_array_equal(patterns.neighbour[rows], [1, 2, 3])
    assert patterns.start[5] - patterns.start[4] == 0  # the star at the other side has no neighbour


def test_bins_are_half_a_degree_and_a_fiftieth():
    theta = np.radians([0.0, 0.49, 0.51, 39.99])
    assert CONFIG.bins(theta, np.array([0.0, 0.019, 0.021, 1.0])).tolist() == [0, 0, 1 * 50 + 1, 79 * 50 + 49]


def test_votes_worked_out_by_hand():
    """Star 0 has features (10.1, .33), (20.1, .67), (30.2, 1): bins (20, 16), (40, 33), (60, 50 -> 49)."""
    stars = direction(np.array([0.0, 0.0, 20.1, 0.0]), np.array([0.0, 10.1, 0.0, -30.2]))
    patterns = build_patterns(stars, np.arange(4), CONFIG)
    bins = np.array([20 * 50 + 16, 40 * 50 + 33, 60 * 50 + 49])
    assert patterns.votes(bins)[0] == 3
    assert patterns.votes(bins[:1]).tolist() == [1, 0, 0, 0]
    assert patterns.votes(np.array([3])).tolist() == [0, 0, 0, 0]
    # A bin asked for twice votes twice: the image has two features there.
    assert patterns.votes(bins[[0, 0]])[0] == 2


def test_lookup_equals_brute_force_on_random_patterns():
    rng = np.random.default_rng(4)
    vectors = rng.normal(size=(150, 3))
    vectors /= np.linalg.norm(vectors, axis=1, keepdims=True)
    patterns = build_patterns(vectors, np.arange(150), CONFIG)
    owned = []
    for star in vectors:
        theta = separations(star, vectors)
        theta = theta[(theta > 1e-9) & (theta <= np.radians(40))]
        owned.append(set(CONFIG.bins(theta, theta / theta.max()).tolist()))
    for _ in range(1000):
        bins = rng.integers(0, CONFIG.n_theta * CONFIG.n_rho, rng.integers(1, 60))
        expected = [sum(int(b) in bins_of_star for b in bins) for bins_of_star in owned]
        # Random bins are mostly empty: half of them are taken from a star.
        assert patterns.votes(bins).tolist() == expected
        own = rng.choice(sorted(owned[int(rng.integers(150))]), 12)
        expected = [sum(int(b) in bins_of_star for b in own) for bins_of_star in owned]
        assert patterns.votes(own).tolist() == expected


def test_database_of_the_thesis():
    config = PatternConfig()
    catalogues = load_patterns(config)
    assert len(catalogues) == 26
    sizes = [len(catalogue) for catalogue in catalogues]
    assert sizes == sorted(sizes)
    # The Bright Star Catalogue has 50 stars to V = 2.0 (one of them is T CrB in outburst) and 518 to 4.0.
    assert sizes[0] == 49
    assert 510 <= sizes[20] <= 518
    density = [catalogue.mean_neighbours for catalogue in catalogues]
    assert density == sorted(density)
    # A uniform sky has n (1 - cos r)/2 neighbours; the real one clusters in the Milky Way.
    assert density[-1] == pytest.approx(sizes[-1] * (1 - np.cos(np.radians(config.radius_deg))) / 2, rel=0.15)


def test_bearings_and_separations():
    reference = direction(np.array([40.0]), np.array([25.0]))[0]
    np.testing.assert_allclose(separations(reference, direction(np.array([40.0]), np.array([26.0]))), np.radians(1.0))
    others = direction(np.array([40.0, 41.0, 40.0, 39.0]), np.array([26.0, 25.0, 24.0, 25.0]))
    np.testing.assert_allclose((np.degrees(bearings(reference, others)) + 45) % 360, [45, 134.8, 225, 315.2], atol=0.05)


def test_bearings_turn_with_the_frame_and_keep_their_sense():
    rng = np.random.default_rng(6)
    stars = rng.normal(size=(12, 3))
    stars /= np.linalg.norm(stars, axis=1, keepdims=True)
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    turn *= np.linalg.det(turn)
    there, here = bearings(stars[0] @ turn.T, stars[1:] @ turn.T), bearings(stars[0], stars[1:])
    differences = (there - here - (there - here)[0] + np.pi) % (2 * np.pi) - np.pi
    np.testing.assert_allclose(differences, 0, atol=1e-9)


def test_alignment_finds_rotation_and_refuses_the_mirror_image():
    rng = np.random.default_rng(8)
    radius, tolerance = np.radians(40), np.radians(0.5)
    theta = np.sort(np.arccos(1 - rng.random(40) * (1 - np.cos(radius))))
    bearing = rng.uniform(-np.pi, np.pi, 40)
    found = align(theta[5:], bearing[5:] + 2.0, theta, bearing, tolerance, radius)
    assert found.rotation_rad % (2 * np.pi) == pytest.approx(2.0, abs=1e-6)
    np.testing.assert_array_equal(np.sort(found.pattern), np.arange(5, 40))
    np.testing.assert_array_equal(found.image + 5, found.pattern)
    assert found.log10_false_alarm < -20
    mirrored = align(theta, -bearing, theta, bearing, tolerance, radius)
    assert mirrored.log10_false_alarm > -4


def test_chance_bound_holds_for_poisson_numbers():
    from scipy.stats import poisson

    for expected in (0.01, 0.5, 3.0, 40.0):
        for n in range(1, 120):
            assert 10 ** log10_chance(n, expected) >= poisson.sf(n - 1, expected) * (1 - 1e-9)
    assert log10_chance(0, 1.0) == 0.0


def test_consensus():
    history = History(length=6)
    for limit in (30, 31, 31, 31):
        history.record(limit, 0.9)
    assert history.consensus(5, 0.6) is None
    history.record(31, 0.3)  # not similar enough to count
    assert history.consensus(5, 0.6) is None
    history.record(31, 0.7)
    assert history.consensus(5, 0.6) == (31, 0.8)
    history.record(31, 0.7)  # the first, 30, is forgotten
    assert history.consensus(5, 0.6) == (31, 1.0)
    assert len(history.entries) == 6


def test_configurations_are_values():
    assert hash(DdrConfig()) == hash(THESIS_ADAPTIVE)
    assert THESIS_BASELINE != THESIS_ADAPTIVE
    assert (THESIS_BASELINE.fixed_limit_decimag, THESIS_ADAPTIVE.similarity_threshold) == (40, 0.45)
    assert PatternConfig().limits_decimag == tuple(range(20, 46))
    with pytest.raises(ConfigError):
        DdrConfig(fixed_limit_decimag=99)
    with pytest.raises(ConfigError):
        PatternConfig(radius_deg=0)
