"""Measure a celnav solver on random fields: success, wrong fixes, accuracy and time."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import celnav
from benchmark.fields.solver_fields import HEIGHT, WIDTH, Condition, Field, make_field
from benchmark.judge.cramer_rao import (
    EXACT,
    VERTICAL,
    covariance_bound,
    information_on_position,
    lens_derivatives,
    median_error_km,
    turn_derivatives,
)
from benchmark.judge.geodesy import east_north_km, geodesic_km

F8 = NDArray[np.float64]
WRONG_KM = 10.0
# 95 % quantile of chi^2 with two degrees of freedom.
CHI2_95 = 5.991464547107979


@dataclass(frozen=True, eq=False)
class Measured:
    """Results of a solver on fields of one condition.

    Attributes
    ----------
    condition : Condition
        Condition of the fields.
    error_km : ndarray, shape (n,)
        Distance from the truth; NaN for a refusal.
    chi2 : ndarray, shape (n,)
        Squared error in units of the covariance; NaN for a refusal.
    bound_km : ndarray, shape (n,)
        Median error that the Cramer-Rao bound of the true stars allows; NaN where there is no noise.
    time_ms : ndarray, shape (n,)
        Time of `celnav.solve`.
    n_detections : ndarray, shape (n,)
        Detections in the field.
    reasons : tuple of str
        Reason of each field.
    """

    condition: Condition
    error_km: F8
    chi2: F8
    bound_km: F8
    time_ms: F8
    n_detections: NDArray[np.int64]
    reasons: tuple[str, ...]

    @property
    def solved(self) -> float:
        """Fraction of the fields with a position within 10 km."""
        return float(np.mean(self.error_km <= WRONG_KM))

    @property
    def wrong(self) -> int:
        """Number of fields with a position that is claimed as ok but is farther off."""
        return int(np.sum(self.error_km > WRONG_KM))

    @property
    def inside_ellipse(self) -> float:
        """Fraction of the fixes whose truth is inside the 95 % ellipse."""
        known = self.chi2[np.isfinite(self.chi2)]
        return float(np.mean(known <= CHI2_95)) if len(known) else math.nan


def camera_of(condition: Condition) -> celnav.Camera:
    """Return the camera that the solver receives."""
    model = "equidistant" if condition.equidistant else "pinhole"
    return celnav.Camera(model, WIDTH, HEIGHT, f_px=condition.f_px)


def attitude_of(condition: Condition, field: Field) -> celnav.Attitude:
    """Return the attitude that the solver receives."""
    return celnav.Attitude.exact(field.R_cam) if condition.exact_attitude else celnav.Attitude.up(field.R_cam[:, 2])


def solve_field(condition: Condition, field: Field, solver: str = "skybench") -> celnav.Fix:
    """Solve one field."""
    return celnav.solve(
        field.uv, camera_of(condition), field.utc, attitude_of(condition, field), solver, flux=field.flux
    )


def bound_km(condition: Condition, field: Field) -> float:
    """Median error at the Cramér-Rao bound for centroids with the condition's noise and named stars; NaN without noise."""
    if condition.noise_px == 0:
        return math.nan
    uv = field.uv[field.star_id != 0]
    by_turn = turn_derivatives(camera_of(condition), field.R_cam, uv)
    places = np.broadcast_to(np.eye(2) / condition.noise_px**2, (len(uv), 2, 2))
    prior = EXACT if condition.exact_attitude else VERTICAL
    by_lens = lens_derivatives(camera_of(condition), uv)
    return median_error_km(covariance_bound(information_on_position(by_turn, by_lens, places, field.lat_deg, prior)))


def measure(condition: Condition, n_fields: int, seed: int, solver: str = "skybench") -> Measured:
    """Solve `n_fields` random fields of a condition."""
    rows = []
    reasons = []
    for number in range(n_fields):
        field = make_field(condition, seed, number)
        start = time.perf_counter()
        fix = solve_field(condition, field, solver)
        elapsed_ms = 1000 * (time.perf_counter() - start)
        error = chi2 = math.nan
        if fix.ok:
            error = geodesic_km(field.lat_deg, field.lon_deg, fix.lat_deg, fix.lon_deg)
            if fix.cov_km2 is not None:
                offset = np.array(east_north_km(field.lat_deg, field.lon_deg, fix.lat_deg, fix.lon_deg))
                chi2 = float(offset @ np.linalg.solve(fix.cov_km2, offset))
        rows.append((error, chi2, bound_km(condition, field), elapsed_ms, len(field.uv)))
        reasons.append(str(fix.reason))
    error_km, chi2s, bounds, times, counts = (np.array(column) for column in zip(*rows, strict=True))
    return Measured(condition, error_km, chi2s, bounds, times, counts.astype(np.int64), tuple(reasons))
