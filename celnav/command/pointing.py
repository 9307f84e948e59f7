"""Pointing: azimuth, altitude and roll of the boresight, the human-readable form of an attitude."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from celnav.errors import AttitudeError

# Sine of the zenith distance below which azimuth and roll are rotations about the same axis.
_POLE = 1e-9


@dataclass(frozen=True)
class Pointing:
    """Direction of the boresight, and roll of the camera about it (docs/conventions.md).

    Attributes
    ----------
    azimuth_deg : float
        Azimuth, from north through east.
    altitude_deg : float
        Apparent altitude, -90 to 90.
    roll_deg : float
        Clockwise rotation of the camera as seen by its holder; at 0 the top of the image is towards the zenith.

    Raises
    ------
    AttitudeError
        When an angle is not finite, or the altitude is outside -90 to 90 degrees.
    """

    azimuth_deg: float
    altitude_deg: float
    roll_deg: float = 0.0

    def __post_init__(self) -> None:
        for name in ("azimuth_deg", "altitude_deg", "roll_deg"):
            if not math.isfinite(getattr(self, name)):
                raise AttitudeError(f"{name} = {getattr(self, name)} must be a finite number of degrees")
        if abs(self.altitude_deg) > 90:
            raise AttitudeError(f"altitude_deg = {self.altitude_deg} must lie between -90 and 90")

    @property
    def R_cam(self) -> NDArray[np.float64]:
        """The rotation from east-north-up to the camera, shape (3, 3)."""
        azimuth, altitude, roll = np.radians([self.azimuth_deg, self.altitude_deg, self.roll_deg])
        sin_a, cos_a, sin_h, cos_h = np.sin(azimuth), np.cos(azimuth), np.sin(altitude), np.cos(altitude)
        right = np.array([cos_a, -sin_a, 0.0])
        up = np.array([-sin_a * sin_h, -cos_a * sin_h, cos_h])
        return np.array(
            [
                np.cos(roll) * right - np.sin(roll) * up,
                -np.sin(roll) * right - np.cos(roll) * up,
                [sin_a * cos_h, cos_a * cos_h, sin_h],
            ]
        )

    @classmethod
    def of(cls, R_cam: ArrayLike) -> Pointing:
        """Return the pointing of a rotation from east-north-up to the camera, shape (3, 3).

        Azimuth is from 0 to 360, and roll above -180 to 180. At the zenith and the nadir, where only their sum or difference
        is defined, the azimuth is 180: a camera that points at the zenith with north up has a roll of 0.
        """
        right, _, boresight = np.asarray(R_cam, dtype=np.float64)
        horizontal = math.hypot(boresight[0], boresight[1])
        altitude = math.atan2(boresight[2], horizontal)
        sin_a, cos_a = boresight[:2] / horizontal if horizontal > _POLE else (0.0, -1.0)
        azimuth = math.atan2(sin_a, cos_a)
        across = np.array([cos_a, -sin_a, 0.0])
        up = np.cross(across, boresight)
        roll = math.atan2(-float(right @ up), float(right @ across))
        return cls(math.degrees(azimuth) % 360.0 % 360.0, math.degrees(altitude), _half_open(math.degrees(roll)))


def _half_open(angle_deg: float) -> float:
    """Return -180 as 180, so that half a turn has a unique value."""
    return 180.0 if angle_deg == -180.0 else angle_deg + 0.0
