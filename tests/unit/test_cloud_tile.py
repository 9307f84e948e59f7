"""The transform of a cloud's tile in single precision against the definition in double precision."""

import numpy as np
import pytest
from scipy.stats import norm

from generator.sky.clouds import COARSE_CELL_KM, FINE_CELL_KM, SPLIT_PER_KM, Texture, cloud_pattern, gaussian_tile

TEXTURES = [Texture(), Texture(stretch=3.0, wind_azimuth_deg=35.0), Texture(cell_km=1.5)]


def defined(cells, cell_km, slope, outer_km, band, random, texture):
    white = np.fft.fft2(random.standard_normal((cells, cells)))
    waves = np.fft.fftfreq(cells, cell_km)
    kx, ky = waves[None, :], waves[:, None]
    k = np.hypot(kx, ky)
    power = texture.power(kx, ky, slope, outer_km) * ((k >= band[0]) & (k < band[1])) / cell_km**2
    power[0, 0] = 0
    return np.fft.ifft2(white * np.sqrt(power)).real, power.mean()


@pytest.mark.parametrize("texture", TEXTURES)
def test_a_tile_is_its_definition_to_rounding(texture) -> None:
    """The field within 1e-5 of its standard deviation, its variance within 1e-9."""
    arguments = 256, COARSE_CELL_KM, -8 / 3, 5.0, (0.0, SPLIT_PER_KM)
    field, variance = gaussian_tile(*arguments, np.random.default_rng(3), texture)
    wanted, wanted_variance = defined(*arguments, np.random.default_rng(3), texture)
    np.testing.assert_allclose(field, wanted, atol=1e-5 * wanted.std())
    assert variance == pytest.approx(wanted_variance, rel=1e-9)


def test_a_pattern_s_scale_is_that_of_double_precision() -> None:
    """Threshold and mean depth by SciPy's normal distribution on the pattern's own field, within 1e-5."""
    texture = TEXTURES[2]
    pattern = cloud_pattern(0.7, 0.4, -8 / 3, 5.0, np.random.default_rng(5), texture)
    random = np.random.default_rng(5)
    gaussian_tile(1024, COARSE_CELL_KM, -8 / 3, 5.0, (0.0, SPLIT_PER_KM), random, texture)
    _, variance = gaussian_tile(512, FINE_CELL_KM, -8 / 3, 5.0, (SPLIT_PER_KM, 0.5 / FINE_CELL_KM), random, texture)
    sigma = np.sqrt(variance)
    coarse = pattern.coarse.astype(np.float64)
    assert pattern.threshold == pytest.approx(np.hypot(coarse.std(), sigma) * norm.ppf(0.6), rel=1e-5)
    above = (coarse - pattern.threshold) / sigma
    mean = np.mean(sigma * (norm.pdf(above) + above * norm.cdf(above)))
    assert pattern.scale * mean == pytest.approx(0.7, rel=1e-5)
