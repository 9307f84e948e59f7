"""The machinery of comparisons, by simulation: do 95 % intervals cover 93 to 97 %, do tests keep their level?

Frames come in sites whose frames share luck (intra-class correlation). Every test draws from a fixed seed. Its false-alarm
rate is the chance that a program at the edge of what it must hold would fail with a seed drawn at random: `FALSE_ALARM`
for each bound.
"""

import math

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from benchmark.stats.break_point import break_point
from benchmark.stats.clustered import (
    Resamples,
    mean_estimate,
    percentile_interval,
    proportion_estimate,
    quantile_estimate,
)
from benchmark.stats.comparison import compare, difference_estimate, ranks
from benchmark.stats.confidence import calibration_error, overconfidence, risk_coverage
from benchmark.stats.covariance import ellipse_coverage, nees_of_identified
from benchmark.stats.intervals import Estimate, wilson
from benchmark.stats.overall import mean_of
from benchmark.stats.paired_tests import holm, mcnemar_clustered, mcnemar_exact, sign_flip
from benchmark.stats.power import minimum_detectable_difference

FALSE_ALARM = 1e-4
LIMIT = stats.norm.isf(FALSE_ALARM)
SEED = 314159
TRIALS = 500
RESAMPLES = 600


def rng_for(*key):
    return np.random.default_rng(np.random.SeedSequence(SEED, spawn_key=tuple(int(k) for k in key)))


def z_of(hits, trials, rate):
    return (hits / trials - rate) / math.sqrt(rate * (1.0 - rate) / trials)


def assert_covers(estimates, truth, highest=0.97):
    hits = sum(estimate.low - 1e-12 <= truth <= estimate.high + 1e-12 for estimate in estimates)
    share = hits / len(estimates)
    assert z_of(hits, len(estimates), 0.93) > -LIMIT, share
    assert z_of(hits, len(estimates), highest) < LIMIT, share


def correlated(rng, n_sites, per_site, correlation):
    """Standard normal numbers of `n_sites` x `per_site` frames; those of a site are correlated."""
    shared = np.repeat(rng.standard_normal(n_sites), per_site)
    return math.sqrt(correlation) * shared + math.sqrt(1 - correlation) * rng.standard_normal(n_sites * per_site)


def resamples(rng, n_sites, per_site):
    return Resamples.of(np.repeat(np.arange(n_sites), per_site), RESAMPLES, int(rng.integers(2**31)))


def frame_table(site, right, **columns):
    n = len(site)
    return pd.DataFrame(
        {
            "frame_id": [f"frame-{i:05d}" for i in range(n)],
            "site": [f"site {s}" for s in site],
            "status": "fix",
            "error_km": np.where(right, 1.0, 100.0),
            **columns,
        }
    )


@pytest.mark.parametrize(("n_sites", "per_site"), [(30, 5), (120, 1)])
@pytest.mark.parametrize("p", [0.5, 0.9])
def test_proportions_of_clustered_frames(n_sites, per_site, p):
    rng = rng_for(1, n_sites, 100 * p)
    found = []
    for _ in range(TRIALS):
        right = correlated(rng, n_sites, per_site, 0.2) < stats.norm.ppf(p)
        found.append(proportion_estimate(right, np.ones(len(right)), resamples(rng, n_sites, per_site)))
    assert_covers(found, p)


def test_why_proportions_have_no_percentile_interval():
    """Near 1 a percentile bootstrap falls far short: the reason for the effective sample size."""
    rng = rng_for(2)
    hits = 0
    for _ in range(TRIALS):
        right = (correlated(rng, 60, 1, 0.0) < stats.norm.ppf(0.97)).astype(float)
        drawn = resamples(rng, 60, 1)
        low, high = percentile_interval(drawn.sums(right) / 60, 60)
        hits += low <= 0.97 <= high
    assert hits / TRIALS < 0.90


@pytest.mark.parametrize(("n_sites", "per_site"), [(20, 5), (120, 1)])
def test_means_of_clustered_frames(n_sites, per_site):
    rng = rng_for(3, n_sites)
    found = [
        mean_estimate(correlated(rng, n_sites, per_site, 0.2) + 0.3, resamples(rng, n_sites, per_site))
        for _ in range(TRIALS)
    ]
    assert_covers(found, 0.3)


@pytest.mark.parametrize(("n_sites", "per_site", "q"), [(40, 5, 0.5), (40, 5, 0.9), (120, 1, 0.5)])
def test_error_quantiles_with_refused_frames(n_sites, per_site, q):
    rng = rng_for(4, n_sites, 100 * q)
    refused = 0.05
    truth = math.exp(1.5 * stats.norm.ppf(q / (1 - refused)))
    found = []
    for _ in range(TRIALS):
        error = np.exp(1.5 * correlated(rng, n_sites, per_site, 0.2))
        error[rng.uniform(size=len(error)) < refused] = math.inf
        found.append(quantile_estimate(error, q, resamples(rng, n_sites, per_site)))
    assert_covers(found, truth)


@pytest.mark.parametrize(("p", "q"), [(0.7, 0.6), (0.5, 0.5), (0.95, 0.93)])
def test_differences_of_success(p, q):
    rng = rng_for(5, 100 * p)
    found = []
    for _ in range(TRIALS):
        sky = correlated(rng, 30, 5, 0.2)
        own = [math.sqrt(0.7) * sky + math.sqrt(0.3) * correlated(rng, 30, 5, 0.2) for _ in range(2)]
        gap = (own[0] < stats.norm.ppf(p)).astype(float) - (own[1] < stats.norm.ppf(q))
        found.append(difference_estimate(gap, np.full(len(gap), math.nan), resamples(rng, 30, 5)))
    # The two frames added for safety count most where few frames differ.
    assert_covers(found, p - q, highest=0.985)


def confident_frames(rng, n_sites, per_site, chance):
    confidence = rng.uniform(size=n_sites * per_site)
    right = stats.norm.cdf(correlated(rng, n_sites, per_site, 0.1)) < chance(confidence)
    return frame_table(np.repeat(np.arange(n_sites), per_site), right, confidence=confidence)


CHANCES = {"calibrated": lambda c: c, "promises too much": lambda c: np.clip(c - 0.15, 0, 1), "bent": lambda c: c**2}


@pytest.mark.parametrize("kind", CHANCES)
def test_expected_calibration_error(kind):
    rng = rng_for(6, len(kind))
    fine = (np.arange(200_000) + 0.5) / 200_000
    gap = (CHANCES[kind](fine) - fine).reshape(10, -1).mean(axis=1)
    found, mean_gap = [], []
    for _ in range(200):
        frames = confident_frames(rng, 50, 5, CHANCES[kind])
        drawn = Resamples.of(frames["site"], RESAMPLES, int(rng.integers(2**31)))
        found.append(calibration_error(frames, drawn))
        mean_gap.append(overconfidence(frames, drawn))
    # The interval may only be too long where the error is 0, the end of its range.
    assert_covers(found, float(np.abs(gap).mean()), highest=0.985)
    assert_covers(mean_gap, -float(gap.mean()))


def test_risk_coverage_area():
    rng = rng_for(7)
    # Accepted above c the risk is the mean of 1 - u over u in (c, 1), which is (1 - c)/2; its mean over c is 1/4.
    found = [risk_coverage(confident_frames(rng, 40, 4, CHANCES["calibrated"])).area for _ in range(150)]
    assert_covers(found, 0.25)


EVEN_CURVE, STEEP_CURVE = (0.95, 0.9, 0.7, 0.4, 0.2, 0.05), (1.0, 0.98, 0.6, 0.45, 0.1, 0.0)


# Each set takes 2,000 isotonic regressions; every day one of each curve and of each direction, a quarter as often.
@pytest.mark.parametrize(
    ("curve", "harder", "sets"),
    [
        (EVEN_CURVE, 1, 60),
        pytest.param(STEEP_CURVE, -1, 100, marks=pytest.mark.journey),
        *(
            pytest.param(curve, harder, 400, marks=pytest.mark.slow)
            for curve in (EVEN_CURVE, STEEP_CURVE)
            for harder in (1, -1)
        ),
    ],
)
def test_break_points(curve, harder, sets):
    rng = rng_for(8, 100 * curve[1], harder + 1)
    levels = np.arange(6.0)
    truth = float(np.interp(-0.5, -np.array(curve), levels)) * harder
    site, level = np.repeat(np.arange(25), 18), np.tile(np.repeat(np.arange(6), 3), 25)
    found = []
    for _ in range(sets):
        right = stats.norm.cdf(correlated(rng, 25, 18, 0.2)) < np.array(curve)[level]
        frames = frame_table(site, right, condition=harder * levels[level])
        found.append(break_point(frames, harder, seed=int(rng.integers(2**31))))
    assert_covers(found, truth, highest=0.98)


def equal_solvers(rng, n_sites, per_site, n_solvers, shifts=None):
    """Successes, shape (n_solvers, n): sites favour solvers each in its own way."""
    shifts = np.zeros(n_solvers) if shifts is None else np.asarray(shifts)
    sky = correlated(rng, n_sites, per_site, 0.3)
    own = np.stack([correlated(rng, n_sites, per_site, 0.5) for _ in range(n_solvers)])
    return math.sqrt(0.5) * sky + math.sqrt(0.5) * own < 0.3 + shifts[:, None]


def test_the_family_of_pairs_keeps_its_level():
    rng = rng_for(9)
    site = np.repeat(np.arange(40), 5)
    pairs = [(i, j) for i in range(4) for j in range(i)]
    alarms = naive = 0
    for _ in range(TRIALS):
        right = equal_solvers(rng, 40, 5, 4)
        alarms += min(holm([mcnemar_clustered(right[i], right[j], site).p for i, j in pairs])) <= 0.05
        naive += min(holm([mcnemar_exact(right[i], right[j]).p for i, j in pairs])) <= 0.05
    assert z_of(alarms, TRIALS, 0.05) < LIMIT
    assert alarms > 0
    # Frames of a site taken as independent evidence raise false alarms: the reason for the test by site.
    assert z_of(naive, TRIALS, 0.05) > LIMIT


def test_error_ratios_keep_their_level():
    rng = rng_for(10)
    site = np.repeat(np.arange(30), 4)
    alarms = sum(
        sign_flip(correlated(rng, 30, 4, 0.3), site, n_flips=399, seed=int(rng.integers(2**31))) <= 0.05
        for _ in range(TRIALS)
    )
    assert abs(z_of(alarms, TRIALS, 0.05)) < stats.norm.isf(FALSE_ALARM / 2)


def test_rank_intervals_hold_together():
    rng = rng_for(11)
    site = np.repeat(np.arange(60), 2)
    shifts = np.array([0.9, 0.0, 0.0, -0.9])
    true_ranks = [1, 2, 2, 4]  # a tie shares the better rank, and its interval must reach both
    held = separated = 0
    trials = 50
    for _ in range(trials):
        right = equal_solvers(rng, 60, 2, 4, shifts)
        tables = {f"s{i}": frame_table(site, right[i]) for i in range(4)}
        found = {rank.solver: rank for rank in ranks(tables, compare(tables))}
        held += all(found[f"s{i}"].low <= true_ranks[i] <= found[f"s{i}"].high for i in range(4)) and all(
            found[name].high >= 3 for name in ("s1", "s2")
        )
        separated += found["s3"].low > found["s0"].high
    assert z_of(held, trials, 0.95) > -LIMIT
    assert separated / trials > 0.9


@pytest.mark.parametrize(("n", "discordant"), [(200, 0.2), (800, 0.1)])
def test_the_detectable_difference_is_detected(n, discordant):
    """Of 100 studies at the difference it names, 80 find it; the exact test, a little conservative, some fewer."""
    d = minimum_detectable_difference(n, discordant)
    rng = rng_for(12, n)
    cells = rng.multinomial(n, [(discordant + d) / 2, (discordant - d) / 2, 1 - discordant], 2000)
    only_first, only_second = cells[:, 0], cells[:, 1]
    both = only_first + only_second
    p = np.minimum(1.0, 2 * stats.binom.cdf(np.minimum(only_first, only_second), both, 0.5))
    power = float(np.mean(p <= 0.05))
    assert 0.72 < power < 0.84


def test_an_honest_covariance_passes_and_a_bold_one_does_not():
    rng = rng_for(13)
    n, claimed, held = 60, [], []
    covariance = np.array([[0.5, 0.2], [0.2, 0.3]])
    for _ in range(TRIALS):
        east, north = rng.multivariate_normal([0, 0], covariance, n).T
        frames = frame_table(np.arange(n), np.ones(n, bool), error_east_km=east, error_north_km=north,
                             cov_ee_km2=0.5, cov_en_km2=0.2, cov_nn_km2=0.3)  # fmt: skip
        claimed.append(nees_of_identified(frames, resamples(rng, n, 1)))
        held.append(ellipse_coverage(frames, Resamples.of(np.arange(n), 10), 0.95))
    # The mean of a skew number: its percentile interval falls short of 95 % by one to two points at 60 sites.
    assert_covers(claimed, 2.0)
    assert_covers(held, 0.95, highest=0.99)
    bold = nees_of_identified(frames.assign(cov_ee_km2=0.125, cov_en_km2=0.05, cov_nn_km2=0.075), resamples(rng, n, 1))
    assert bold.value == pytest.approx(4 * claimed[-1].value)
    assert bold.low > 2.0


def test_the_mean_over_sets_covers_with_skew_intervals():
    # Eight sets of 60 frames of different difficulty, near 0 and 1 too, each with Wilson's interval.
    rng = rng_for(17)
    shares = np.array([0.02, 0.1, 0.3, 0.5, 0.7, 0.9, 0.98, 1.0])
    trials = rng.binomial(60, shares, (TRIALS, len(shares))).tolist()
    found = [mean_of([Estimate(k / 60, *wilson(k, 60), 60) for k in counts]) for counts in trials]
    assert_covers(found, float(shares.mean()), highest=0.985)
