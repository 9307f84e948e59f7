"""The choice of a cloud's pattern by the stars that it dims, and the slope of the veil of twins."""

import numpy as np
import pytest
from small_scenes import small_scenario

from benchmark.twin.cloud_draw import SNR_IN_ORDER, choose_draw, cloud_of, heights_of, in_order
from benchmark.twin.weather import VEIL


def field_of(draw: int, depth: float = 1.0, cover: float = 1.0):
    given = VEIL | {"mean_optical_depth": depth, "coverage": cover, "draw": draw}
    return cloud_of(small_scenario(sky__clouds=given))


def stars(number: int) -> np.ndarray:
    """Directions, even over the sky above 15 deg."""
    rng = np.random.default_rng(8)
    up, turn = rng.uniform(np.sin(np.radians(15)), 1, number), rng.uniform(0, 2 * np.pi, number)
    level = np.sqrt(1 - up**2)
    return np.column_stack((level * np.sin(turn), level * np.cos(turn), up))


def test_the_pattern_that_dims_the_stars_is_found() -> None:
    """The third of four, by 300 stars of an SNR of 2 to 100 without cloud and the noise of the photograph; its part of stars
    above an SNR of 4 within 15 %."""
    enu, draw, rng = stars(300), 2, np.random.default_rng(9)
    clear = np.exp(rng.uniform(np.log(2), np.log(100), len(enu)))
    snr = clear * field_of(draw, 1.2, 0.8).point_transmission(enu) * rng.lognormal(0, 0.1, len(enu))
    photographed = snr + rng.standard_normal(len(enu))
    found = choose_draw(enu, photographed, clear, field_of, range(4))
    assert found.draw == draw
    assert found.mean_depth == pytest.approx(1.2, rel=0.5)
    made = clear * field_of(draw, found.mean_depth, found.cover).point_transmission(enu)
    assert (made > SNR_IN_ORDER).sum() == pytest.approx((photographed > SNR_IN_ORDER).sum(), rel=0.15)


def test_in_order_stars_that_are_not_seen_are_alike() -> None:
    assert in_order(np.array([9.0, -3.0, 5.0, 1.0])).tolist() == [SNR_IN_ORDER, SNR_IN_ORDER, 5.0, 9.0]


def test_draws_are_other_patterns_and_the_first_is_the_scenario_s_own() -> None:
    given = VEIL | {"mean_optical_depth": 1.0, "coverage": 1.0}
    own = cloud_of(small_scenario(sky__clouds=given)).pattern
    assert (field_of(0).pattern.coarse == own.coarse).all()
    assert abs(np.corrcoef(field_of(1).pattern.fine.ravel(), own.fine.ravel())[0, 1]) < 0.02


def test_heights_give_back_the_depth() -> None:
    enu = stars(50)
    field = field_of(1, 0.7, 0.9)
    heights, slant = heights_of(field_of(1), enu)
    sigma = np.hypot(field.pattern.coarse.std(), field.pattern.fine.std())
    depth = field.pattern.scale * np.maximum(heights * sigma - field.pattern.threshold, 0) * slant
    np.testing.assert_allclose(depth, [still.slant_depth(enu) for still in field.moments], rtol=1e-4, atol=1e-4)


def test_columns_through_turbulence_have_the_veil_s_slope() -> None:
    """Obukhov and Corrsin: power of a scalar in three dimensions k^(-5/3 - 2). A cube of it summed along one axis, mean
    over 20: the slope of its plane's power within 0.15."""
    n, rng = 48, np.random.default_rng(10)
    waves = np.fft.fftfreq(n) * n
    k = np.sqrt(waves[:, None, None] ** 2 + waves[:, None] ** 2 + waves**2)
    amplitude = np.where(k > 0, k, 1.0) ** (-11 / 6) * (k > 0)
    power = np.zeros((n, n))
    for _ in range(20):
        cube = np.fft.ifftn(np.fft.fftn(rng.standard_normal((n, n, n))) * amplitude).real
        power += np.abs(np.fft.fft2(cube.sum(axis=0))) ** 2
    flat = np.hypot(waves[:, None], waves)
    part = (flat >= 3) & (flat <= 15)
    slope = np.polyfit(np.log(flat[part]), np.log(power[part]), 1)[0]
    assert slope == pytest.approx(VEIL["spectral_slope"], abs=0.15)
