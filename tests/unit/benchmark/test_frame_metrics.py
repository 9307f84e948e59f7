"""Metrics of a table of frames against numbers worked out by hand."""

import math

import numpy as np
import pytest
from unit.benchmark.frame_tables import table

from benchmark.errors import ResultsError
from benchmark.stats.clustered import Resamples, expanded_levels, mean_estimate, mean_estimates, quantile_estimate
from benchmark.stats.confidence import (
    calibration_error,
    overconfidence,
    risk_coverage,
)
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
        "median_error_km": 50.0, "p90_error_km": math.inf, "wrong_and_confident": 0.2, "stars_named_right": 0.4,
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


def test_what_a_solver_does_not_return_is_undefined_and_what_it_has_no_chance_to_return_is_not() -> None:
    names = {"n_matches": [0, 0, 0, 0], "n_correct": [0, 0, 0, 0], "n_detected_stars": [20, 10, 10, 0]}
    silent = measure(table(**names))
    assert math.isnan(silent["star_recall"].value)
    assert math.isnan(silent["star_precision"].value)
    assert math.isnan(silent["kelvins_score"].value)
    refused = measure(table(**names, status=["refused"] * 4, error_km=[math.inf] * 4))
    assert refused["star_recall"].value == 0.0
