"""Combination of many orientations of one stationary camera: their mean, their scatter, and the Earth's rotation.

A stationary camera keeps one orientation relative to the Earth. Each frame measures it, and a line through the frames
measures its rate of rotation, which is zero if the mount does not move, the clock is right and the stars are identified
correctly. If frames deviate from that line by more than their covariances explain, the mount wanders; this scatter is
estimated by the method of moments (DerSimonian & Laird 1986, Control. Clin. Trials 7, 177). Wander that is independent from
frame to frame averages out; wander that is correlated does not. If there are too few frames to decide, it is assumed to be
correlated.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from celnav.horizon import rotation_vector
from celnav.identification.verification import rotation_of

F8 = NDArray[np.float64]
Rows = NDArray[np.intp]

# Rotation of the Earth relative to the stars, rad/s of UT1 (IAU 2000, Earth rotation angle).
EARTH_RAD_S = 2 * math.pi * 1.00273781191135448 / 86400.0
# Squared distance, three degrees of freedom, that one good frame in 10,000 exceeds.
GATE = 21.108
# Least number of frames for an estimate of the correlation of wander from one frame to the next.
FEWEST_FOR_CORRELATION = 8
# Least number of frames that leave enough degrees of freedom for the scatter after fitting a line.
FEWEST_FOR_LINE = 4
# Number of frames, spread evenly, with which all are compared where there are more.
_MOST_COMPARED = 400


@dataclass(frozen=True, eq=False)
class FixedMount:
    """Combined orientation of a camera relative to the Earth.

    Attributes
    ----------
    rotation : ndarray, shape (3, 3)
        Terrestrial frame (ITRS) to camera at the mean time.
    cov : ndarray, shape (3, 3)
        Covariance of its error as a small rotation in the camera frame, rad^2, including wander.
    used : ndarray of int
        Rows of the frames that were used.
    wander_rad : float
        Standard deviation, about each axis, of the scatter beyond the frames' own covariances; 0 if there is none.
    independent : float
        Number of frames over which wander averages: all that were used, or one if it is correlated from frame to frame.
    turn_rad_s : ndarray, shape (3,)
        Rotation rate of the camera relative to the Earth, terrestrial axes: zero for a steady mount and a right clock.
    turn_cov : ndarray, shape (3, 3)
        Covariance of `turn_rad_s`.
    span_s : float
        Time from the first frame to the last.
    """

    rotation: F8
    cov: F8
    used: Rows
    wander_rad: float
    independent: float
    turn_rad_s: F8
    turn_cov: F8
    span_s: float

    @property
    def turn_chi2(self) -> float:
        """Squared rotation rate in units of its covariance, three degrees of freedom; NaN if the frames span no time."""
        if not np.isfinite(self.turn_cov).all():
            return math.nan
        return float(self.turn_rad_s @ np.linalg.solve(self.turn_cov, self.turn_rad_s))

    @property
    def drift_cov(self) -> F8:
        """Covariance of the frames due to the fitted rotation, camera frame, rad^2: uniform spread over rate x span."""
        drift = self.rotation @ self.turn_rad_s * self.span_s
        return np.asarray(np.outer(drift, drift) / 12)

    @property
    def sky_turn(self) -> F8:
        """Rotation of the Earth relative to the stars as measured by the frames, rad/s, camera frame, shape (3,)."""
        return np.asarray(self.rotation @ (np.array([0.0, 0.0, EARTH_RAD_S]) - self.turn_rad_s))


def combine(rotations: F8, covs: F8, times_s: F8) -> FixedMount:
    """Combine the frames of a stationary camera.

    Parameters
    ----------
    rotations : ndarray, shape (n, 3, 3)
        Rotation from the terrestrial frame to the camera for each frame.
    covs : ndarray, shape (n, 3, 3)
        Covariances of small rotations in the camera frame, rad^2.
    times_s : ndarray, shape (n,)
        Times of the frames, seconds.
    """
    reference = rotations[_most_central(rotations)]
    for _ in range(3):
        turns = np.stack([rotation_vector(rotation @ reference.T) for rotation in rotations])
        used, wander = _consistent(turns, covs, times_s)
        weights = np.asarray(np.linalg.inv(covs[used] + wander**2 * np.eye(3)), dtype=np.float64)
        mean = np.linalg.solve(weights.sum(axis=0), np.einsum("nij,nj->i", weights, turns[used]))
        reference = rotation_of(mean) @ reference
    turns = np.stack([rotation_vector(rotation @ reference.T) for rotation in rotations[used]])
    independent = _independent(turns, times_s[used]) if wander > 0 else float(len(used))
    span = float(np.ptp(times_s[used]))
    inflated = np.linalg.inv(weights.sum(axis=0)) + wander**2 * np.eye(3) * (1 / independent - 1 / len(used))
    turn, turn_cov = _turn(turns, weights, times_s[used], len(used) / independent)
    if np.isfinite(turn_cov).all():
        turn_cov = reference.T @ turn_cov @ reference
    return FixedMount(reference, inflated, used, wander, independent, reference.T @ turn, turn_cov, span)


def _most_central(rotations: F8) -> int:
    """Return the row of the rotation with the least median distance to the others, which one wrong frame does not affect."""
    cosines = (np.einsum("aij,bij->ab", rotations, rotations[_spread(len(rotations))]) - 1) / 2
    return int(np.argmax(np.median(cosines, axis=1)))


def _spread(n: int) -> Rows:
    """Return all of n rows, or as many of them, spread evenly, as frames are compared with."""
    return np.unique(np.linspace(0, n - 1, min(n, _MOST_COMPARED)).astype(np.intp))


def _consistent(turns: F8, covs: F8, times_s: F8) -> tuple[Rows, float]:
    """Return the rows of the frames that agree, and their scatter about each axis beyond their covariances, radians.

    Frames are left out by their distance from a line in time, in units of their own covariance and of the scatter of the
    inner half of the frames: a misidentified frame is degrees away, a frame of a drifting mount is not.
    """
    away = turns - _robust_line(turns, times_s)
    robust = 1.4826 * np.median(np.abs(away), axis=0)
    spread = covs + np.diag(robust**2)
    distance = np.einsum("ni,nij,nj->n", away, np.linalg.inv(spread), away)
    used = np.flatnonzero(distance <= GATE)
    if len(used) < 2:
        return used, 0.0
    weights = np.asarray(np.linalg.inv(covs[used]), dtype=np.float64)
    design = _line(times_s[used])
    normal = np.einsum("na,nb,nij->aibj", design, design, weights)
    size = 3 * design.shape[1]
    inverse = np.linalg.inv(normal.reshape(size, size))
    right = np.einsum("na,nij,nj->ai", design, weights, turns[used]).ravel()
    rest = turns[used] - design @ (inverse @ right).reshape(-1, 3)
    chi2 = float(np.einsum("ni,nij,nj->", rest, weights, rest))
    freedom = 3 * len(used) - size
    # An excess beyond what chance gives once in a thousand (Wilson & Hilferty 1931) is scatter of the mount.
    limit = freedom * (1 - 2 / (9 * freedom) + 3.09 * math.sqrt(2 / (9 * freedom))) ** 3
    if chi2 <= limit:
        return used, 0.0
    squares = np.einsum("na,nb,nij,njk->aibk", design, design, weights, weights).reshape(size, size)
    share = float(np.einsum("nii->", weights)) - float(np.trace(inverse @ squares))
    return used, math.sqrt((chi2 - freedom) / share)


def _robust_line(turns: F8, times_s: F8) -> F8:
    """Fit a line to the rotations by repeated medians (Siegel 1982, Biometrika 69, 242), robust to bad data in half of them.

    If there are too few frames for a line, return the median of the rotations. Shape (n, 3).
    """
    design = _line(times_s)
    if design.shape[1] == 1:
        return np.broadcast_to(np.median(turns, axis=0), turns.shape)
    since = design[:, 1]
    some = _spread(len(turns))
    apart = since[some][:, None] - since[some][None, :]
    rise = turns[some][:, None, :] - turns[some][None, :, :]
    with np.errstate(divide="ignore", invalid="ignore"):
        slopes = np.where(apart[..., None] == 0, np.nan, rise / apart[..., None])
    # Frames at the same instant as all others have no slope.
    has = np.isfinite(slopes).any(axis=(1, 2))
    slope = np.median(np.nanmedian(slopes[has], axis=1), axis=0)
    level = turns - since[:, None] * slope
    return np.asarray(turns - level + np.median(level, axis=0))


def _line(times_s: F8) -> F8:
    """Design matrix of mean and slope in time, shape (n, 2); of the mean alone, (n, 1), if there are too few frames."""
    since = times_s - np.mean(times_s)
    if len(times_s) < FEWEST_FOR_LINE or not np.ptp(since) > 0:
        return np.ones((len(times_s), 1))
    return np.column_stack((np.ones(len(times_s)), since / np.ptp(since)))


def _independent(turns: F8, times_s: F8) -> float:
    """Return the number of frames over which wander averages: all, or one if neighbours agree or the frames are too few.

    `turns` are the rotations of the frames, shape (n, 3).
    """
    n = len(turns)
    if n < FEWEST_FOR_CORRELATION:
        return 1.0
    order = np.argsort(times_s, kind="stable")
    design = _line(times_s[order])
    rest = turns[order] - design @ np.linalg.lstsq(design, turns[order], rcond=None)[0]
    neighbours = float(np.sum(rest[1:] * rest[:-1])) / float(np.sum(rest**2))
    # Compare with two standard deviations of a correlation from 3 n numbers.
    return 1.0 if neighbours > 2 / math.sqrt(3 * n) else float(n)


def _turn(turns: F8, weights: F8, times_s: F8, correlated: float) -> tuple[F8, F8]:
    """Return the weighted slope of the rotations in time, rad/s, and its covariance, camera frame."""
    middle = float(np.mean(times_s))
    since = times_s - middle
    if len(turns) < 3 or not np.ptp(since) > 0:
        return np.zeros(3), np.full((3, 3), np.inf)
    normal = np.zeros((6, 6))
    normal[:3, :3] = weights.sum(axis=0)
    normal[:3, 3:] = normal[3:, :3] = np.einsum("n,nij->ij", since, weights)
    normal[3:, 3:] = np.einsum("n,nij->ij", since**2, weights)
    right = np.concatenate((np.einsum("nij,nj->i", weights, turns), np.einsum("n,nij,nj->i", since, weights, turns)))
    scale = np.sqrt(np.diag(normal))
    cov = np.linalg.inv(normal / scale[:, None] / scale) / scale[:, None] / scale
    return np.asarray((cov @ right)[3:]), np.asarray(cov[3:, 3:] * correlated)
