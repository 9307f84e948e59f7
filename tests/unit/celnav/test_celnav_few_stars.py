"""Covariances of fits by a few stars, whose residuals hardly know the noise: Student's distribution, not the normal one."""

import dataclasses

import numpy as np
import pytest
from scipy import stats

import celnav
import celnav.skybench_solver
from benchmark.fields.solver_bars import attitude_of, camera_of
from benchmark.fields.solver_fields import Condition, make_field
from celnav.adjustment import CameraPriors, adjust, noise_known_by

CAMERA = celnav.Camera("pinhole", width=1080, height=720, f_px=935.3, cx_px=539.5, cy_px=359.5)
NOISE_PX = 0.3
_HELD = CameraPriors()


def test_the_variance_of_student_s_distribution():
    """n / (n - 2): 2, 5/3 and 1.25 for 4, 5 and 10 degrees of freedom, as in tables; finite where that is not."""
    assert [noise_known_by(n) for n in (4, 5, 10)] == pytest.approx([2, 5 / 3, 1.25])
    assert noise_known_by(4.5) == pytest.approx(stats.t(4.5).var())
    assert noise_known_by(2.0) == noise_known_by(3.0) == 3.0
    assert noise_known_by(2000) < 1 + 1 / 900


def fitted(rng, number, priors=_HELD):
    """Fit a turn of nothing to so many stars at random; the outcome."""
    rays = CAMERA.to_rays(rng.uniform([40, 40], [1040, 680], (number, 2)))
    uv = CAMERA.project(rays) + rng.normal(0, NOISE_PX, (number, 2))
    each = np.arange(number)
    adjusted = adjust(
        CAMERA, uv, None, rays, (each, each), np.eye(3),
        values=np.zeros(5), sigma_px=NOISE_PX, priors=priors, area_px=1080.0 * 720.0,
    )  # fmt: skip
    assert adjusted is not None
    return adjusted


@pytest.mark.parametrize("number", [4, 5, 8, 40])
def test_squared_errors_over_the_covariance_are_those_of_fisher_s_f(number):
    """With 2 n - 3 degrees of freedom v the turn's squared error over its covariance is 3 (v - 2) / v times F of 3 and v."""
    rng = np.random.default_rng([3, number])
    freedom = 2 * number - 3
    squares = []
    for _ in range(150):
        adjusted = fitted(rng, number)
        turned = adjusted.rotation
        turn = np.array([turned[2, 1] - turned[1, 2], turned[0, 2] - turned[2, 0], turned[1, 0] - turned[0, 1]]) / 2
        squares.append(turn @ np.linalg.solve(adjusted.cov, turn))
    scaled = np.array(squares) / 3 * noise_known_by(freedom)
    assert stats.kstest(scaled, stats.f(3, freedom).cdf).pvalue > 0.01


def test_what_was_told_is_not_widened():
    """A principal point told to 0.002 px, which four stars cannot better, stays as uncertain as it was told."""
    adjusted = fitted(np.random.default_rng(8), 4, CameraPriors(centre_px=0.002))
    assert adjusted.camera_sigmas[1:3] == pytest.approx([0.002, 0.002], rel=0.01)


@pytest.mark.parametrize("kept", [0, 3])
@pytest.mark.parametrize("round_", [1, 2])
def test_a_field_that_its_adjustment_leaves_with_too_few_stars_is_refused(monkeypatch, kept, round_):
    """In the first adjustment, and in the one that weighs stars by the noise that was measured."""
    condition = Condition("vertical known", 60, 5.5, noise_px=0.3)
    field = make_field(condition, 3, 0)
    rounds = []

    def emptied(*args, **more):
        found = adjust(*args, **more)
        rounds.append(found)
        if found is None or len(rounds) < round_:
            return found
        few = slice(0, kept)
        return dataclasses.replace(
            found, detection=found.detection[few], star=found.star[few], weight=found.weight[few],
            residual_px=found.residual_px[few],
        )  # fmt: skip

    given = (camera_of(condition), field.utc, attitude_of(condition, field))
    monkeypatch.setattr(celnav.skybench_solver, "adjust", emptied)
    monkeypatch.setattr(celnav.skybench_solver, "measured_sigmas", lambda seen, adjusted: np.ones(len(seen.uv)))
    fix = celnav.solve(field.uv, *given)
    assert len(rounds) >= round_
    assert not fix.ok
    assert fix.reason == celnav.Reason.INCONSISTENT
    assert "do not fit one orientation" in fix.message
