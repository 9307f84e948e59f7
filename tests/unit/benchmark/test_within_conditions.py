"""Intervals within fixed conditions, worked out by hand, and the fewest clusters from which intervals are given."""

import math

import numpy as np
import pytest
from scipy import stats

from benchmark.stats.clustered import Resamples, proportion_estimate, quantile_estimate
from benchmark.stats.intervals import pooled_proportion, wilson
from benchmark.stats.skewed_means import skewed_mean_estimate
from benchmark.stats.within_conditions import difference_within_conditions, share_within_conditions


def interval(right, condition, clusters):
    found = share_within_conditions(right, condition, Resamples.of(clusters))
    return found.low, found.high


def by_hand(share, variance, degrees):
    """Wilson's interval for the effective number of frames, scaled by the quantiles of normal and t distribution."""
    effective = share * (1 - share) / variance * (stats.norm.ppf(0.975) / stats.t.ppf(0.975, degrees)) ** 2
    return pytest.approx(wilson(share * effective, effective), rel=1e-12)


def test_a_share_within_two_conditions_by_hand():
    """Three sites at each: residuals of 1/3 and 2/3 about the means, squared, times 3 / 2, over 36; 6 - 2 degrees."""
    right, condition = [1, 1, 0, 0, 0, 1], [1, 1, 1, 2, 2, 2]
    variance = 1.5 * (2 * (1 / 9 + 1 / 9 + 4 / 9)) / 36
    assert interval(right, condition, list("abcdef")) == by_hand(0.5, variance, 4)


def test_a_condition_whose_frames_agree_has_half_a_differing_frame():
    """Four of four right at one condition: p = 0.5 / 5, so that the sum of four has the variance 16 p (1 - p) / 4."""
    right, condition = [1] * 4 + [1, 0] * 4, [1] * 4 + [2] * 8
    variance = (8 / 7 * 8 * 0.25 + 16 * 0.1 * 0.9 / 4) / 144
    assert interval(right, condition, list("abcdefghijkl")) == by_hand(8 / 12, variance, 10)


def test_a_difference_within_two_conditions_by_hand():
    """The sum of squares of residuals times 3 / 2, and 2 for the two frames that are added."""
    gap, condition = [1, 0, 1, 0, 0, -1], [1, 1, 1, 2, 2, 2]
    squares = 1.5 * 2 * (2 / 9 + 4 / 9) + 2
    found = difference_within_conditions(gap, condition, Resamples.of(list("abcdef")))
    half = stats.t.ppf(0.975, 4) * math.sqrt(squares) / 8
    assert (found.low, found.high) == pytest.approx((1 / 8 - half, 1 / 8 + half), rel=1e-12)


@pytest.mark.parametrize(("right", "condition", "clusters"), [
    ([1, 0, 0, 1], [1, 2, 1, 2], "aabb"),
    ([1, 0] * 4, [1] * 4 + [2] * 4, "aabbccdd"),
])  # fmt: skip
def test_residuals_that_cancel_within_every_site_leave_the_interval_of_the_whole(right, condition, clusters):
    whole = proportion_estimate(right, np.ones(len(right)), Resamples.of(list(clusters)))
    assert interval(right, condition, list(clusters)) == (whole.low, whole.high)


def test_more_rare_events_never_lower_the_upper_end():
    """Nine conditions of forty sites each, none to six of 360 frames wrong, at different conditions."""
    condition, ends = np.repeat(np.arange(9), 40), []
    for wrong in range(7):
        flags = np.zeros(360)
        flags[np.arange(wrong) * 40 + np.arange(wrong)] = 1
        low, high = interval(flags, condition, np.arange(360))
        ends.append(high)
        assert high <= 1.2 * wilson(wrong, 360)[1]
        assert low <= wrong / 360
    assert ends == sorted(ends)


def test_one_cluster_at_a_condition_tells_no_variance():
    right, condition = [1, 0, 1, 0, 1], [1, 1, 2, 2, 2]
    whole = pooled_proportion(right, np.ones(5))
    assert interval(right, [1, 1, 1, 1, 2], list("abcde")) == (whole.low, whole.high)
    assert interval(right, condition, list("abcde")) != (whole.low, whole.high)  # two at one of them do


def test_a_median_has_an_interval_from_six_sites_on():
    for sites, ends in ((5, (0.0, math.inf)), (6, (1.0, 6.0))):
        found = quantile_estimate(np.arange(1.0, sites + 1), 0.5, Resamples.of(np.arange(sites)))
        assert (found.low <= ends[0], found.high >= ends[1]) == (True, True)
        assert math.isfinite(found.high) == (sites == 6)


def test_a_skewed_mean_has_an_interval_from_forty_sites_on():
    values = np.random.default_rng(8).exponential(size=40)
    for sites in (39, 40):
        found = skewed_mean_estimate(values[:sites], Resamples.of(np.arange(sites)))
        assert math.isfinite(found.high) == (sites == 40)


def test_a_skewed_mean_has_no_interval_where_one_site_has_most_of_the_sum():
    values = np.append(np.random.default_rng(8).exponential(size=58), (0.0, 0.0))
    for largest, known in ((0.9, True), (1.1, False)):
        values[-1] = values[:-1].sum() * largest
        found = skewed_mean_estimate(values, Resamples.of(np.arange(60)))
        assert found.value == values.mean()
        assert math.isfinite(found.low) == math.isfinite(found.high) == known
    split = np.concatenate((values[:-1], np.full(10, values[-1] / 10)))
    assert math.isnan(skewed_mean_estimate(split, Resamples.of(np.minimum(np.arange(69), 59))).high)
