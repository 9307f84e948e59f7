"""A camera that turns while a rolling shutter reads: covariances hold, though no solver is told of the shutter.

Fields are ERFA's (`benchmark.fields`). Each star leaves a streak from where it stood at the start of its row's exposure to
where at the end; detections are the middles between the ends, with the errors that middles of streaks have: large along
them, small across.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.special import chdtri, ndtri
from scipy.stats import binom

import celnav
from benchmark.fields.solver_bars import camera_of
from benchmark.fields.solver_fields import PRESSURE_HPA, TEMPERATURE_C, Condition, make_field
from benchmark.judge.geodesy import east_north_km
from celnav.skybench_config import SkybenchConfig
from celnav.skybench_solver import SkybenchSolver

SEED, FIELDS = 11, 100
WIDE = Condition("60 deg", 60, 5, brightest=25, tilt_deg=30)
ALONG_PX, ACROSS_PX = 0.8, 0.15
LENGTH_PX = 60.0
FALSE_ALARM = 1e-3
# Squares beyond what chance exceeds in one field of a hundred; as many of all fields in one run of a thousand.
RARE = 1e-2
MOST_BEYOND = int(binom.isf(FALSE_ALARM, FIELDS, RARE))


def turned(condition, number, readout):
    """A field, its detections, and how far the shutter moved the outermost of them, px; `readout` is over the exposure."""
    field, rng = make_field(condition, SEED, number), np.random.default_rng([SEED, number, 3])
    camera = camera_of(condition)
    angle, roll = rng.uniform(0, 2 * np.pi), rng.normal(0, 0.02)
    turn = np.array([LENGTH_PX / camera.f_px * math.cos(angle), LENGTH_PX / camera.f_px * math.sin(angle), roll])
    rays = camera.to_rays(field.uv)

    def seen(when):
        return camera.project(Rotation.from_rotvec(np.asarray(when)[:, None] * turn).apply(rays))

    # The shutter reaches a star's row when the star is there: two rounds find it.
    delay = np.zeros(len(rays))
    for _ in range(2):
        delay = readout * (seen(delay)[:, 1] / (camera.height - 1) - 0.5)
    start, end = seen(delay - 0.5), seen(delay + 0.5)
    streak, middle = end - start, (start + end) / 2
    unit = streak / np.hypot(*streak.T)[:, None]
    along, across = rng.normal(0, 1, (2, len(rays), 1)) * np.array([[[ALONG_PX]], [[ACROSS_PX]]])
    uv = middle + along * unit + across * np.column_stack((-unit[:, 1], unit[:, 0]))
    inside = (uv >= 0).all(axis=1) & (uv <= [camera.width - 1, camera.height - 1]).all(axis=1)
    sense = rng.choice([-1.0, 1.0], len(rays))
    number_of = np.ones(len(rays))
    detections = celnav.Detections(
        uv[inside], field.flux[inside], (camera.height, camera.width),
        (math.hypot(ALONG_PX, ACROSS_PX) / math.sqrt(2) * number_of)[inside],
        (streak * sense[:, None])[inside], (ACROSS_PX * number_of)[inside],
    )  # fmt: skip
    return field, detections


def squares(condition, readout, solver="skybench", told=True, number=FIELDS):
    """Squared errors over their covariances, and the readout times that were found with their standard deviations."""
    found, times = [], []
    for k in range(number):
        field, detections = turned(condition, k, readout)
        if not told:
            detections = replace(detections, streak_px=None, sigma_across_px=None)
        fix = celnav.solve(
            detections, camera_of(condition), field.utc, celnav.Attitude.up(field.R_cam[:, 2]), solver=solver,
            pressure_hpa=PRESSURE_HPA, temperature_c=TEMPERATURE_C,
        )  # fmt: skip
        assert fix.ok
        off = np.array(east_north_km(field.lat_deg, field.lon_deg, fix.lat_deg, fix.lon_deg))
        found.append(off @ np.linalg.solve(fix.cov_km2, off))
        times.append((fix.details.get("readout", 0.0), fix.details.get("readout_sigma", math.nan)))
    return np.array(found), np.array(times)


def beyond(found):
    return int(np.sum(found > chdtri(2, RARE)))


@pytest.mark.parametrize("readout", [0.03, -0.03, 0.0], ids=["down", "up", "global"])
def test_covariances_hold_under_a_rolling_shutter(readout):
    """The sum of squares is chi-squared of two a field, and so is each: either fails in one run of a thousand.

    Residuals say how large the noise is: 25 stars scatter it by a seventh, which is allowed for in the sum.
    """
    found, times = squares(WIDE, readout)
    low, high = (chdtri(2 * FIELDS, p) for p in (1 - FALSE_ALARM / 2, FALSE_ALARM / 2))
    assert 0.85 * low < found.sum() < 1.15 * high
    assert beyond(found) <= MOST_BEYOND
    # The sense of the turn is not known, nor that of the time that is found.
    off = (np.abs(times[:, 0]) - abs(readout)) / times[:, 1]
    if readout:
        assert np.abs(off.mean()) < -ndtri(FALSE_ALARM / 2) / math.sqrt(FIELDS) + 0.1
        assert np.median(times[:, 1]) < 0.01


def test_a_camera_off_from_what_is_told_under_a_rolling_shutter():
    """Principal points 20 px and focal lengths 1 % off (1 sigma), as phones' may be: the covariances hold as above.

    Where streaks stand at mid-exposure is reckoned with the camera told, which is good enough.
    """
    camera, found = camera_of(WIDE), []
    sigmas = celnav.ToldSigmas(focal=0.01, centre_px=20)
    for k in range(FIELDS):
        field, detections = turned(WIDE, k, 0.03)
        off = np.random.default_rng([SEED, k, 5]).normal(0, 1, 3) * [sigmas.focal, sigmas.centre_px, sigmas.centre_px]
        scale = math.exp(off[0])
        told = replace(
            camera, f_px=scale * camera.f_px, fy_px=scale * camera.fy_px, cx_px=camera.cx_px + off[1],
            cy_px=camera.cy_px + off[2],
        )  # fmt: skip
        attitude = celnav.Attitude.up(field.R_cam[:, 2])
        fix = celnav.solve(
            detections, told, field.utc, attitude, pressure_hpa=PRESSURE_HPA, temperature_c=TEMPERATURE_C, sigmas=sigmas
        )
        assert fix.ok, fix.message
        assert len(fix.matches) > 20
        at = np.array(east_north_km(field.lat_deg, field.lon_deg, fix.lat_deg, fix.lon_deg))
        found.append(at @ np.linalg.solve(fix.cov_km2, at))
    low, high = (chdtri(2 * FIELDS, p) for p in (1 - FALSE_ALARM / 2, FALSE_ALARM / 2))
    assert 0.85 * low < np.sum(found) < 1.15 * high
    assert beyond(np.array(found)) <= MOST_BEYOND


def test_without_streaks_told_the_same_middles_are_wrong_and_confident():
    """What was stated before streaks were told: this test's own power."""
    found, _ = squares(WIDE, 0.03, told=False)
    assert beyond(found) > MOST_BEYOND


def test_a_global_shutter_that_is_said_to_be_one():
    config = SkybenchConfig(readout_sigma=0.0)
    found, times = squares(WIDE, 0.0, SkybenchSolver(config), number=20)
    assert found.sum() < 1.15 * chdtri(40, FALSE_ALARM)
    assert np.isnan(times[:, 1]).all()
