"""The effort of the default solver: counted work that bounds every search, and a deadline for callers who want one."""

from dataclasses import replace

import numpy as np
import pytest

import celnav
from benchmark.fields.solver_bars import attitude_of, camera_of
from benchmark.fields.solver_fields import Condition, make_field
from celnav.identification import identify
from celnav.identification.effort import Effort
from celnav.identification.pairing import candidate_pairs, mutual_nearest

CAMERA = celnav.Camera.pinhole(width=1080, height=720, hfov_deg=60)
UTC = "2020-01-01T00:00:00Z"
UP = celnav.Attitude.up([0, 0, 1])
GOOD = Condition("good", noise_px=0.5)


def clutter(n, seed=1):
    rng = np.random.default_rng(seed)
    return rng.uniform([0, 0], [1079, 719], (n, 2)), rng.random(n)


def solve_clutter(n=300, **config):
    uv, flux = clutter(n)
    solver = celnav.SkybenchSolver(celnav.SkybenchConfig(**config))
    return celnav.solve(uv, CAMERA, UTC, UP, solver, flux=flux)


def solve_good(solver="skybench", number=0, **options):
    frame = make_field(GOOD, 5, number)
    return celnav.solve(
        frame.uv, camera_of(GOOD), frame.utc, attitude_of(GOOD, frame), solver, flux=frame.flux, **options
    )


@pytest.mark.parametrize("max_work", [1, 100_000, 1_000_000, 5_000_000, 20_000_000])
def test_work_never_exceeds_its_bound(max_work):
    fix = solve_clutter(max_work=max_work)
    assert fix.reason == "effort_spent"
    assert fix.work <= max_work
    # What is not spent is less than one batch of each search, and the part kept for a rival.
    assert fix.work >= max_work - 600_000 - 3 * 2_500_000


def test_work_is_the_same_every_time():
    assert solve_clutter().work == solve_clutter().work
    assert solve_good().work == solve_good().work > 0


def test_more_work_finds_what_less_does_not():
    """A field of which three in five stars are missing, among twice as many false ones."""
    condition = Condition("hard", noise_px=0.5, missing=0.6, false=2.0)
    works = []
    for number in range(6):
        frame = make_field(condition, 2, number)
        question = (frame.uv, camera_of(condition), frame.utc, attitude_of(condition, frame))
        fix = celnav.solve(*question, flux=frame.flux)
        if not fix.ok:
            continue
        works.append(fix.work)
        less = celnav.SkybenchSolver(celnav.SkybenchConfig(max_work=fix.work // 4))
        refused = celnav.solve(*question, less, flux=frame.flux)
        assert (refused.ok, refused.reason) == (False, "effort_spent")
    assert len(works) >= 3


def test_a_search_that_tried_everything_says_so():
    """Six detections make so few pairs that the bound does not matter."""
    uv, flux = clutter(6)
    wide = celnav.Camera.pinhole(1080, 720, 120)
    fix = celnav.solve(uv, wide, UTC, UP, celnav.SkybenchSolver(celnav.SkybenchConfig(max_work=10**9)), flux=flux)
    assert fix.reason == "no_hypothesis"
    assert "max_work" not in fix.message


def test_the_bound_counts_what_is_done(monkeypatch):
    """Look-ups are counted by the code that makes them, and do not exceed the work that was charged."""
    made = {"lookups": 0, "hypotheses": 0}
    original = identify.best_hypotheses

    def count(rotations, view, *arguments):
        made["hypotheses"] += len(rotations)
        return original(rotations, view, *arguments)

    from celnav.identification import search

    nearest = search.nearest_stars

    def count_lookups(rotations, rays, *arguments):
        made["lookups"] += len(rotations) * len(rays)
        return nearest(rotations, rays, *arguments)

    monkeypatch.setattr(identify, "best_hypotheses", count)
    monkeypatch.setattr(search, "nearest_stars", count_lookups)
    fix = solve_clutter()
    assert made["lookups"] + made["hypotheses"] < fix.work
    # The rest is what forming hypotheses and verifying them costs, as look-ups.
    assert made["lookups"] > 0.25 * fix.work


def test_a_deadline_ends_the_search_and_says_so():
    fix = solve_clutter(time_limit_s=1e-9)
    assert (fix.reason, fix.work) == ("effort_spent", 0)
    assert "time_limit_s" in fix.message
    uv, flux = clutter(300)
    assert celnav.solve(uv, CAMERA, UTC, UP, flux=flux, time_limit_s=1e-9).work == 0
    both = celnav.SkybenchSolver(celnav.SkybenchConfig(time_limit_s=3600.0))
    assert celnav.solve(uv, CAMERA, UTC, UP, both, flux=flux, time_limit_s=1e-9).work == 0


def test_a_deadline_that_is_far_changes_nothing():
    plain, limited = solve_good(), solve_good(time_limit_s=3600.0)
    assert (plain.lat_deg, plain.lon_deg, plain.work) == (limited.lat_deg, limited.lon_deg, limited.work)


def test_parts_of_the_effort():
    effort = Effort(100)
    effort.allow(30)
    effort.work = 20
    assert effort.affords(10)
    assert not effort.spent
    assert not effort.affords(11)
    assert effort.spent
    effort.allow(1000)
    assert effort.limit == 100
    assert not Effort(100, deadline_s=-1.0).affords(1)


def test_detections_beyond_the_most_are_left_out():
    """A frame of stars and a hundred times as many faint false ones is solved by its brightest."""
    frame = make_field(GOOD, 5, 1)
    uv, flux = clutter(60_000)
    solver = celnav.SkybenchSolver(replace(celnav.SkybenchConfig(), max_detections=5000))
    fix = celnav.solve(
        np.vstack((frame.uv, uv)), camera_of(GOOD), frame.utc, attitude_of(GOOD, frame), solver,
        flux=np.concatenate((frame.flux, 1e-3 * frame.flux.min() * flux)),
    )  # fmt: skip
    assert fix.ok, fix.message
    assert abs(fix.lat_deg - frame.lat_deg) < 0.05
    assert fix.matches[:, 0].max() < len(frame.uv) + 60_000
    assert len(fix.matches) > 0.9 * len(frame.uv)


def test_pairs_are_all_within_the_radius():
    rng = np.random.default_rng(3)
    seen, predicted = rng.uniform(0, 100, (400, 2)), rng.uniform(0, 100, (300, 2))
    distance = np.linalg.norm(seen[:, None] - predicted, axis=2)
    rows, columns, found = candidate_pairs(seen, predicted, 6.0)
    order = np.lexsort((columns, rows))
    np.testing.assert_array_equal(np.column_stack((rows, columns))[order], np.argwhere(distance <= 6.0))
    np.testing.assert_allclose(found, distance[rows, columns])
    a, b = mutual_nearest(seen, predicted, 6.0)
    expected = [
        (i, j) for i, j in enumerate(distance.argmin(axis=1)) if distance[:, j].argmin() == i and distance[i, j] <= 6.0
    ]
    assert list(zip(a.tolist(), b.tolist(), strict=True)) == expected
    assert len(mutual_nearest(seen[:0], predicted, 6.0)[0]) == len(mutual_nearest(seen, predicted[:0], 6.0)[0]) == 0
