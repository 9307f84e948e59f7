"""The camera's attitude, fully or partly known."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from celnav.checking import finite_number, real_array, shown
from celnav.errors import AttitudeError

Kind = Literal["rotation", "up"]
_Rows = tuple[tuple[float, float, float], ...]
ROTATION_TOLERANCE = 1e-6
_SIGMA_KEYS = ("tilt_sigma_deg", "heading_sigma_deg")
# Keys of the section "attitude" of frame records (docs/dataset_format.md). Only R_cam and the sigmas are used here.
_KEYS = {
    "R_cam", *_SIGMA_KEYS, "azimuth_deg", "altitude_deg", "roll_deg", "sample_time_s", "sample_R_cam", "imu_time_s",
    "imu_rate_deg_s", "imu_bias_deg_s",
}  # fmt: skip
_LARGEST_ENTRY = 1e100  # its square is still a float


@dataclass(frozen=True)
class Attitude:
    """An attitude that is exact, uncertain, or only a vertical; made with `exact`, `with_sigma` or `up`.

    Attributes
    ----------
    kind : str
        ``rotation`` (all three angles known) or ``up`` (the heading is not).
    rows : tuple
        The three rows of `R_cam`, or the up vector in the camera frame as a single row.
    tilt_deg, heading_deg : float
        Standard deviations: of the tilt about each horizontal axis, and of the heading.
    """

    kind: Kind
    rows: _Rows
    tilt_deg: float = 0.0
    heading_deg: float = 0.0

    @classmethod
    def exact(cls, R_cam: ArrayLike) -> Attitude:
        """Make an exactly known attitude from the 3x3 matrix that takes ENU to the camera frame."""
        return cls("rotation", _rotation_rows(R_cam))

    @classmethod
    def with_sigma(cls, R_cam: ArrayLike, *, tilt_deg: float, heading_deg: float) -> Attitude:
        """Make an attitude with standard deviations of tilt (about each horizontal axis) and heading, degrees."""
        return cls("rotation", _rotation_rows(R_cam), _sigma("tilt_deg", tilt_deg), _sigma("heading_deg", heading_deg))

    @classmethod
    def up(cls, vector_in_camera_frame: ArrayLike, tilt_deg: float = 0.0) -> Attitude:
        """Make an attitude of which only the vertical is known: the direction of the zenith in the camera frame.

        Parameters
        ----------
        vector_in_camera_frame : array_like, shape (3,)
            Components along the camera's axes right, down and boresight; any length.
        tilt_deg : float
            Standard deviation of each of the two tilt angles, degrees.

        Raises
        ------
        AttitudeError
            When the vector is not a valid direction or `tilt_deg` is not a valid standard deviation.
        """
        vector = _finite(vector_in_camera_frame, (3,), "up vector")
        length = float(np.linalg.norm(vector))
        if length == 0.0:
            raise AttitudeError("up vector has no length; give the zenith's direction in the camera frame")
        row = tuple(float(x) for x in vector / length)
        return cls("up", ((row[0], row[1], row[2]),), _sigma("tilt_deg", tilt_deg), math.inf)

    @classmethod
    def zenith_north_up(cls) -> Attitude:
        """Make the attitude of a camera that looks at the zenith, with north at the top of the image and east at its left."""
        return cls.exact([[-1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]])

    @classmethod
    def from_json(cls, path: str | Path) -> Attitude:
        """Read ``R_cam`` from a JSON file: at the top level, or under ``attitude`` as in frame records and calibrations.

        If ``tilt_sigma_deg`` and ``heading_sigma_deg`` stand next to it, as a calibration writes them, the attitude is
        uncertain. A ``heading_sigma_deg`` of null leaves the heading unknown, as in frames packed for solvers.

        Raises
        ------
        AttitudeError
            When the file cannot be read, or holds no rotation, one sigma without the other, or an unknown key. Unknown
            keys are refused because a misspelt sigma would make the attitude exact.
        """
        try:
            record = json.loads(Path(path).read_text(encoding="utf-8-sig"))
        except OSError as error:
            raise AttitudeError(f"cannot read attitude file {path}: {error.strerror}") from None
        except (ValueError, RecursionError) as error:
            raise AttitudeError(f"attitude file {path} is not JSON: {error}") from None
        inner = isinstance(record, dict) and isinstance(record.get("attitude"), dict)
        if inner:
            record = record["attitude"]
        if not isinstance(record, dict) or "R_cam" not in record:
            raise AttitudeError(f"attitude file {path} holds no R_cam; see docs/dataset_format.md")
        # A rotation at the top level may have other sections of a record next to it.
        unknown = [key for key, value in record.items() if key not in _KEYS and (inner or not isinstance(value, dict))]
        if unknown:
            raise AttitudeError(
                f"attitude file {path}: {shown(unknown[0])} is not known beside R_cam; the standard deviations are "
                f"{' and '.join(_SIGMA_KEYS)}"
            )
        stated = [key for key in _SIGMA_KEYS if key in record]
        if not stated:
            return cls.exact(record["R_cam"])
        if len(stated) < len(_SIGMA_KEYS):
            other = next(key for key in _SIGMA_KEYS if key not in record)
            raise AttitudeError(
                f"attitude file {path} holds {stated[0]} without {other}: give both (0 is exact, a heading's of null unknown)"
            )
        tilt, heading = (record[key] for key in _SIGMA_KEYS)
        if heading is None:
            return cls.up([row[2] for row in _rotation_rows(record["R_cam"])], tilt)
        return cls.with_sigma(record["R_cam"], tilt_deg=tilt, heading_deg=heading)

    @property
    def R_cam(self) -> NDArray[np.float64]:
        """The 3x3 matrix that takes ENU to the camera frame; raises `AttitudeError` if the heading is unknown."""
        if self.kind != "rotation":
            raise AttitudeError("the heading is unknown: there is no full rotation")
        return np.array(self.rows)


def as_attitude(attitude: Attitude | ArrayLike | None) -> Attitude | None:
    """Return an `Attitude` for any value that `celnav.solve` accepts as one."""
    if attitude is None or isinstance(attitude, Attitude):
        return attitude
    return Attitude.exact(attitude)


def _finite(values: ArrayLike, shape: tuple[int, ...], what: str) -> NDArray[np.float64]:
    array = real_array(values, what, AttitudeError)
    if array.shape != shape:
        raise AttitudeError(f"{what} has shape {array.shape}; it must be {shape}")
    if not np.isfinite(array).all():
        raise AttitudeError(f"{what} holds NaN or infinity")
    if np.abs(array).max() > _LARGEST_ENTRY:
        raise AttitudeError(f"{what} holds a number above {_LARGEST_ENTRY:g}")
    return array


def _rotation_rows(R_cam: ArrayLike) -> _Rows:
    matrix = _finite(R_cam, (3, 3), "R_cam")
    if np.abs(matrix @ matrix.T - np.eye(3)).max() > ROTATION_TOLERANCE:
        raise AttitudeError("R_cam is not a rotation: its rows are not orthonormal (ENU to camera is wanted)")
    if np.linalg.det(matrix) < 0:
        raise AttitudeError("R_cam is a reflection, not a rotation: its determinant is -1 (check the handedness)")
    return tuple((float(r[0]), float(r[1]), float(r[2])) for r in matrix)


def _sigma(name: str, value: float) -> float:
    return finite_number(value, name, AttitudeError, least=0.0)
