"""The answer of a solver: a position with its uncertainty, or a refusal with a reason."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from enum import StrEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray


class Reason(StrEnum):
    """`OK` for a position, or why the solver refuses; docs/celnav.md explains each reason."""

    OK = "ok"
    TOO_FEW_DETECTIONS = "too_few_detections"
    NO_HYPOTHESIS = "no_hypothesis"
    EFFORT_SPENT = "effort_spent"
    AMBIGUOUS = "ambiguous"
    INCONSISTENT = "inconsistent"
    ATTITUDE_REQUIRED = "attitude_required"
    VERTICAL_REQUIRED = "vertical_required"
    NOT_CONVERGED = "not_converged"


@dataclass(frozen=True)
class Estimate:
    """A value and its standard deviation."""

    value: float
    sigma: float


@dataclass(frozen=True)
class Calibration:
    """Corrections of the camera that the solver estimated; None for a value that it kept.

    Attributes
    ----------
    log_f : Estimate or None
        Natural logarithm of the factor on the focal length.
    cx_px, cy_px : Estimate or None
        Shift of the principal point.
    q1, q2 : Estimate or None
        Radial terms: positions move from the principal point by the factor 1 + q1 r^2 + q2 r^4, with r the distance
        from it over half the diagonal of the frame.
    """

    log_f: Estimate | None = None
    cx_px: Estimate | None = None
    cy_px: Estimate | None = None
    q1: Estimate | None = None
    q2: Estimate | None = None


def _no_matches() -> NDArray[np.int64]:
    return np.empty((0, 2), dtype=np.int64)


@dataclass(frozen=True, eq=False)
class Fix:
    """A position, or a refusal.

    Attributes
    ----------
    ok : bool
        Whether there is a position.
    reason : Reason
        Code of the reason, a string.
    message : str
        The reason in words; empty if there is a position.
    lat_deg, lon_deg : float
        Geodetic position on WGS84; longitude is positive to the east, -180 to 180. NaN for a refusal.
    cov_km2 : ndarray, shape (2, 2), or None
        Covariance of the position in the axes east and north, km^2.
    confidence : float
        0 to 1, as the solver defines it; 0 if there is no hypothesis.
    matches : ndarray of int64, shape (m, 2)
        For each match, the index of the detection and the star id: Hipparcos number, or minus the HR number of a star
        without one. Planets follow the stars, with ids below -1000000 (`celnav.sky.planets`); no position rests on them.
    residual_rms_px : float
        Root mean square distance between matched detections and predicted stars, pixels; NaN without a position.
    residuals_px : ndarray, shape (m, 2), or None
        Observed minus predicted position of every match, pixels; None if the solver does not report it.
    R_icrs_to_camera : ndarray, shape (3, 3), or None
        Inertial attitude: takes apparent ICRS directions (aberration included) to the camera frame. Without a vertical it
        contains the refraction, by 0.02 to 0.03 deg for a camera 50 to 30 deg above the horizon.
    rotation_cov_rad2 : ndarray, shape (3, 3), or None
        Covariance of the error of `R_icrs_to_camera` as a small rotation in the camera frame, rad^2; without a vertical, the
        refraction is not in it.
    common_cov_rad2 : ndarray, shape (3, 3), or None
        The part of `rotation_cov_rad2` that all frames of a stationary camera share: errors of lens and air.
    limiting_mag : float
        Estimated magnitude down to which the frame shows the catalogue's stars; NaN if the solver does not report it.
    log10_false_alarm : float
        Decimal logarithm of a bound on the probability that chance explains the identification; NaN if unknown.
    heading_off_deg : float
        Difference between the heading that the stars imply and the supplied one, degrees; NaN if no heading was supplied
        or the solver does not report it.
    calibration : Calibration
        Corrections of the camera that the solver estimated.
    work : int
        Work of the identification, in look-ups (docs/solver.md, "Effort"); 0 if the solver does not count it.
    time_ms : mapping of str to float
        Time that each stage took, milliseconds.
    solver : str
        Name of the solver.
    details : mapping
        Further diagnostics, for example the number of stars that the frame should show; other solvers have other ones.
        ``vertical_doubt_deg``, if present, is the standard deviation about each axis by which a lens that the stars
        contradict puts the vertical in doubt; `cov_km2` contains it, `rotation_cov_rad2` does not.
    """

    ok: bool
    reason: Reason
    message: str = ""
    lat_deg: float = math.nan
    lon_deg: float = math.nan
    cov_km2: NDArray[np.float64] | None = None
    confidence: float = 0.0
    matches: NDArray[np.int64] = field(default_factory=_no_matches)
    residual_rms_px: float = math.nan
    residuals_px: NDArray[np.float64] | None = None
    R_icrs_to_camera: NDArray[np.float64] | None = None
    rotation_cov_rad2: NDArray[np.float64] | None = None
    common_cov_rad2: NDArray[np.float64] | None = None
    limiting_mag: float = math.nan
    log10_false_alarm: float = math.nan
    heading_off_deg: float = math.nan
    calibration: Calibration = Calibration()
    work: int = 0
    time_ms: Mapping[str, float] = field(default_factory=dict)
    solver: str = ""
    details: Mapping[str, float | int | str] = field(default_factory=dict)

    @classmethod
    def refusal(cls, reason: Reason, message: str, confidence: float = 0.0) -> Fix:
        """Make a refusal."""
        return cls(ok=False, reason=reason, message=message, confidence=confidence)

    def to_dict(self) -> dict[str, Any]:
        """Return the fix as plain values that JSON can hold (NaN becomes None)."""

        def number(value: float) -> float | None:
            return float(value) if math.isfinite(value) else None

        return {
            "ok": self.ok,
            "reason": str(self.reason),
            "message": self.message,
            "lat_deg": number(self.lat_deg),
            "lon_deg": number(self.lon_deg),
            "cov_km2": None if self.cov_km2 is None else self.cov_km2.tolist(),
            "confidence": number(self.confidence),
            "matches": self.matches.tolist(),
            "residual_rms_px": number(self.residual_rms_px),
            "residuals_px": None if self.residuals_px is None else self.residuals_px.round(4).tolist(),
            "R_icrs_to_camera": None if self.R_icrs_to_camera is None else self.R_icrs_to_camera.tolist(),
            "limiting_mag": number(self.limiting_mag),
            "log10_false_alarm": number(self.log10_false_alarm),
            "heading_off_deg": number(self.heading_off_deg),
            "calibration": {name: part for name, part in asdict(self.calibration).items() if part is not None},
            "work": self.work,
            "time_ms": {stage: round(float(ms), 3) for stage, ms in self.time_ms.items()},
            "solver": self.solver,
            "details": dict(self.details),
        }
