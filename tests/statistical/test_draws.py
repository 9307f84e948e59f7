"""Normal and Poisson numbers drawn by Dr.Jit, against SciPy's distributions. False-alarm rate of each test: 1e-4."""

import itertools

import numpy as np
import pytest
from scipy import special, stats

from generator import mitsuba_runtime
from generator.seeds import random_stream
from generator.sensor import draws
from generator.sensor.draws import SMALLEST_MEAN_BY_NORMAL, poisson, poisson_excess, standard_normal

FALSE_ALARM = 1e-4
SIZE = 4_000_000
SHAPE = (720, 1080)


def chi_squared_p(found: np.ndarray, wanted: np.ndarray) -> float:
    """Pearson's test of counts; those wanted less than ten times are taken together, at each end by themselves."""
    often = np.flatnonzero(wanted >= 10)
    first, last = often[0], often[-1]
    found = np.concatenate([[found[:first].sum()], found[first : last + 1], [found[last + 1 :].sum()]])
    wanted = np.concatenate([[wanted[:first].sum()], wanted[first : last + 1], [wanted[last + 1 :].sum()]])
    rare = wanted < 1
    assert stats.poisson.sf(found[rare] - 1, wanted[rare]).min(initial=1.0) > FALSE_ALARM
    return float(stats.chi2.sf(((found - wanted)[~rare] ** 2 / wanted[~rare]).sum(), (~rare).sum() - 1))


def poisson_p(counts: np.ndarray, mean: float) -> float:
    number = np.arange(int(mean + 12 * np.sqrt(mean) + 20))
    wanted = counts.size * stats.poisson.pmf(number, mean)
    found = np.bincount(counts.astype(np.int64), minlength=len(number))
    assert len(found) == len(number)
    return chi_squared_p(found, wanted)


def test_philox_s_known_answer() -> None:
    """Random123's test vector of philox4x32-10 (file kat_vectors): counter and key zero."""
    mitsuba_runtime.start()
    words = [int(np.array(word)[0]) for word in draws._words(0, 1, 0)]
    assert words == [0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8]


@pytest.mark.parametrize("mean", [0.0031, 0.1, 1.0, 9.0, 19.9, 20.0, 30.0, 100.5, 1000.0, 50000.0])
def test_poisson_numbers_are_poisson(mean) -> None:
    """One mean for all, and an array of it, by Pearson's test over all counts."""
    mean = float(np.float32(mean))
    assert poisson_p(poisson(mean, (SIZE,), random_stream(1, "one", 0)), mean) > FALSE_ALARM
    assert poisson_p(poisson(np.full(SIZE, mean), (SIZE,), random_stream(1, "array", 0)), mean) > FALSE_ALARM


def test_each_pixel_has_its_own_mean() -> None:
    """Small and large means side by side; all counts of a pixel's kind are Poisson with its mean."""
    means = np.array([0.0, 0.5, 15.0, 25.0, 4000.0], np.float32)
    counts = poisson(np.resize(means, (1001, 2000)), (1001, 2000), random_stream(2, "mixed", 0)).ravel()
    assert (counts[::5] == 0).all()
    for place, mean in enumerate(means[1:], 1):
        assert poisson_p(counts[place::5], float(mean)) > FALSE_ALARM


@pytest.mark.parametrize("mean", [SMALLEST_MEAN_BY_NORMAL, 20.7, 25.0, 30.5, 50.0, 200.0, 1000.0, 30000.0])
def test_the_quantile_s_series_is_within_its_bound(mean) -> None:
    """Probabilities of all counts, from where the series crosses whole numbers: the sum of errors falls from 4e-6."""
    normal = np.linspace(-6.8, 6.8, 2_000_001)
    quantile = mean + poisson_excess(np.full_like(normal, mean), normal, np.sqrt)
    assert (np.diff(quantile) > 0).all()
    counts = np.arange(np.ceil(quantile[0]), np.floor(quantile[-1]) + 1)
    edges = np.interp(counts, quantile, normal)
    low, high = np.append(-np.inf, edges), np.append(edges, np.inf)
    found = np.where(low > 0, special.ndtr(-low) - special.ndtr(-high), special.ndtr(high) - special.ndtr(low))
    wanted = stats.poisson.pmf(np.append(counts[0] - 1, counts), mean)
    assert np.abs(found - wanted).sum() < 4e-6 * (SMALLEST_MEAN_BY_NORMAL / mean) ** 2 + 1e-10


def test_single_precision_misplaces_few_counts() -> None:
    """Of the numbers that single and double precision draw from one normal number, less than 1 in 2,000 differ, by 1."""
    normal = standard_normal((1_000_000,), random_stream(3, "normal", 0))
    for mean in (20.5, 300.3, 50000.7):
        single, double = np.full_like(normal, mean), np.full(normal.shape, np.float64(np.float32(mean)))
        whole = np.floor(single)
        short = whole + np.floor(single - whole + poisson_excess(single, normal, np.sqrt))
        long = np.floor(double + poisson_excess(double, normal.astype(np.float64), np.sqrt))
        assert (short != long).mean() < 5e-4
        assert np.abs(short - long).max() <= 1
        assert abs((short - long).mean()) < 1e-4


def test_normal_numbers_are_normal() -> None:
    """Pearson's test over a thousand equal steps from -5 to 5, both tails, the variance."""
    numbers = standard_normal((2 * SIZE,), random_stream(4, "normal", 0)).astype(np.float64)
    edges = np.linspace(-5, 5, 1001)
    found, _ = np.histogram(numbers, np.concatenate([[-np.inf], edges, [np.inf]]))
    cumulative = np.concatenate([[0], stats.norm.cdf(edges), [1]])
    assert chi_squared_p(found, numbers.size * np.diff(cumulative)) > FALSE_ALARM
    limit = stats.norm.isf(FALSE_ALARM / 2)
    assert abs(numbers.mean()) * np.sqrt(numbers.size) < limit
    assert abs(numbers.var() - 1) / np.sqrt(2 / numbers.size) < limit
    assert 5 < np.abs(numbers).max() < 6.8


def test_neighbours_are_unrelated() -> None:
    """Correlations of numbers, and of their squares, with those 1 to 5 places on and one row down."""
    numbers = standard_normal(SHAPE, random_stream(5, "normal", 0)).astype(np.float64)
    counts = poisson(np.full(SHAPE, 3.0), SHAPE, random_stream(5, "small", 0)) - 3.0
    many = poisson(np.full(SHAPE, 300.0), SHAPE, random_stream(5, "large", 0)) - 300.0
    limit = stats.norm.isf(FALSE_ALARM / 2 / 36)
    for values in (numbers, counts, many):
        for power in (1, 2):
            flat = values.ravel() ** power
            for step in (1, 2, 3, 4, 5, SHAPE[1]):
                assert abs(np.corrcoef(flat[:-step], flat[step:])[0, 1]) * np.sqrt(flat.size) < limit


def test_streams_are_unrelated() -> None:
    """Normal, small and large Poisson numbers of neighbouring seeds, names and frames, and of one stream."""
    drawn = []
    for key in [(0, "shot", 0), (1, "shot", 0), (0, "shot", 1), (0, "read", 0)]:
        drawn.append(standard_normal(SHAPE, random_stream(*key)).ravel())
        drawn.append(poisson(np.full(SHAPE, 2.0), SHAPE, random_stream(*key)).ravel())
    drawn += [poisson(np.full(SHAPE, 200.0), SHAPE, random_stream(2, "shot", frame)).ravel() for frame in (0, 1)]
    pairs = list(itertools.combinations(drawn, 2))
    limit = stats.norm.isf(FALSE_ALARM / 2 / len(pairs))
    for one, other in pairs:
        assert abs(np.corrcoef(one, other)[0, 1]) * np.sqrt(one.size) < limit


def test_the_same_on_any_number_of_threads() -> None:
    means = np.linspace(0, 60, SHAPE[0] * SHAPE[1]).reshape(SHAPE)
    found = []
    for threads in (1, 2):
        mitsuba_runtime.set_threads(threads)
        found.append(
            (poisson(means, SHAPE, random_stream(6, "a", 0)), standard_normal(SHAPE, random_stream(6, "b", 0)))
        )
    for one, other in zip(*found, strict=True):
        np.testing.assert_array_equal(one, other)


def test_a_pixel_s_number_depends_on_its_own_mean_alone() -> None:
    """Whatever the others' means are, which decide how the numbers are found."""
    means = np.full(SHAPE, 300.0)
    darker = means.copy()
    darker[::2] = 1.0
    bright, mixed = (poisson(values, SHAPE, random_stream(7, "a", 0)) for values in (means, darker))
    np.testing.assert_array_equal(bright[1::2], mixed[1::2])


@pytest.mark.parametrize("wrong", [-1.0, np.nan])
def test_a_mean_that_is_none_is_refused(wrong) -> None:
    with pytest.raises(ValueError, match="negative or not a number"):
        poisson(np.array([1.0, wrong]), (2,), random_stream(0, "a", 0))
