"""What counts as right is within the limit of the task, in every number of a page."""

import pandas as pd
import pytest

from benchmark.stats.confidence import confidence_metrics_within
from benchmark.stats.covariance import covariance_metrics_within
from benchmark.stats.frame_metrics import measure, metrics_within

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
KEYS = ("wrong_and_confident", "right_bound_ratio", "nees", "overconfidence", "risk_coverage_area")


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
