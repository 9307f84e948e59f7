"""Do 95 % intervals cover 95 %? By simulation, with a z-test whose false-alarm rate is stated.

Every test draws from a fixed seed; its false-alarm rate is the chance that a correct program would fail with a seed
drawn at random.
"""

import math

import numpy as np
import pytest
from scipy import stats

from benchmark.stats.intervals import pooled_proportion, quantile_estimate, quantile_ranks, wilson

FALSE_ALARM = 1e-4
SEED = 271828


def rng_for(*key: int) -> np.random.Generator:
    return np.random.default_rng(np.random.SeedSequence(SEED, spawn_key=key))


def z_of(hits: int, trials: int, coverage: float) -> float:
    return (hits / trials - coverage) / math.sqrt(coverage * (1.0 - coverage) / trials)


@pytest.mark.parametrize(("n", "q"), [(27, 0.5), (27, 0.9), (200, 0.5), (200, 0.9)])
def test_quantile_interval_covers_as_the_binomial_says(n, q):
    low, high = quantile_ranks(n, q)
    expected = stats.binom.cdf(high - 1, n, q) - stats.binom.cdf(low - 1, n, q)
    assert expected >= 0.95
    truth = stats.lognorm.ppf(q, 1.5)
    samples = stats.lognorm.rvs(1.5, size=(4000, n), random_state=rng_for(n, int(100 * q)))
    estimates = [quantile_estimate(sample, q) for sample in samples]
    hits = sum(estimate.low <= truth <= estimate.high for estimate in estimates)
    assert abs(z_of(hits, len(samples), expected)) < stats.norm.isf(FALSE_ALARM / 2)


@pytest.mark.parametrize("refused", [0.2, 0.45, 0.7])
def test_quantile_interval_holds_with_refused_frames(refused):
    # A share of the errors is infinite; so is the true median from one half on.
    rng = rng_for(2, int(100 * refused))
    truth = stats.lognorm.ppf(0.5 / (1.0 - refused), 1.5) if refused < 0.5 else math.inf
    errors = stats.lognorm.rvs(1.5, size=(4000, 27), random_state=rng)
    errors[rng.uniform(size=errors.shape) < refused] = math.inf
    estimates = [quantile_estimate(row, 0.5) for row in errors]
    hits = sum(estimate.low <= truth <= estimate.high for estimate in estimates)
    # Ties at infinity can only add to the coverage, so the test is one-sided.
    assert z_of(hits, len(errors), 0.95) > -stats.norm.isf(FALSE_ALARM)


@pytest.mark.parametrize(("n", "p"), [(27, 0.5), (27, 0.9), (200, 0.97)])
def test_wilson_interval_covers_as_enumerated(n, p):
    counts = np.arange(n + 1)
    covered = np.array([low <= p <= high for low, high in (wilson(k, n) for k in counts)])
    expected = float(stats.binom.pmf(counts, n, p)[covered].sum())
    draws = rng_for(3, n, int(100 * p)).binomial(n, p, 4000)
    assert abs(z_of(int(covered[draws].sum()), len(draws), expected)) < stats.norm.isf(FALSE_ALARM / 2)
    assert 0.93 <= expected <= 0.99


@pytest.mark.parametrize("n", [3, 27, 200])
def test_wilson_interval_covers_95_percent_on_average(n):
    # Averaged over p from 0 to 1, by enumeration: Newcombe (1998), table II, finds 0.952 over his range of n and p.
    counts = np.arange(n + 1)
    ends = np.array([wilson(k, n) for k in counts])
    p = (np.arange(2000) + 0.5) / 2000
    covered = (ends[:, :1] <= p) & (p <= ends[:, 1:])
    mean = float((stats.binom.pmf(counts[:, None], n, p) * covered).sum(axis=0).mean())
    assert mean == pytest.approx(0.952, abs=0.006)


def pooled_coverage(n, p, rho, trials):
    """Share of intervals that hold p, for frames of 20 to 60 stars with intra-frame correlation rho."""
    rng = rng_for(4, n, int(100 * p), int(100 * rho))
    a, b = p * (1.0 - rho) / rho, (1.0 - p) * (1.0 - rho) / rho
    stars = rng.integers(20, 61, (trials, n))
    correct = rng.binomial(stars, rng.beta(a, b, (trials, n)))
    estimates = [pooled_proportion(k, m) for k, m in zip(correct, stars, strict=True)]
    return sum(estimate.low <= p <= estimate.high for estimate in estimates)


@pytest.mark.parametrize(("n", "p", "rho"), [(27, 0.5, 0.1), (27, 0.8, 0.2), (100, 0.8, 0.2), (100, 0.9, 0.2)])
def test_pooled_interval_covers_when_stars_of_a_frame_fail_together(n, p, rho):
    # The linearised variance is an approximation; docs/benchmark.md promises 93 to 97 % in this range.
    hits = pooled_coverage(n, p, rho, 2000)
    limit = stats.norm.isf(FALSE_ALARM / 2)
    assert z_of(hits, 2000, 0.93) > -limit
    assert z_of(hits, 2000, 0.97) < limit


def test_the_naive_interval_would_not_cover():
    # The reason for the effective sample size: stars taken as independent cover far less than they claim.
    rng = rng_for(5)
    stars = rng.integers(20, 61, (1000, 27))
    correct = rng.binomial(stars, rng.beta(0.8 * 4, 0.2 * 4, (1000, 27)))
    ends = [wilson(k.sum(), m.sum()) for k, m in zip(correct, stars, strict=True)]
    assert sum(low <= 0.8 <= high for low, high in ends) < 700


def test_pooled_interval_falls_short_where_the_documentation_says_so():
    # Rare failures of whole frames (p = 0.95, correlation 0.5, 27 frames): docs/benchmark.md says about 86 %.
    hits = pooled_coverage(27, 0.95, 0.5, 2000)
    assert abs(hits / 2000 - 0.86) < 0.03
