"""Motion during the exposure: streaks, rolling shutter, vibration spectra, gyro logs and the simulated gyroscope."""

import numpy as np
import pytest
import yaml
from scipy import signal
from scipy.spatial.transform import Rotation
from small_scenes import BASE, small_scenario

from generator.errors import ScenarioError
from generator.frame.exposure.expected import render_expected
from generator.frame.plan import plan_frame
from generator.optics.motion import body_rotation, gimbal_jitter, vibration
from generator.scenario.file import parse_scenario
from generator.scenario.motion_spec import GimbalSpec, MotionSpec, VibrationSpec
from generator.seeds import random_stream

RATE_DEG_S = 2.0
EXPOSURE_S = 0.5
NARROW = {
    "camera__hfov_deg": 40, "camera__width": 540, "camera__height": 360, "sky": None, "stars": {"limiting_magnitude": 5.0},
    "time__exposure_s": EXPOSURE_S,
}  # fmt: skip


def rendered(**values):
    plan = plan_frame(small_scenario(**NARROW | values), 0)
    return plan, render_expected(plan)


def same_stars(plan, other, rows):
    """Rows of the same stars in another plan."""
    row_of = {star: row for row, star in enumerate(other.stars.star_id)}
    return [row_of[star] for star in plan.stars.star_id[rows]]


def alone(frame, reach: float, inside: float):
    """Indices of stars in the frame's inner part, with nothing else within reach."""
    chosen = []
    for row in np.argsort(-frame.star_electrons):
        u, v = frame.u_px[row], frame.v_px[row]
        if not (inside < u < 539 - inside and inside < v < 359 - inside):
            continue
        close = np.hypot(frame.u_px - u, frame.v_px - v) < reach
        if close.sum() == 1:
            chosen.append(int(row))
    return chosen


@pytest.mark.parametrize("samples", [2, 32])
def test_streaks_have_the_length_and_light_of_rate_times_time(samples) -> None:
    """From the image: second moment along the streak gives the length within 0.05 px; its sum the flux within 0.5 %."""
    motion = {"rate_deg_s": [0.0, RATE_DEG_S, 0.0], "samples": samples}
    plan, frame = rendered(motion=motion, stars={"limiting_magnitude": 4.5})
    focal = plan.spec.camera.f_px
    sigma2 = plan.spec.camera.psf_sigma_px**2 + 1 / 12
    checked = 0
    for row in alone(frame, 40, 25)[:12]:
        u, v = frame.u_px[row], frame.v_px[row]
        window = np.s_[round(v) - 9 : round(v) + 10, round(u) - 22 : round(u) + 23]
        light = frame.electrons[window].astype(float)
        rows, columns = np.mgrid[window]
        total = light.sum()
        assert total == pytest.approx(frame.star_electrons[row], rel=5e-3)
        mean = (light * columns).sum() / total
        length = np.sqrt(12 * ((light * (columns - mean) ** 2).sum() / total - sigma2))
        # Turning right about y by omega t moves the image left: du/dt = -f omega (1 + (u - cx)^2 / f^2).
        x, y = (u - 269.5) / focal, (v - 179.5) / focal
        by_hand = focal * np.radians(RATE_DEG_S * EXPOSURE_S) * (1 + x * x)
        rise = focal * np.radians(RATE_DEG_S * EXPOSURE_S) * x * y
        assert length == pytest.approx(by_hand, abs=0.05)
        truth = frame.end_px[row] - frame.start_px[row]
        assert truth[0] == pytest.approx(-by_hand, abs=0.05)
        assert truth[1] == pytest.approx(-rise, abs=0.05)
        assert frame.centroid_px[row] == pytest.approx([mean, (light * rows).sum() / total], abs=0.02)
        checked += 1
    assert checked >= 4


def test_attitude_at_the_ends_is_the_rate_s() -> None:
    plan, _ = rendered(motion={"rate_deg_s": [3.0, -2.0, 5.0]})
    assert plan.motion.R_mid == pytest.approx(plan.spec.R_cam)
    omega = np.radians([3.0, -2.0, 5.0]) * EXPOSURE_S / 2
    wanted = Rotation.from_rotvec(-omega).as_matrix() @ plan.spec.R_cam
    np.testing.assert_allclose(plan.motion.R_cam[-1], wanted, atol=1e-12)
    # A roll about the boresight (z) by a positive angle turns x towards y: the camera's right towards its down.
    turned = Rotation.from_rotvec([0, 0, -0.1]).as_matrix()
    np.testing.assert_allclose(turned.T @ [1, 0, 0], [np.cos(0.1), np.sin(0.1), 0], atol=1e-12)


@pytest.mark.parametrize("direction", ["down", "up"])
def test_rolling_shutter_shears_as_computed_by_hand(direction) -> None:
    """u shifts by speed x line time x rows from the middle, within 0.05 px; the light stays, within 0.5 %."""
    motion = {"rate_deg_s": [0.0, RATE_DEG_S, 0.0]}
    short = {"motion": motion, "time__exposure_s": 0.1}
    plan, still = rendered(**short)
    rolled_plan, rolled = rendered(
        **short, sensor={"rolling_shutter": {"line_time_us": 500.0, "direction": direction}},
        # The same middle of the shutter's time, so that the sky stands alike.
        time__utc_start="2020-01-15T19:59:59.910250Z",
    )  # fmt: skip
    assert rolled_plan.spec.shutter_s == pytest.approx(0.1 + 359 * 500e-6)
    focal = plan.spec.camera.f_px
    rows = alone(still, 20, 25)
    assert len(rows) > 20
    for row, same in zip(rows, same_stars(plan, rolled_plan, rows), strict=True):
        x, y = (still.u_px[row] - 269.5) / focal, (still.v_px[row] - 179.5) / focal
        delay = 500e-6 * (rolled.v_px[same] - 179.5) * (1 if direction == "down" else -1)
        speed = -focal * np.radians(RATE_DEG_S)
        assert rolled.u_px[same] - still.u_px[row] == pytest.approx(speed * (1 + x * x) * delay, abs=0.05)
        assert rolled.v_px[same] - still.v_px[row] == pytest.approx(speed * x * y * delay, abs=0.05)
        assert rolled.star_electrons[same] == pytest.approx(still.star_electrons[row], rel=5e-3)


def test_a_star_that_follows_the_readout_is_exposed_longer() -> None:
    """Moving down at s rows per second under a line time L, a star gets 1 / (1 - s L) of its light."""
    rate = 20.0
    shutter = {"rolling_shutter": {"line_time_us": 200.0}}
    for sign in (1, -1):
        motion = {"rate_deg_s": [sign * rate, 0.0, 0.0], "samples": 200}
        plan, frame = rendered(motion=motion, sensor=shutter, time__exposure_s=0.05)
        still_plan, still = rendered(sensor=shutter, time__exposure_s=0.05)
        near = (np.abs(frame.u_px - 269.5) < 120) & (np.abs(frame.v_px - 179.5) < 40) & (frame.star_electrons > 0)
        assert near.sum() > 3
        # Turning about x (right) by omega moves the image by +f omega (1 + y^2) along v.
        y = (frame.v_px[near] - 179.5) / plan.spec.camera.f_px
        speed = sign * plan.spec.camera.f_px * np.radians(rate) * (1 + y * y)
        ratio = frame.star_electrons[near] / still.star_electrons[same_stars(plan, still_plan, near)]
        np.testing.assert_allclose(ratio, 1 / (1 - speed * 200e-6), rtol=0.01)


def test_polynomial_and_gyro_log_of_a_constant_rate_are_that_rate(tmp_path) -> None:
    time = np.linspace(0, 0.5, 17)

    def stream(name):
        raise AssertionError("nothing random here")

    rate = body_rotation(MotionSpec(rate_deg_s=(4.0, 0.0, 0.0)), time, 0.5, stream)
    polynomial = body_rotation(MotionSpec(polynomial_deg=((4.0,), (), ())), time, 0.5, stream)
    assert (rate * polynomial.inv()).magnitude().max() < 1e-12
    (tmp_path / "gyro.csv").write_text("t,wx,wy,wz\n0,1,2,3\n0.25,1,2,3\n0.7,1,2,3\n")
    scenario = scenario_in(tmp_path, motion={"gyro_log": "gyro.csv"})
    logged = plan_frame(scenario, 0).motion
    plain = plan_frame(small_scenario(motion={"rate_deg_s": [1.0, 2.0, 3.0]}), 0).motion
    np.testing.assert_allclose(logged.R_cam, plain.R_cam, atol=1e-9)


def test_gyro_log_with_a_ramp_is_integrated(tmp_path) -> None:
    """w(t) = 8 t deg/s about z: from mid-exposure (0.25 s) to the end (0.5 s) it turns 4 (0.25 - 0.0625) = 0.75 deg."""
    (tmp_path / "gyro.csv").write_text("t,wx,wy,wz\n" + "".join(f"{t},0,0,{8 * t}\n" for t in (0, 0.1, 0.3, 0.6)))
    motion = plan_frame(scenario_in(tmp_path, motion={"gyro_log": "gyro.csv"}), 0).motion
    turned = Rotation.from_matrix(motion.R_cam[-1] @ motion.R_mid.T).as_rotvec(degrees=True)
    np.testing.assert_allclose(turned, [0, 0, -0.75], atol=5e-4)


def scenario_in(folder, **overrides):
    return parse_scenario(yaml.safe_dump(BASE | overrides), str(folder / "scene.yaml"))


def test_vibration_s_spectrum_is_recovered_from_the_attitude() -> None:
    """Welch's estimate over 30 draws: every frequency of a band within 4 standard errors, none outside; the variance too."""
    part = VibrationSpec(axis="y", psd_deg2_hz=((10.0, 1e-6), (30.0, 4e-6), (60.0, 1e-6)))
    rate, count = 256.0, 1024
    time = np.arange(count) / rate
    draws = np.array([vibration(part, time, random_stream(2, "test", n)) for n in range(30)])
    frequency, density = signal.welch(draws, rate, nperseg=256, axis=-1)
    mean, error = density.mean(axis=0), density.std(axis=0, ddof=1) / np.sqrt(30)
    inside = (frequency > 12) & (frequency < 58)
    wanted = np.interp(frequency, [10, 30, 60], [1e-6, 4e-6, 1e-6])
    assert (np.abs(mean - wanted)[inside] / error[inside]).max() < 4.5
    assert (mean[inside] / wanted[inside]).mean() == pytest.approx(1, abs=0.03)
    assert mean[(frequency > 65) | ((frequency > 2) & (frequency < 5))].max() < 1e-8
    assert draws.var() == pytest.approx(20 * 2.5e-6 + 30 * 2.5e-6, rel=0.05)


@pytest.mark.parametrize("centre_hz", [20.0, 20.1, 33.333, 47.61, 59.9])
@pytest.mark.parametrize("width_hz", [0.02, 2.0])
def test_a_narrow_line_of_vibration_has_its_power(centre_hz, width_hz) -> None:
    """A triangular line has half its width times its height, whatever bin it falls into; over 600 draws within 4 standard
    errors of a single tone's, and all of it at its frequency."""
    half = width_hz / 2
    psd = ((5.0, 0.0), (centre_hz - half, 0.0), (centre_hz, 1e-2), (centre_hz + half, 0.0), (80.0, 0.0))
    part = VibrationSpec(axis="y", psd_deg2_hz=psd)
    time = np.linspace(0, 0.4, 64)
    draws = np.array([vibration(part, time, random_stream(2, "line", n)) for n in range(600)])
    exact = half * 1e-2
    power = (draws**2).mean(axis=1)
    assert power.mean() == pytest.approx(exact, abs=4 * power.std() / np.sqrt(600) + 1e-9)
    assert power.std() / np.sqrt(600) < 0.05 * exact
    if width_hz < 1:
        phase = 2 * np.pi * centre_hz * time
        tone = np.stack([np.cos(phase), np.sin(phase)], axis=1)
        left = draws.T - tone @ np.linalg.lstsq(tone, draws.T, rcond=None)[0]
        assert (left**2).mean() < 1e-3 * exact


def test_white_vibration_has_equal_tones_in_the_middle_of_equal_bins() -> None:
    """To the bit: frames of the benchmark have white vibration."""
    part = VibrationSpec(axis="x", psd_deg2_hz=((5.0, 1e-4), (25.0, 1e-4)))
    time = np.linspace(0, 0.3, 32)
    edges = np.linspace(5.0, 25.0, 65)
    tones, power = (edges[1:] + edges[:-1]) / 2, 1e-4 * np.diff(edges)
    cosine, sine = random_stream(4, "white", 0).normal(size=(2, 64)) * np.sqrt(power)
    phase = 2 * np.pi * np.outer(time, tones)
    np.testing.assert_array_equal(
        vibration(part, time, random_stream(4, "white", 0)), np.cos(phase) @ cosine + np.sin(phase) @ sine
    )


def test_vibration_reaches_the_attitude_samples() -> None:
    """The angles between nominal and sampled attitudes are the process itself, about its axis."""
    vibrating = {"vibration": [{"axis": "x", "psd_deg2_hz": [[5.0, 1e-3], [20.0, 1e-3]]}], "samples": 64}
    plan = plan_frame(small_scenario(motion=vibrating), 0)
    turned = Rotation.from_matrix(plan.motion.R_cam @ plan.spec.R_cam.T).as_rotvec(degrees=True)
    part = plan.spec.motion.vibration[0]
    wanted = vibration(part, plan.motion.time_s, random_stream(7, "motion.vibration.0", 0))
    np.testing.assert_allclose(turned[:, 0], -wanted, atol=1e-9)
    assert np.abs(turned[:, 1:]).max() < 1e-9


def test_gimbal_jitter_has_its_spread_and_memory() -> None:
    """Standard deviation within 3 %, correlation e^-1 after the correlation time within 0.03."""
    time = np.arange(40000) * 0.02
    angles = gimbal_jitter(GimbalSpec(sigma_deg=0.3, correlation_s=0.1), time, random_stream(3, "test", 0))
    assert angles.std() == pytest.approx(0.3, rel=0.03)
    lagged = np.mean(angles[5:] * angles[:-5]) / angles.var()
    assert lagged == pytest.approx(np.exp(-1), abs=0.03)


def test_gyroscope_reads_rate_bias_and_noise() -> None:
    """Mean within 4 standard errors of rate + bias; scatter density / sqrt(interval) within 5 %."""
    imu = {"rate_hz": 2000.0, "noise_deg_s_rthz": 0.01, "bias_deg_s": [0.1, -0.2, 0.3]}
    motion = {"rate_deg_s": [1.0, 2.0, -3.0], "imu": imu}
    plan = plan_frame(small_scenario(motion=motion, time__exposure_s=1.0), 0)
    reading = plan.motion.imu
    assert reading is not None
    assert reading.rate_deg_s.shape == (2000, 3)
    sigma = 0.01 * np.sqrt(2000)
    np.testing.assert_allclose(reading.rate_deg_s.mean(axis=0), [1.1, 1.8, -2.7], atol=4 * sigma / np.sqrt(2000))
    np.testing.assert_allclose(reading.rate_deg_s.std(axis=0), sigma, rtol=0.06)
    still = plan_frame(small_scenario(motion={"imu": imu}), 0).motion.imu
    assert still is not None
    np.testing.assert_allclose(still.rate_deg_s.mean(axis=0), [0.1, -0.2, 0.3], atol=4 * sigma / np.sqrt(1000))


def test_long_exposures_follow_the_stars_arcs() -> None:
    """Half an hour looking at the pole: the truth's ends lie on the circle about it, 7.5 deg apart."""
    attitude = {"azimuth_deg": 0.0, "altitude_deg": 52.0}
    plan, frame = rendered(attitude=attitude, time__exposure_s=1800.0, atmosphere={"refraction": False})
    inside = np.isfinite(frame.end_px[:, 0]) & (frame.fraction_in_frame > 0.99)
    focal = plan.spec.camera.f_px

    def angle_about_pole(position):
        direction = np.stack(
            [(position[:, 0] - 269.5) / focal, (position[:, 1] - 179.5) / focal, np.ones(len(position))], 1
        )
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        return direction

    start, middle, end = (
        angle_about_pole(p[inside]) for p in (frame.start_px, np.stack([frame.u_px, frame.v_px], 1), frame.end_px)
    )
    colatitude = [np.arccos(d[:, 2]) for d in (start, middle, end)]
    np.testing.assert_allclose(colatitude[0], colatitude[1], atol=2e-4)
    np.testing.assert_allclose(colatitude[2], colatitude[1], atol=2e-4)
    turn = np.abs(np.angle((end[:, 0] + 1j * end[:, 1]) / (start[:, 0] + 1j * start[:, 1])))
    far = colatitude[1] > np.radians(3)
    np.testing.assert_allclose(np.degrees(turn[far]), 1800 / 86164.1 * 360, atol=0.02)


def test_bad_motion_is_refused(tmp_path) -> None:
    (tmp_path / "short.csv").write_text("t,wx,wy,wz\n0,0,0,0\n0.3,0,0,0\n")
    (tmp_path / "columns.csv").write_text("t,wx\n0,0\n1,0\n")
    (tmp_path / "falling.csv").write_text("t,wx,wy,wz\n0,0,0,0\n1,0,0,0\n0.5,0,0,0\n")
    fast = [{"axis": "x", "psd_deg2_hz": [[10.0, 1e-6], [400.0, 1e-6]]}]
    falling = [{"axis": "x", "psd_deg2_hz": [[10.0, 1e-6], [4.0, 1e-6]]}]
    cases = [
        ({"gyro_log": "short.csv"}, ["motion.gyro_log", "covers 0 to 0.3 s", "open from 0 to 0.5 s"]),
        ({"gyro_log": "columns.csv"}, ["motion.gyro_log", "t, wx, wy, wz"]),
        ({"gyro_log": "falling.csv"}, ["motion.gyro_log", "line 4", "column t", "values that increase"]),
        ({"gyro_log": "none.csv"}, ["motion.gyro_log", "cannot be read"]),
        ({"vibration": fast}, ["motion.samples", "32", "400 Hz"]),
        ({"vibration": falling}, ["motion.vibration.0", "frequencies must increase"]),
        ({"rate_deg_s": [1.0, 2.0]}, ["motion.rate_deg_s"]),
    ]
    for motion, fragments in cases:
        with pytest.raises(ScenarioError) as caught:
            scenario_in(tmp_path, motion=motion)
        for fragment in fragments:
            assert fragment in str(caught.value)
