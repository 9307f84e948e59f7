"""One number over several sets of frames, which count equally whatever their numbers of frames.

The sets must be independent of each other: no site may be in two of them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from benchmark.stats.intervals import Estimate


def mean_of(estimates: Sequence[Estimate]) -> Estimate:
    """Mean of independent estimates; undefined ones are ignored.

    The interval is combined from theirs, so it is as skewed as they are: the distance from the mean to its end is the root of
    the sum of squares of the estimates' own distances to that end, divided by their number.

    Parameters
    ----------
    estimates : sequence of Estimate

    Returns
    -------
    Estimate
        `n` is the sum of theirs. Undefined where all estimates are; infinite, without an interval, where one is infinite.

    References
    ----------
    G. Y. Zou and A. Donner, Statistics in Medicine 27, 1693-1702, 2008 (the method of variance estimates recovery).
    """
    known = [one for one in estimates if not math.isnan(one.value)]
    if not known:
        return Estimate(math.nan, math.nan, math.nan, 0)
    value, low, high = np.array([(one.value, one.low, one.high) for one in known]).T
    n, mean = sum(one.n for one in known), float(value.mean())
    if math.isinf(mean):
        return Estimate(mean, math.nan, math.nan, n)
    below, above = (float(np.sqrt(np.square(value - end).sum())) / len(known) for end in (low, high))
    return Estimate(mean, mean - below, mean + above, n)


def geometric_mean_of(estimates: Sequence[Estimate]) -> Estimate:
    """Geometric mean of independent estimates of positive numbers: `mean_of` their logarithms."""
    with np.errstate(divide="ignore", over="ignore"):
        logs = [Estimate(float(np.log(e.value)), float(np.log(e.low)), float(np.log(e.high)), e.n) for e in estimates]
        found = mean_of(logs)
        value, low, high = (float(np.exp(end)) for end in (found.value, found.low, found.high))
    return Estimate(value, low, high, found.n)
