"""Drift of lens and mount: its statistics, and who is told what.

Each of the statistical assertions fails for a correct program with a probability of 1e-4 (two-sided, normal or chi squared);
there are 17 of them, so that the file fails by chance with 1.7e-3 at most. Seeds are fixed.
"""

import math

import numpy as np
import pytest
from scipy import stats
from small_scenes import small_scenario

import celnav
from benchmark.frames.dataset import open_dataset, true_observation
from benchmark.frames.record_values import read_record
from benchmark.judge.frame_bounds import light_of
from generator.errors import ScenarioError
from generator.frame.plan import plan_frame
from generator.frame.record import frame_record, record_bytes
from generator.frame.render import render_dataset, render_frame
from generator.optics.drift import drift_at, wander
from generator.reading.record import read_record as checked
from generator.scenario.lens.drift_spec import DriftSpec

SEEDS = 3000
LIMIT = stats.norm.isf(0.5e-4)
START_H = 1_411_234.0
"""Hours since the epoch of modified Julian dates: in 2019."""


def samples(times_h, constant_h=24.0, name="drift.test"):
    """One row per seed."""
    return np.array([[wander(seed, name, START_H + time, constant_h) for time in times_h] for seed in range(SEEDS)])


@pytest.fixture(scope="module")
def walks():
    return samples([0.0, 0.375, 6.0, 24.0, 72.0])


@pytest.mark.parametrize("column", range(5))
def test_unit_variance_at_any_time(walks, column) -> None:
    """On a step (0.75 h) of the process and between two: mean 0 and variance 1."""
    assert abs(walks[:, column].mean()) * math.sqrt(SEEDS) < LIMIT
    low, high = stats.chi2.ppf([0.5e-4, 1 - 0.5e-4], SEEDS)
    assert low < (walks[:, column] ** 2).sum() < high


@pytest.mark.parametrize(("column", "lag"), [(2, 0.25), (3, 1.0), (4, 3.0)])
def test_correlation_falls_exponentially(walks, column, lag) -> None:
    """Uhlenbeck and Ornstein: exp(-lag / time constant), by Fisher's transformation."""
    found = np.corrcoef(walks[:, 0], walks[:, column])[0, 1]
    assert abs(math.atanh(found) - math.atanh(math.exp(-lag))) * math.sqrt(SEEDS - 3) < LIMIT


def test_quantities_are_independent(walks) -> None:
    other = samples([0.0], name="drift.other")[:, 0]
    assert abs(np.corrcoef(walks[:, 0], other)[0, 1]) * math.sqrt(SEEDS) < LIMIT


def test_it_is_a_normal_distribution(walks) -> None:
    assert stats.kstest(walks[:, 1], "norm").pvalue > 1e-4


def test_a_path_has_no_jumps() -> None:
    """Over steps of a thousandth of the time constant, through many blocks of innovations: each step below 0.05."""
    path = np.array([wander(5, "drift.test", time, 1.0) for time in np.arange(START_H, START_H + 20, 0.001)])
    assert np.abs(np.diff(path)).max() < 0.05
    assert path.std() > 0.4


def test_temperature_moves_the_lens_in_proportion() -> None:
    spec = DriftSpec(
        focal_ppm_per_c=20.0, principal_u_px_per_c=0.02, principal_v_px_per_c=-0.01, reference_temperature_c=5.0
    )
    drift = drift_at(spec, 1, 58000.0, 20.0)
    assert drift.focal_ppm == pytest.approx(300.0)
    assert drift.principal_point_px == pytest.approx((0.3, -0.15))
    assert drift.mount_deg == (0.0, 0.0, 0.0)


DRIFT = {"focal_ppm": 300.0, "principal_point_px": 2.0, "mount_deg": 0.2, "time_constant_h": 48.0}
NIGHTS = {"sweep": [f"2020-01-{day:02d}T20:00:00Z" for day in (10, 11, 25)]}
SCENE = {
    "camera__hfov_deg": 60, "stars": {"limiting_magnitude": 5.5}, "drift": DRIFT, "time__utc_start": NIGHTS,
    "atmosphere__refraction": False,
}  # fmt: skip


def test_the_frame_is_the_true_camera_s_and_solvers_are_told_the_nominal_one(tmp_path) -> None:
    scenario = small_scenario(**SCENE)
    render_dataset(scenario, tmp_path, exr=False)
    nominal = small_scenario(**(SCENE | {"drift": None}))
    for index, frame in enumerate(open_dataset(tmp_path).frames):
        path = tmp_path / f"frame-{index:05d}.json"
        record = read_record(path)
        plan, undrifted = plan_frame(scenario, index), plan_frame(nominal, index)
        told, seen = frame.observation, true_observation(path, record)
        assert told.camera.f_px == pytest.approx(undrifted.spec.camera.f_px, rel=1e-12)
        np.testing.assert_allclose(told.R_cam, undrifted.motion.R_mid, atol=1e-12)
        assert (told.tilt_sigma_deg, told.heading_sigma_deg) == (0.2, 0.2)
        assert record["drift"]["mount_deg"] == list(plan.drift.mount_deg)
        assert seen.camera.f_px / told.camera.f_px - 1 == pytest.approx(1e-6 * record["drift"]["focal_ppm"], rel=1e-6)
        assert seen.camera.cx_px - told.camera.cx_px == pytest.approx(record["drift"]["principal_point_px"][0])
        # The stars are where the true camera has them, and the told one does not.
        enu = dict(zip(plan.stars.star_id.tolist(), plan.middle.enu, strict=True))
        directions = np.array([enu[int(star)] for star in frame.truth.star_id])
        true_uv = celnav.Camera.from_dict(seen.camera.as_given()).project(directions @ seen.R_cam.T)
        told_uv = celnav.Camera.from_dict(told.camera.as_given()).project(directions @ told.R_cam.T)
        np.testing.assert_allclose(frame.truth.uv, true_uv, atol=1e-4)
        assert np.hypot(*(frame.truth.uv - told_uv).T).min() > 0.1
        light = light_of(frame)
        assert light is not None
        assert light.camera == seen.camera
        np.testing.assert_array_equal(light.R_cam, seen.R_cam)


def test_a_drifting_frame_alone_is_the_same_frame() -> None:
    first, again = (render_frame(small_scenario(**SCENE), 2) for _ in range(2))
    np.testing.assert_array_equal(first.dn, again.dn)
    records = [record_bytes(frame_record(frame.plan, frame.expected, frame.stars)) for frame in (first, again)]
    assert records[0] == records[1]
    assert checked(records[0], "record")["told"]["camera"]["f_px"] == first.plan.told_camera.f_px


def test_mount_and_lens_of_many_nights_have_the_stated_spread() -> None:
    """Nights 20 time constants apart, three axes: chi squared of 120 rotations about each axis."""
    spec = DriftSpec(mount_deg=0.2, principal_point_px=0.1, time_constant_h=12.0)
    found = [drift_at(spec, 7, 58000.0 + 10 * night, 10.0) for night in range(120)]
    low, high = stats.chi2.ppf([0.5e-4, 1 - 0.5e-4], 360)
    assert low < (np.array([drift.mount_deg for drift in found]) ** 2).sum() / 0.2**2 < high
    low, high = stats.chi2.ppf([0.5e-4, 1 - 0.5e-4], 240)
    assert low < (np.array([drift.principal_point_px for drift in found]) ** 2).sum() / 0.1**2 < high


def test_refused() -> None:
    with pytest.raises(ScenarioError, match=r"drift\.time_constant_h"):
        small_scenario(drift={"time_constant_h": 0})
