"""Detection's own statistics: false alarms on pure noise, completeness, and standard deviations of centroids and fluxes."""

import numpy as np
import pytest
from scipy.stats import norm
from star_images import add_star, grid, nearest

import celnav

SIZE = (360, 480)


@pytest.mark.parametrize("make", [lambda rng: rng.normal(500, 20, (720, 1080)).astype(np.float32),
                                  lambda rng: rng.poisson(30, (720, 1080)).astype(np.uint16),
                                  lambda rng: np.rint(rng.normal(50, 0.6, (720, 1080))).astype(np.uint8)])  # fmt: skip
def test_false_alarms_on_pure_noise(make):
    """About three in a million pixels: of eight images 19; more than 45 have a probability below 1e-6."""
    found = sum(len(celnav.detect(make(np.random.default_rng(seed)))) for seed in range(8))
    assert found <= 45


def test_completeness_is_that_of_a_matched_filter():
    """Half of the stars of 5.0 times the filter's noise are found, which 4.5 with noise of 1 puts at 69 %.

    The ideal filter's signal-to-noise is light / (2 sigma sqrt(pi) noise); the zero sum costs 4 %.
    """
    found_of = {}
    for level in (3.0, 5.0, 7.0):
        hits = total = 0
        for seed in range(4):
            rng = np.random.default_rng([seed, 3])
            truth = grid(rng)
            image = rng.normal(300, 10, SIZE)
            light = level * 10 * 2 * np.sqrt(np.pi) * np.sqrt(1 + 1 / 12)
            for place in truth:
                add_star(image, *place, light)
            distance, _ = nearest(celnav.detect(image.astype(np.float32)), truth)
            hits, total = hits + np.sum(distance < 1.5), total + len(truth)
        found_of[level] = hits / total
    for level, part in found_of.items():
        # Between the ideal filter and one that loses 12 %: sampling, zero sum, and the width that is guessed.
        assert norm.cdf(0.88 * level - 4.5) - 0.05 < part < norm.cdf(1.02 * level - 4.5) + 0.08, (level, part)


@pytest.mark.parametrize(("sigma_px", "read"), [(1.0, 3.0), (1.0, 12.0), (1.7, 3.0), (0.75, 3.0)])
def test_centroid_pulls_have_unit_variance(sigma_px, read):
    """Errors over standard deviations of stars that noise, not pixels, limits: variance 1 within 15 %, photon noise known.

    Some 1,500 numbers: the variance of normal ones is good to 4 %.
    """
    pulls, light_ratio = [], []
    for seed in range(5 if sigma_px < 1.5 else 10):
        rng = np.random.default_rng([seed, 7])
        truth = grid(rng, step=24 if sigma_px < 1.5 else 36)
        noise = np.sqrt(200 + read**2)
        light = 2 * np.sqrt(np.pi) * sigma_px * noise * 10 ** rng.uniform(0.85, 1.7, len(truth))  # 7 to 50 sigma
        image = np.full(SIZE, 200.0)
        for place, flux in zip(truth, light, strict=True):
            add_star(image, *place, flux, sigma_px)
        image = rng.poisson(image) + rng.normal(0, read, SIZE)
        found = celnav.detect(np.rint(image).astype(np.uint16), config=celnav.DetectionConfig(gain_e_per_dn=1.0))
        distance, row = nearest(found, truth)
        near = (distance < 2) & (found.sigma_px[row] > 0.06)
        pulls.append(((found.uv[row] - truth) / found.sigma_px[row, None])[near].ravel())
        light_ratio.append((found.flux[row] / light)[near])
    squares = np.concatenate(pulls) ** 2
    assert len(squares) > 1500
    assert 0.85 < squares.mean() < 1.15
    assert 0.93 < np.median(np.concatenate(light_ratio)) < 1.07
