"""Steps of the detection that work on pieces of an image, or on lists of pixels, against the same done on the whole image."""

import numpy as np
import pytest
from scipy import ndimage
from scipy.spatial import cKDTree

import celnav
from celnav.detecting import matched_filter as filtering
from celnav.detecting import strips
from celnav.detecting.close_pairs import close_pairs
from celnav.detecting.connected import connected
from celnav.detecting.filtered_noise import _one_sided
from celnav.detecting.noise_map import NoiseMap
from celnav.detecting.row_statistics import count_true, medians, moments_within
from celnav.detecting.star_shape import StarShape, gaussians, inverse, offsets, windows
from celnav.detecting.tiles import Tiles, mean_map, smooth


@pytest.mark.parametrize("part", [0.02, 0.3, 0.7])
@pytest.mark.parametrize("width", [1, 2, 37])
def test_connected_pixels_are_those_of_scipy(part, width):
    mask = np.random.default_rng(3).random((23, width)) < part
    expected, number = ndimage.label(mask, structure=np.ones((3, 3)))
    label, found = connected(np.flatnonzero(mask), width)
    assert found == number
    np.testing.assert_array_equal(label, expected[mask])


@pytest.mark.parametrize("number", [0, 1, 2, 60, 900])
@pytest.mark.parametrize("radius_px", [1.0, 6.0, 56.0])
def test_close_pairs_are_those_of_scipy(number, radius_px):
    uv = np.random.default_rng(4).uniform(0, 400, (number, 2))
    found = close_pairs(uv, radius_px)
    assert found.shape[1] == 2
    assert {tuple(pair) for pair in found.tolist()} == cKDTree(uv).query_pairs(radius_px)


@pytest.mark.parametrize("sigma_px", [0.6, 1.0, 2.3])
@pytest.mark.parametrize("block", [(64, 1152), (7, 11)])
def test_the_filter_in_blocks_is_that_of_the_whole_image(monkeypatch, sigma_px, block):
    """A Gaussian less its mean over a square, by SciPy, scaled so that a star of unit peak gives one."""
    monkeypatch.setattr(filtering, "_BLOCK_ROWS", block[0])
    monkeypatch.setattr(filtering, "_BLOCK_COLUMNS", block[1])
    light = np.random.default_rng(5).normal(0, 30, (50, 70)).astype(np.float32)
    found = filtering.matched_filter(light, StarShape.constant(sigma_px**2, 0, sigma_px**2, (50, 70)))
    reach = max(2, int(np.ceil(3 * sigma_px)))
    line = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma_px) ** 2)
    side = 2 * int(np.ceil(7 * sigma_px)) + 1
    star = ndimage.correlate(light.astype(float), np.outer(line, line) / line.sum() ** 2, mode="nearest")
    expected = star - ndimage.uniform_filter(light.astype(float), side, mode="nearest")
    gain = (np.outer(line, line) ** 2).sum() / line.sum() ** 2 - line.sum() ** 2 / side**2
    np.testing.assert_allclose(found.amplitude, expected / gain, atol=2e-4)
    kernel = np.outer(line, line) / line.sum() ** 2
    assert found.noise_factor[0, 0] == pytest.approx(np.sqrt((kernel**2).sum() - 1 / side**2) / gain, rel=1e-5)


@pytest.mark.parametrize("covariance", [(30.0, 22.0, 20.0), (1.4, 0.0, 9.0)])
@pytest.mark.parametrize("zone", [17, 450])
def test_the_filter_in_zones_is_that_of_the_whole_image(monkeypatch, covariance, zone):
    monkeypatch.setattr(filtering, "_ALIKE_PX", zone)
    light = np.random.default_rng(6).normal(0, 30, (60, 85)).astype(np.float32)
    found = filtering.matched_filter(light, StarShape.constant(*covariance, light.shape))
    expected, factor = filtered_whole(light, covariance)
    np.testing.assert_allclose(found.amplitude, expected, atol=3e-4)
    np.testing.assert_allclose(found.noise_factor, factor, rtol=1e-5)


def test_each_zone_has_the_filter_for_the_shape_at_its_middle(monkeypatch):
    monkeypatch.setattr(filtering, "_ZONE_PX", 40)
    light = np.random.default_rng(7).normal(0, 30, (80, 120)).astype(np.float32)
    shape = StarShape(np.vstack(([12.0, 4.0, 8.0], [5.0, 0.0, 1.0], np.zeros((4, 3)))), light.shape)
    found = filtering.matched_filter(light, shape)
    for left in (0, 40, 80):
        part = np.s_[40:80, left : left + 40]
        expected, factor = filtered_whole(light, shape.at(np.array([[left + 19.5, 59.5]]))[0])
        np.testing.assert_allclose(found.amplitude[part], expected[part], atol=3e-4)
        np.testing.assert_allclose(found.noise_factor[part], factor, rtol=1e-5)


def filtered_whole(light, covariance):
    """An elongated Gaussian less its mean over a square, by SciPy, scaled so that a star of unit peak gives one."""
    reach_u, reach_v = (int(np.ceil(3 * np.sqrt(covariance[k]))) for k in (0, 2))
    dv, du = np.mgrid[-reach_v : reach_v + 1, -reach_u : reach_u + 1]
    p, q, r = inverse(np.array([covariance]))[0]
    star = np.exp(-0.5 * (p * du * du + 2 * q * du * dv + r * dv * dv))
    side = 2 * int(np.ceil(2.4 * max(reach_u, reach_v))) + 1
    kernel = star / star.sum()
    summed = ndimage.correlate(light.astype(float), kernel, mode="nearest")
    summed -= ndimage.uniform_filter(light.astype(float), side, mode="nearest")
    gain = (kernel * star).sum() - star.sum() / side**2
    return summed / gain, np.sqrt((kernel**2).sum() - 1 / side**2) / gain


@pytest.mark.parametrize("size", [(20, 300), (97, 131), (640, 64)])
@pytest.mark.parametrize("extrapolated", [False, True])
def test_a_map_is_the_same_by_strips_pixels_and_meshes(size, extrapolated):
    tiles = Tiles.of(size, 32)
    grid = np.random.default_rng(2).normal(100, 5, tiles.shape).astype(np.float32)
    values = tiles.map_of(grid, extrapolated)
    whole = values.whole()
    assert whole.shape == size
    by_strips = np.concatenate([values.strip(top, min(top + 9, size[0])) for top in range(0, size[0], 9)])
    np.testing.assert_allclose(by_strips, whole, rtol=1e-6)
    rows, columns = np.nonzero(np.ones(size))
    np.testing.assert_allclose(values.at(rows, columns), whole.ravel(), rtol=1e-6)
    np.testing.assert_allclose(
        values.mesh(np.arange(0, size[0], 7), np.arange(0, size[1], 5)), whole[::7, ::5], rtol=1e-6
    )


@pytest.mark.parametrize("size", [(20, 300), (97, 131), (640, 64)])
@pytest.mark.parametrize("extrapolated", [False, True])
def test_the_mean_of_maps_is_that_of_their_pixels(size, extrapolated):
    rng = np.random.default_rng(4)
    grids = Tiles.of(size, 32).both
    maps = [grid.map_of(rng.normal(100, 5, grid.shape), extrapolated) for grid in grids]
    expected = (maps[0].whole() + maps[1].whole()) / 2
    np.testing.assert_allclose(mean_map(maps).whole(), expected, rtol=2e-6)


def test_a_map_is_linear_between_the_centres_of_tiles():
    tiles = Tiles.of((64, 96), 32)
    v, u = np.mgrid[0:64, 0:96]
    centres = 2.0 * np.array([15.5, 47.5])[:, None] - 3.0 * np.array([15.5, 47.5, 79.5])
    np.testing.assert_allclose(tiles.map_of(centres.astype(np.float32)).whole(), 2.0 * v - 3.0 * u, atol=1e-4)
    held = tiles.map_of(centres.astype(np.float32), extrapolated=False).whole()
    assert held.max() == pytest.approx(centres.max())
    assert held.min() == pytest.approx(centres.min())


def test_noise_is_nowhere_below_the_least_and_times_its_ratio():
    tiles = Tiles.of((64, 64), 32)
    white = tiles.map_of(np.array([[1.0, 4.0], [1.0, 4.0]], dtype=np.float32), extrapolated=False)
    noise = NoiseMap(white, 2.0, ratio=tiles.map_of(np.full((2, 2), 3.0, dtype=np.float32)))
    expected = 3 * np.maximum(white.whole(), 2.0)
    np.testing.assert_allclose(noise.strip(0, 64), expected, rtol=1e-6)
    np.testing.assert_allclose(noise.at(np.arange(64), np.arange(64)), np.diag(expected), rtol=1e-6)
    np.testing.assert_allclose(noise.mesh(np.arange(64), np.arange(64)), expected, rtol=1e-6)


def test_scatter_on_both_sides_of_the_median():
    """A tile of 144 samples tells the width of each side to some 10 %; samples that do not count are left out."""
    rng = np.random.default_rng(8)
    tiles = Tiles.of((320, 320), 32)
    samples = rng.normal(0, 1, (100, 144))
    samples = np.where(samples > 0, 3 * samples, samples).astype(np.float32)
    counted = rng.random(samples.shape) < 0.8
    ordered = np.sort(np.where(counted, samples, np.float32(np.inf)), axis=1)
    above, below = _one_sided(ordered, counted.sum(axis=1), tiles)
    assert np.median(above) == pytest.approx(3, rel=0.06)
    assert np.median(below) == pytest.approx(1, rel=0.06)


def test_detections_do_not_depend_on_the_pieces(monkeypatch):
    """A large frame is worked on in smaller strips than a small one: the stars are the same."""
    rng = np.random.default_rng(4)
    image = rng.normal(400, 20, (300, 500))
    v, u = np.mgrid[0:300, 0:500]
    for place, peak in zip(rng.uniform(6, [493, 293], (60, 2)), rng.uniform(150, 5000, 60), strict=True):
        image += peak * np.exp(-0.5 * ((u - place[0]) ** 2 + (v - place[1]) ** 2))
    image = np.rint(image).astype(np.uint16)
    once = celnav.detect(image)
    monkeypatch.setattr(filtering, "_BLOCK_ROWS", 9)
    monkeypatch.setattr(filtering, "_BLOCK_COLUMNS", 50)
    monkeypatch.setattr(strips, "_BYTES", 1)
    again = celnav.detect(image)
    assert len(once) >= 55
    np.testing.assert_allclose(again.uv, once.uv, atol=1e-4)
    np.testing.assert_allclose(again.flux, once.flux, rtol=1e-4)


@pytest.mark.parametrize("covariance", [(1.0, 0.0, 1.5), (4.0, 3.0, 4.0), (0.25, 0.0, 0.25), (60.0, 59.5, 60.0)])
def test_gaussians_of_any_inclination(covariance):
    """Far from the middle of a long one the factors along the axes overflow where their product does not."""
    uv = np.array([[40.3, 30.8], [12.0, 9.0]])
    light = np.ones((60, 80), dtype=np.float32)
    cut, rows, columns = windows(light, uv, (20, 24))
    assert cut.shape == (41, 49, 2)
    np.testing.assert_array_equal(cut[:, :, 0], 1)
    np.testing.assert_array_equal(cut[:, :, 1] > 0, (rows[:, 1] >= 0)[:, None] & (columns[:, 1] >= 0))
    found = gaussians(inverse(np.tile(covariance, (2, 1))), *offsets(rows, columns, uv))
    du, dv = columns - uv[:, 0], rows - uv[:, 1]
    p, q, r = np.linalg.inv([covariance[:2], covariance[1:]])[[0, 0, 1], [0, 1, 1]]
    expected = np.exp(-0.5 * (p * du[None] ** 2 + 2 * q * du[None] * dv[:, None] + r * dv[:, None] ** 2))
    np.testing.assert_allclose(found, expected, atol=2e-5)


def test_medians_of_nine_tiles():
    grids = np.random.default_rng(1).normal(0, 1, (2, 7, 11)).astype(np.float32)
    expected = [ndimage.median_filter(grid, 3, mode="nearest") for grid in grids]
    np.testing.assert_array_equal(smooth(grids), expected)
    np.testing.assert_array_equal(smooth(grids[0, :1, :1]), grids[0, :1, :1])


def test_statistics_of_rows_leave_out_what_does_not_count():
    rng = np.random.default_rng(2)
    samples = rng.normal(5, 2, (20, 144)).astype(np.float32)
    counted = rng.random(samples.shape) < rng.random((20, 1))
    counted[3] = False
    number = count_true(counted)
    np.testing.assert_array_equal(number, [np.count_nonzero(row) for row in counted])
    upper = [
        np.sort(row[keep])[keep.sum() // 2] if keep.any() else np.nan
        for row, keep in zip(samples, counted, strict=True)
    ]
    np.testing.assert_array_equal(medians(samples, counted), np.array(upper, dtype=np.float32))
    np.testing.assert_array_equal(medians(samples, np.ones_like(counted)), np.sort(samples, axis=1)[:, 72])
    mean, square = moments_within(samples, np.full(20, 6, dtype=np.float32), counted)
    for k, (row, keep) in enumerate(zip(samples.astype(float), counted, strict=True)):
        kept = row[keep & (np.abs(row) <= 6)]
        assert mean[k] == pytest.approx(kept.mean() if len(kept) else 0, rel=1e-6)
        assert square[k] == pytest.approx((kept**2).mean() if len(kept) else 0, rel=1e-6)


def test_tiles_of_one_value_are_told():
    image = np.random.default_rng(3).integers(0, 50, (96, 128)).astype(np.float32)
    tiles = Tiles.of((96, 128), 32)
    assert not tiles.same_value(image).any()
    image[:32, 32:64] = 7
    image[64, 64:96] = 9  # the first row of a tile alone
    assert np.flatnonzero(tiles.same_value(image)).tolist() == [1]


@pytest.mark.parametrize("either_sign", [False, True])
@pytest.mark.parametrize("by_zones", [False, True])
def test_pixels_that_exceed_the_noise(either_sign, by_zones):
    rng = np.random.default_rng(6)
    values = rng.normal(0, 3, (150, 2000)).astype(np.float32)
    tiles = Tiles.of(values.shape, 32)
    white, ratio = (
        tiles.map_of(rng.uniform(1, 2, tiles.shape).astype(np.float32), extrapolated=False) for _ in range(2)
    )
    noise = NoiseMap(white, 1.2, ratio=ratio)
    zones = rng.uniform(0.5, 1, values.shape).astype(np.float32) if by_zones else None
    at, limit = noise.exceeding(values, 1.5, zones, either_sign)
    limits = 1.5 * noise.strip(0, 150).astype(float) * (1 if zones is None else zones)
    sizes = np.abs(values) if either_sign else values
    assert np.all(np.diff(at) > 0)
    np.testing.assert_allclose(limit, limits.ravel()[at], rtol=1e-5)
    beyond = sizes > limits
    beyond.ravel()[at] ^= True
    # Only rounding tells them apart.
    assert np.all(np.abs(sizes / limits - 1)[beyond] < 1e-5)
