import numpy as np
import pytest

import celnav


def star_field(rng=None, n=40, sigma_px=0.9, peak=(200, 3000)):
    """Pixel-integrated Gaussians on a vignetted slope; returns the image and the truth, (n, 2), brightest first."""
    from scipy.special import erf

    place = np.random.default_rng(1)
    v, u = np.mgrid[0:240, 0:320]
    image = 100 + 0.2 * u + 0.1 * v - 0.001 * ((u - 160) ** 2 + (v - 120) ** 2)
    cells = place.permutation(np.stack(np.meshgrid(np.arange(15), np.arange(11)), -1).reshape(-1, 2))[:n]
    truth = cells * 20 + 15 + place.uniform(-3, 3, (n, 2))
    light = np.geomspace(peak[1], peak[0], n) * 2 * np.pi * sigma_px**2

    def part(x, centre):
        return 0.5 * (erf((x - centre + 0.5) / sigma_px / 2**0.5) - erf((x - centre - 0.5) / sigma_px / 2**0.5))

    for (x, y), flux in zip(truth, light, strict=True):
        image += flux * np.outer(part(v[:, 0], y), part(u[0], x))
    if rng is not None:
        image = rng.poisson(image) + rng.normal(0, 3, image.shape)
    return image, truth, light


def test_noise_free_stars_on_a_slope():
    image, truth, light = star_field()
    found = celnav.detect(image)
    assert len(found) == len(truth)
    np.testing.assert_allclose(found.uv, truth, atol=0.02)
    # The window is wider than the star: a Gaussian of 0.9 px, broadened by the pixel, gives 1.06 of its light.
    np.testing.assert_allclose(found.flux, 2 * light / (1 + 0.9**2 + 1 / 12), rtol=0.02)
    whole = celnav.detect(image, config=celnav.DetectionConfig(window_sigma_px=None))
    np.testing.assert_allclose(whole.flux, light, rtol=0.06)
    assert (np.diff(found.flux) <= 0).all()


@pytest.mark.parametrize("dtype", [np.uint16, np.uint8, np.float32])
def test_noisy_stars(dtype):
    image, truth, _ = star_field(np.random.default_rng(2))
    scale = 255 / image.max() if dtype is np.uint8 else 1.0
    found = celnav.detect(np.clip(np.rint(image * scale), 0, None).astype(dtype))
    near = np.linalg.norm(found.uv[:, None] - truth[None], axis=2)
    assert (near.min(axis=0) < 0.5).sum() >= 36
    assert (near.min(axis=1) > 1.5).sum() == 0


def test_pure_noise_gives_next_to_nothing():
    image = np.random.default_rng(3).normal(500, 20, (720, 1080)).astype(np.float32)
    assert len(celnav.detect(image)) <= 3


def test_flat_and_black_images_are_empty():
    assert len(celnav.detect(np.zeros((60, 80), dtype=np.uint8))) == 0
    assert len(celnav.detect(np.full((60, 80), 7.5))) == 0


def test_mask_area_and_hot_pixels():
    image, truth, _ = star_field()
    image[100, 100] += 5000  # one pixel is not a star
    image[200:240, 280:320] += 4000  # nor is the Moon
    mask = np.zeros(image.shape, dtype=bool)
    x, y = np.rint(truth[0]).astype(int)
    mask[y - 8 : y + 9, x - 8 : x + 9] = True
    found = celnav.detect(image, mask, celnav.DetectionConfig(window_sigma_px=None))
    assert np.linalg.norm(found.uv - truth[0], axis=1).min() > 5
    assert np.linalg.norm(found.uv - [100, 100], axis=1).min() > 3
    assert not ((found.uv[:, 0] > 280) & (found.uv[:, 1] > 200)).any()
    assert len(celnav.detect(image, np.ones(image.shape, dtype=bool))) == 0


def test_colour_counts_as_grey():
    image, _, _ = star_field()
    colour = np.repeat(image[:, :, None], 3, axis=2)
    np.testing.assert_allclose(celnav.detect(colour).uv, celnav.detect(image).uv, atol=1e-2)


def test_unweighted_centroid_is_the_middle_of_the_component():
    image = np.zeros((40, 40))
    image[10, 10:14] = [100, 100, 100, 900]
    config = celnav.DetectionConfig(weighted=False, window_sigma_px=None)
    np.testing.assert_allclose(celnav.detect(image, config=config).uv, [[11.5, 10.0]])
    config = celnav.DetectionConfig(window_sigma_px=None)
    np.testing.assert_allclose(celnav.detect(image, config=config).uv, [[12.5, 10.0]])


def test_a_trail_is_no_star():
    image, truth, _ = star_field(np.random.default_rng(2))
    u = np.arange(40, 280)
    v = 60.5 + 0.4 * (u - 40)
    for shift in (-1, 0, 1):
        image[np.rint(v).astype(int) + shift, u] += 600
    found = celnav.detect(image)
    kept = celnav.detect(image, config=celnav.DetectionConfig(trail_length=None))
    assert len(kept) > len(found)
    from_line = np.abs(found.uv[:, 1] - (60.5 + 0.4 * (found.uv[:, 0] - 40)))
    is_star = np.linalg.norm(found.uv[:, None] - truth, axis=2).min(axis=1) < 1
    assert not ((from_line < 2) & ~is_star).any()
    assert is_star.mean() > 0.95


def test_centroid_sigmas_are_those_of_the_errors():
    """Normalised errors of faint stars on a bright sky have unit variance (900 numbers: 5 sigma are 12 %)."""
    errors = []
    for seed in range(12):
        image, truth, _ = star_field(np.random.default_rng(seed), peak=(120, 200))
        found = celnav.detect(image)
        distance = np.linalg.norm(found.uv[:, None] - truth, axis=2)
        match = distance.argmin(axis=1)
        near = distance.min(axis=1) < 1.5
        errors.append(((found.uv - truth[match]) / found.sigma_px[:, None])[near])
    squares = np.concatenate(errors).ravel() ** 2
    assert len(squares) > 700
    assert 0.7 < squares.mean() < 1.4
