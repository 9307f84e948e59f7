"""The attitude of a mount at a given time, from the frames of a calibration: best known near them, less so hours away.

Each of the three angles is modelled as a process whose correlation falls exponentially with the time between frames (Ornstein
& Uhlenbeck 1930, Phys. Rev. 36, 823): frames a minute apart share its value, frames of different nights only its mean. The
value at another time is the best linear prediction with unknown mean (ordinary kriging; Cressie 1993, Statistics for Spatial
Data, section 3.2).
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from celnav.attitude import Attitude
from celnav.calibrating.mount import USUAL_WANDER_DEG, USUAL_WEIGHT, mean_rotation, turned, turns_deg
from celnav.checking import finite_number
from celnav.errors import AttitudeError
from celnav.sky.utc import Utc

F8 = NDArray[np.float64]

MEMORY_H = 4.0
"""Hours after which the correlation has fallen to 1/e, from 115 frames of a meteor camera on two nights, whose attitudes
differ by 0.004 deg after a quarter of an hour and by 0.01 to 0.02 deg after two hours (docs/camera_calibration.md)."""
SAME_NIGHT_H = 12.0
"""At this many hours or more from all frames, the attitude is that for another night."""
LEAST_SIGMA_DEG = 1e-4
"""Least standard deviation of a frame's attitude: a third of an arcsecond, like star positions and refraction."""
MOST_FRAMES = 2000
"""Most frames of a calibration file, as many as a calibration takes."""


@dataclass(frozen=True, eq=False)
class AttitudeInTime:
    """A measured attitude: rotation from east-north-up to camera, its sigmas (deg), and the times of its frames (MJD)."""

    R_cam: F8
    tilt_sigma_deg: float
    heading_sigma_deg: float
    mjd: tuple[float, ...]


def attitude_at(measured: Sequence[AttitudeInTime], utc: Utc, another_night: Attitude) -> Attitude:
    """Predict the attitude at a time.

    Parameters
    ----------
    measured : sequence of AttitudeInTime
        Attitudes of the calibration's frames, or of its nights.
    utc : Utc
        The time.
    another_night : Attitude
        Attitude of the mount for a future night, which applies `SAME_NIGHT_H` hours away from all frames.

    Returns
    -------
    Attitude
        The attitude with its standard deviations; if the frames themselves differ by more than mounts usually do, that
        scatter is included.
    """
    moment = utc.mjd
    nearest = [min(one.mjd, key=lambda mjd: abs(mjd - moment)) for one in measured]
    hours = 24 * (np.array(nearest) - moment)
    if not len(hours) or np.abs(hours).min() > SAME_NIGHT_H:
        return another_night
    rotations = np.stack([one.R_cam for one in measured])
    reference = mean_rotation(rotations)
    turns = turns_deg(rotations, reference)
    tilt = np.array([one.tilt_sigma_deg for one in measured])
    heading = np.array([one.heading_sigma_deg for one in measured])
    mean, variance = np.empty(3), np.empty(3)
    for axes, noise in ((slice(0, 2), tilt), (slice(2, 3), heading)):
        mean[axes], variance[axes] = _predicted(hours, turns[:, axes], noise)
    about = np.sqrt(variance)
    return Attitude.with_sigma(
        turned(reference, mean), tilt_deg=float(np.hypot(*about[:2]) / math.sqrt(2)), heading_deg=float(about[2])
    )


def _predicted(hours: F8, turns: F8, noise: F8) -> tuple[F8, float]:
    """Predict angles, shape (n, a), measured `hours` from the time with errors `noise`, (n,); and their variance, deg^2."""
    count, axes = turns.shape
    noise = np.maximum(noise, LEAST_SIGMA_DEG)
    ones = np.ones(count)
    correlation = np.exp(-np.abs(hours[:, None] - hours) / MEMORY_H)
    # The prior of the variance counts as some nights with the usual wander, as in `mount_of`.
    weight = np.linalg.inv(correlation + np.diag(noise**2 / USUAL_WANDER_DEG**2))
    kept = weight - np.outer(weight @ ones, ones @ weight) / (ones @ weight @ ones)
    square = float(np.einsum("na,nm,ma->", turns, kept, turns)) / axes
    variance = (USUAL_WEIGHT * USUAL_WANDER_DEG**2 + square) / (USUAL_WEIGHT + count - 1)
    with_now = np.exp(-np.abs(hours) / MEMORY_H)
    weight = np.linalg.inv(correlation + np.diag(noise**2 / variance))
    lack = 1 - float(ones @ weight @ with_now)
    total = float(ones @ weight @ ones)
    left = 1 - float(with_now @ weight @ with_now) + lack**2 / total
    return np.asarray((weight @ (with_now + ones * (lack / total))) @ turns), variance * max(left, 0.0)


def read_attitude_at(path: str | Path, utc: Utc) -> Attitude:
    """Read the attitude at a time from a JSON file: predicted from the frames of a calibration, else as written in the file.

    Raises
    ------
    AttitudeError
        When the file holds no attitude, or that of a frame is malformed.
    """
    there = Attitude.from_json(path)
    return attitude_at(read_measured(path), utc, there)


def read_measured(path: str | Path) -> tuple[AttitudeInTime, ...]:
    """Read the attitudes of a calibration's frames from a JSON file that holds an attitude; empty for any other file.

    Raises
    ------
    AttitudeError
        When the attitude of a frame is malformed, or there are more than `MOST_FRAMES`.
    """
    record = json.loads(Path(path).read_text(encoding="utf-8-sig"))
    calibration = record.get("calibration") if isinstance(record, dict) else None
    frames = calibration.get("frames") if isinstance(calibration, dict) else None
    if not isinstance(frames, list):
        return ()
    if len(frames) > MOST_FRAMES:
        raise AttitudeError(f"attitude file {path}: more than {MOST_FRAMES} calibration frames")
    by_attitude: dict[Attitude, list[float]] = {}
    for number, frame in enumerate(frames):
        what = f"attitude file {path}: calibration frame {number}"
        if not isinstance(frame, dict) or "R_cam" not in frame:
            raise AttitudeError(f"{what} holds no R_cam")
        tilt, heading = (
            finite_number(frame.get(f"{name}_sigma_deg"), f"{what}: {name}_sigma_deg", AttitudeError, least=0.0)
            for name in ("tilt", "heading")
        )
        try:
            known = Attitude.with_sigma(frame["R_cam"], tilt_deg=tilt, heading_deg=heading)
        except AttitudeError as error:
            raise AttitudeError(f"{what}: {error}") from None
        mjd = finite_number(frame.get("utc_mjd"), f"{what}: utc_mjd", AttitudeError)
        by_attitude.setdefault(known, []).append(mjd)
    return tuple(
        AttitudeInTime(known.R_cam, known.tilt_deg, known.heading_deg, tuple(mjd)) for known, mjd in by_attitude.items()
    )
