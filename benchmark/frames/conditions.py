"""Conditions by which results are sorted: the true circumstances of a frame, which no solver sees."""

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import celnav
from benchmark.errors import DatasetError
from benchmark.frames.record_values import integer, number, optional_number, text, value
from benchmark.protocol import CameraRecord


@dataclass(frozen=True)
class FrameConditions:
    """True circumstances of a frame, by which results are sorted; a solver never sees them.

    Units are part of the names; None where the frame record has no such value.

    Attributes
    ----------
    latitude_deg, longitude_deg : float
        The site.
    bortle : int or None
    zenith_mag_arcsec2 : float or None
    exposure_s : float
    n_in_field : int
        Number of truth stars, that is, of rows of the frame in the truth table.
    limiting_magnitude : float or None
        Magnitude at which the list of stars is cut.
    moon_altitude_deg, moon_illuminated : float or None
        Apparent altitude, and illuminated fraction of the disk, 0 to 1.
    cloud_optical_depth : float or None
        Mean over the lines of sight to the frame's stars.
    rate_deg_s : float or None
        Mean angular rate of the camera during the exposure.
    fov_deg : float or None
        Angle between the midpoints of the left and right edges of the image.
    azimuth_deg, altitude_deg, roll_deg : float or None
        Pointing of the boresight, apparent, at mid-exposure (docs/conventions.md).
    """

    latitude_deg: float
    longitude_deg: float
    bortle: int | None
    zenith_mag_arcsec2: float | None
    exposure_s: float
    n_in_field: int
    limiting_magnitude: float | None = None
    moon_altitude_deg: float | None = None
    moon_illuminated: float | None = None
    cloud_optical_depth: float | None = None
    rate_deg_s: float | None = None
    fov_deg: float | None = None
    azimuth_deg: float | None = None
    altitude_deg: float | None = None
    roll_deg: float | None = None


@dataclass(frozen=True)
class SequenceStep:
    """Index of a frame's sequence in its scenario and of the frame in its sequence, both from 0."""

    sequence: int
    step: int


def read_step(path: Path, record: Mapping[str, Any]) -> SequenceStep | None:
    """Read a frame's place in its sequence; None for a single frame. Raises DatasetError; `path` is for messages."""
    if record.get("sequence") is None:
        return None
    return SequenceStep(integer(path, record, "sequence.index"), integer(path, record, "sequence.step"))


def read_conditions(
    path: Path,
    record: Mapping[str, Any],
    camera: CameraRecord,
    R_cam: NDArray[np.float64],
    n_in_field: int,
    cloud_optical_depth: NDArray[np.float64] | None,
) -> FrameConditions:
    """Read the circumstances of a frame from its record; `path` is for messages.

    Parameters
    ----------
    path : Path
    record : mapping
    camera : CameraRecord
    R_cam : ndarray, shape (3, 3)
        East-north-up to camera.
    n_in_field : int
    cloud_optical_depth : ndarray, shape (n_in_field,), or None
        Optical depth of cloud in front of each truth star.

    Raises
    ------
    DatasetError
    """
    pointing = celnav.Pointing.of(R_cam)
    bortle = value(path, record, "sky.bortle")
    zenith = value(path, record, "sky.zenith_mag_arcsec2")
    found = FrameConditions(
        latitude_deg=number(path, record, "site.latitude_deg", -90.0, 90.0),
        longitude_deg=number(path, record, "site.longitude_deg", -360.0, 360.0),
        bortle=None if bortle is None else integer(path, record, "sky.bortle", low=1),
        zenith_mag_arcsec2=None if zenith is None else number(path, record, "sky.zenith_mag_arcsec2"),
        exposure_s=number(path, record, "time.exposure_s", 0.0),
        n_in_field=n_in_field,
        limiting_magnitude=optional_number(path, record, "stars.limiting_magnitude"),
        moon_altitude_deg=optional_number(path, record, "sky.moon_altitude_deg"),
        moon_illuminated=_illuminated(optional_number(path, record, "sky.moon_phase_angle_deg")),
        cloud_optical_depth=_mean_or_none(cloud_optical_depth),
        rate_deg_s=_rate_deg_s(path, record),
        fov_deg=_fov_deg(path, camera),
        azimuth_deg=pointing.azimuth_deg,
        altitude_deg=pointing.altitude_deg,
        roll_deg=pointing.roll_deg,
    )
    _check_date(path, found, text(path, record, "time.utc_mid"))
    return found


def site_of(latitude_deg: float, longitude_deg: float, utc: str) -> str:
    """Name a frame's place (to a ten-thousandth of a degree) and night (the date of the preceding noon, local mean time).

    Raises
    ------
    ValueError, OverflowError
        There is no such date.
    """
    instant = _instant(utc)
    night = (instant + timedelta(hours=longitude_deg / 15.0 - 12.0)).date()
    return f"{latitude_deg:+.4f} {longitude_deg:+.4f} {night.isoformat()}"


def _instant(utc: str) -> datetime:
    """Parse a time in UTC; a leap second, which `datetime` does not have, counts as the second before it."""
    return datetime.fromisoformat(utc.replace("T23:59:60", "T23:59:59").replace("Z", "+00:00"))


def _check_date(path: Path, where: FrameConditions, utc: str) -> None:
    try:
        site_of(where.latitude_deg, where.longitude_deg, utc)
    except (ValueError, OverflowError) as error:
        raise DatasetError(
            f"{path}: time.utc_mid: there is no {utc} ({error}); give the frame's date and time"
        ) from error


def _illuminated(phase_angle_deg: float | None) -> float | None:
    """Illuminated fraction of the Moon's disk (Meeus, Astronomical Algorithms, 1998, eq. 48.1)."""
    return None if phase_angle_deg is None else (1.0 + math.cos(math.radians(phase_angle_deg))) / 2.0


def _mean_or_none(values: NDArray[np.float64] | None) -> float | None:
    return None if values is None or not np.isfinite(values).any() else float(np.nanmean(values))


def _rate_deg_s(path: Path, record: Mapping[str, Any]) -> float | None:
    """Angle through which the samples of the attitude turn, per unit of time; 0 where nothing moves the camera."""
    attitude = record.get("attitude", {})
    if "sample_time_s" not in attitude or "sample_R_cam" not in attitude:
        return None
    try:
        time_s = np.asarray(attitude["sample_time_s"], dtype=np.float64)
        rotations = np.asarray(attitude["sample_R_cam"], dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise DatasetError(f"{path}: attitude.sample_R_cam must be matrices, one for each sample_time_s") from error
    if time_s.ndim != 1 or rotations.shape != (len(time_s), 3, 3):
        raise DatasetError(f"{path}: attitude.sample_R_cam must be matrices, one for each sample_time_s")
    if len(time_s) < 2:
        return 0.0
    steps = np.einsum("nij,nkj->nik", rotations[1:], rotations[:-1])
    # Half the chord between the matrices is sqrt(2) sin(angle / 2), which keeps its accuracy at small angles.
    chord = np.linalg.norm(steps - np.eye(3), axis=(1, 2))
    angle = 2.0 * np.arcsin(np.clip(chord / math.sqrt(8.0), 0.0, 1.0))
    return float(np.degrees(angle.sum()) / (time_s[-1] - time_s[0]))


def _fov_deg(path: Path, camera: CameraRecord) -> float | None:
    """Angle from the midpoint of the image's left edge through the boresight to that of its right edge."""
    try:
        lens = celnav.Camera.from_dict(dataclasses.asdict(camera))
    except celnav.CelnavError as error:
        raise DatasetError(f"{path}: camera: {error}") from error
    rays = lens.to_rays([[-0.5, camera.cy_px], [camera.width - 0.5, camera.cy_px]])
    angle = float(np.degrees(np.arctan2(np.hypot(rays[:, 0], rays[:, 1]), rays[:, 2])).sum())
    return angle if math.isfinite(angle) else None
