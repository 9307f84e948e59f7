"""McNemar and Holm against published and hand-computed numbers."""

from math import comb

import numpy as np
import pytest

from benchmark.stats.paired_tests import holm, mcnemar_exact


def successes(both, only_first, only_second, neither):
    first = [True] * (both + only_first) + [False] * (only_second + neither)
    second = [True] * both + [False] * only_first + [True] * only_second + [False] * neither
    return first, second


@pytest.mark.parametrize(
    ("only_first", "only_second", "p"),
    [
        (0, 6, 2 / 2**6),  # all six on one side
        (1, 9, 2 * (1 + 10) / 2**10),
        (5, 5, 1.0),
        (0, 0, 1.0),
    ],
)
def test_mcnemar_by_hand(only_first, only_second, p):
    found = mcnemar_exact(*successes(30, only_first, only_second, 20))
    assert (found.n, found.only_first, found.only_second) == (50 + only_first + only_second, only_first, only_second)
    assert found.p == pytest.approx(p)


def test_mcnemar_of_many_discordant_pairs():
    """Agresti's approval ratings (Categorical Data Analysis, table 11.1): 150 and 86 change; z^2 = 17.36, p = 3e-5."""
    found = mcnemar_exact(*successes(794, 150, 86, 570))
    exact = 2 * sum(comb(236, k) for k in range(87)) / 2**236
    assert found.p == pytest.approx(exact, rel=1e-9)
    assert 2e-5 < found.p < 5e-5


def test_mcnemar_is_symmetric_and_wants_pairs():
    first, second = successes(3, 8, 2, 1)
    assert mcnemar_exact(first, second).p == mcnemar_exact(np.array(second), np.array(first)).p
    with pytest.raises(ValueError, match="one length"):
        mcnemar_exact([True], [True, False])


def test_holm_by_hand():
    """Sorted 0.005, 0.01, 0.03, 0.04 times 4, 3, 2, 1 are 0.02, 0.03, 0.06, 0.04; the last may not fall below 0.06."""
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx((0.03, 0.06, 0.06, 0.02))
    assert holm([0.6, 0.7]) == pytest.approx((1.0, 1.0))
    assert holm([]) == ()
    with pytest.raises(ValueError, match="between 0 and 1"):
        holm([1.2])


def test_holm_keeps_the_level_under_true_null_hypotheses():
    rng = np.random.default_rng(np.random.SeedSequence(20260101, spawn_key=(77,)))
    false_alarms = sum(min(holm(rng.random(6).tolist())) < 0.05 for _ in range(4000))
    assert 0.035 < false_alarms / 4000 < 0.06
