"""A camera's calibration: lens, attitudes, uncertainties, and a verdict in words."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from celnav.attitude import Attitude
from celnav.calibrating.lens_form import LensForm
from celnav.calibrating.model_choice import Judged
from celnav.calibrating.mount import Mount
from celnav.calibrating.mount_times import AttitudeInTime, attitude_at
from celnav.calibrating.scatter.noise import Noise
from celnav.calibrating.scatter.pixel_phase import PixelPhase
from celnav.calibrating.scatter.residual_pattern import Pattern
from celnav.camera import Camera
from celnav.sky.utc import Utc, parse_utc

F8 = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class FrameAttitude:
    """Attitude of one frame.

    Attributes
    ----------
    name, utc, night
        Name, time and night of the frame; nights are numbered in order of time.
    R_cam : ndarray, shape (3, 3)
        East-north-up to camera.
    tilt_sigma_deg, heading_sigma_deg : float
        Standard deviations about each horizontal axis and about the vertical, with the lens as published.
    stars : int
        Number of stars that it was fitted to.
    rms_px : float
        Weighted root mean square of the residuals along an axis.
    limiting_mag : float
        Magnitude down to which stars were matched.
    exposure_s : float or None
        Exposure time of the frame; None if unknown.
    """

    name: str
    utc: Utc
    night: int
    R_cam: F8
    tilt_sigma_deg: float
    heading_sigma_deg: float
    stars: int
    rms_px: float
    limiting_mag: float
    exposure_s: float | None = None


@dataclass(frozen=True, eq=False)
class Residuals:
    """Fitted stars: positions, measured minus predicted (n, 2), standard deviations, frame, star id, attitude.

    The positions are corrected for pixel-phase error.
    """

    uv: F8
    off_px: F8
    sigma_px: F8
    frame: NDArray[np.intp]
    star_id: NDArray[np.int32]
    group: NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class CameraCalibration:
    """Result of `celnav.calibrate`.

    Attributes
    ----------
    camera : Camera
        The lens.
    form : LensForm
        The lens parameters that were fitted; `form.names` are the names for `values` and `cov`.
    values : ndarray, shape (m,)
        Values of the fitted parameters.
    cov : ndarray, shape (m, m)
        Covariance of the fitted parameters, with the attitudes free.
    attitudes : tuple of FrameAttitude
        Attitude of each frame that could be used.
    one_attitude_per : str
        ``night`` or ``frame``.
    steady : bool
        Whether the attitudes of each night's frames differ by no more than chance explains.
    mount : Mount
        Mean attitude of the fixed camera, with standard deviations for a future night.
    noise : Noise
        Scatter of the measured positions.
    pixel_phase : PixelPhase
        Error of the centroids due to the pixel grid, which was subtracted from them.
    rms_px, plain_rms_px : float
        Root mean square of the residuals along an axis: weighted by the variances of the stars, and unweighted.
    median_px : float
        Median distance, both axes combined.
    pattern : Pattern
        Residuals that neighbours share.
    judged : tuple of Judged
        Forms compared by held-out stars, best first; empty if the form was given.
    left_out : tuple of str
        Frames that could not be identified.
    residuals : Residuals
        Residuals of every star.
    R_by_group : ndarray, shape (g, 3, 3)
        The fitted attitudes.
    """

    camera: Camera
    form: LensForm
    values: F8
    cov: F8
    attitudes: tuple[FrameAttitude, ...]
    one_attitude_per: str
    steady: bool
    mount: Mount
    noise: Noise
    pixel_phase: PixelPhase
    rms_px: float
    plain_rms_px: float
    median_px: float
    pattern: Pattern
    judged: tuple[Judged, ...]
    left_out: tuple[str, ...]
    residuals: Residuals
    R_by_group: F8

    @cached_property
    def sigmas(self) -> Mapping[str, float]:
        """Standard deviation of each parameter, by name."""
        return dict(zip(self.form.names, np.sqrt(np.diag(self.cov)).tolist(), strict=True))

    @cached_property
    def attitude(self) -> Attitude:
        """The mount's attitude for another night, with its standard deviations, for `celnav.solve`."""
        mount = self.mount
        return Attitude.with_sigma(mount.R_cam, tilt_deg=mount.tilt_sigma_deg, heading_deg=mount.heading_sigma_deg)

    @cached_property
    def attitudes_in_time(self) -> tuple[AttitudeInTime, ...]:
        """The fitted attitudes, each with the times of its frames."""
        times: dict[int, list[FrameAttitude]] = {}
        for one in self.attitudes:
            group = next(g for g, rotation in enumerate(self.R_by_group) if np.array_equal(rotation, one.R_cam))
            times.setdefault(group, []).append(one)
        return tuple(
            AttitudeInTime(
                group[0].R_cam, group[0].tilt_sigma_deg, group[0].heading_sigma_deg, tuple(one.utc.mjd for one in group)
            )
            for group in times.values()
        )

    def attitude_at(self, utc: str | datetime | Utc) -> Attitude:
        """Return the mount's attitude at a time; near the calibration's frames it is better known than on another night."""
        return attitude_at(self.attitudes_in_time, parse_utc(utc), self.attitude)

    def to_dict(self) -> dict[str, Any]:
        """Return the calibration as plain values for JSON; `celnav solve` reads camera and attitude from it."""
        mount = self.mount
        return {
            "camera": self.camera.to_dict(),
            "attitude": {
                "R_cam": mount.R_cam.tolist(),
                "tilt_sigma_deg": mount.tilt_sigma_deg,
                "heading_sigma_deg": mount.heading_sigma_deg,
            },
            "calibration": {
                "parameters": list(self.form.names),
                "values": self.values.tolist(),
                "covariance": self.cov.tolist(),
                "form": self.form.words,
                "stars": len(self.residuals.uv),
                "rms_px": self.rms_px,
                "plain_rms_px": self.plain_rms_px,
                "median_px": self.median_px,
                "floor_px": self.noise.floor_px,
                "centroid_sigma_factor": self.noise.factor,
                "pixel_phase_px": list(self.pixel_phase.amplitude_px),
                "pattern_px": self.pattern.rms_px,
                "wander_tilt_deg": _or_none(mount.wander_tilt_deg),
                "wander_heading_deg": _or_none(mount.wander_heading_deg),
                "one_attitude_per": self.one_attitude_per,
                "steady": self.steady,
                "frames": [
                    {
                        "name": one.name,
                        "utc_mjd": one.utc.mjd,
                        "night": one.night,
                        "R_cam": one.R_cam.tolist(),
                        "tilt_sigma_deg": one.tilt_sigma_deg,
                        "heading_sigma_deg": one.heading_sigma_deg,
                        "stars": one.stars,
                        "rms_px": _or_none(one.rms_px),
                        "limiting_mag": _or_none(one.limiting_mag),
                    }
                    for one in self.attitudes
                ],
                "left_out": list(self.left_out),
            },
        }

    def to_json(self) -> str:
        """Return the calibration as a JSON document."""
        return json.dumps(self.to_dict(), indent=1, allow_nan=False) + "\n"


def _or_none(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
