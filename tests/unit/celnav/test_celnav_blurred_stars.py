"""Stars that a lens has blurred: their width is told from the whole image, and clouds, faults and sharp stars tell none."""

import numpy as np
import pytest
from star_images import add_star, nearest, scattered

import celnav
from celnav.detecting.correlation.self_correlation import correlations_of_halves
from celnav.detecting.correlation.width import width_of_image
from celnav.detecting.noise_map import NoiseMap
from celnav.detecting.tiles import Tiles

SIZE = (360, 480)
LEVEL, READ = 200.0, 3.0
NOISE = np.sqrt(LEVEL + READ**2)


def told_width(light, seed=3):
    tiles = Tiles.of(SIZE, 32)
    noise = NoiseMap(tiles.map_of(np.full(tiles.shape, NOISE, dtype=np.float32)), NOISE)
    halves = correlations_of_halves(seen(light, seed) - np.float32(LEVEL), noise)
    shape = width_of_image(halves, SIZE)
    return None if shape is None else shape.round_sigma_px


def seen(light, seed):
    rng = np.random.default_rng([15, seed])
    return np.clip(np.rint(rng.poisson(LEVEL + np.maximum(light, 0)) + rng.normal(0, READ, SIZE)), 0, 65535).astype(
        np.uint16
    )


def add_disk(image, u, v, light, diameter_px):
    """Add an evenly lit disk, as geometrical optics makes of a star out of focus, by fine parts."""
    at = (np.arange(40) + 0.5) / 40 * diameter_px - diameter_px / 2
    dv, du = (each.ravel() for each in np.meshgrid(at, at, indexing="ij"))
    inside = np.hypot(du, dv) < diameter_px / 2
    rows, columns = np.rint(v + dv[inside]).astype(int), np.rint(u + du[inside]).astype(int)
    np.add.at(image, (rows, columns), light / inside.sum())


def starry(add, brightest=2500.0, faintest=700.0, seed=4):
    light = np.zeros(SIZE)
    places = scattered(np.random.default_rng(seed), 30, apart=40.0, margin=24)
    for place, flux in zip(places, np.geomspace(brightest, faintest, len(places)), strict=True):
        add(light, *place, flux)
    return light, places


@pytest.mark.parametrize("sigma_px", [1.6, 2.2, 3.0])
def test_the_width_of_gaussians(sigma_px):
    """No peak of the widest stands four times above a pixel's noise; the pixel's own width adds 1/12 to the variance."""
    light, _ = starry(lambda *star: add_star(*star, sigma_px))
    assert told_width(light) == pytest.approx(np.sqrt(sigma_px**2 + 1 / 12), rel=0.08)


@pytest.mark.parametrize("diameter_px", [7.0, 10.0, 13.0])
def test_the_width_of_disks(diameter_px):
    """Between the root mean square of the light, D / 4, and the Gaussian that finds a disk best.

    That has D^2 / (8 s^2) = x where 1 + 2 x = exp(x), the maximum of (1 - exp(-x)) / sqrt(x): x = 1.256, s = 0.315 D.
    """
    light, _ = starry(lambda *star: add_disk(*star, diameter_px), 6000.0, 1500.0)
    assert 0.25 * diameter_px < told_width(light) < 0.325 * diameter_px


def test_sharp_stars_are_measured_one_by_one():
    light, _ = starry(lambda *star: add_star(*star, 0.9))
    assert told_width(light) is None


def turbulent(exponent, seed=12):
    """Cloud of unit scatter whose power falls with the frequency to `exponent`, but beyond 64 px, which tiles take off."""
    rng = np.random.default_rng(seed)
    frequency = np.hypot(np.fft.fftfreq(SIZE[0])[:, None], np.fft.rfftfreq(SIZE[1])[None])
    power = np.where(frequency > 1 / 64, np.maximum(frequency, 1e-9) ** exponent, 0.0)
    cloud = np.fft.irfft2(np.fft.rfft2(rng.normal(size=SIZE)) * np.sqrt(power), SIZE)
    return cloud / cloud.std()


@pytest.mark.parametrize("exponent", [-11 / 3, -8 / 3])
@pytest.mark.parametrize(("depth", "stars"), [(3.0, False), (10.0, False), (60.0, False), (10.0, True), (60.0, True)])
def test_clouds_have_no_width(exponent, depth, stars):
    """-11/3 is the power law of turbulence (Kolmogorov) in a layer, -8/3 that of a thin one."""
    light = starry(lambda *star: add_star(*star, 1.0), 4000.0, 500.0)[0] if stars else np.zeros(SIZE)
    assert told_width(light + depth * turbulent(exponent)) is None


def test_noise_and_what_lies_in_one_half_have_none():
    assert told_width(np.zeros(SIZE)) is None
    light = np.zeros(SIZE)
    for place in [(40.0, 50.0), (60.0, 200.0), (150.0, 120.0), (180.0, 300.0)]:
        add_star(light, *place, 40_000.0, 3.0)
    assert told_width(light) is None


@pytest.mark.parametrize("fault", ["rows", "columns"])
def test_bright_lines_have_none(fault):
    light = np.zeros(SIZE)
    lines = light if fault == "rows" else light.T
    lines[20::53] += 8.0
    lines[21::53] += 8.0
    assert told_width(light) is None


def test_stars_far_out_of_focus_are_found_once_and_where_they_are():
    """30 stars on disks of 12 px, 9 to 25 times the noise under a matched filter: no pixel of any is 4 times its noise."""
    places = scattered(np.random.default_rng(4), 30, apart=40.0, margin=24)
    under_filter = NOISE * np.sqrt(4 * np.pi) * 3.0
    light = np.zeros(SIZE)
    for place, ratio in zip(places, np.geomspace(25, 9, len(places)), strict=True):
        add_disk(light, *place, ratio * under_filter, 12.0)
    found = celnav.detect(seen(light, 7))
    distance, which = nearest(found, places)
    assert (distance < 1.5).sum() >= 28
    assert len(found) <= 32
    good = distance < 1.5
    apart = (found.uv[which[good]] - places[good]) / found.sigma_px[which[good], None]
    assert 0.5 < np.mean(apart**2) < 2.0
