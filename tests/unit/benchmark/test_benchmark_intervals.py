import math

import numpy as np
import pytest
from scipy import stats

from benchmark.stats.intervals import pooled_proportion, proportion, quantile, quantile_estimate, quantile_ranks, wilson


# Newcombe (1998), table I, method 3.
@pytest.mark.parametrize(
    ("successes", "trials", "low", "high"),
    [(81, 263, 0.2553, 0.3662), (15, 148, 0.0624, 0.1605), (0, 20, 0.0, 0.1611), (1, 29, 0.0061, 0.1718)],
)
def test_wilson_reproduces_newcombe(successes, trials, low, high):
    assert wilson(successes, trials) == pytest.approx((low, high), abs=5e-5)


def test_wilson_is_symmetric_and_reaches_the_ends():
    low, high = wilson(27, 27)
    assert high == 1.0
    assert wilson(0, 27) == pytest.approx((0.0, 1.0 - low), abs=1e-12)


def test_wilson_without_trials_is_undefined_and_nonsense_is_refused():
    assert all(math.isnan(end) for end in wilson(0, 0))
    with pytest.raises(ValueError, match="successes"):
        wilson(3, 2)


def test_proportion_counts_frames():
    estimate = proportion([True, False, True, True])
    assert (estimate.value, estimate.n) == (0.75, 4)
    assert (estimate.low, estimate.high) == wilson(3, 4)


# Campbell and Gardner, BMJ 296, 1454 (1988): ranks of the 95 % interval of a median.
@pytest.mark.parametrize(
    ("n", "ranks"), [(6, (1, 6)), (10, (2, 9)), (20, (6, 15)), (30, (10, 21)), (50, (18, 33)), (100, (40, 61))]
)
def test_median_ranks_reproduce_published_table(n, ranks):
    assert quantile_ranks(n, 0.5) == ranks


def test_five_values_bound_no_median():
    assert quantile_ranks(5, 0.5) == (0, 6)
    estimate = quantile_estimate([1.0, 2.0, 3.0, 4.0, 5.0], 0.5)
    assert (estimate.low, estimate.value, estimate.high) == (0.0, 3.0, math.inf)


@pytest.mark.parametrize("q", [0.5, 0.9, 0.95])
@pytest.mark.parametrize("n", [1, 7, 27, 200])
def test_ranks_are_the_tightest_with_equal_tails(n, q):
    low, high = quantile_ranks(n, q)
    below = sum(math.comb(n, k) * q**k * (1 - q) ** (n - k) for k in range(low))
    above = sum(math.comb(n, k) * q**k * (1 - q) ** (n - k) for k in range(high, n + 1))
    assert below <= 0.025 + 1e-12
    assert above <= 0.025 + 1e-12
    assert below + math.comb(n, low) * q**low * (1 - q) ** (n - low) > 0.025
    assert above + math.comb(n, high - 1) * q ** (high - 1) * (1 - q) ** (n - high + 1) > 0.025


@pytest.mark.parametrize("n", [1, 2, 3, 10, 27])
@pytest.mark.parametrize("q", [0.5, 0.9, 0.95])
def test_quantile_is_definition_2_of_hyndman_and_fan(n, q):
    values = np.random.default_rng(np.random.SeedSequence(5, spawn_key=(n,))).exponential(size=n)
    assert quantile(values, q) == pytest.approx(float(np.quantile(values, q, method="averaged_inverted_cdf")))


def test_infinite_values_make_infinite_quantiles_only_where_they_must():
    assert quantile([1.0, 2.0, math.inf], 0.5) == 2.0
    assert quantile([1.0, 2.0, math.inf, math.inf], 0.5) == math.inf
    assert quantile([math.inf], 0.5) == math.inf
    assert quantile([1.0] * 9 + [math.inf], 0.9) == math.inf
    assert quantile([1.0] * 10 + [math.inf], 0.9) == 1.0


def test_quantile_of_nothing_or_of_nan_is_refused():
    with pytest.raises(ValueError, match="at least one"):
        quantile([], 0.5)
    with pytest.raises(ValueError, match="NaN"):
        quantile([math.nan], 0.5)


def test_pooled_proportion_by_hand():
    # p = 12/20; residuals k - p m = 1, -1, 0; variance = 3/2 * 2 / 400 = 0.0075; n_eff = 0.24 / 0.0075 = 32 > 20.
    estimate = pooled_proportion([7, 2, 3], [10, 5, 5])
    scale = (stats.norm.ppf(0.975) / stats.t.ppf(0.975, 2)) ** 2
    assert estimate.value == 0.6
    assert (estimate.low, estimate.high) == pytest.approx(wilson(12 * scale, 20 * scale))


def test_pooled_proportion_widens_when_frames_fail_as_a_whole():
    together = pooled_proportion([40] * 20 + [0] * 5, [40] * 25)
    apart = pooled_proportion([32] * 25, [40] * 25)
    assert together.value == apart.value == 0.8
    # Whole frames carry 24 degrees of freedom, not 1000 stars: the interval is that of about 24 trials.
    assert together.high - together.low == pytest.approx(np.subtract(*reversed(wilson(0.8 * 24, 24))), rel=0.1)
    assert apart.high - apart.low < 0.06


def test_pooled_proportion_at_the_ends_counts_frames():
    assert pooled_proportion([30, 40, 50], [30, 40, 50]).low == wilson(3, 3)[0]
    assert pooled_proportion([0, 0], [30, 40]).high == wilson(0, 2)[1]


def test_pooled_proportion_of_few_frames():
    assert math.isnan(pooled_proportion([0, 0], [0, 0]).value)
    one = pooled_proportion([5, 0], [10, 0])
    assert (one.value, one.low, one.high, one.n) == (0.5, 0.0, 1.0, 1)
