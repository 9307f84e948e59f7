"""The mount: its motion between frames and between nights, and the uncertainty of its attitude on a future night."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from celnav.horizon import rotation_vector
from celnav.identification.verification import rotation_of

F8 = NDArray[np.float64]
Rows = NDArray[np.intp]

# Frames of one night share one attitude, unless the probability that they differ as much by chance is below this.
LEAST_CHANCE = 1e-3
USUAL_WANDER_DEG = 0.012
"""Usual wander of a fixed outdoor mount about each axis from night to night, measured on an all-sky camera
(docs/camera_calibration.md)."""
USUAL_WEIGHT = 2.0  # number of nights that the usual value counts as


@dataclass(frozen=True, eq=False)
class Mount:
    """The attitude of a fixed camera.

    Attributes
    ----------
    R_cam : ndarray, shape (3, 3)
        Mean over the nights, east-north-up to camera.
    tilt_sigma_deg, heading_sigma_deg : float
        Standard deviations of the attitude on a future night, about each horizontal axis and about the vertical. They
        include the wander from night to night.
    wander_tilt_deg, wander_heading_deg : float
        Scatter between the nights, about each horizontal axis and about the vertical, with its own noise subtracted; NaN if
        there is only one night.
    """

    R_cam: F8
    tilt_sigma_deg: float
    heading_sigma_deg: float
    wander_tilt_deg: float
    wander_heading_deg: float


def mean_rotation(rotations: F8) -> F8:
    """Return the rotation nearest to several, shape (g, 3, 3), in the mean square of the angles (which are small)."""
    u, _, vt = np.linalg.svd(rotations.sum(axis=0))
    return np.asarray(u @ np.diag([1.0, 1.0, float(np.linalg.det(u @ vt))]) @ vt)


def turns_deg(rotations: F8, reference: F8) -> F8:
    """Return the rotation of each attitude, shape (g, 3, 3), from the reference: about east, north and up, shape (g, 3).

    The unit is degrees. The third is the change of heading, positive from north to east like azimuths.
    """
    vectors = np.stack([reference.T @ rotation_vector(rotation @ reference.T) for rotation in rotations])
    return np.asarray(np.degrees(vectors))


def drift_chance(rotations: F8, cov: F8, group: Rows) -> float:
    """Return the probability that chance alone makes the attitudes within groups of frames differ as much as they do.

    Parameters
    ----------
    rotations : ndarray, shape (g, 3, 3)
        Attitudes of the frames.
    cov : ndarray, shape (g, 3, 3)
        Covariances, as of small rotations in the camera frame, radians.
    group : ndarray, shape (g,)
        Frames that may share an attitude.
    """
    from scipy.special import chdtrc

    chi2, freedom = 0.0, 0
    for number in np.unique(group):
        rows = np.flatnonzero(group == number)
        if len(rows) < 2:
            continue
        reference = mean_rotation(rotations[rows])
        vectors = np.stack([rotation_vector(rotations[row] @ reference.T) for row in rows])
        weights = np.linalg.inv(cov[rows])
        middle = np.linalg.solve(weights.sum(axis=0), np.einsum("gij,gj->i", weights, vectors))
        apart = vectors - middle
        chi2 += float(np.einsum("gi,gij,gj->", apart, weights, apart))
        freedom += 3 * (len(rows) - 1)
    return float(chdtrc(freedom, chi2)) if freedom else 1.0


def mount_of(rotations: F8, cov: F8, night: Rows) -> Mount:
    """Summarise the attitudes of frames or nights.

    The variance between nights is estimated with a prior: the usual wander counts as two nights (the posterior mean of an
    inverse-gamma prior except for its normalisation), so that a calibration from one night claims no more stability than
    mounts have.

    Parameters
    ----------
    rotations : ndarray, shape (g, 3, 3)
        Attitudes, each of a frame or a night.
    cov : ndarray, shape (g, 3, 3)
        Covariances, as of small rotations in the camera frame, radians.
    night : ndarray, shape (g,)
        Night of each attitude.
    """
    nights = np.unique(night)
    by_night = np.stack([mean_rotation(rotations[night == number]) for number in nights])
    reference = mean_rotation(by_night)
    # About east, north, up.
    turns = turns_deg(by_night, reference)
    own = np.stack([np.diag(reference.T @ matrix @ reference) for matrix in cov]) * math.degrees(1) ** 2
    own_by_night = np.stack([own[night == number].mean(axis=0) / (night == number).sum() for number in nights])
    within = _within(rotations, night, nights)
    freedom = len(nights) - 1
    # Sums of squares: the two axes of the tilt together, and the heading.
    scatter = np.maximum((turns**2).sum(axis=0) - freedom * own_by_night.mean(axis=0), 0.0)
    tilt, heading = scatter[:2].sum() / 2, scatter[2]
    usual = USUAL_WANDER_DEG**2
    between = [(USUAL_WEIGHT * usual + part) / (USUAL_WEIGHT + freedom) for part in (tilt, heading)]
    noise = [float(own_by_night[:, :2].mean()), float(own_by_night[:, 2].mean())]
    inside = [float(within[:2].mean()), float(within[2])]
    known = [
        math.degrees(math.radians(math.sqrt(b * (1 + 1 / len(nights)) + n / len(nights) + w)))
        for b, n, w in zip(between, noise, inside, strict=True)
    ]
    wander = [math.sqrt(part / freedom) if freedom else math.nan for part in (tilt, heading)]
    return Mount(reference, known[0], known[1], wander[0], wander[1])


def _within(rotations: F8, night: Rows, nights: Rows) -> F8:
    """Variance of frames around the mean of their night, about east, north and up, deg^2; includes the frames' noise."""
    squares, freedom = np.zeros(3), 0
    for number in nights:
        rows = np.flatnonzero(night == number)
        if len(rows) > 1:
            squares += (turns_deg(rotations[rows], mean_rotation(rotations[rows])) ** 2).sum(axis=0)
            freedom += len(rows) - 1
    return squares / freedom if freedom else squares


def turned(rotation: F8, vector_deg: F8) -> F8:
    """Rotate a camera by angles about east, north and up: the inverse of `turns_deg`."""
    return np.asarray(rotation_of(rotation @ np.radians(vector_deg)) @ rotation)
