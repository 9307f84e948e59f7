import numpy as np
import pytest

from benchmark.frames.dataset import TruthStars
from benchmark.judge.star_id import MATCH_RADIUS_PX, TRACE_SNR, score_matches

TRUTH = TruthStars(
    star_id=np.array([11, 22, 33, 44, 55]),
    uv=np.array([[10.0, 10.0], [50.0, 50.0], [51.5, 50.0], [90.0, 90.0], [53.0, 50.0]]),
    electrons_e=np.array([1e4, 1e4, 1e3, 10.0, 1e3]),
    snr=np.array([100.0, 100.0, 30.0, 0.5, 30.0]),
)
# One near 11, one among 22 (brightest), 33 (nearest) and 55, one on 44 (which leaves no trace), one on nothing.
UV = np.array([[11.0, 10.0], [51.0, 50.0], [90.0, 90.0], [70.0, 20.0]])


def score(*pairs):
    return score_matches(UV, np.array(pairs, dtype=np.int64).reshape(-1, 2), TRUTH)


def test_the_truth_is_perfect():
    result = score((0, 11), (1, 22))
    assert (result.n_detected_stars, result.n_matches, result.n_correct) == (2, 2, 2)


def test_in_a_crowd_the_nearest_and_the_brightest_are_right_and_no_faint_one_beside():
    assert score((1, 22)).n_correct == 1
    assert score((1, 33)).n_correct == 1
    assert score((1, 55)).n_correct == 0


@pytest.mark.parametrize(("electrons", "right"), [(5001.0, 1), (5000.0, 1), (4999.0, 0)])
def test_a_blend_may_be_named_after_any_star_of_half_the_brightest(electrons, right):
    light = np.where(TRUTH.star_id == 55, electrons, TRUTH.electrons_e)
    truth = TruthStars(TRUTH.star_id, TRUTH.uv, light, TRUTH.snr)
    assert score_matches(UV, np.array([[1, 55]]), truth).n_correct == right


def test_a_star_counts_once_however_often_it_is_named():
    truth = TruthStars(np.array([7, 8]), np.array([[0.0, 0.0], [50.0, 50.0]]), np.ones(2), np.full(2, 10.0))
    uv = np.array([[60.0, 60.0], [0.0, 1.0], [1.0, 0.0], [50.0, 50.0], [0.0, 0.0]])
    found = score_matches(uv, np.array([[0, 7], [1, 7], [2, 7], [3, 8], [4, 7]]), truth)
    assert found.correct.tolist() == [False, True, False, True, False]
    assert (found.n_detected_stars, found.n_matches, found.n_correct) == (4, 5, 2)


def test_wrong_identity_place_or_invisible_star_is_wrong():
    assert score((0, 22), (1, 11), (2, 44), (3, 99)).correct.tolist() == [False] * 4


def test_the_radius_is_where_it_is_said_to_be():
    inside = TruthStars(np.array([1]), np.array([[MATCH_RADIUS_PX - 1e-6, 0.0]]), np.ones(1), np.full(1, 10.0))
    outside = TruthStars(np.array([1]), np.array([[MATCH_RADIUS_PX + 1e-6, 0.0]]), np.ones(1), np.full(1, 10.0))
    match = np.array([[0, 1]])
    assert score_matches(np.zeros((1, 2)), match, inside).n_correct == 1
    assert score_matches(np.zeros((1, 2)), match, inside).n_detected_stars == 1
    assert score_matches(np.zeros((1, 2)), match, outside).n_correct == 0
    assert score_matches(np.zeros((1, 2)), match, outside).n_detected_stars == 0


@pytest.mark.parametrize(("snr", "traced"), [(TRACE_SNR, 1), (TRACE_SNR - 1e-6, 0)])
def test_a_star_leaves_a_trace_from_the_limit_on(snr, traced):
    truth = TruthStars(np.array([1]), np.zeros((1, 2)), np.ones(1), np.full(1, snr))
    result = score_matches(np.zeros((1, 2)), np.array([[0, 1]]), truth)
    assert (result.n_detected_stars, result.n_correct) == (traced, traced)


@pytest.mark.parametrize("truth", [TRUTH, TruthStars(*[np.empty(s) for s in (0, (0, 2), 0, 0)])])
def test_nothing_detected_scores_nothing(truth):
    result = score_matches(np.empty((0, 2)), np.empty((0, 2), dtype=np.int64), truth)
    assert (result.n_detected_stars, result.n_matches, result.n_correct) == (0, 0, 0)


@pytest.mark.parametrize("crowding_px", [2.0, 6.0])
def test_a_crowded_field_is_judged_as_the_definition_says(crowding_px):
    """Each match alone, by the words of docs/benchmark.md; two thousand detections among as many stars."""
    rng = np.random.default_rng([20261129, int(crowding_px)])
    n = 2000
    side = crowding_px * np.sqrt(n)
    truth = TruthStars(
        np.arange(n) * 7, rng.uniform(0, side, (n, 2)), 10 ** rng.uniform(2, 5, n), rng.uniform(1.0, 50.0, n)
    )
    uv = rng.uniform(0, side, (n, 2))
    named = rng.permutation(n)
    near = np.linalg.norm(uv[:, None] - truth.uv, axis=2)
    given = np.argsort(near, axis=1)[:, 0] * 7
    given[::3] = named[::3] * 7
    given[1::3] = np.argsort(near, axis=1)[1::3, 1] * 7
    right: list[bool] = []
    counted: set[int] = set()
    for row, star in zip(near, given, strict=True):
        within = np.flatnonzero((row <= MATCH_RADIUS_PX) & (truth.snr >= TRACE_SNR))
        light = truth.electrons_e[within]
        allowed = {within[row[within].argmin()], *within[light >= 0.5 * light.max()]} if len(within) else set()
        right.append(int(star) // 7 in allowed - counted)
        counted |= {int(star) // 7} & allowed
    found = score_matches(uv, np.column_stack((np.arange(n), given)), truth)
    assert found.correct.tolist() == right
    assert 0.1 < np.mean(right) < 0.9
