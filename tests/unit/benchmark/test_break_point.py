"""Break points of graded tasks against numbers worked out by hand."""

import math

import numpy as np
import pytest
from scipy.optimize import isotonic_regression
from unit.benchmark.frame_tables import table

from benchmark.stats.break_point import break_point, crossing, discrimination, isotonic


@pytest.mark.parametrize("levels", [1, 2, 7])
def test_isotonic_regression_is_that_of_scipy(levels):
    """To the last bit, which decides whether a share is one half; levels without frames are left out."""
    rng = np.random.default_rng(levels)
    counts = rng.integers(0, 9, (300, levels)) * rng.integers(0, 2, (300, levels)).astype(float)
    hits = np.floor(rng.uniform(size=counts.shape) * (counts + 1))
    fitted, _ = isotonic(hits, counts)
    for row, tested in enumerate(counts > 0):
        successes, frames = hits[row, tested], counts[row, tested]
        if not len(frames):
            continue
        first = isotonic_regression(successes / frames, weights=frames, increasing=False).blocks
        share = np.add.reduceat(successes, first[:-1]) / np.add.reduceat(frames, first[:-1])
        np.testing.assert_array_equal(fitted[row, tested], np.repeat(share, np.diff(first)))


def test_isotonic_regression_by_hand():
    """Proportions 0.9, 0.4, 0.6, 0.1 of ten frames each: the middle two are pooled to 0.5. A level without frames waits."""
    fitted, _ = isotonic(np.array([[9.0, 4, 6, 1]]), np.full((1, 4), 10.0))
    assert fitted[0].tolist() == pytest.approx([0.9, 0.5, 0.5, 0.1])
    levels = np.array([1.0, 2, 3, 4])
    assert crossing(levels, fitted, np.full((1, 4), 10.0))[0] == pytest.approx(2.5)
    fitted, counts = isotonic(np.array([[9.0, 0, 1]]), np.array([[10.0, 0, 10]]))
    assert crossing(np.array([0.0, 5, 10]), fitted, counts)[0] == pytest.approx(5.0)


def by_level(rates, harder=1):
    right = [i < round(20 * rate) for rate in rates for i in range(20)]
    level = [float(harder * n) for n in range(len(rates)) for _ in range(20)]
    return table(error_km=np.where(right, 1.0, 100.0), condition=level)


def test_break_points_that_exist_and_that_do_not():
    found = break_point(by_level([1.0, 0.8, 0.2, 0.0]))
    assert found.value == pytest.approx(1.5)
    assert 1.0 < found.low < 1.5 < found.high < 2.0
    mirrored = break_point(by_level([1.0, 0.8, 0.2, 0.0], -1), harder=-1)
    assert (mirrored.value, mirrored.low, mirrored.high) == pytest.approx((-1.5, -found.high, -found.low), abs=0.06)
    assert break_point(by_level([1.0, 0.9, 0.8])).value == math.inf
    assert break_point(by_level([0.1, 0.0, 0.0])).value == -math.inf
    assert break_point(by_level([0.1, 0.0], -1), harder=-1).value == math.inf
    assert break_point(by_level([0.9, 0.55])).high == math.inf
    assert math.isnan(break_point(table(condition=[None, None])).value)


def test_a_task_must_tell_solvers_apart():
    hard = {"a": by_level([1.0, 0.9, 0.5, 0.1]), "b": by_level([1.0, 0.5, 0.1, 0.0])}
    found = discrimination(hard)
    assert (found.n_conditions, found.n_informative, found.best_at_hardest, found.holds) == (4, 3, 0.1, True)
    easy = {"a": by_level([1.0, 1.0, 1.0, 0.6])}
    assert not discrimination(easy).holds
    # A condition at which every solver fails tells none from another.
    assert discrimination({"a": by_level([1.0, 0.5, 0.0, 0.0])}).n_informative == 1
    assert discrimination({"a": by_level([0.2, 0.9], -1)}, harder=-1).best_at_hardest == 0.9
