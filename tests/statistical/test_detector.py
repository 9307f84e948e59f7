"""The detector's noise: moments by z-tests, saturation, quantisation. False-alarm rate of each z-test: 1e-4."""

import numpy as np
import pytest
from scipy import stats

from generator.scenario.model import SensorSpec
from generator.seeds import random_stream
from generator.sensor.detector import expose, matched_filter_snr, saturation_e

LIMIT = stats.norm.isf(0.5e-4)
SHAPE = (400, 500)


def streams(name: str) -> np.random.Generator:
    return random_stream(3, name, 0)


def read_out(level_e: float, exposure_s: float = 1.0, **sensor):
    spec = SensorSpec(**({"gain_e_per_dn": 0.25, "bits": 16, "black_level_dn": 400, "full_well_e": 1e5} | sensor))
    return spec, expose(np.full(SHAPE, level_e, np.float32), exposure_s, spec, streams).astype(np.float64)


@pytest.mark.parametrize("level_e", [0.0, 3.0, 250.0, 4000.0])
def test_mean_and_variance_are_emva_1288_s(level_e) -> None:
    """Mean K (mu + dark) + black, variance K^2 (mu + dark + read^2) + 1/12 DN^2 (EMVA 1288 release 4.0)."""
    spec, dn = read_out(level_e, exposure_s=2.0, read_noise_e=3.0, dark_current_e_s=1.5)
    gain = 1 / spec.gain_e_per_dn
    mean = gain * (level_e + 3.0) + spec.black_level_dn
    variance = gain**2 * (level_e + 3.0 + 9.0) + 1 / 12
    n = dn.size
    assert abs(dn.mean() - mean) / np.sqrt(variance / n) < LIMIT
    kurtosis_excess = (level_e + 3.0) * gain**4 / variance**2
    assert abs(dn.var(ddof=1) - variance) / (variance * np.sqrt((2 + kurtosis_excess) / n)) < LIMIT


def test_photon_transfer_gives_the_gain_back() -> None:
    """Slope of variance over mean, by weighted least squares, is 1/gain within 4 standard errors."""
    levels = np.array([200.0, 500, 1000, 2000, 4000])
    means, variances = [], []
    for level in levels:
        _, dn = read_out(level, read_noise_e=2.0, dark_current_e_s=0.0)
        means.append(dn.mean())
        variances.append(dn.var(ddof=1))
    errors = np.array(variances) * np.sqrt(2 / dn.size)
    slope, covariance = np.polyfit(means, variances, 1, w=1 / errors, cov="unscaled")
    assert abs(slope[0] - 4.0) < 4 * np.sqrt(covariance[0, 0])


def test_pixels_are_independent() -> None:
    _, dn = read_out(100.0)
    for shift in ((0, 1), (1, 0)):
        correlation = np.corrcoef(dn.ravel(), np.roll(dn, shift, (0, 1)).ravel())[0, 1]
        assert abs(correlation) * np.sqrt(dn.size) < LIMIT


def test_saturates_at_full_well_and_at_the_largest_dn() -> None:
    _, full = read_out(5e4, full_well_e=1000.0, read_noise_e=0.0)
    assert np.unique(full).tolist() == [400 + 4000]
    spec, clipped = read_out(5e4, bits=12, full_well_e=1e6)
    assert np.unique(clipped).tolist() == [4095]
    assert saturation_e(spec, 1.0) == (4095 - 400) * 0.25


def test_without_noise_the_expected_signal_is_quantised() -> None:
    spec, dn = read_out(10.3, noise=False, dark_current_e_s=0.0)
    assert np.unique(dn).tolist() == [np.rint(10.3 * 4 + 400)]
    assert spec.noise is False


def test_matched_filter_snr_against_simulation() -> None:
    """Spread of matched-filter fluxes over 4,000 noisy stars: the stated SNR within 5 standard errors."""
    sensor = SensorSpec(read_noise_e=3.0, dark_current_e_s=0.0, gain_e_per_dn=0.5, bits=16, full_well_e=1e5)
    sigma, sky, star = 1.5, 60.0, 400.0
    axis = np.arange(-12, 13)
    edges = stats.norm.cdf(np.append(axis - 0.5, 12.5) / sigma)
    psf = np.outer(np.diff(edges), np.diff(edges))
    stamps = np.broadcast_to(star * psf + sky, (4000, 25, 25)).astype(np.float32)
    dn = expose(stamps, 1.0, sensor, streams).astype(np.float64)
    signal = (dn - sensor.black_level_dn) * sensor.gain_e_per_dn - sky
    flux = (signal * psf).sum(axis=(1, 2)) / (psf**2).sum()
    # The stated noise takes the star's own shot noise as that of its whole light; under a fixed filter it is less.
    own = (psf**3).sum() / (psf**2).sum() ** 2
    background = (star / matched_filter_snr(np.array([star]), np.array([sky]), sigma, 1.0, sensor)[0]) ** 2 - star
    wanted = np.sqrt(background + star * own)
    assert flux.mean() == pytest.approx(star, abs=5 * wanted / np.sqrt(4000))
    assert flux.std(ddof=1) == pytest.approx(wanted, rel=5 / np.sqrt(2 * 4000) + 0.01)
