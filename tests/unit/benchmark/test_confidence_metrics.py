"""What solvers claim, confidences and covariances, against numbers worked out by hand."""

import itertools
import math

import numpy as np
import pytest
from unit.benchmark.frame_tables import table

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
    resamples_of,
)


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
    four = frames.iloc[:4]
    assert nees_of_identified(four, resamples_of(four)).value == math.inf
    wrong = three.assign(error_km=[1.0, 100.0, 1.0])
    assert nees_of_identified(wrong, resamples_of(wrong)).value == pytest.approx((1 + 2 / 3) / 2)
    assert math.isnan(nees_of_identified(frames.iloc[4:], resamples_of(frames.iloc[4:])).value)
    assert ellipse_coverage(four, resamples_of(four)).value == 0.75


def test_covariances_of_only_some_fixes_do_not_choose_the_value():
    frames = table(
        error_east_km=[1.0] * 4, error_north_km=[1.0] * 4,
        cov_ee_km2=[1.0, 1.0, 1.0, None], cov_en_km2=[0.0, 0.0, 0.0, None], cov_nn_km2=[1.0, 1.0, 1.0, None],
    )  # fmt: skip
    assert math.isnan(nees_of_identified(frames, resamples_of(frames)).value)
    held = ellipse_coverage(frames, resamples_of(frames))
    assert (held.value, held.n) == (0.75, 4)
    # A fix from wrong stars needs no covariance for NEES, and one that is refused counts nowhere.
    wrong = frames.assign(error_km=[1.0, 1.0, 1.0, 1000.0])
    assert nees_of_identified(wrong, resamples_of(wrong)).value == pytest.approx(2.0)
    refused = frames.assign(status=["fix", "fix", "fix", "refused"])
    assert nees_of_identified(refused, resamples_of(refused)).value == pytest.approx(2.0)
    held = ellipse_coverage(refused, resamples_of(refused))
    assert (held.value, held.n) == (1.0, 3)
    none = frames.iloc[3:]
    assert math.isnan(ellipse_coverage(none, resamples_of(none)).value)
