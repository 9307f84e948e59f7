"""Solvers against each other: differences, tests, ranks and sample sizes against numbers worked out by hand."""

import math

import numpy as np
import pandas as pd
import pytest
from unit.benchmark.frame_tables import table

from benchmark.errors import ResultsError
from benchmark.stats.comparison import compare, detectable, paired, ranks
from benchmark.stats.paired_tests import holm, mcnemar_clustered, mcnemar_exact, sign_flip, sign_flips
from benchmark.stats.power import design_effect, minimum_detectable_difference


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


def test_ranks_say_no_more_than_the_tests():
    right = np.zeros((3, 60), dtype=bool)
    right[0, :55], right[1, :53], right[2, :10] = True, True, True
    tables = {name: table(error_km=np.where(row, 1.0, 100.0)) for name, row in zip("abc", right, strict=True)}
    found = ranks(tables, compare(tables))
    assert [(r.solver, r.rank, r.low, r.high) for r in found] == [("a", 1, 1, 2), ("b", 2, 1, 2), ("c", 3, 3, 3)]
    with pytest.raises(ValueError, match="all pairs"):
        ranks(tables, compare(tables)[:1])


def test_a_rank_needs_a_difference_that_holds_among_all_pairs():
    """a is ahead of b and c on six frames (p = 2 / 2^6 = 0.031, by Holm 0.094): all may share the first rank."""
    right = np.zeros((3, 40), dtype=bool)
    right[0, :26], right[1, :20], right[2, :20] = True, True, True
    tables = {name: table(error_km=np.where(row, 1.0, 100.0)) for name, row in zip("abc", right, strict=True)}
    compared = compare(tables)
    assert sorted(one.success_test.p for one in compared) == pytest.approx([2 / 64, 2 / 64, 1.0])
    assert [(r.low, r.high) for r in ranks(tables, compared)] == [(1, 3)] * 3
    assert [(r.low, r.high) for r in ranks(tables, compared, level=0.1)] == [(1, 1), (2, 3), (2, 3)]


def test_what_three_solvers_can_detect_is_tested_at_a_third_of_the_level():
    right = np.zeros((3, 100), dtype=bool)
    right[0, :70], right[1, :50], right[2, 20:70] = True, True, True
    tables = {name: table(error_km=np.where(row, 1.0, 100.0)) for name, row in zip("abc", right, strict=True)}
    assert detectable(compare(tables)) == pytest.approx(minimum_detectable_difference(100, 0.2, 0.05 / 3))


def test_errors_below_a_metre_count_as_a_metre():
    tables = {"a": table(error_km=[1e-6, 1e-4]), "b": table(error_km=[1.0, 1.0])}
    assert compare(tables)[0].error_ratio.value == pytest.approx(1e-3)


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


def test_the_test_of_errors_can_tell_in_any_family():
    """Of 24 solvers one errs three times as much on every frame; 276 times the least p-value of 4999 flips is 0.055."""
    rng = np.random.default_rng(np.random.SeedSequence(11))
    frames = [f"frame-{i:05d}" for i in range(40)]
    base = 10.0 ** rng.normal(0.0, 0.1, 40)
    tables = {
        f"s{k:02d}": pd.DataFrame(
            {
                "frame_id": frames,
                "site": frames,
                "status": "fix",
                "error_km": base * 10.0 ** rng.normal(0.0, 0.05, 40) * (3.0 if k == 0 else 1.0),
                "condition": math.nan,
            }
        )
        for k in range(24)
    }
    found = [one for one in compare(tables, 10.0) if "s00" in (one.first, one.second)]
    assert len(found) == 23
    assert max(one.error_p_holm for one in found) < 0.05
