"""Drift of lens and mount with time and temperature.

Each drifting quantity is an Ornstein-Uhlenbeck process (Uhlenbeck & Ornstein 1930, Phys. Rev. 36, 823): stationary,
Gaussian, with correlation exp(-|t| / time constant). It is a function of only the scenario's seed and the time, so that
any frame can be rendered by itself. The process is a first-order autoregression on steps of 1/32 of the time constant,
summed over the last 8 time constants, with innovations that are drawn in numbered blocks; between steps it is
interpolated linearly, and its variance restored.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from generator.optics.motion import Motion
from generator.scenario.camera_spec import CameraSpec
from generator.scenario.lens.drift_spec import DriftSpec
from generator.seeds import random_stream

STEPS_PER_CONSTANT = 32
BLOCK = 256
"""Number of innovations per draw, and of steps that are summed: the rest has exp(-16) of the variance."""


@dataclass(frozen=True)
class Drift:
    """Deviation of lens and mount from their calibration, which solvers receive.

    Attributes
    ----------
    focal_ppm : float
        Deviation of the focal length, parts per million.
    principal_point_px : (u, v)
    mount_deg : (x, y, z)
        Rotation vector about the camera's axes, deg, from the calibrated camera frame to the true one.
    """

    focal_ppm: float
    principal_point_px: tuple[float, float]
    mount_deg: tuple[float, float, float]

    @property
    def turn(self) -> NDArray[np.float64]:
        """Rotation from the calibrated camera frame to the true one, (3, 3)."""
        return Rotation.from_rotvec(self.mount_deg, degrees=True).as_matrix()

    def camera(self, told: CameraSpec) -> CameraSpec:
        """Return the true camera for a calibrated one."""
        lens = told.projection
        u_px, v_px = self.principal_point_px
        moved = told.model_copy(
            update={
                "hfov_deg": None,
                "focal_length_mm": None,
                "focal_px": lens.f_px * (1 + 1e-6 * self.focal_ppm),
                "principal_u_px": lens.cx_px + u_px,
                "principal_v_px": lens.cy_px + v_px,
            }
        )
        return moved.resting_as(told)

    def motion(self, told: Motion) -> Motion:
        """Return the true attitude for a calibrated one; a gyroscope's readings remain along the calibrated axes."""
        return replace(told, R_cam=self.turn @ told.R_cam, R_mid=self.turn @ told.R_mid)


def drift_at(spec: DriftSpec, seed: int, mjd: float, temperature_c: float) -> Drift:
    """Drift of a scenario with root `seed` at a time (modified Julian date) and a temperature of the air."""

    def sample(name: str, sigma: float) -> float:
        if not sigma:
            return 0.0
        return sigma * wander(seed, f"drift.{name}", mjd * 24, spec.time_constant_h)

    warmer_c = temperature_c - spec.reference_temperature_c
    return Drift(
        sample("focal", spec.focal_ppm) + spec.focal_ppm_per_c * warmer_c,
        (
            sample("principal.u", spec.principal_point_px) + spec.principal_u_px_per_c * warmer_c,
            sample("principal.v", spec.principal_point_px) + spec.principal_v_px_per_c * warmer_c,
        ),
        (
            sample("mount.x", spec.mount_deg),
            sample("mount.y", spec.mount_deg),
            sample("mount.z", spec.mount_deg),
        ),
    )


def wander(seed: int, name: str, time: float, time_constant: float) -> float:
    """Value of a process of unit variance at a time in the same unit as its time constant; fixed by seed and name."""
    place = time / (time_constant / STEPS_PER_CONSTANT)
    first = math.floor(place)
    weight = place - first
    numbers = np.arange(first - BLOCK + 1, first + 2)
    blocks = range(int(numbers[0]) // BLOCK, int(numbers[-1]) // BLOCK + 1)
    drawn = np.concatenate([random_stream(seed, name, block).normal(size=BLOCK) for block in blocks])
    innovations = drawn[numbers - blocks[0] * BLOCK]
    kept = math.exp(-1 / STEPS_PER_CONSTANT)
    fading = kept ** np.arange(BLOCK)[::-1] * math.sqrt((1 - kept**2) / (1 - kept ** (2 * BLOCK)))
    before, after = fading @ innovations[:-1], fading @ innovations[1:]
    # Between steps, linear interpolation would have less variance than at them.
    variance = 1 - 2 * weight * (1 - weight) * (1 - kept)
    return float(((1 - weight) * before + weight * after) / math.sqrt(variance))
