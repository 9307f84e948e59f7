"""Streaks that a camera's motion makes of stars: told from the whole image, found in one piece, placed by their ends."""

import numpy as np
import pytest
from star_images import add_star, add_streak, grid, nearest, scattered

import celnav
from celnav.detecting.correlation.self_correlation import correlations_of_halves
from celnav.detecting.correlation.streak import GAUSSIAN_OF_LINE, streak_of_image
from celnav.detecting.noise_map import NoiseMap
from celnav.detecting.star_centroids import measure_stars
from celnav.detecting.star_shape import StarShape, axes, fit_shape
from celnav.detecting.streaks.ends import by_ends
from celnav.detecting.tiles import Tiles

SIZE = (360, 480)
LEVEL = 200.0


def flat_noise(sigma):
    tiles = Tiles.of(SIZE, 32)
    return NoiseMap(tiles.map_of(np.full(tiles.shape, sigma, dtype=np.float32)), sigma)


def seen(light, seed):
    rng = np.random.default_rng([5, seed])
    return np.clip(np.rint(rng.poisson(LEVEL + light) + rng.normal(0, 3, SIZE)), 0, 65535).astype(np.uint16)


def streaked(streak, lights, seed=4, number=36):
    rng = np.random.default_rng(seed)
    truth = scattered(rng, number, apart=34.0, margin=40)
    light = np.zeros(SIZE)
    for place, flux in zip(truth, np.geomspace(*lights, len(truth)), strict=True):
        add_streak(light, *place, flux, *streak)
    return light, truth


def told_streak(image, sigma):
    return streak_of_image(correlations_of_halves(image, flat_noise(sigma)), SIZE)


def line_of(shape):
    """Direction, deg, and length, px, of the line that a shape stands for."""
    uu, uv, vv = shape.coefficients[0]
    large, small = axes(shape.coefficients[:1])
    return np.degrees(np.arctan2(2 * uv, uu - vv) / 2) % 180, np.sqrt(GAUSSIAN_OF_LINE * (large - small)[0])


@pytest.mark.parametrize(
    ("streak", "lights"),
    [
        ((-6.0, 8.0), (3000, 900)),
        ((-24.0, 32.0), (6000, 1500)),
        ((-37.0, 48.0), (9000, 2500)),
        ((44.0, 26.0), (9000, 2500)),
    ],
)
def test_faint_streaks_are_found_in_one_piece(streak, lights):
    """A pixel of the fainter ones lies below the threshold for points: pieces of a streak are no stars."""
    light, truth = streaked(streak, lights)
    found = celnav.detect(seen(light, 1))
    distance, row = nearest(found, truth)
    length = np.hypot(*streak)
    assert np.mean(distance < 2 + 0.1 * length) > 0.8
    assert len(found) < 1.1 * len(truth) + 2
    near = distance < 2 + 0.1 * length
    pull = (found.uv[row] - truth)[near] / found.sigma_px[row][near, None]
    assert 0.3 < np.mean(pull**2) < 2.0


def test_middles_are_known_to_noise_over_ridge():
    """The bound for a line under a Gaussian, n / a along it, as of trail fitting (Veres et al. 2012, PASP 124, 1197)."""
    streak, noise, flux, sigma_px = (40.0, 0.0), 4.0, 1500.0, 1.0
    ridge = flux / 40 / np.sqrt(2 * np.pi) / sigma_px
    rng = np.random.default_rng(11)
    truth = grid(rng, size=SIZE, step=55, margin=30)
    light = rng.normal(0, noise, SIZE)
    for place in truth:
        add_streak(light, *place, flux, *streak)
    covariance = np.tile([40**2 / GAUSSIAN_OF_LINE + 1, 0.0, 1.0], (len(truth), 1))
    image, scale = light.astype(np.float32), flat_noise(noise)
    begun = truth + rng.uniform(-3, 3, truth.shape) * [1, 0.2]
    under_gaussians = measure_stars(image, scale, begun, covariance, np.inf)
    stars, streaks = by_ends(image, scale, under_gaussians, covariance, np.inf)
    assert np.abs(np.abs(streaks.ends) - [40.0, 0.0]).max() < 2.0
    assert np.sqrt(np.mean(streaks.sigma_across**2)) == pytest.approx((stars.uv - truth)[:, 1].std(), rel=0.35)
    along, across = (stars.uv - truth).T
    bound = noise / ridge
    assert along.std() == pytest.approx(bound, rel=0.25)
    assert across.std() < 0.35 * bound
    assert (under_gaussians.uv - truth)[:, 0].std() > 2 * bound
    # The root mean square of both axes is stated.
    assert np.sqrt(np.mean(stars.sigma_px**2)) == pytest.approx(bound / np.sqrt(2), rel=0.35)


def test_length_and_middle_where_the_shape_is_short_and_the_image_cuts_streaks():
    """The one length that all streaks share mends a shape that is 20 % short; ends outside of the image are no ends."""
    rng = np.random.default_rng(12)
    light = rng.normal(0, 2.0, SIZE)
    truth = np.array([[6.0, 60.0], [470.0, 120.0], [120.0, 180.0], [240.0, 240.0], [300.0, 100.0], [400.0, 300.0]])
    for place in truth:
        add_streak(light, *place, 8000.0, 50.0, 0.0)
    covariance = np.tile([40**2 / GAUSSIAN_OF_LINE + 1, 0.0, 1.0], (len(truth), 1))
    image, scale = light.astype(np.float32), flat_noise(2.0)
    stars = measure_stars(image, scale, truth + [3.0, 0.0] * np.sign([240, 180] - truth), covariance, np.inf)
    assert np.abs(by_ends(image, scale, stars, covariance, np.inf)[0].uv - truth).max() < 0.6


@pytest.mark.parametrize("streak", [(-7.0, 9.0), (30.0, 5.0), (-36.0, 48.0), (0.0, 55.0)])
def test_the_image_tells_the_streak_before_any_star_is_found(streak):
    light, _ = streaked(streak, (5000, 600))
    image = seen(light, 2) - np.float32(LEVEL)
    direction, length = line_of(told_streak(image, np.sqrt(LEVEL + 9)))
    assert abs((direction - np.degrees(np.arctan2(streak[1], streak[0])) + 90) % 180 - 90) < 3
    assert length == pytest.approx(np.hypot(*streak), rel=0.15)


def crossed_by_a_trail(light):
    add_streak(light, 240.0, 180.0, 4e5, 300.0, 120.0)


def with_an_uneven_sky(light):
    v, u = np.mgrid[0 : SIZE[0], 0 : SIZE[1]]
    light += 60 * np.sin(u / 25) * np.sin((u + 2 * v) / 40) ** 2


def with_a_bright_column(light):
    light[:, 200:203] += 30.0


def with_bright_rows(light):
    light[100:340:40, :] += 8.0


def under_bands_of_cloud(light):
    """Smooth noise, four times as long along one direction as across, as moonlit cloud."""
    from scipy import ndimage

    noise = np.random.default_rng(12).normal(0.0, 1.0, (800, 800))
    cloud = ndimage.rotate(ndimage.gaussian_filter(noise, (5, 20)), 15, reshape=False, order=1)[:360, :480]
    light += 60 * cloud / cloud.std()


@pytest.mark.parametrize(
    "add",
    [None, crossed_by_a_trail, with_an_uneven_sky, with_a_bright_column, with_bright_rows, under_bands_of_cloud],
)
def test_round_stars_trails_clouds_and_faults_are_no_streaks(add):
    rng = np.random.default_rng(4)
    light = np.zeros(SIZE)
    for place, flux in zip(scattered(rng, 20, apart=60.0, margin=40), np.geomspace(20_000, 500, 20), strict=True):
        add_star(light, *place, flux, 1.2)
    if add is not None:
        add(light)
    assert told_streak(seen(np.maximum(light, 0), 3) - np.float32(LEVEL), np.sqrt(LEVEL + 9)) is None


def test_noise_and_small_images_have_no_streak():
    noise = np.random.default_rng(8).normal(0, 1, SIZE).astype(np.float32)
    assert told_streak(noise, 1.0) is None
    assert correlations_of_halves(noise[:60], flat_noise(1.0)) is None


def test_few_streaks_and_round_stars_stay_where_they_were():
    light, truth = streaked((40.0, 0.0), (6000, 5000), number=8)
    image, scale = light.astype(np.float32), flat_noise(2.0)
    long, round_ = ([GAUSSIAN_OF_LINE * 25, 0.0, 1.0], [2.0, 0.0, 1.0])
    for covariance, places in ((long, truth[:3]), (round_, truth)):
        own = np.tile(covariance, (len(places), 1))
        stars = measure_stars(image, scale, places, own, np.inf)
        found, streaks = by_ends(image, scale, stars, own, np.inf)
        assert found is stars
        assert streaks is None


def test_shape_of_few_long_streaks_and_of_few_round_stars():
    rng = np.random.default_rng(3)
    uv = rng.uniform(0, 300, (6, 2))
    alike = 1 + rng.normal(0, 0.03, (6, 1))
    shape = fit_shape(np.array([[90.0, -120.0, 170.0]]) * alike, uv, SIZE)
    assert isinstance(shape, StarShape)
    assert not shape.varies
    few = fit_shape(np.array([[1.2, 0.0, 1.1]]) * alike, uv, SIZE)
    assert few is not None
    assert few.at(uv) == pytest.approx(np.tile([1.2, 0.0, 1.1], (6, 1)), rel=0.05)
    unlike = np.geomspace(1, 8, 6)[:, None]
    assert fit_shape(np.array([[1.2, 0.0, 1.1]]) * unlike, uv, SIZE) is None
    narrow = np.array([[1.2, 0.0, 0.1]]) * alike  # tracks of particles
    assert fit_shape(narrow, uv, SIZE) is None


def test_streaks_measured_a_few_at_a_time_are_those_measured_together(monkeypatch):
    light, truth = streaked((24.0, 18.0), (6000, 3000))
    image, noise = seen(light, 6) - np.float32(LEVEL), flat_noise(np.sqrt(LEVEL + 9))
    own = np.tile(np.array([24.0 * 24, 24.0 * 18, 18.0 * 18]) / GAUSSIAN_OF_LINE + [1.0, 0.0, 1.0], (len(truth), 1))
    stars = measure_stars(image, noise, truth, own, np.inf)
    together, _ = by_ends(image, noise, stars, own, np.inf)
    monkeypatch.setattr("celnav.detecting.streaks.ends._AT_ONCE", 5)
    apart, _ = by_ends(image, noise, stars, own, np.inf)
    assert together is not stars
    assert apart.uv == pytest.approx(together.uv, abs=1e-9)
    assert apart.sigma_px == pytest.approx(together.sigma_px, rel=1e-9)
