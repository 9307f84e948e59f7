"""Stars of a photograph over those of its twin, in bins: answers that are known, and intervals that hold them."""

import itertools

import numpy as np
import pytest
from scipy import stats

from benchmark.photographed.star_light import star_light
from benchmark.studies.realism.star_tables import star_tables
from benchmark.twin.star_bins import (
    ANGLE_EDGES_DEG,
    LEAST_STARS,
    MAGNITUDE_EDGES,
    RESAMPLES,
    snr_by_magnitude,
    width_by_angle,
)

FALSE_ALARM = 1e-3


def catalogue(rng: np.random.Generator, n: int = 600) -> tuple[np.ndarray, np.ndarray]:
    """Magnitudes as numerous as in the sky, and the SNR that they have."""
    v_mag = np.clip(6.0 + np.log10(rng.random(n)) / 0.5, 0.0, 6.0 - 1e-6)
    return v_mag, 3000.0 * 10 ** (-0.4 * v_mag)


def test_stars_that_are_a_fifth_fainter_on_the_twin_are_found_so_in_every_bin() -> None:
    """z-test of all bins of 40 pictures: the stated standard deviations are those of the ratios, and 1.25 is their mean."""
    pulls = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        v_mag, snr = catalogue(rng)
        # Scatter of the stars that photograph and twin do not share: catalogue, pixels, air.
        real, twin = (factor * snr * rng.normal(1.0, 0.1, len(snr)) for factor in (1.0, 0.8))
        found = snr_by_magnitude(real, twin, v_mag)
        assert [(one.low, one.high) for one in found] == list(itertools.pairwise(MAGNITUDE_EDGES))[-len(found) :]
        pulls += [(one.ratio - 1.25) / one.sigma for one in found if one.stars >= 30]
    n = len(pulls)
    assert n >= 80
    assert abs(np.mean(pulls)) * np.sqrt(n) < stats.norm.isf(FALSE_ALARM / 2)
    # A bootstrap of medians is within 15 % of the scatter for 30 stars and more.
    low, high = np.sqrt(stats.chi2.ppf([FALSE_ALARM / 2, 1 - FALSE_ALARM / 2], n) / n)
    assert 0.85 * low < np.sqrt(np.mean(np.square(pulls))) < 1.15 * high


def test_widths_grow_towards_the_edge_as_they_were_drawn() -> None:
    rng = np.random.default_rng(3)
    axis_deg = rng.uniform(0, 90, 400)
    twin = np.full(400, 0.9)
    real = twin * (1 + 0.3 * axis_deg / 90) * rng.normal(1, 0.02, 400)
    snr = np.full(400, 50.0)
    found = width_by_angle((real, twin), (snr, snr), axis_deg)
    assert [one.low for one in found] == list(ANGLE_EDGES_DEG[:-1])
    for one in found:
        middle = 1 + 0.3 * (one.low + one.high) / 2 / 90
        # Five standard deviations, and what the slope within a bin moves the median.
        assert one.ratio == pytest.approx(middle, abs=5 * one.sigma + 0.005)
        assert one.twin == pytest.approx(0.9)
    assert found[-1].ratio > found[0].ratio + 0.15


def test_faint_and_unmeasured_stars_do_not_count_and_small_bins_are_left_out() -> None:
    snr = np.array([50.0] * LEAST_STARS + [5.0] * 20 + [np.nan] * 20)
    axis_deg = np.full(len(snr), 10.0)
    width = np.linspace(0.8, 1.0, len(snr))
    (one,) = width_by_angle((width, width), (snr, snr), axis_deg)
    assert (one.stars, one.ratio, one.sigma) == (LEAST_STARS, 1.0, 0.0)
    snr[0] = np.nan
    assert width_by_angle((width, width), (snr, snr), axis_deg) == ()
    assert snr_by_magnitude(np.array([]), np.array([]), np.array([])) == ()
    assert RESAMPLES >= 200


@pytest.mark.parametrize("sigma_px", [0.7, 1.0])
def test_the_width_of_a_gaussian_star_is_its_standard_deviation_within_the_aperture(sigma_px) -> None:
    """Truncated at 3.5 px: s^2 (1 - q e^-q / (1 - e^-q)) with q = 3.5^2 / 2 s^2; pixels add 1/12 px^2 if integrated."""
    v, u = np.mgrid[0:64, 0:64]
    image = 500.0 + 1e5 * np.exp(-((u - 31.7) ** 2 + (v - 32.2) ** 2) / (2 * sigma_px**2))
    found = star_light(image, np.array([[31.7, 32.2], [2.0, 2.0]]))
    q = 3.5**2 / (2 * sigma_px**2)
    expected = sigma_px * np.sqrt(1 - q * np.exp(-q) / (1 - np.exp(-q)))
    assert found.width_px[0] == pytest.approx(expected, rel=0.01)
    assert np.isnan(found.width_px[1])


def test_the_tables_have_a_dash_where_a_bin_has_too_few_stars() -> None:
    one = {"low": 3.0, "high": 4.0, "stars": 12, "real": 55.0, "twin": 50.0, "ratio": 1.1, "sigma": 0.04}
    width = {"low": 0.0, "high": 15.0, "stars": 9, "real": 0.83, "twin": 0.8, "ratio": 1.0375, "sigma": 0.02}
    by_magnitude, by_angle = star_tables(
        [{"photograph": "005", "snr_by_magnitude": [one], "width_by_angle_px": [width]}]
    )
    assert by_magnitude.rows == (("005", "-", "-", "1.10 ± 0.04 (12)", "-", "-"),)
    assert by_angle.rows[0][:3] == ("005", "1.04 ± 0.02 (0.83 px, 9)", "-")
