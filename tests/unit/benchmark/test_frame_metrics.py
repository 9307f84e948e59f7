"""Metrics of a table of frames against numbers worked out by hand."""

import itertools
import math

import numpy as np
import pandas as pd
import pytest
from scipy.optimize import isotonic_regression

from benchmark.errors import ResultsError
from benchmark.stats.break_point import break_point, crossing, discrimination, isotonic
from benchmark.stats.clustered import Resamples, expanded_levels, mean_estimate, mean_estimates, quantile_estimate
from benchmark.stats.comparison import compare, detectable, paired, ranks
from benchmark.stats.confidence import (
    _curve,
    calibration_error,
    expected_calibration_error,
    overconfidence,
    reliability,
    risk_coverage,
)
from benchmark.stats.covariance import ellipse_coverage, nees_of_identified, nees_values
from benchmark.stats.frame_metrics import (
    METRICS,
    groups_of,
    kelvins_scores,
    measure,
    read_frames,
    resamples_of,
    sites,
)
from benchmark.stats.intervals import quantile, wilson
from benchmark.stats.paired_tests import holm, mcnemar_clustered, mcnemar_exact, sign_flip, sign_flips
from benchmark.stats.power import design_effect, minimum_detectable_difference


def table(**columns):
    n = len(next(iter(columns.values())))
    base = {"frame_id": [f"frame-{i}" for i in range(n)], "status": ["fix"] * n, "error_km": [1.0] * n}
    return pd.DataFrame({**base, **columns})


MIXED = table(
    status=["fix", "fix", "fix", "refused", "error"],
    error_km=[0.5, 5.0, 50.0, None, None],
    n_matches=[10, 10, 10, 0, 0],
    n_correct=[10, 8, 0, 0, 0],
    n_detected_stars=[10, 16, 10, 12, 0],
    time_ms=[1.0, 2.0, 3.0, 4.0, 100.0],
    crlb_km=[0.25, 5.0, 1.0, 1.0, None],
    peak_memory_mib=[100.0, 300.0, 200.0, None, None],
)


def test_every_metric_by_hand():
    found = {key: estimate.value for key, estimate in measure(MIXED).items()}
    assert found == {
        "success_1km": 0.2, "success_3km": 0.2, "success_10km": 0.4, "success_30km": 0.4,
        "median_error_km": 50.0, "p90_error_km": math.inf, "wrong_and_confident": 0.2,
        "star_precision": 18 / 30, "star_recall": 18 / 48,
        "kelvins_score": pytest.approx((1.0 + 4 / 16 - 1.0 + 0.0 + 0.0) / 5),
        # 2, 1, 50, inf; the frame without a bound takes no part.
        "bound_ratio": pytest.approx((2.0 + 50.0) / 2), "identified_bound_ratio": 1.5,
        "median_time_ms": 3.0, "p95_time_ms": 100.0, "peak_memory_mib": 300.0,
    }  # fmt: skip


def test_quantiles_and_limits_of_metrics():
    """Of twenty, the 90 % quantile lies between the 18th and the 19th, the 95 % quantile between the 19th and the 20th."""
    keys = ("median_error_km", "p90_error_km", "p95_time_ms", "success_10km", "wrong_and_confident")
    frames = table(error_km=np.arange(1.0, 21.0), time_ms=np.arange(20.0, 0.0, -1.0))
    found = measure(frames, [metric for metric in METRICS if metric.key in keys])
    assert found["median_error_km"].value == 10.5
    assert found["p90_error_km"].value == 18.5
    assert found["p95_time_ms"].value == 19.5
    # Success is an error below the limit, not at it: 10 km is no success at 10 km, but a wrong fix.
    assert found["success_10km"].value == 9 / 20
    assert found["wrong_and_confident"].value == 11 / 20


def test_a_frame_without_a_site_is_one_of_its_own():
    frames = table(site=["a", "", None, "a"])
    assert sites(frames).tolist() == ["a", "frame frame-1", "frame frame-2", "a"]
    assert sites(frames.drop(columns="site")).tolist() == [f"frame-{n}" for n in range(4)]
    assert resamples_of(frames).n_clusters == 3


def test_the_kelvins_score_is_that_of_the_competition():
    """max((c - 2 w) / max(t, 1), -1): 20 stars of which 15 right and 2 wrong give 11/20; all wrong not below -1."""
    frames = table(n_matches=[17, 30, 0, 0], n_correct=[15, 0, 0, 0], n_detected_stars=[20, 10, 10, 0])
    assert kelvins_scores(frames).tolist() == [0.55, -1.0, 0.0, 0.0]


def test_an_error_at_the_bound_has_the_ratio_of_the_documentation():
    """Median of a round Gaussian error over its root mean square: sqrt(ln 2) = 0.833; of one in one direction: 0.674."""
    rng = np.random.default_rng(np.random.SeedSequence(8))
    n, bound = 20_000, 0.07
    east, north = rng.normal(0, bound / math.sqrt(2), (2, n))
    # The density of the ratio at its median gives a standard error of 0.0042 and 0.0056; four of them.
    for error, expected in ((np.hypot(east, north), math.sqrt(math.log(2))), (np.abs(rng.normal(0, bound, n)), 0.6745)):
        frames = table(error_km=error, crlb_km=[bound] * n)
        assert measure(frames, [m for m in METRICS if m.key == "bound_ratio"])["bound_ratio"].value == pytest.approx(
            expected, abs=0.022
        )


def test_frames_of_their_own_site_are_independent():
    frames = table(error_km=[1.0] * 30 + [100.0] * 10)
    found = measure(frames, METRICS[:3])["success_3km"]
    assert (found.value, found.n) == (0.75, 40)
    # Wilson's interval but for the t quantile and n/(n - 1) of an estimated variance.
    assert (found.low, found.high) == pytest.approx(wilson(30, 40), abs=0.01)


def test_frames_of_one_site_count_once():
    frames = table(error_km=([1.0] * 5 + [100.0] * 5) * 10, site=[str(i // 5) for i in range(100)])
    found = measure(frames, METRICS[:3])["success_10km"]
    assert (found.low, found.high) == pytest.approx(wilson(10, 20), abs=0.03)


def test_nothing_to_count_is_undefined():
    assert all(math.isnan(estimate.value) for estimate in measure(MIXED.iloc[:0]).values())
    assert math.isnan(measure(table(error_km=[1.0]), METRICS[-1:])["peak_memory_mib"].value)


def test_groups_of_a_circumstance():
    """Each distinct value by itself; more values than groups in groups of like size; NaN in none; no group empty."""
    by_value = groups_of(np.array([2.0, 1.0, math.nan, 2.0]), 2)
    assert [mask.tolist() for mask in by_value] == [[False, True, False, False], [True, False, False, True]]
    like_size = groups_of(np.arange(40.0)[::-1], 4)
    assert [np.flatnonzero(mask).tolist() for mask in like_size] == [
        list(range(30, 40)), list(range(20, 30)), list(range(10, 20)), list(range(10))
    ]  # fmt: skip
    tied = groups_of(np.array([0.0] * 8 + [1.0, 2.0, 3.0, 4.0, math.nan]), 3)
    assert [int(mask.sum()) for mask in tied] == [8, 4]
    assert groups_of(np.full(3, math.nan), 2) == []


def test_a_damaged_table_is_named(tmp_path):
    (tmp_path / "frames.parquet").write_bytes(b"PAR1")
    with pytest.raises(ResultsError, match="damaged"):
        read_frames(tmp_path / "frames.parquet")


def test_resampled_quantiles_are_quantiles_of_the_resampled_frames():
    rng = np.random.default_rng(np.random.SeedSequence(1))
    values, cluster = rng.lognormal(size=40), np.repeat(np.arange(8), 5)
    values[3] = math.inf
    drawn = Resamples.of(cluster, 50)
    for q in (0.5, 0.9):
        slow = [quantile(np.repeat(values, w[cluster].astype(int)), q) for w in drawn.weights]
        assert drawn.quantiles(values, q) == pytest.approx(slow)
    assert Resamples.of(cluster, 50).weights.tolist() == drawn.weights.tolist()
    assert drawn.weights.sum(axis=1).tolist() == [8.0] * 50
    assert quantile_estimate([math.nan] * 3, 0.5, Resamples.of([1, 2, 3])).n == 0


def test_sites_that_agree_are_not_taken_for_all_sites():
    """Three sites without a fault: Wilson's bound says that up to 56 % of the others may have one."""
    counts = {name: [5] * 9 for name in ("n_matches", "n_correct", "n_detected_stars")}
    frames = table(confidence=[1.0] * 9, site=list("aaabbbccc"), time_ms=[1.0] * 9, **counts)
    drawn, unseen = resamples_of(frames), wilson(0, 3)[1]
    assert unseen == pytest.approx(0.5615, abs=1e-4)
    ece, over, area = calibration_error(frames, drawn), overconfidence(frames, drawn), risk_coverage(frames).area
    assert (ece.low, ece.high) == (area.low, area.high) == (0.0, pytest.approx(unseen))
    assert (over.low, over.high) == (pytest.approx(-unseen), pytest.approx(unseen))
    found = measure(frames)
    assert (found["kelvins_score"].low, found["kelvins_score"].high) == (pytest.approx(1 - 2 * unseen), 1.0)
    assert (found["median_error_km"].low, found["median_error_km"].high) == (0.0, math.inf)


def test_a_quantile_that_few_frames_cannot_bound():
    """As for order statistics: no finite upper end of a 90 % quantile below 36 frames, of a median below 6."""
    for n, bounded in ((35, False), (36, True)):
        drawn = Resamples.of(np.arange(n), 200)
        assert math.isfinite(quantile_estimate(np.arange(1.0, n + 1), 0.9, drawn).high) == bounded
    assert quantile_estimate(np.arange(1.0, 6), 0.5, Resamples.of(np.arange(5), 200)).high == math.inf
    assert quantile_estimate(np.arange(1.0, 7), 0.5, Resamples.of(np.arange(6), 200)).high < math.inf


def test_expanded_levels_of_hesterberg():
    """By hand for n = 10: t_0.975,9 = 2.262 times sqrt(10/9) is 2.3845, which a normal deviate exceeds with 0.855 %."""
    assert expanded_levels(10) == pytest.approx((0.00855, 0.99145), abs=1e-4)
    assert expanded_levels(100_000) == pytest.approx((0.025, 0.975), abs=1e-5)


def test_reliability_and_calibration_error_by_hand():
    frames = table(
        error_km=[1.0, 100.0, 1.0, 1.0, 100.0, 1.0],
        confidence=[0.05, 0.1, 0.95, 0.85, 0.9, None],
        status=["fix"] * 5 + ["refused"],
    )
    bins = reliability(frames)
    assert [(b.low, b.n, b.success.value) for b in bins] == [(0.0, 2, 0.5), (0.8, 2, 0.5), (0.9, 1, 1.0)]
    assert [b.confidence for b in bins] == pytest.approx([0.075, 0.875, 0.95])
    found = calibration_error(frames, resamples_of(frames))
    assert found.value == pytest.approx((2 * 0.425 + 2 * 0.375 + 0.05) / 5)
    assert found.low <= found.value <= found.high
    many = table(error_km=[1.0] * 70 + [100.0] * 30, confidence=[0.95] * 100)
    wide = calibration_error(many, resamples_of(many))
    assert wide.value == pytest.approx(0.25)
    # About two standard errors of a proportion of 70 in 100 to either side.
    assert 0.14 < wide.low < 0.20
    assert 0.30 < wide.high < 0.36
    assert overconfidence(frames, resamples_of(frames)).value == pytest.approx((2.85 - 3) / 5)
    assert math.isnan(calibration_error(frames.iloc[5:], resamples_of(frames.iloc[5:])).value)


def test_expected_calibration_error_by_hand():
    """Ten fixes at 0.95, seven right: 0.25 off; ten at 0.55, five right: 0.05 off. An edge belongs to the bin below it."""
    confidence = np.array([0.95] * 10 + [0.55] * 10)
    success = np.array([True] * 7 + [False] * 3 + [True] * 5 + [False] * 5)
    assert expected_calibration_error(confidence, success) == pytest.approx(0.15)
    assert expected_calibration_error(np.array([0.45, 0.5]), np.array([True, False])) == pytest.approx(0.025)
    assert expected_calibration_error(np.array([0.5, 0.55]), np.array([True, False])) == pytest.approx(0.525)
    assert math.isnan(expected_calibration_error(np.empty(0), np.empty(0, bool)))


def test_risk_coverage_by_hand():
    frames = table(
        error_km=[1.0, 100.0, 1.0, None], confidence=[0.9, 0.5, 0.5, None], status=["fix", "fix", "fix", "refused"]
    )
    found = risk_coverage(frames)
    # The two of confidence 0.5 share one error between them: 0, 0.5/2, 1/3, and the refused one 2/4.
    assert found.risk.tolist() == pytest.approx([0, 0.25, 1 / 3, 0.5])
    assert found.coverage.tolist() == [0.25, 0.5, 0.75, 1.0]
    assert (found.area.value, found.n_fixes) == (pytest.approx((0.25 + 1 / 3 + 0.5) / 4), 3)
    assert risk_coverage(table(confidence=[0.1, 0.9])).area.value == 0.0
    assert risk_coverage(frames.iloc[3:]).area.value == 1.0
    # A fix without a confidence is accepted after those with one and before a refused frame.
    some = table(status=["refused", "fix", "fix"], error_km=[None, 1.0, 1.0], confidence=[None, None, 0.1])
    assert risk_coverage(some).risk.tolist() == pytest.approx([0, 0, 1 / 3])


def test_squared_errors_in_units_of_the_covariance():
    frames = table(
        error_east_km=[2.0, 0.0, 1.0, 1.0, 1.0], error_north_km=[0.0, 3.0, 1.0, 1.0, 1.0],
        cov_ee_km2=[4.0, 1.0, 2.0, 0.0, None], cov_en_km2=[0.0, 0.0, 1.0, 0.0, None], cov_nn_km2=[1.0, 9.0, 2.0, 1.0, None],
    )  # fmt: skip
    assert nees_values(frames)[:4].tolist() == pytest.approx([1.0, 1.0, 2 / 3, math.inf])
    assert math.isnan(nees_values(frames)[4])
    three = frames.iloc[:3]
    found = nees_of_identified(three, resamples_of(three))
    assert (found.n, found.value) == (3, pytest.approx(8 / 9))
    assert nees_of_identified(frames, resamples_of(frames)).value == math.inf
    wrong = three.assign(error_km=[1.0, 100.0, 1.0])
    assert nees_of_identified(wrong, resamples_of(wrong)).value == pytest.approx((1 + 2 / 3) / 2)
    assert math.isnan(nees_of_identified(frames.iloc[4:], resamples_of(frames.iloc[4:])).value)
    assert ellipse_coverage(frames, resamples_of(frames)).value == 0.75


def two(first, second, **columns):
    errors = [[1.0 if right else 100.0 for right in rights] for rights in (first, second)]
    return {name: table(error_km=error, **columns) for name, error in zip("ab", errors, strict=True)}


def test_a_comparison_by_hand():
    tables = two([1] * 8 + [0] * 2, [1, 1] + [0] * 8)
    (found,) = compare(tables)
    assert found.difference.value == pytest.approx(0.6)
    assert (found.success_test.p, found.success_p_holm) == pytest.approx((2 / 2**6, 2 / 2**6))
    assert found.error_ratio.value == pytest.approx(100**-0.6)
    assert found.closer.value == pytest.approx(0.8)
    assert (found.n_frames, found.n_sites, found.design_effect) == (10, 10, 1.0)


def test_refused_frames_in_a_comparison():
    """Infinitely far where closeness is asked; no part in the ratio of errors."""
    tables = {
        "a": table(status=["fix", "fix", "refused", "refused"], error_km=[1.0, 2.0, None, None]),
        "b": table(status=["fix", "refused", "fix", "refused"], error_km=[2.0, None, 5.0, None]),
    }
    (found,) = compare(tables)
    assert found.error_ratio.value == pytest.approx(0.5)
    assert found.closer.value == pytest.approx((1 + 1 + 0 + 0.5) / 4)


def test_equal_solvers_have_a_symmetric_interval_of_their_difference():
    """The two frames added keep it from being a point, one to each side."""
    (found,) = compare(two([1] * 20 + [0] * 20, [1] * 20 + [0] * 20))
    assert found.difference.value == 0.0
    assert found.difference.high == pytest.approx(-found.difference.low, abs=0.011)
    assert 0.02 < found.difference.high < 0.15


def test_both_p_values_are_adjusted_over_all_pairs():
    rng = np.random.default_rng(np.random.SeedSequence(12))
    tables = {
        name: table(error_km=rng.lognormal(shift, 1.0, 40)) for name, shift in zip("abc", (0.0, 0.3, 1.5), strict=True)
    }
    found = compare(tables)
    assert len(found) == 3
    assert [one.success_p_holm for one in found] == pytest.approx(holm([one.success_test.p for one in found]))
    assert [one.error_p_holm for one in found] == pytest.approx(holm([one.error_p for one in found]))
    assert [one.error_p_holm for one in found] != pytest.approx([one.error_p for one in found])


def test_frames_are_paired_by_id_and_must_be_the_same():
    one = table(error_km=[1.0, 2.0, 3.0])
    assert paired(one, one.iloc[::-1])[1]["error_km"].tolist() == [1.0, 2.0, 3.0]
    with pytest.raises(ResultsError, match="different frames"):
        paired(one, one.iloc[:2])
    with pytest.raises(ResultsError, match="twice"):
        paired(one, pd.concat([one, one]))


def test_clustered_mcnemar_by_hand():
    # Sites with differences 2, 1, 1: of 8 sign patterns, sums +-4 come twice.
    first = [True, True, True, True, False]
    second = [False] * 5
    site = ["x", "x", "y", "z", "z"]
    assert mcnemar_clustered(first, second, site).p == pytest.approx(2 / 8)
    own = list(range(30))
    rng = np.random.default_rng(np.random.SeedSequence(5))
    a, b = rng.uniform(size=(2, 30)) < [[0.8], [0.5]]
    assert mcnemar_clustered(a, b, own).p == pytest.approx(mcnemar_exact(a, b).p)
    assert mcnemar_clustered([], [], []).p == 1.0


def test_sign_flips_of_few_clusters():
    """Four clusters of one sign: 2 of 16 patterns are as extreme, within what 9999 draws can tell."""
    p = sign_flip([1.0, 2.0, 3.0, 4.0], [1, 2, 3, 4], n_flips=9999)
    assert p == pytest.approx(2 / 16, abs=5 * math.sqrt(0.125 * 0.875 / 9999))
    assert sign_flip([], []) == 1.0


def test_many_sign_flips_at_once_are_those_of_each_by_itself():
    """Against flips drawn one set after another; sets of equally many clusters share theirs."""

    def direct(sums, n_flips, seed):
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(len(sums),)))
        signs = 1 - 2 * rng.integers(0, 2, (n_flips, len(sums)), dtype=np.int8).astype(float)
        return (1 + np.count_nonzero(np.abs(signs @ sums) >= abs(sums.sum()) * (1 - 1e-12))) / (n_flips + 1)

    rng = np.random.default_rng(np.random.SeedSequence(9))
    sums = [rng.normal(0.3, 1.0, n) for n in (7, 13, 7, 101, 13)]
    assert sign_flips([*sums, np.empty(0)], 399, 5) == [*(direct(one, 399, 5) for one in sums), 1.0]


def test_bootstrap_quantiles_and_means_against_repeated_frames(monkeypatch):
    """Each resample written out frame by frame; blocks of frames so small that quantiles lie in several."""
    monkeypatch.setattr("benchmark.stats.clustered._BLOCK_FRAMES", 8)
    rng = np.random.default_rng(np.random.SeedSequence(10))
    cluster = rng.integers(0, 25, 90)
    values = np.where(rng.uniform(size=90) < 0.3, math.inf, np.round(rng.lognormal(0.0, 1.0, 90), 1))
    drawn = Resamples.of(cluster, 60)
    repeated = [np.repeat(np.arange(90), weights[drawn.cluster]) for weights in drawn.weights]
    for q in (0.03, 0.25, 0.5, 0.9):
        assert drawn.quantiles(values, q).tolist() == [quantile(values[frames], q) for frames in repeated]
    columns = np.column_stack((rng.normal(size=90), np.where(rng.uniform(size=90) < 0.5, math.nan, 1.0)))
    found = mean_estimates(columns, drawn)
    assert found == [mean_estimate(column, drawn) for column in columns.T]
    means = np.sort([columns[frames, 0].mean() for frames in repeated])
    low, high = expanded_levels(drawn.n_clusters)
    assert found[0].low == pytest.approx(np.quantile(means, low, method="lower"))
    assert found[0].high == pytest.approx(np.quantile(means, high, method="higher"))


def test_the_area_of_ties_is_the_mean_over_their_orders():
    wrong, block = np.array([False, True, False, True, True]), np.array([0, 1, 4])
    orders = [np.cumsum(wrong[[0, *order, 4]]) / np.arange(1, 6) for order in itertools.permutations([1, 2, 3])]
    risk, area = _curve(np.ones((1, 5), dtype=np.uint8), wrong, block)
    assert risk[0].tolist() == pytest.approx(np.mean(orders, axis=0).tolist())
    assert area[0] == pytest.approx(np.mean(orders))
    # A resample: frames two and three are drawn twice and not at all; all three that are tied are wrong.
    risk, area = _curve(np.array([[1, 2, 0, 1, 1]], dtype=np.uint8), wrong, block)
    assert risk[0].tolist() == pytest.approx([0.0, 2 / 3, 2 / 3, 3 / 4, 4 / 5])
    assert area[0] == pytest.approx((2 * 2 / 3 + 3 / 4 + 4 / 5) / 5)
    risk, _ = _curve(np.array([[1, 1, 2, 1, 1]], dtype=np.uint8), wrong, block)
    assert risk[0].tolist() == pytest.approx([0.0, 0.5 / 2, 1.5 / 4, 2 / 5, 3 / 6])


def test_ranks_say_no_more_than_the_tests():
    right = np.zeros((3, 60), dtype=bool)
    right[0, :55], right[1, :53], right[2, :10] = True, True, True
    tables = {name: table(error_km=np.where(row, 1.0, 100.0)) for name, row in zip("abc", right, strict=True)}
    found = ranks(tables, compare(tables))
    assert [(r.solver, r.rank, r.low, r.high) for r in found] == [("a", 1, 1, 2), ("b", 2, 1, 2), ("c", 3, 3, 3)]
    with pytest.raises(ValueError, match="all pairs"):
        ranks(tables, compare(tables)[:1])


def test_the_sample_size_of_a_paired_study():
    """Two published examples of Connor's formula (two-sided 5 %, power 80 %): 45 against 5 % of discordant pairs take 23
    pairs (powerandsamplesize.com), 30 against 15 % take 155 (clinicaltrials-tools, McNemar calculator)."""
    for n, psi, d in ((23, 0.5, 0.4), (155, 0.45, 0.15)):
        assert minimum_detectable_difference(n, psi) <= d < minimum_detectable_difference(n - 1, psi)
    assert math.isnan(minimum_detectable_difference(5, 0.2))
    assert math.isnan(minimum_detectable_difference(100, 0.0))
    assert minimum_detectable_difference(1000, 0.2) > minimum_detectable_difference(4000, 0.2)
    assert design_effect([1, 1, 1, -1, 0], ["x", "x", "y", "z", "z"]) == pytest.approx((4 + 1 + 1) / 4)
    tables = two([1] * 70 + [0] * 30, [1] * 50 + [0] * 30 + [1] * 20)
    assert detectable(compare(tables)) == pytest.approx(minimum_detectable_difference(100, 0.4))


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


def test_what_a_solver_does_not_return_is_undefined_and_what_it_has_no_chance_to_return_is_not() -> None:
    names = {"n_matches": [0, 0, 0, 0], "n_correct": [0, 0, 0, 0], "n_detected_stars": [20, 10, 10, 0]}
    silent = measure(table(**names))
    assert math.isnan(silent["star_recall"].value)
    assert math.isnan(silent["star_precision"].value)
    assert math.isnan(silent["kelvins_score"].value)
    refused = measure(table(**names, status=["refused"] * 4, error_km=[math.inf] * 4))
    assert refused["star_recall"].value == 0.0
