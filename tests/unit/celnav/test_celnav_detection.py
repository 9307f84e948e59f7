"""Detection against purpose-made images: what is found, where, and what is left alone."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from star_images import add_star, add_streak, grid, nearest

import celnav
from celnav import detection
from celnav.detecting.colour_mosaic import level_mosaic
from celnav.detecting.noise_map import NoiseMap
from celnav.detecting.star_candidates import Cores, without_flanks
from celnav.detecting.star_shape import StarShape, fit_shape
from celnav.detecting.tiles import Tiles
from celnav.errors import ConfigError

SIZE = (360, 480)


def sky(level=400.0):
    return np.full(SIZE, level)


def noisy(image, seed=0, read=3.0):
    rng = np.random.default_rng([99, seed])
    return np.clip(np.rint(rng.poisson(image) + rng.normal(0, read, image.shape)), 0, 65535).astype(np.uint16)


def star_field(seed=1, lights=(600, 60_000), sigma_px=1.0, level=400.0, **options):
    """Image without noise, positions and lights, brightest first."""
    rng = np.random.default_rng(seed)
    truth = rng.permutation(grid(rng, **options))
    light = np.geomspace(lights[1], lights[0], len(truth))
    image = sky(level)
    for (u, v), flux in zip(truth, light, strict=True):
        add_star(image, u, v, flux, sigma_px)
    return image, truth, light


def test_noise_free_stars_on_a_slope():
    image, truth, light = star_field(sigma_px=0.9)
    v, u = np.mgrid[0 : SIZE[0], 0 : SIZE[1]]
    found = celnav.detect(image + 0.2 * u + 0.1 * v - 0.001 * ((u - 160) ** 2 + (v - 120) ** 2))
    assert len(found) == len(truth)
    distance, row = nearest(found, truth)
    assert distance.max() < 0.03
    np.testing.assert_allclose(found.flux[row], light, rtol=0.04)
    assert (np.diff(found.flux) <= 0).all()


@pytest.mark.parametrize("dtype", [np.uint16, np.uint8, np.float32])
@pytest.mark.parametrize("sigma_px", [0.6, 1.0, 1.6, 2.5])
def test_noisy_stars_of_any_width(dtype, sigma_px):
    lights, step = (3000 * sigma_px, 30_000 * sigma_px), 24 if sigma_px < 2 else 40
    image, truth, _ = star_field(lights=lights, sigma_px=sigma_px, level=100.0, step=step)
    image = noisy(image).astype(float)
    found = celnav.detect((image * 255 / image.max()).astype(dtype) if dtype is np.uint8 else image.astype(dtype))
    distance, _ = nearest(found, truth)
    assert np.mean(distance < 0.5) > 0.97
    assert len(found) <= len(truth) + 2


def test_a_sky_of_half_a_step_of_noise():
    """Where one step of the converter is twice the noise, medians would see none of it."""
    image, truth, _ = star_field(lights=(14, 200), level=80.3)
    rng = np.random.default_rng(4)
    found = celnav.detect(np.rint(image + rng.normal(0, 0.5, SIZE)).astype(np.uint16))
    distance, _ = nearest(found, truth)
    assert np.mean(distance < 1) > 0.95
    assert len(found) <= len(truth) + 2


@pytest.mark.parametrize("seed", [3, 5])
def test_a_handful_of_bright_stars_shows_its_own_width(seed):
    """The wings of six bright stars, all that the correlation of the dark image sees, are wider than the stars."""
    rng = np.random.default_rng([17, seed])
    light = np.zeros((1024, 1024))
    truth = rng.uniform(60, 960, (6, 2))
    for (u, v), flux in zip(truth, np.geomspace(2000, 20_000, 6), strict=True):
        add_star(light, u, v, flux * rng.uniform(0.8, 1.2))
    image = np.rint(64 + rng.poisson(133 * light) / 133 + rng.normal(0, 0.69, light.shape)).astype(np.uint16)
    found = celnav.detect(image)
    distance, _ = nearest(found, truth)
    assert distance.max() < 0.1


def test_flat_and_black_images_are_empty():
    for image in (
        np.zeros((60, 80), dtype=np.uint8),
        np.full((60, 80), 7.5),
        np.full((60, 80), 65535, dtype=np.uint16),
    ):
        assert len(celnav.detect(image)) == 0


def test_mask_and_moon():
    image, truth, _ = star_field()
    v, u = np.mgrid[0 : SIZE[0], 0 : SIZE[1]]
    image[np.hypot(u - 400, v - 290) < 25] += 40_000  # the Moon
    mask = np.zeros(SIZE, dtype=bool)
    x, y = np.rint(truth[0]).astype(int)
    mask[y - 8 : y + 9, x - 8 : x + 9] = True
    found = celnav.detect(noisy(image), mask)
    assert np.linalg.norm(found.uv - truth[0], axis=1).min() > 5
    assert np.hypot(*(found.uv - [400, 290]).T).min() > 25
    elsewhere = np.hypot(*(truth - [400, 290]).T) > 45
    distance, _ = nearest(found, truth[elsewhere][1:])
    assert np.mean(distance < 1) > 0.97
    assert len(celnav.detect(image, np.ones(SIZE, dtype=bool))) == 0


def test_hot_and_dead_pixels_and_cosmic_rays_are_no_stars():
    image, truth, _ = star_field(lights=(2000, 60_000))
    image = noisy(image)
    clean = celnav.detect(image)
    rng = np.random.default_rng(3)
    rows, columns = rng.integers(0, SIZE[0], 150), rng.integers(0, SIZE[1], 150)
    image[rows[:100], columns[:100]] += rng.integers(150, 20_000, 100).astype(np.uint16)
    image[rows[100:140], columns[100:140]] = 0
    for row, column in zip(rows[140:], columns[140:], strict=True):
        image[row, column : column + 5] += 3000  # the track of a particle
    found = celnav.detect(image)
    distance, _ = nearest(found, truth)
    assert np.mean(distance < 0.7) > 0.97
    assert len(found) <= len(clean) + 4


def tracks(rng, count, mean_length_px=5.0, charge=1200.0):
    """Light of particles that cross the sensor: straight, one pixel wide, in any direction."""
    length = rng.exponential(mean_length_px, count)
    angle = rng.uniform(0, 2 * np.pi, count)
    start = rng.uniform(0, [[SIZE[1]], [SIZE[0]]], (2, count))
    along = np.arange(0, 40, 0.25)
    u, v = (s[:, None] + np.outer(f(angle), along) for s, f in zip(start, (np.cos, np.sin), strict=True))
    column, row = np.floor(u).astype(int), np.floor(v).astype(int)
    hit = (along <= length[:, None]) & (column >= 0) & (column < SIZE[1]) & (row >= 0) & (row < SIZE[0])
    image = np.zeros(SIZE)
    np.add.at(image, (row[hit], column[hit]), charge / 4)
    return image


@pytest.mark.parametrize("pedestal", [380, 400, 420])
def test_an_image_without_its_sky_keeps_stars_and_rejects_tracks(pedestal):
    """What is left of the sky says nothing about photon noise: neither tracks nor the sigmas of bright stars may grow."""
    image, truth, _ = star_field()
    whole = noisy(image + tracks(np.random.default_rng(8), 60))
    before, found = celnav.detect(whole), celnav.detect(whole.astype(np.float32) - pedestal)
    assert abs(len(found) - len(before)) <= 2
    assert np.mean(nearest(found, truth)[0] < 0.5) >= np.mean(nearest(before, truth)[0] < 0.5) - 0.01
    assert np.median(found.sigma_px[:40]) < 2 * np.median(before.sigma_px[:40])


@pytest.mark.parametrize("defect", [1e6, 1e7, -1e7])
def test_one_wild_pixel_of_a_float_image_hides_no_star(defect):
    image = noisy(star_field()[0]).astype(np.float32)
    before = len(celnav.detect(image))
    image[100, 101] = defect
    assert abs(len(celnav.detect(image)) - before) <= 1


def test_a_deep_stack_as_floats_shows_the_stars_that_it_shows_as_integers():
    """Three stars of 60,000 set no threshold for those of 10."""
    image, _, _ = star_field(lights=(20, 400), level=100.0)
    for u, v in ((80, 60), (160, 120), (240, 180)):
        add_star(image, u, v, 400_000, 1.0)
    stack = np.mean([noisy(image, seed).astype(np.float64) for seed in range(100)], axis=0)
    assert len(celnav.detect(stack)) == len(celnav.detect(np.rint(stack * 100).astype(np.int32)))


@pytest.mark.parametrize("sigma_px", [0.8, 1.2])
def test_a_storm_of_particles(sigma_px):
    """Tracks outnumber stars ten times and are as bright: shape and stars are found, and little else."""
    image, truth, _ = star_field(lights=(8000, 40_000), sigma_px=sigma_px, step=36)
    found = celnav.detect(noisy(image + tracks(np.random.default_rng(8), 10 * len(truth))))
    distance, _ = nearest(found, truth)
    assert np.mean(distance < 0.7) > 0.8
    assert len(found) < 1.15 * len(truth)


def test_the_shape_is_that_which_stars_agree_on():
    """Forty of two hundred covariances are of stars; without them nothing agrees, and there is no shape."""
    rng = np.random.default_rng(2)
    long, short, angle = rng.uniform(1, 16, 160), rng.uniform(0.25, 2, 160), rng.uniform(0, np.pi, 160)
    c, s = np.cos(angle), np.sin(angle)
    others = np.column_stack((long * c * c + short * s * s, (long - short) * c * s, long * s * s + short * c * c))
    stars = np.array([0.9, 0.1, 0.7]) + rng.normal(0, 0.03, (40, 3))
    uv = rng.uniform(0, 360, (200, 2))
    shape = fit_shape(np.concatenate((others, stars)), uv, SIZE)
    np.testing.assert_allclose(shape.at(uv), np.broadcast_to([0.9, 0.1, 0.7], (200, 3)), atol=0.03)
    assert fit_shape(others, uv[:160], SIZE) is None


def test_row_and_column_noise():
    """Offsets of rows and columns as large as the noise cost few of the faintest stars and make none."""
    image, truth, _ = star_field(lights=(900, 20_000))
    image = noisy(image).astype(float)
    rng = np.random.default_rng(8)
    clean = celnav.detect(np.rint(image).astype(np.uint16))
    striped = image + rng.normal(0, 20, (SIZE[0], 1)) + rng.normal(0, 20, (1, SIZE[1]))
    found = celnav.detect(np.rint(striped).astype(np.uint16))
    near, _ = nearest(found, truth)
    before, _ = nearest(clean, truth)
    assert np.sum(near < 1) >= 0.95 * np.sum(before < 1)
    assert len(found) - np.sum(near < 1) <= 3


def test_colour_counts_as_grey():
    image, _, _ = star_field()
    colour = np.repeat(image[:, :, None], 3, axis=2)
    np.testing.assert_allclose(celnav.detect(colour).uv, celnav.detect(image).uv, atol=1e-2)


def test_a_mosaic_of_colours():
    """Pixels under red, green and blue filters see different skies; stars are found all the same."""
    image, truth, _ = star_field(lights=(6000, 60_000))
    image[::2, ::2] *= 0.5
    image[1::2, 1::2] *= 0.7
    found = celnav.detect(noisy(image))
    distance, _ = nearest(found, truth)
    assert np.mean(distance < 1) > 0.95
    assert len(found) <= len(truth) + 3


@pytest.mark.parametrize(("light", "width"), [(600, 1), (200, 1), (3000, 2)])
def test_a_trail_is_no_star(light, width):
    image, truth, _ = star_field(lights=(3000, 60_000))
    u = np.linspace(40, 440, 1200)
    for shift in range(width):
        for x in u:
            add_star(image, x, 60.5 + 0.4 * (x - 40) + shift, light * 7 / 3, reach=5)
    found = celnav.detect(noisy(image))
    distance = np.linalg.norm(found.uv[:, None] - truth, axis=2).min(axis=1)
    on_line = np.abs(found.uv[:, 1] - (60.5 + 0.4 * (found.uv[:, 0] - 40))) < 4
    assert not (on_line & (distance > 1.5)).any()
    far = np.abs(truth[:, 1] - (60.5 + 0.4 * (truth[:, 0] - 40))) > 8
    assert np.mean(nearest(found, truth[far])[0] < 1) > 0.97
    kept = celnav.detect(noisy(image), config=celnav.DetectionConfig(trail_length_px=None))
    assert len(kept) > len(found) + 10


def test_stars_in_a_row_are_no_trail():
    image = sky()
    truth = np.column_stack((100 + 6.0 * np.arange(8), 120 + 2.0 * np.arange(8)))
    for u, v in truth:
        add_star(image, u, v, 20_000)
    distance, _ = nearest(celnav.detect(noisy(image)), truth)
    assert (distance < 0.3).all()


@pytest.mark.parametrize(("separation", "ratio"), [(4.0, 1), (6.0, 1), (5.0, 4), (6.0, 4)])
def test_stars_that_touch_are_told_apart(separation, ratio):
    """Both are found, and neither centroid is pulled by more than a tenth of the distance."""
    rng = np.random.default_rng(5)
    places = rng.permutation(grid(rng, step=40))
    alone, middles = np.split(places, [40])
    angle = rng.uniform(0, 2 * np.pi, len(middles))
    offset = separation * np.column_stack((np.cos(angle), np.sin(angle)))
    image = sky()
    for place, other in zip(middles, middles + offset, strict=True):
        add_star(image, *place, 20_000.0 * ratio)
        add_star(image, *other, 20_000.0)
    for place in alone:
        add_star(image, *place, 20_000.0)
    found = celnav.detect(noisy(image))
    assert (nearest(found, alone)[0] < 0.1).all()
    for truth in (middles, middles + offset):
        distance, _ = nearest(found, truth)
        assert np.mean(distance < 0.1 * separation) > 0.9


@pytest.mark.parametrize("given", [False, True])
@pytest.mark.parametrize("streak", [(6.0, 3.0), (-9.0, 12.0)])
def test_streaks_of_a_moving_camera(streak, given):
    rng = np.random.default_rng(6)
    truth = rng.permutation(grid(rng, step=36, margin=30))
    image = sky(200.0)
    light = np.geomspace(60_000, 2500, len(truth))
    for place, flux in zip(truth, light, strict=True):
        add_streak(image, *place, flux, *streak)
    found = celnav.detect(noisy(image), config=celnav.DetectionConfig(streak_px=streak if given else None))
    distance, row = nearest(found, truth)
    assert np.mean(distance < 2.0) > 0.93
    assert len(found) < 1.1 * len(truth)
    bright = light > 10_000
    assert np.median(distance[bright]) < 0.3
    pull = (found.uv[row] - truth)[distance < 2] / found.sigma_px[row][distance < 2, None]
    assert np.median(np.abs(pull)) < 1.5


def test_streaks_that_turn_over_the_frame():
    """A turn about the optical axis: streaks lie on circles, and grow with the distance from the middle."""
    rng = np.random.default_rng(7)
    truth = rng.permutation(grid(rng, step=36, margin=30))
    image = sky(200.0)
    moved = 0.06 * (truth - [240, 180]) @ np.array([[0.0, 1.0], [-1.0, 0.0]])
    for place, (du, dv) in zip(truth, moved, strict=True):
        add_streak(image, *place, 15_000, du, dv)
    found = celnav.detect(noisy(image))
    distance, _ = nearest(found, truth)
    assert np.mean(distance < 0.7) > 0.9
    assert len(found) < 1.1 * len(truth)


@pytest.mark.parametrize("given", [False, True])
def test_saturated_stars(given):
    """Flat tops of several pixels: one detection each, in the middle, and before all others."""
    rng = np.random.default_rng(2)
    truth = rng.permutation(grid(rng, step=40, margin=30))
    light = np.concatenate((np.geomspace(8e6, 1e6, 6), np.geomspace(1e5, 3e3, len(truth) - 6)))
    image = sky()
    for place, flux in zip(truth, light, strict=True):
        add_star(image, *place, flux, sigma_px=1.2)
    clipped = np.minimum(noisy(np.minimum(image, 1e6)), 20_000).astype(np.uint16)
    found = celnav.detect(clipped, config=celnav.DetectionConfig(saturation_dn=20_000 if given else None))
    distance, row = nearest(found, truth)
    assert (distance[:6] < 0.3).all()
    assert set(row[:6]) == set(range(6))
    assert np.mean(distance < 1) > 0.97
    assert len(found) <= len(truth) + 2
    assert (np.abs(found.uv[row[:6]] - truth[:6]) < 4 * found.sigma_px[row[:6], None]).all()


def test_flood_fill_of_the_thesis():
    image = np.zeros((40, 40))
    image[10, 10:14] = [100, 100, 100, 900]
    found = celnav.detect(image, config=celnav.FloodFillConfig(weighted=False))
    np.testing.assert_allclose(found.uv, [[11.5, 10.0]])
    np.testing.assert_allclose(celnav.detect(image, config=celnav.FloodFillConfig()).uv, [[12.5, 10.0]])
    image, truth, light = star_field(lights=(3000, 60_000))
    found = celnav.detect(noisy(image), config=celnav.FloodFillConfig())
    distance, row = nearest(found, truth)
    assert np.mean(distance < 0.5) > 0.95
    assert found.sigma_px is None
    np.testing.assert_allclose(found.flux[row[:50]], light[:50], rtol=0.1)
    everything = np.ones(SIZE, dtype=bool)
    assert len(celnav.detect(image, everything, celnav.FloodFillConfig())) == 0


@pytest.mark.parametrize(
    "choice",
    [{"seed_sigma": 2.0}, {"tile_px": 2}, {"psf_sigma_px": 0.1}, {"streak_px": (100.0, 0.0)}, {"gain_e_per_dn": 0.0}],
)
def test_choices_out_of_range(choice):
    with pytest.raises(ConfigError):
        celnav.DetectionConfig(**choice)
    with pytest.raises(ConfigError):
        celnav.FloodFillConfig(min_area_px=0)


@settings(max_examples=60, deadline=None)
@given(
    image=st.one_of(
        arrays(np.uint8, st.tuples(st.integers(3, 90), st.integers(3, 90))),
        arrays(np.uint16, st.tuples(st.integers(3, 40), st.integers(3, 40))),
        arrays(np.float32, (40, 50), elements=st.floats(-1e6, 1e6, width=32)),
    ),
    config=st.sampled_from(
        [
            None,
            celnav.DetectionConfig(streak_px=(7, 3)),
            celnav.DetectionConfig(psf_sigma_px=3),
            celnav.FloodFillConfig(),
        ]
    ),
    masked=st.booleans(),
)
def test_any_image_gives_finite_detections(image, config, masked):
    mask = (image > np.median(image)) if masked else None
    found = celnav.detect(image, mask, config)
    assert found.uv.shape == (len(found.flux), 2)
    assert np.isfinite(found.uv).all()
    assert np.isfinite(found.flux).all()
    assert (found.flux >= 0).all()
    assert ((found.uv > -6) & (found.uv < np.array(image.shape[::-1]) + 6)).all()
    if found.sigma_px is not None:
        assert (found.sigma_px > 0).all()


def test_a_saturated_star_may_stand_without_any_peak():
    """Where trails take all peaks and one flat top is left, nothing stands in its flanks."""
    shape = StarShape.constant(1.0, 0.0, 1.0, (64, 48))
    cores = Cores(np.array([[20.0, 20.0]]), np.array([3.0]), 60_000.0)
    nothing = np.empty(0)
    assert without_flanks(np.empty((0, 2)), nothing, nothing, 5.0, shape, cores).shape == (0,)


def test_full_scale_that_does_not_stand_out_of_the_sky_is_no_star():
    """A bright corner of a meteor camera's frame reached 255 among fixed dark pixels: cores without light lay 1e31 px off."""
    light = np.full((64, 64), -0.5, np.float32)
    light[31, 32] = -20.0
    add_star(light, 15.2, 40.1, 400.0, 1.2)
    cores = Cores(np.array([[15.0, 40.0], [31.0, 31.0]]), np.array([1.5, 1.5]), 4.0)
    shape = StarShape.constant(1.4, 0.0, 1.4, light.shape)
    uv, flux, sigma = detection._saturated_stars(light, cores, shape, celnav.DetectionConfig())
    assert uv == pytest.approx(np.array([[15.2, 40.1]]), abs=0.1)
    assert len(flux) == len(sigma) == 1


def test_a_shape_that_has_no_width_in_the_middle_is_searched_all_the_same():
    """A polynomial through few stars may be negative where there are none; a roof under a fisheye made one."""
    coefficients = np.zeros((6, 3))
    coefficients[0], coefficients[3], coefficients[5] = (-0.5, 0, -0.5), (3, 0, 3), (3, 0, 3)
    light = np.random.default_rng(1).normal(0, 1, (96, 128)).astype(np.float32)
    shape = StarShape(coefficients, light.shape)
    everywhere = np.ones(light.shape, dtype=bool)
    tiles = Tiles.of(light.shape, 32)
    noise = NoiseMap(tiles.map_of(np.ones(tiles.shape, dtype=np.float32)), 0.1)
    found = detection._search(light, noise, everywhere, shape, celnav.DetectionConfig())
    assert np.isfinite(found.noise.strip(0, len(light))).all()


def test_a_coloured_sky_over_a_mosaic_hides_no_stars():
    """A sky of 400, 900, 900 and 300 under the four colours: as many stars as on grey; grey frames stay as they are."""
    rng = np.random.default_rng(1)
    sky = np.full((361, 481), 600.0)
    coloured = sky.copy()
    for row, column, level in ((0, 0, 400), (0, 1, 900), (1, 0, 900), (1, 1, 300)):
        coloured[row::2, column::2] = level
    found = []
    for image in (sky, coloured):
        stars = np.zeros_like(image)
        truth = grid(np.random.default_rng(2), image.shape, step=30, margin=16)
        for u, v in truth:
            add_star(stars, u, v, 1500.0)
        frame = np.random.default_rng(3).poisson(image + stars).astype(np.uint16)
        found.append(np.mean(nearest(celnav.detect(frame), truth)[0] < 1))
    assert found[0] > 0.95
    assert found[1] > found[0] - 0.05
    flat = rng.poisson(sky).astype(np.float32)
    assert level_mosaic(flat, np.ones(flat.shape, dtype=bool), 32, 1.01) is flat


def test_quantised_noise_under_a_mask_is_no_mosaic():
    """Noise of 0.39 of a step, pixels masked all over but in one tile: medians of whole numbers differ by chance alone."""
    rng = np.random.default_rng(5)
    image = np.rint(19.47 + rng.normal(0, 0.39, (360, 640))).astype(np.uint8)
    used = rng.random(image.shape) > 0.3
    used[50:200, 50:200] = True
    flat = image.astype(np.float32)
    assert level_mosaic(flat, used, 32, 1.01) is flat
    assert len(celnav.detect(image, ~used)) <= 3
