"""Intervals of means of which a few frames have the most, and of shares over conditions that a task fixes, by simulation.

Every test draws from a fixed seed. `FALSE_ALARM` is the chance that a program at the edge of what a bound asks fails it with
a seed drawn at random.
"""

import math

import numpy as np
import pytest
from scipy import stats

from benchmark.stats.clustered import Resamples, mean_estimate, proportion_estimate
from benchmark.stats.comparison import difference_estimate
from benchmark.stats.skewed_means import FEWEST_CLUSTERS, skewed_mean_estimate
from benchmark.stats.within_conditions import share_within_conditions

FALSE_ALARM = 1e-4
LIMIT = stats.norm.isf(FALSE_ALARM)
SEED = 271828
TRIALS = 400
RESAMPLES = 600


def rng_for(*key):
    return np.random.default_rng(np.random.SeedSequence(SEED, spawn_key=tuple(int(k) for k in key)))


def assert_covers(share, trials, lowest, highest=1.0):
    """A share of intervals that is not below what is asked by more than chance, nor above."""
    assert (share - lowest) / math.sqrt(lowest * (1 - lowest) / trials) > -LIMIT, share
    if highest < 1.0:
        assert (share - highest) / math.sqrt(highest * (1 - highest) / trials) < LIMIT, share


def covered(estimates, truth):
    return float(np.mean([one.low <= truth <= one.high for one in estimates]))


# Skewness as of covariances that are honest (chi-squared with two degrees of freedom), and too small by a number that varies.
@pytest.mark.parametrize(
    ("spread", "n", "lowest"), [(0.0, 40, 0.93), (1.0, 60, 0.90), (1.5, 60, 0.86), (1.5, 160, 0.87)]
)
def test_the_mean_of_skewed_numbers(spread, n, lowest):
    rng, truth = rng_for(1, 10 * spread, n), 2.0 * math.exp(spread**2 / 2)
    found, percentile = [], []
    for _ in range(TRIALS):
        drawn = Resamples.of(np.arange(n), RESAMPLES, int(rng.integers(2**31)))
        values = rng.chisquare(2, n) * np.exp(spread * rng.standard_normal(n))
        found.append(skewed_mean_estimate(values, drawn))
        percentile.append(mean_estimate(values, drawn, (0.0, math.inf)))
    known = [k for k, one in enumerate(found) if not math.isnan(one.low)]  # not one value with most of the sum
    assert len(known) > 0.9 * TRIALS
    stated = covered([found[k] for k in known], truth)
    assert_covers(stated, len(known), lowest, 0.97)
    if spread >= 1.5:
        assert covered([percentile[k] for k in known], truth) < stated


def test_the_mean_of_skewed_numbers_by_site():
    """Four frames to a site, whose covariances are too small together; a fifth of the frames has no fix."""
    rng, n_sites, truth = rng_for(2), 60, 2.0 * math.exp(0.5)
    found = []
    for _ in range(TRIALS):
        site = np.repeat(np.arange(n_sites), 4)
        values = rng.chisquare(2, len(site)) * np.exp(rng.standard_normal(n_sites))[site]
        values[rng.uniform(size=len(site)) < 0.2] = math.nan
        found.append(skewed_mean_estimate(values, Resamples.of(site, RESAMPLES, int(rng.integers(2**31)))))
    assert_covers(covered(found, truth), TRIALS, 0.89, 0.97)


def test_too_few_skewed_numbers_have_no_interval():
    values = rng_for(3).chisquare(2, FEWEST_CLUSTERS)
    whole = skewed_mean_estimate(values, Resamples.of(np.arange(FEWEST_CLUSTERS)))
    assert whole.low < whole.value < whole.high
    values[0] = math.nan
    part = skewed_mean_estimate(values, Resamples.of(np.arange(FEWEST_CLUSTERS)))
    assert (part.value, part.n) == (pytest.approx(np.nanmean(values)), FEWEST_CLUSTERS - 1)
    assert math.isnan(part.low)
    assert math.isnan(part.high)
    same = skewed_mean_estimate(np.ones(50), Resamples.of(np.arange(50)))
    assert same.value == 1.0
    assert math.isnan(same.low)
    assert skewed_mean_estimate(np.full(50, math.nan), Resamples.of(np.arange(50))).n == 0


STEEP = (1.0, 0.999, 0.99, 0.97, 0.9, 0.6, 0.3, 0.1, 0.01)
EVEN = (0.9, 0.8, 0.7, 0.6, 0.5, 0.4)
AT_THE_ENDS = (1.0, 1.0, 1.0, 0.5, 0.0, 0.0)


@pytest.mark.parametrize("shares", [STEEP, EVEN, AT_THE_ENDS])
def test_shares_over_conditions_that_are_fixed(shares):
    """40 frames at each; an interval that takes conditions for drawn is wider and covers 97 to 100 %."""
    rng, p = rng_for(4, 100 * sum(shares)), np.repeat(shares, 40)
    condition, drawn, found, whole = np.repeat(np.arange(len(shares)), 40), Resamples.of(np.arange(len(p))), [], []
    for _ in range(2 * TRIALS):
        right = rng.uniform(size=len(p)) < p
        found.append(share_within_conditions(right, condition, drawn))
        whole.append(proportion_estimate(right, np.ones(len(p)), drawn))
    assert_covers(covered(found, p.mean()), 2 * TRIALS, 0.935, 0.98)
    assert np.mean([one.high - one.low for one in found]) < 0.95 * np.mean([one.high - one.low for one in whole])


@pytest.mark.parametrize("crossed", [False, True])
def test_shares_over_fixed_conditions_of_sites_that_share_luck(crossed):
    """Sites of four frames at one condition, or with one frame at each."""
    shares, per_site = np.array([0.95, 0.8, 0.5, 0.2]), 4
    rng, n_sites, found = rng_for(5, crossed), 80, []
    site = np.repeat(np.arange(n_sites), per_site)
    condition = np.tile(np.arange(4), n_sites) if crossed else site % 4
    drawn = Resamples.of(site)
    for _ in range(2 * TRIALS):
        luck = math.sqrt(0.3) * rng.standard_normal(n_sites)[site] + math.sqrt(0.7) * rng.standard_normal(len(site))
        found.append(share_within_conditions(luck < stats.norm.ppf(shares)[condition], condition, drawn))
    assert_covers(covered(found, shares.mean()), 2 * TRIALS, 0.935, 0.975)


def test_where_conditions_tell_no_variance_the_whole_is_asked():
    drawn = Resamples.of(np.arange(12))
    right, ones = np.arange(12) % 3 == 0, np.ones(12)
    whole = proportion_estimate(right, ones, drawn)
    assert share_within_conditions(right, np.zeros(12), drawn) == whole
    assert share_within_conditions(right, np.full(12, math.nan), drawn) == whole
    assert share_within_conditions(right, np.minimum(np.arange(12), 1), drawn) == whole  # one frame at the first
    assert share_within_conditions(ones, np.arange(12) % 2, drawn) == proportion_estimate(ones, ones, drawn)


# Chances of the first solver, and of the second, at each condition.
APART = ((1.0, 1.0), (0.99, 0.95), (0.9, 0.7), (0.6, 0.3), (0.2, 0.02), (0.01, 0.0))
CROSSING = ((0.95, 0.4), (0.8, 0.6), (0.6, 0.8), (0.3, 0.9))
ALIKE = ((1.0, 1.0), (1.0, 0.99), (0.5, 0.5), (0.0, 0.02), (0.0, 0.0))


@pytest.mark.parametrize("chances", [APART, CROSSING, ALIKE])
def test_differences_over_conditions_that_are_fixed(chances):
    """40 frames at each, on which both solvers share some luck; conditions that are taken for drawn widen the interval."""
    first, second = np.array(chances).T
    rng, condition, found, whole = rng_for(6, 100 * first.sum()), np.repeat(np.arange(len(first)), 40), [], []
    drawn, nowhere = Resamples.of(np.arange(len(condition)), RESAMPLES), np.full(len(condition), math.nan)
    for _ in range(2 * TRIALS):
        luck = rng.standard_normal(len(condition))
        own = [(math.sqrt(0.5) * luck + math.sqrt(0.5) * rng.standard_normal(len(luck))) for _ in range(2)]
        gap = (own[0] < stats.norm.ppf(first)[condition]).astype(float) - (own[1] < stats.norm.ppf(second)[condition])
        found.append(difference_estimate(gap, condition, drawn))
        whole.append(difference_estimate(gap, nowhere, drawn))
    truth = float((first - second).mean())
    assert_covers(covered(found, truth), 2 * TRIALS, 0.935, 0.985)
    ratio = np.mean([one.high - one.low for one in found]) / np.mean([one.high - one.low for one in whole])
    assert ratio < {APART: 1.0, CROSSING: 0.85, ALIKE: 1.05}[chances]


@pytest.mark.parametrize("crossed", [False, True])
def test_differences_over_fixed_conditions_of_sites_that_share_luck(crossed):
    """Sites of four frames at one condition, or with one frame at each."""
    first, second = np.array([0.95, 0.8, 0.5, 0.2]), np.array([0.6, 0.7, 0.6, 0.1])
    rng, n_sites, found = rng_for(7, crossed), 80, []
    site = np.repeat(np.arange(n_sites), 4)
    condition = np.tile(np.arange(4), n_sites) if crossed else site % 4
    drawn = Resamples.of(site, RESAMPLES)
    for _ in range(2 * TRIALS):
        luck = [
            math.sqrt(0.3) * rng.standard_normal(n_sites)[site] + math.sqrt(0.7) * rng.standard_normal(len(site))
            for _ in range(2)
        ]
        gap = (luck[0] < stats.norm.ppf(first)[condition]).astype(float) - (luck[1] < stats.norm.ppf(second)[condition])
        found.append(difference_estimate(gap, condition, drawn))
    assert_covers(covered(found, float((first - second).mean())), 2 * TRIALS, 0.935, 0.975)


def test_two_solvers_that_never_differ_have_an_interval_about_zero():
    same = difference_estimate(np.zeros(40), np.arange(40) % 4, Resamples.of(np.arange(40)))
    assert same.value == 0.0
    assert same.low == -same.high < 0.0
