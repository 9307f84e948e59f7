"""Many orientations of one camera on the ground: their mean, what they scatter, and the Earth's rotation in them.

A camera that stands still keeps one orientation to the Earth. Each frame measures it; a line through the frames measures
how it turns, which is nothing while the mount stands, the clock runs right and the stars are named rightly. Frames that
disagree with that line by more than their covariances say wander: the scatter is estimated by the method of moments
(DerSimonian & Laird 1986, Control. Clin. Trials 7, 177). It averages where frames wander independently; what goes on from
frame to frame does not, and where too few frames are there to tell it is taken as going on.
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

# Rotation of the Earth to the stars, rad/s of UT1 (IAU 2000, Earth rotation angle).
EARTH_RAD_S = 2 * math.pi * 1.00273781191135448 / 86400.0
# Squared distance of three degrees of freedom that one good frame in 10,000 exceeds.
GATE = 21.108
# Fewer frames are no measure of how wander goes on from one to the next.
FEWEST_FOR_CORRELATION = 8
# Fewest frames whose line leaves enough to measure scatter by.
FEWEST_FOR_LINE = 4
_MOST_FOR_SLOPE = 400


@dataclass(frozen=True, eq=False)
class FixedMount:
    """What frames of a camera say about its orientation to the Earth.

    Attributes
    ----------
    rotation : ndarray, shape (3, 3)
        Terrestrial frame (ITRS) to camera at the mean time.
    cov : ndarray, shape (3, 3)
        Covariance of its error as a small rotation in the camera frame, rad^2, wander included.
    used : ndarray of int
        Rows of the frames that count.
    wander_rad : float
        Standard deviation about each axis that frames scatter beyond their own covariances; 0 where they do not.
    independent : float
        Over how many frames wander averages: all that count, or one where it goes on from frame to frame.
    turn_rad_s : ndarray, shape (3,)
        Turn of the camera to the Earth, terrestrial axes: zero for a mount that stands still under a clock that is right.
    turn_cov : ndarray, shape (3, 3)
        Its covariance.
    span_s : float
        From the first frame to the last.
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
        """Squared turn in units of its covariance, three degrees of freedom; NaN where frames span no time."""
        if not np.isfinite(self.turn_cov).all():
            return math.nan
        return float(self.turn_rad_s @ np.linalg.solve(self.turn_cov, self.turn_rad_s))

    @property
    def drift_cov(self) -> F8:
        """Scatter of the frames by the turn that the line shows, camera frame, rad^2: a uniform spread of turn x span."""
        drift = self.rotation @ self.turn_rad_s * self.span_s
        return np.asarray(np.outer(drift, drift) / 12)

    @property
    def sky_turn(self) -> F8:
        """Rotation of the Earth to the stars as the frames measure it, rad/s, camera frame, shape (3,)."""
        return np.asarray(self.rotation @ (np.array([0.0, 0.0, EARTH_RAD_S]) - self.turn_rad_s))


def combine(rotations: F8, covs: F8, times_s: F8) -> FixedMount:
    """Combine the frames of a camera that stands still.

    Parameters
    ----------
    rotations : ndarray, shape (n, 3, 3)
        Terrestrial frame to camera, one for each frame.
    covs : ndarray, shape (n, 3, 3)
        Covariances of small rotations in the camera frame, rad^2.
    times_s : ndarray, shape (n,)
        Instants.
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
    """Row of the rotation that is nearest to the others, in the median: one wrong frame does not matter."""
    cosines = (np.einsum("aij,bij->ab", rotations, rotations) - 1) / 2
    return int(np.argmax(np.median(cosines, axis=1)))


def _consistent(turns: F8, covs: F8, times_s: F8) -> tuple[Rows, float]:
    """Rows of the frames that agree, and the scatter about each axis that their covariances do not explain, radians.

    Frames are left out by their distance from a line by time, in units of their own covariance and of the scatter of the
    inner half of the frames: a frame that was named wrongly lies degrees away, one of a mount that drifts does not.
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
    # Beyond what chance gives once in a thousand (Wilson & Hilferty 1931), the excess is scatter of the mount.
    limit = freedom * (1 - 2 / (9 * freedom) + 3.09 * math.sqrt(2 / (9 * freedom))) ** 3
    if chi2 <= limit:
        return used, 0.0
    squares = np.einsum("na,nb,nij,njk->aibk", design, design, weights, weights).reshape(size, size)
    share = float(np.einsum("nii->", weights)) - float(np.trace(inverse @ squares))
    return used, math.sqrt((chi2 - freedom) / share)


def _robust_line(turns: F8, times_s: F8) -> F8:
    """Line through the turns by repeated medians (Siegel 1982, Biometrika 69, 242), which half of the frames cannot spoil.

    The median of the turns where there are too few frames for a line. Shape (n, 3).
    """
    design = _line(times_s)
    if design.shape[1] == 1:
        return np.broadcast_to(np.median(turns, axis=0), turns.shape)
    since = design[:, 1]
    # Of more frames, that many spread over all tell the slope.
    some = np.unique(np.linspace(0, len(turns) - 1, min(len(turns), _MOST_FOR_SLOPE)).astype(int))
    apart = since[some][:, None] - since[some][None, :]
    rise = turns[some][:, None, :] - turns[some][None, :, :]
    with np.errstate(divide="ignore", invalid="ignore"):
        slopes = np.where(apart[..., None] == 0, np.nan, rise / apart[..., None])
    # Frames of one instant with all others have no slope.
    has = np.isfinite(slopes).any(axis=(1, 2))
    slope = np.median(np.nanmedian(slopes[has], axis=1), axis=0)
    level = turns - since[:, None] * slope
    return np.asarray(turns - level + np.median(level, axis=0))


def _line(times_s: F8) -> F8:
    """Design of a mean and a slope by time, shape (n, 2); of a mean alone, (n, 1), where there are too few frames."""
    since = times_s - np.mean(times_s)
    if len(times_s) < FEWEST_FOR_LINE or not np.ptp(since) > 0:
        return np.ones((len(times_s), 1))
    return np.column_stack((np.ones(len(times_s)), since / np.ptp(since)))


def _independent(turns: F8, times_s: F8) -> float:
    """Over how many of the frames, shape (n, 3), wander averages: all, or one where neighbours agree or too few tell."""
    n = len(turns)
    if n < FEWEST_FOR_CORRELATION:
        return 1.0
    order = np.argsort(times_s, kind="stable")
    design = _line(times_s[order])
    rest = turns[order] - design @ np.linalg.lstsq(design, turns[order], rcond=None)[0]
    neighbours = float(np.sum(rest[1:] * rest[:-1])) / float(np.sum(rest**2))
    # Two standard deviations of a correlation of 3 n numbers.
    return 1.0 if neighbours > 2 / math.sqrt(3 * n) else float(n)


def _turn(turns: F8, weights: F8, times_s: F8, correlated: float) -> tuple[F8, F8]:
    """Weighted slope of the turns by time, rad/s, and its covariance, camera frame."""
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
