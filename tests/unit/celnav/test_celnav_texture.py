"""Stars in the gaps of bright, broken cloud: its knots and edges are no stars, and do not set the width of stars."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage

import celnav
from celnav.detecting.noise_map import NoiseMap
from celnav.detecting.surroundings import amid_scatter, in_texture
from celnav.detecting.tiles import Tiles

F8 = NDArray[np.float64]

SIZE = (480, 640)
SKY_E, CLOUD_E = 400.0, 1500.0


def broken_cloud(seed: int) -> F8:
    """Light of cloud with gaps, whose depth is the upper half of a random field of all sizes."""
    random = np.random.default_rng(seed)
    frequency = np.hypot(np.fft.fftfreq(SIZE[0])[:, None], np.fft.rfftfreq(SIZE[1])[None])
    amplitude = np.maximum(frequency, 4 / SIZE[1]) ** -1.6
    field = np.fft.irfft2(np.fft.rfft2(random.normal(size=SIZE)) * amplitude, SIZE)
    depth = np.maximum((field - np.median(field)) / field.std(), 0)
    return ndimage.gaussian_filter(CLOUD_E * (1 - np.exp(-2 * depth)), 1.0)


def places_between(cloud: F8, n: int, apart_px: float, seed: int) -> F8:
    """Random places that far from each other and 10 px from any cloud, shape (n, 2)."""
    random = np.random.default_rng(seed)
    places = np.empty((0, 2))
    while len(places) < n:
        place = random.uniform(11, [SIZE[1] - 12, SIZE[0] - 12])
        column, row = np.rint(place).astype(int)
        cloudless = cloud[row - 10 : row + 11, column - 10 : column + 11].max() < 20
        if cloudless and np.hypot(*(places - place).T).min(initial=np.inf) > apart_px:
            places = np.vstack((places, place))
    return places


def photograph(cloud: F8, places: F8, peaks_e: F8, sigma_px: tuple[float, float], seed: int) -> F8:
    """Electrons of sky, cloud and Gaussian stars, with photon noise."""
    light = SKY_E + cloud
    v, u = np.mgrid[0 : SIZE[0], 0 : SIZE[1]]
    for (column, row), peak in zip(places, peaks_e, strict=True):
        near = np.s_[max(int(row) - 12, 0) : int(row) + 14, max(int(column) - 12, 0) : int(column) + 14]
        square = ((u[near] - column) / sigma_px[0]) ** 2 + ((v[near] - row) / sigma_px[1]) ** 2
        light[near] += peak * np.exp(-square / 2)
    return np.random.default_rng(seed).poisson(light).astype(np.float64)


def noise_of(sigma: float) -> NoiseMap:
    tiles = Tiles.of(SIZE, 32)
    return NoiseMap(tiles.map_of(np.full(tiles.shape, sigma, dtype=np.float32)), 1e-3)


@pytest.mark.parametrize(
    ("sigma_px", "faintest_e", "least_found", "most_false"),
    [
        pytest.param((1.0, 1.0), 150.0, 172, 160, id="points"),
        pytest.param((2.0, 0.8), 400.0, 155, 60, id="short streaks"),
    ],
)
def test_stars_between_bright_clouds_are_found(
    sigma_px: tuple[float, float], faintest_e: float, least_found: int, most_false: int
) -> None:
    n_found = n_false = 0
    for seed in (1, 2, 3, 4):
        cloud = broken_cloud(seed)
        places = places_between(cloud, 60, 14.0, seed)
        peaks = faintest_e * np.linspace(0.01, 1, 60) ** -0.9
        uv = celnav.detect(photograph(cloud, places, peaks, sigma_px, seed)).uv
        apart = np.hypot(*(uv[:, None] - places).transpose(2, 0, 1))
        n_found += int((apart.min(axis=0) < 0.7).sum())
        n_false += int((apart.min(axis=1) > 1.5).sum())
    assert n_found >= least_found  # of 240
    assert n_false <= most_false


def test_a_crowded_clear_sky_is_no_texture() -> None:
    random = np.random.default_rng(5)
    places = random.uniform(0, [SIZE[1] - 1, SIZE[0] - 1], (1500, 2))
    peaks = np.minimum(60 * random.uniform(size=1500) ** -1.2, 3e4)
    image = photograph(np.zeros(SIZE), places, peaks, (1.0, 1.0), 5)
    found = celnav.detect(image)
    light = (image - SKY_E).astype(np.float32)
    height = light[tuple(np.rint(found.uv).astype(int).T[::-1])].astype(np.float64)
    textured = in_texture(light, light, noise_of(np.sqrt(SKY_E)), found.uv, height / 4, 1.0)
    assert len(found) > 600
    assert textured.mean() < 0.005


V, U = np.mgrid[0 : SIZE[0], 0 : SIZE[1]].astype(np.float64)
KNOTS = ndimage.gaussian_filter(np.random.default_rng(7).normal(size=SIZE), 2.0)


@pytest.mark.parametrize(
    ("structure", "expected"),
    [
        pytest.param(np.zeros(SIZE), 0.0, id="noise"),
        pytest.param(0.5 * U + 0.3 * V, 0.0, id="gradient"),
        pytest.param(9 * KNOTS / KNOTS.std(), 1.0, id="knots"),
    ],
)
def test_a_gradient_is_no_texture_and_knots_are(structure: F8, expected: float) -> None:
    random = np.random.default_rng(6)
    white = random.normal(size=SIZE).astype(np.float32)
    light = white + structure.astype(np.float32)
    uv = random.uniform(30, [SIZE[1] - 31, SIZE[0] - 31], (300, 2))
    least = np.full(300, 1e-9)  # the filtered image scatters around every place, so that the light itself decides
    assert amid_scatter(white, uv, least, 1.0).all()
    assert in_texture(white, light, noise_of(1.0), uv, least, 1.0).mean() == pytest.approx(expected, abs=0.01)
