"""Rotation of the camera during the exposure, and the readings of a gyroscope on it.

Body rates are about the camera's axes (x right, y down, z along the boresight): the attitude R (world to camera) obeys
dR/dt = -[omega]x R. Vibration is a stationary Gaussian process, synthesised from its one-sided power spectral density as
a sum of cosines with Rayleigh amplitudes and uniform phases (Shinozuka & Deodatis 1991, Applied Mechanics Reviews 44,
191). A gimbal's jitter is an Ornstein-Uhlenbeck process, drawn with its exact transition (Gillespie 1996, Phys. Rev. E
54, 2084). The gyroscope's reading is the mean rate over each sampling interval plus bias and white noise (IEEE Std 952,
angle random walk: noise density over the square root of the interval).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from generator.scenario.gyro_log import check_motion, read_gyro_log
from generator.scenario.motion_spec import AXES, GimbalSpec, ImuSpec, MotionSpec, VibrationSpec
from generator.seeds import random_stream

if TYPE_CHECKING:
    from generator.scenario.model import FrameSpec

Floats = NDArray[np.float64]
Stream = Callable[[str], np.random.Generator]
Path = Callable[[Floats], Rotation]

MOST_TONES = 4000


@dataclass(frozen=True)
class ImuReading:
    """A gyroscope's reading.

    Attributes
    ----------
    time_s : (m,) array
        End of each sampling interval, s from the start of the shutter's time.
    rate_deg_s : (m, 3) array
        Rates about x, y, z.
    bias_deg_s : (3,) array
        Bias that the rates contain.
    """

    time_s: Floats
    rate_deg_s: Floats
    bias_deg_s: Floats


@dataclass(frozen=True)
class Motion:
    """The camera's attitude over the shutter's time.

    Attributes
    ----------
    time_s : (k,) array
        Evenly spaced times, s from the start.
    R_cam : (k, 3, 3) array
        Attitudes, ENU to camera.
    R_mid : (3, 3) array
        Attitude at the middle.
    imu : ImuReading or None
    """

    time_s: Floats
    R_cam: Floats
    R_mid: Floats
    imu: ImuReading | None


def plan_motion(spec: FrameSpec, seed: int, index: int, path: Path | None = None) -> Motion:
    """Attitudes of frame `index` of a scenario with root `seed`.

    Parameters
    ----------
    spec : FrameSpec
    seed, index : int
    path : callable, optional
        Attitudes (east-north-up to camera) at times (k) after the start of the exposure, for a camera that is carried
        along a path; its own motion is added. By default, the frame's attitude.

    Raises
    ------
    MotionError
        A gyro log does not cover the exposure, or vibration is too fast for the number of samples.
    """
    motion, duration = spec.motion, spec.shutter_s
    nominal = Rotation.from_matrix(spec.R_cam)

    def stream(name: str) -> np.random.Generator:
        return random_stream(seed, f"motion.{name}", index)

    if path is not None:
        return _carried(motion, path, duration, stream)
    if motion.still:
        time = np.zeros(1)
        follow = Slerp([0.0, duration], Rotation.concatenate([nominal, nominal]))
        imu = None if motion.imu is None else _imu_reading(motion.imu, follow, duration, stream)
        return Motion(time, spec.R_cam[None], spec.R_cam, imu)
    check_motion(motion, duration)
    time = np.linspace(0.0, duration, motion.samples)
    turned = body_rotation(motion, time, duration, stream) * nominal
    follow = Slerp(time, turned)
    imu = None if motion.imu is None else _imu_reading(motion.imu, follow, duration, stream)
    return Motion(time, turned.as_matrix(), follow([duration / 2]).as_matrix()[0], imu)


def _carried(motion: MotionSpec, path: Path, duration_s: float, stream: Stream) -> Motion:
    """Attitudes on a path; exact at the middle if the camera has no motion of its own."""
    check_motion(motion, duration_s)
    time, middle = np.linspace(0.0, duration_s, motion.samples), np.array([duration_s / 2])
    own = body_rotation(motion, time, duration_s, stream)
    return Motion(time, (own * path(time)).as_matrix(), (Slerp(time, own)(middle) * path(middle)).as_matrix()[0], None)


def body_rotation(motion: MotionSpec, time_s: Floats, duration_s: float, stream: Stream) -> Rotation:
    """Rotations (k) that take the camera frame at rest to the camera frame at each time."""
    middle = duration_s / 2
    from_middle = time_s - middle
    turn = Rotation.from_rotvec(-np.radians(np.outer(from_middle, motion.rate_deg_s)))
    angles = np.zeros((len(time_s), 3))
    for axis, coefficients in enumerate(motion.polynomial_deg):
        angles[:, axis] = sum((c * from_middle ** (i + 1) for i, c in enumerate(coefficients)), np.zeros(len(time_s)))
    turn = Rotation.from_rotvec(-np.radians(angles)) * turn
    if motion.gyro_log is not None:
        turn = _logged_rotation(read_gyro_log(motion.gyro_log), time_s, middle) * turn
    angles = np.zeros((len(time_s), 3))
    for number, part in enumerate(motion.vibration):
        angles[:, AXES.index(part.axis)] += vibration(part, time_s, stream(f"vibration.{number}"))
    if motion.gimbal is not None:
        angles += gimbal_jitter(motion.gimbal, time_s, stream("gimbal"))
    return Rotation.from_rotvec(-np.radians(angles)) * turn


def vibration(part: VibrationSpec, time_s: Floats, random: np.random.Generator) -> Floats:
    """Angle, deg, at times (k,) of a Gaussian process with the part's one-sided power spectral density."""
    frequency, density = np.array(part.psd_deg2_hz).T
    span = max(time_s[-1] - time_s[0], 1e-6)
    # The tones are closer than the time's own resolution, so that the process does not repeat within it.
    count = int(np.clip(np.ceil((frequency[-1] - frequency[0]) * span * 4), 64, MOST_TONES))
    tones, power = _tones(frequency, density, count)
    # Normal sine and cosine amplitudes are equivalent to Rayleigh amplitudes and uniform phases.
    cosine, sine = random.normal(size=(2, count)) * np.sqrt(power)
    phase = 2 * np.pi * np.outer(time_s, tones)
    return np.cos(phase) @ cosine + np.sin(phase) @ sine


def _tones(frequency: Floats, density: Floats, count: int) -> tuple[Floats, Floats]:
    """Frequencies and powers (count,) of tones that stand for equal bins of a density, which is linear between its points.

    The power is the density's integral over the bin, and the frequency the bin's centroid, so that a line that is
    narrower than a bin has all of its power.
    """
    edges = np.linspace(frequency[0], frequency[-1], count + 1)
    middle, width = (edges[1:] + edges[:-1]) / 2, np.diff(edges)
    # Integrals of the deviation from the value in the middle of the bin are exactly zero for a constant density.
    level = np.interp(middle, frequency, density)
    knots = np.unique(np.concatenate([edges, frequency]))
    owner = np.clip(np.searchsorted(edges, knots[:-1], side="right") - 1, 0, count - 1)
    step, value = np.diff(knots), np.interp(knots, frequency, density)
    left, right = value[:-1] - level[owner], value[1:] - level[owner]
    before, after = knots[:-1] - middle[owner], knots[1:] - middle[owner]
    excess = np.bincount(owner, step * (left + right) / 2, count)
    moment = np.bincount(owner, step * (left * (2 * before + after) + right * (before + 2 * after)) / 6, count)
    power = np.maximum(level * width + excess, 0)
    shift = np.divide(moment, power, out=np.zeros(count), where=power > 0)
    return middle + np.clip(shift, -width / 2, width / 2), power


def gimbal_jitter(gimbal: GimbalSpec, time_s: Floats, random: np.random.Generator) -> Floats:
    """Angles, deg, (k, 3): an Ornstein-Uhlenbeck process about each axis, stationary from the start."""
    draws = random.normal(size=(len(time_s), 3)) * gimbal.sigma_deg
    angles = np.empty_like(draws)
    angles[0] = draws[0]
    for step in range(1, len(time_s)):
        kept = math.exp(-(time_s[step] - time_s[step - 1]) / gimbal.correlation_s)
        angles[step] = kept * angles[step - 1] + math.sqrt(1 - kept * kept) * draws[step]
    return angles


def _logged_rotation(log: Floats, time_s: Floats, middle_s: float) -> Rotation:
    """Rotations relative to mid-exposure from the log's rates, linear between its rows, with the midpoint rule."""
    moments = np.unique(np.concatenate([log[:, 0], time_s, [middle_s]]))
    halfway = (moments[1:] + moments[:-1]) / 2
    rates = np.stack([np.interp(halfway, log[:, 0], log[:, axis]) for axis in (1, 2, 3)], axis=1)
    steps = Rotation.from_rotvec(-np.radians(rates) * np.diff(moments)[:, None])
    turned = [Rotation.identity()]
    for step in steps:
        turned.append(step * turned[-1])
    path = Rotation.concatenate(turned)
    return path[np.searchsorted(moments, time_s)] * path[int(np.searchsorted(moments, middle_s))].inv()


def _imu_reading(imu: ImuSpec, attitude: Callable[[Floats], Rotation], duration_s: float, stream: Stream) -> ImuReading:
    count = max(1, int(duration_s * imu.rate_hz + 1e-9))
    edges = np.minimum(np.arange(count + 1) / imu.rate_hz, duration_s)
    poses = attitude(edges)
    interval = np.diff(edges)[:, None]
    true_rate = -np.degrees((poses[1:] * poses[:-1].inv()).as_rotvec()) / interval
    bias = np.array(imu.bias_deg_s) + imu.bias_sigma_deg_s * stream("imu.bias").normal(size=3)
    noise = imu.noise_deg_s_rthz / np.sqrt(interval) * stream("imu.noise").normal(size=true_rate.shape)
    return ImuReading(edges[1:], true_rate + bias + noise, bias)


def turned_rad(R_cam: Floats) -> float:
    """Sum of the angles, rad, between successive attitudes (k, 3, 3)."""
    turns = Rotation.from_matrix(R_cam)
    return float((turns[1:] * turns[:-1].inv()).magnitude().sum()) if len(R_cam) > 1 else 0.0
