"""What counts as right is within the limit of the task, in every number of a page; what counts as identified."""

import numpy as np
import pandas as pd
import pytest

from benchmark.stats.confidence import confidence_metrics_within
from benchmark.stats.covariance import covariance_metrics_within
from benchmark.stats.frame_metrics import identified, measure, metrics_within

FRAMES = pd.DataFrame(
    {
        "frame_id": ["a", "b", "c", "d"],
        "status": ["fix", "fix", "fix", "refused"],
        "error_km": [5.0, 100.0, 900.0, None],
        "error_east_km": [5.0, 100.0, 900.0, None],
        "error_north_km": [0.0, 0.0, 0.0, None],
        "cov_ee_km2": [25.0, 2500.0, 10000.0, None],
        "cov_en_km2": [0.0, 0.0, 0.0, None],
        "cov_nn_km2": [25.0, 2500.0, 10000.0, None],
        "crlb_km": [5.0, 50.0, 100.0, 1.0],
        "confidence": [0.9, 0.9, 0.9, None],
    }
)
KEYS = ("wrong_and_confident", "identified_bound_ratio", "nees", "overconfidence", "risk_coverage_area")


@pytest.mark.parametrize(
    ("limit_km", "wrong", "ratio", "nees", "over", "area"),
    [
        # One, two and three of the three fixes are right; of the three alike in confidence the wrong ones are spread evenly.
        (10.0, 0.5, 1.0, 1.0, 0.9 - 1 / 3, (3 * 2 / 3 + 3 / 4) / 4),
        (500.0, 0.25, 1.5, (1 + 4) / 2, 0.9 - 2 / 3, (3 * 1 / 3 + 2 / 4) / 4),
        (2500.0, 0.0, 2.0, (1 + 4 + 81) / 3, 0.9 - 1, (0 + 1 / 4) / 4),
    ],
)
def test_right_is_within_the_task_s_limit(limit_km, wrong, ratio, nees, over, area):
    asked = (*metrics_within(limit_km), *covariance_metrics_within(limit_km), *confidence_metrics_within(limit_km))
    found = measure(FRAMES, [metric for metric in asked if metric.key in KEYS])
    assert [found[key].value for key in KEYS] == pytest.approx([wrong, ratio, nees, over, area])


@pytest.mark.parametrize(
    ("status", "error_km", "n_matches", "n_correct", "is_identified"),
    [
        ("fix", 50.0, 10, 6, True),
        ("fix", 50.0, 10, 5, False),
        ("fix", 50.0, 0, 0, False),
        ("fix", 5.0, 0, 0, True),
        ("fix", 5.0, 10, 0, True),
        ("refused", None, 10, 10, False),
    ],
)
def test_identified_by_most_of_its_stars_or_within_the_limit(status, error_km, n_matches, n_correct, is_identified):
    row = {"status": status, "error_km": error_km, "n_matches": n_matches, "n_correct": n_correct}
    assert identified(pd.DataFrame([row]), 10.0).tolist() == [is_identified]


def test_the_share_of_frames_whose_stars_are_named_right_is_of_all_frames():
    frames = pd.DataFrame(
        {
            "frame_id": list("abcde"),
            "status": ["fix"] * 4 + ["refused"],
            "error_km": [1.0, 100.0, 1.0, 1.0, None],
            "n_matches": [10, 10, 10, 0, 0],
            "n_correct": [6, 10, 5, 0, 0],
        }
    )
    asked = [metric for metric in metrics_within(10.0) if metric.key == "stars_named_right"]
    assert measure(frames, asked)["stars_named_right"].value == pytest.approx(2 / 5)
    assert np.isnan(measure(frames.assign(n_matches=0, n_correct=0), asked)["stars_named_right"].value)


def test_a_close_limit_does_not_flatter_covariances():
    """Honest errors of 65 km on each axis: 2 whatever the limit, where fixes within 30 km alone would give 0.1.

    The sum over n fixes is chi-squared with 2 n degrees of freedom, of standard deviation 0.032 for the mean of 4,000.
    """
    n, sigma_km = 4000, 65.0
    east, north = np.random.default_rng(17).normal(0.0, sigma_km, (2, n))
    frames = pd.DataFrame(
        {
            "frame_id": [f"frame-{i}" for i in range(n)],
            "status": "fix",
            "error_km": np.hypot(east, north),
            "error_east_km": east,
            "error_north_km": north,
            "cov_ee_km2": sigma_km**2,
            "cov_en_km2": 0.0,
            "cov_nn_km2": sigma_km**2,
            "n_matches": 20,
            "n_correct": 19,
        }
    )
    named = measure(frames, covariance_metrics_within(30.0))["nees"].value
    unnamed = measure(frames.assign(n_matches=0, n_correct=0), covariance_metrics_within(30.0))["nees"].value
    assert named == pytest.approx(2.0, abs=4 * 0.032)
    assert unnamed == pytest.approx(0.1, abs=0.03)
