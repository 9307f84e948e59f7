"""What solvers receive for a camera of real photographs: its lens and its attitude, from a calibration file."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import celnav
from benchmark.errors import PhotographError
from celnav.calibrating.mount_times import AttitudeInTime, attitude_at, read_measured
from celnav.command.attitude_option import read_attitude
from celnav.command.camera_file import read_camera_file
from celnav.sky.utc import parse_utc


@dataclass(frozen=True, eq=False)
class ToldCamera:
    """A camera as solvers receive it.

    Attributes
    ----------
    camera : celnav.Camera
    R_cam : (3, 3) array
        ENU to camera.
    tilt_sigma_deg, heading_sigma_deg : float
        Standard deviations of the attitude; an infinite one means that the heading is unknown.
    measured : tuple of AttitudeInTime
        Attitudes of the calibration's frames, from which that of other frames of the same night is better known; empty where
        the same attitude is supplied for all times.
    """

    camera: celnav.Camera
    R_cam: NDArray[np.float64]
    tilt_sigma_deg: float
    heading_sigma_deg: float
    measured: tuple[AttitudeInTime, ...] = ()

    @classmethod
    def calibrated(cls, found: celnav.CameraCalibration) -> ToldCamera:
        """Make it from a calibration, for any time."""
        mount = found.mount
        return cls(
            found.camera, mount.R_cam, mount.tilt_sigma_deg, mount.heading_sigma_deg, tuple(found.attitudes_in_time)
        )

    def at(self, utc_mid: str) -> ToldCamera:
        """What solvers receive for a photograph: the attitude predicted for its time."""
        if not self.measured:
            return self
        known = attitude_at(self.measured, parse_utc(utc_mid), self._for_another_night)
        return told_by(self.camera, known)

    def for_another_night(self) -> ToldCamera:
        """The same camera with one attitude for all times."""
        return replace(self, measured=())

    @property
    def _for_another_night(self) -> celnav.Attitude:
        return celnav.Attitude.with_sigma(self.R_cam, tilt_deg=self.tilt_sigma_deg, heading_deg=self.heading_sigma_deg)

    @property
    def sigma_px(self) -> float:
        """Uncertainty of a star's position near the axis from that of the attitude, one standard deviation, px."""
        return float(self.camera.f_px * math.radians(math.hypot(self.tilt_sigma_deg, self.heading_sigma_deg)))

    def meaning(self) -> dict[str, Any]:
        """All of its content as data for JSON."""
        return {
            "camera": camera_object(self.camera),
            "R_cam": np.asarray(self.R_cam).tolist(),
            "tilt_sigma_deg": self.tilt_sigma_deg,
            "heading_sigma_deg": None if math.isinf(self.heading_sigma_deg) else self.heading_sigma_deg,
            "measured": [
                [np.asarray(one.R_cam).tolist(), one.tilt_sigma_deg, one.heading_sigma_deg, list(one.mjd)]
                for one in self.measured
            ],
        }


def read_told(camera_file: Path, attitude: str | None = None) -> ToldCamera:
    """Read a camera's file, with its attitude from the same file or from the option ``--attitude``.

    Raises
    ------
    PhotographError
        The file contains no camera or no attitude; the message says what to do.
    """
    try:
        camera = read_camera_file(camera_file).camera
        known = celnav.Attitude.from_json(camera_file) if attitude is None else read_attitude(attitude)
        source = camera_file if attitude is None else Path(attitude)
        measured = read_measured(source) if source.is_file() else ()
    except celnav.CelnavError as error:
        hint = "; give --attitude, or make the file by `celnav calibrate`, which finds it" if attitude is None else ""
        raise PhotographError(f"{error}{hint}") from error
    if known is None:
        raise PhotographError("--attitude unknown: a position needs the vertical; give at least an altitude and a roll")
    return replace(told_by(camera, known), measured=measured)


def told_by(camera: celnav.Camera, known: celnav.Attitude) -> ToldCamera:
    """Combine a camera with what is known about its attitude."""
    rows = np.array(known.rows, dtype=np.float64)
    R_cam = rows if known.kind == "rotation" else _upright(rows[0])
    return ToldCamera(camera, R_cam, known.tilt_deg, known.heading_deg if known.kind == "rotation" else math.inf)


def camera_object(camera: celnav.Camera) -> dict[str, Any]:
    """A camera in the form of the frame record (docs/dataset_format.md)."""
    return {"p": []} | {name: value for name, value in camera.to_dict().items() if name != "uncertainty"}


def _upright(up: NDArray[np.float64]) -> NDArray[np.float64]:
    """A rotation ENU to camera that maps the vertical to a direction of the camera frame, with an arbitrary heading."""
    aside = np.eye(3)[int(np.argmin(np.abs(up)))]
    east = np.cross(aside, up)
    east /= np.linalg.norm(east)
    return np.column_stack((east, np.cross(up, east), up))
