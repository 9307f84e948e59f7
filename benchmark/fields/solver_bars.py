"""Measure a celnav solver on random fields: how many are solved, how many wrong, how well, how fast."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import celnav
from benchmark.fields.solver_fields import HEIGHT, WIDTH, Condition, Field, make_field, project
from benchmark.judge.geodesy import geodesic_km

F8 = NDArray[np.float64]
WRONG_KM = 10.0
# chi^2 with two degrees of freedom: 95 % lie below.
CHI2_95 = 5.991464547107979


@dataclass(frozen=True, eq=False)
class Measured:
    """What a solver did on fields of one condition.

    Attributes
    ----------
    condition : Condition
        Of the fields.
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
    right_names : ndarray, shape (n,)
        Part of the matches that name the true star; NaN for a refusal.
    reasons : tuple of str
        Reason of each field.
    """

    condition: Condition
    error_km: F8
    chi2: F8
    bound_km: F8
    time_ms: F8
    n_detections: NDArray[np.int64]
    right_names: F8
    reasons: tuple[str, ...]

    @property
    def solved(self) -> float:
        """Part of the fields with a position within 10 km."""
        return float(np.mean(self.error_km <= WRONG_KM))

    @property
    def wrong(self) -> int:
        """Fields with a position given as ok that is farther off."""
        return int(np.sum(self.error_km > WRONG_KM))

    @property
    def inside_ellipse(self) -> float:
        """Part of the fixes whose truth lies inside the 95 % ellipse."""
        known = self.chi2[np.isfinite(self.chi2)]
        return float(np.mean(known <= CHI2_95)) if len(known) else math.nan


def camera_of(condition: Condition) -> celnav.Camera:
    """Return the camera that the solver is told."""
    model = "equidistant" if condition.equidistant else "pinhole"
    return celnav.Camera(model, WIDTH, HEIGHT, f_px=condition.f_px)


def attitude_of(condition: Condition, field: Field) -> celnav.Attitude:
    """Return the attitude that the solver is told."""
    return celnav.Attitude.exact(field.R_cam) if condition.exact_attitude else celnav.Attitude.up(field.R_cam[:, 2])


def solve_field(condition: Condition, field: Field, solver: str = "skybench") -> celnav.Fix:
    """Solve one field."""
    return celnav.solve(
        field.uv, camera_of(condition), field.utc, attitude_of(condition, field), solver, flux=field.flux
    )


def bound_km(condition: Condition, field: Field) -> float:
    """Median error at the Cramer-Rao bound, exact attitude or vertical, identities known, refraction neglected.

    From the derivatives of the true stars' positions by a turn of the sky; the median of a two-dimensional Gaussian
    with these variances is found by the mean of its axes (within 2 % for axis ratios up to 3).
    """
    if condition.noise_px == 0:
        return math.nan
    uv = field.uv[field.star_id != 0]
    camera = camera_of(condition)
    rays = camera.to_rays(uv) @ field.R_cam
    h = 1e-6
    information = np.zeros((3, 3))
    columns = [
        (project((rays + h * np.cross(axis, rays)) @ field.R_cam.T, condition, condition.f_px)
         - project((rays - h * np.cross(axis, rays)) @ field.R_cam.T, condition, condition.f_px)) / (2 * h)
        for axis in np.eye(3)
    ]  # fmt: skip
    design = np.stack(columns, axis=2).reshape(-1, 3)
    information = design.T @ design / condition.noise_px**2
    tangent = math.tan(math.radians(field.lat_deg))
    if condition.exact_attitude:
        moves = np.array([[0.0, 1.0], [-1.0, 0.0], [-tangent, 0.0]])
        covariance = np.linalg.inv(moves.T @ information @ moves)
    else:
        covariance = np.linalg.inv(information)[:2, :2]
    a, b = np.sqrt(np.maximum(np.linalg.eigvalsh(covariance), 0)) * 6371.0
    return _median_radius(float(a), float(b))


def _median_radius(a: float, b: float) -> float:
    """Median length of a Gaussian vector with axes a and b, by quadrature over its direction."""
    angle = (np.arange(64) + 0.5) / 64 * 2 * math.pi
    inverse = (np.cos(angle) / max(a, 1e-12)) ** 2 + (np.sin(angle) / max(b, 1e-12)) ** 2
    low, high = 0.0, 4 * max(a, b)
    for _ in range(50):
        middle = (low + high) / 2
        # Probability within the radius: the mean over directions of (1 - exp(-r^2 q / 2)) / (q a b).
        inside = float(np.mean((1 - np.exp(-0.5 * middle**2 * inverse)) / inverse)) / (max(a, 1e-12) * max(b, 1e-12))
        low, high = (middle, high) if inside < 0.5 else (low, middle)
    return (low + high) / 2


def measure(condition: Condition, n_fields: int, seed: int, solver: str = "skybench") -> Measured:
    """Solve `n_fields` random fields of a condition."""
    rows = []
    reasons = []
    for number in range(n_fields):
        field = make_field(condition, seed, number)
        start = time.perf_counter()
        fix = solve_field(condition, field, solver)
        elapsed_ms = 1000 * (time.perf_counter() - start)
        error = chi2 = right = math.nan
        if fix.ok:
            error = geodesic_km(field.lat_deg, field.lon_deg, fix.lat_deg, fix.lon_deg)
            if fix.cov_km2 is not None:
                north = math.radians(fix.lat_deg - field.lat_deg) * 6367
                turn = math.remainder(fix.lon_deg - field.lon_deg, 360.0)
                east = math.radians(turn) * 6378 * math.cos(math.radians(field.lat_deg))
                offset = np.array([east, north])
                chi2 = float(offset @ np.linalg.solve(fix.cov_km2, offset))
            if len(fix.matches):
                right = float(np.mean(field.star_id[fix.matches[:, 0]] == fix.matches[:, 1]))
        rows.append((error, chi2, bound_km(condition, field), elapsed_ms, len(field.uv), right))
        reasons.append(str(fix.reason))
    error_km, chi2s, bounds, times, counts, rights = (np.array(column) for column in zip(*rows, strict=True))
    return Measured(condition, error_km, chi2s, bounds, times, counts.astype(np.int64), rights, tuple(reasons))
