"""Allan deviation of simulated inertial errors against IEEE Std 952's formulas, at stated false alarms."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from generator.imu.noise import ErrorModel, drifting_bias, flicker, white_noise
from generator.imu.table import force_errors, gyro_errors
from generator.scenario.sequences.path_spec import AccelerometerSpec, GyroSpec
from generator.seeds import random_stream

FALSE_ALARM = 1e-4
NOTHING = ErrorModel(np.zeros(3), 0.0, 0.0, 0.0, 0.0)


def streams(name: str) -> np.random.Generator:
    return random_stream(952, name, 0)


def allan_variance(rate: np.ndarray, samples: int) -> tuple[float, int]:
    """Allan variance over clusters of `samples` readings without overlap, and its number of differences."""
    whole = len(rate) // samples * samples
    means = rate[:whole].reshape(-1, samples, rate.shape[1]).mean(axis=1)
    half_squares = np.diff(means, axis=0) ** 2 / 2
    return float(half_squares.mean()), half_squares.size


def is_as_expected(found: float, expected: float, independent: float) -> bool:
    """Whether a variance agrees with its expectation: chi squared of `independent` degrees of freedom, two-sided."""
    quantile = stats.chi2.cdf(found / expected * independent, independent)
    return bool(FALSE_ALARM / 2 < quantile < 1 - FALSE_ALARM / 2)


def test_angle_random_walk_is_the_allan_deviation_at_one_second() -> None:
    model = gyro_errors(GyroSpec(angle_random_walk_deg_sqrt_h=0.3))
    rate = white_noise(model, 400_000, 0.01, streams)
    expected = np.radians(0.3) / 60  # deg per square root of an hour is a sixtieth of that per square root of a second
    for tau_s in (0.1, 1.0, 10.0):
        found, count = allan_variance(rate, round(tau_s / 0.01))
        # Differences of neighbours share a mean: the variance of Allan's estimate is 3/2 of that of independent ones.
        assert is_as_expected(found, expected**2 / tau_s, count / 1.5), tau_s


def test_velocity_random_walk_is_the_allan_deviation_at_one_second() -> None:
    model = force_errors(AccelerometerSpec(velocity_random_walk_m_s_sqrt_h=0.06))
    found, count = allan_variance(white_noise(model, 400_000, 0.01, streams), 100)
    assert is_as_expected(found, 0.001**2, count / 1.5)


def test_bias_instability_is_a_floor_of_0_664() -> None:
    """sqrt(2 ln 2 / pi) at all times between the first samples and the length of the record."""
    noise = flicker(2**19, streams("flicker"))[2**12 :]  # past the start
    for samples in (16, 64, 256, 1024):
        found, count = allan_variance(noise, samples)
        # Of flicker noise, neighbouring differences are anticorrelated by less than white noise's.
        assert is_as_expected(found, 2 * np.log(2) / np.pi, count / 2), samples
        assert np.sqrt(found) == pytest.approx(0.664, rel=0.1)


def test_bias_instability_has_its_unit() -> None:
    model = gyro_errors(GyroSpec(bias_instability_deg_h=10.0))
    bias = drifting_bias(model, 2**17, 0.01, streams)[2**12 :]
    assert np.sqrt(allan_variance(bias, 200)[0]) == pytest.approx(0.664 * np.radians(10) / 3600, rel=0.15)
    model = force_errors(AccelerometerSpec(bias_instability_ug=50.0))
    bias = drifting_bias(model, 2**17, 0.01, streams)[2**12 :]
    assert np.sqrt(allan_variance(bias, 200)[0]) == pytest.approx(0.664 * 50e-6 * 9.80665, rel=0.15)


def test_rate_random_walk_grows_with_the_root_of_time() -> None:
    model = gyro_errors(GyroSpec(rate_random_walk_deg_h_sqrt_h=60.0))
    expected = np.radians(60) / 3600 / 60  # K, rad/s per square root of a second
    bias = drifting_bias(model, 400_000, 0.01, streams)
    for tau_s in (1.0, 10.0):
        found, count = allan_variance(bias, round(tau_s / 0.01))
        assert is_as_expected(found, expected**2 * tau_s / 3, count / 2), tau_s


def test_constant_bias_is_drawn_once() -> None:
    model = gyro_errors(GyroSpec(bias_deg_h=[3600.0, 0.0, -3600.0], bias_sigma_deg_h=0.0))
    assert drifting_bias(model, 5, 0.01, streams) == pytest.approx(np.tile(np.radians([1, 0, -1]), (5, 1)))
    spread = ErrorModel(np.zeros(3), 2.0, 0.0, 0.0, 0.0)
    drawn = np.array(
        [drifting_bias(spread, 2, 1.0, lambda name, i=i: random_stream(i, name, 0))[0] for i in range(1000)]
    )
    assert is_as_expected(float(np.mean(drawn**2)), 4.0, 3000)


def test_perfect_unit_has_no_error() -> None:
    assert not drifting_bias(NOTHING, 10, 0.01, streams).any()
    assert not white_noise(NOTHING, 10, 0.01, streams).any()
