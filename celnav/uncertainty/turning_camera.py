"""Corrections of positions for a camera that turns during the exposure, derived from the streaks of the stars.

Each streak is the path of a star while the camera turns, so all streaks of a frame determine one rotation vector, up to its
sense. Two shifts follow. First, the midpoint of a streak is not where the star was at mid-exposure: with a lens that keeps
lines straight it is farther out, by an eighth of the acceleration of the position. That shift does not depend on the
sense of the rotation, and is subtracted.

Second, a rolling shutter reads one row after the other, and a row that is read a time t later sees the camera after t more
of its turn. With streaks of s px in the exposure T, and a time t_r from the first row to the last, stars at the edges are
off by s t_r / T / 2, which shears the image. Neither t_r nor the sense of the rotation is known, but the field of these
shifts is, up to one signed number, t_r / T. It is fitted to the stars with a standard deviation of its own
(`celnav.SkybenchConfig.readout_sigma`).
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from celnav.adjustment import Adjusted, CameraPriors
from celnav.camera import Camera
from celnav.fix import Estimate
from celnav.identification.verification import rotation_of, turning_derivatives
from celnav.problem import Problem
from celnav.uncertainty.field_errors import NamedStars

F8 = NDArray[np.float64]

FEWEST_STREAKS = 4
# Rounds that alternately determine the senses of the streaks from the rotation, and the rotation from the streaks.
_ROUNDS = 3


def turn_of_streaks(camera: Camera, rays: F8, streak_px: F8) -> F8 | None:
    """Return the rotation vector of the sky in the camera frame during the exposure, radians, in either sense; shape (3,).

    Parameters
    ----------
    camera : Camera
        The camera.
    rays : ndarray, shape (n, 3)
        Directions of the midpoints of the streaks, camera frame; NaN outside the image circle.
    streak_px : ndarray, shape (n, 2)
        Vector from one end of each streak to the other, in either sense; 0 for a star without a streak.
    """
    length = np.hypot(*streak_px.T)
    rows = np.flatnonzero((length > 0) & np.isfinite(rays[:, 0]))
    if len(rows) < FEWEST_STREAKS:
        return None
    rays, streak, length = rays[rows], streak_px[rows], length[rows]
    moving = turning_derivatives(rays, camera.project_with_derivatives(rays)[1])
    beside = np.column_stack((-streak[:, 1], streak[:, 0])) / length[:, None]
    # A rotation must not move a star across its streak. This condition gives the axis whatever the senses are, and the axis
    # then gives the senses.
    across = np.einsum("na,nak->nk", beside, moving)
    scale = np.sqrt(np.einsum("nak,nak->k", moving, moving))
    turn = np.linalg.svd(across / scale, full_matrices=False)[2][-1] / scale
    for _ in range(_ROUNDS):
        sense = np.where(np.einsum("na,nak,k->n", streak, moving, turn) < 0, -1.0, 1.0)
        turn = np.linalg.lstsq(moving.reshape(-1, 3), (streak * sense[:, None]).ravel(), rcond=None)[0]
    return np.asarray(turn)


def at_mid_exposure(problem: Problem) -> Problem:
    """Determine the rotation, and move detections from the midpoints of streaks to the mid-exposure positions of the stars.

    Without streaks the problem is returned unchanged.
    """
    seen = problem.observation
    if seen.streak_px is None or (turn := turn_of_streaks(seen.camera, seen.rays, seen.streak_px)) is None:
        return problem
    rows = np.flatnonzero(seen.streak_px.any(axis=1) & np.isfinite(seen.rays[:, 0]))
    ends = [seen.camera.project(seen.rays[rows] @ rotation_of(sign / 2 * turn).T) for sign in (1, -1)]
    off = (ends[0] + ends[1]) / 2 - seen.uv[rows]
    uv = seen.uv.copy()
    uv[rows] -= np.where(np.isfinite(off), off, 0.0)
    return replace(problem, observation=replace(seen, uv=uv, rays=seen.camera.to_rays(uv)), turn_rad=turn)


def by_readout(camera: Camera, uv: F8, rays: F8, turn: F8) -> F8:
    """Derivatives of positions by the readout time over the exposure, shape (n, 2): the streak times the row's delay."""
    moving = turning_derivatives(rays, camera.project_with_derivatives(rays)[1])
    delay = uv[:, 1] / max(camera.height - 1, 1) - 0.5
    return np.asarray(np.nan_to_num(moving @ turn) * delay[:, None])


def fitted_readout(
    named: NamedStars, shifts: F8, priors: CameraPriors, sigma: float, so_far: float
) -> tuple[Estimate, F8]:
    """Fit the readout time over the exposure to the residuals of an adjustment, together with all parameters fitted there.

    Parameters
    ----------
    named : NamedStars
        The stars, with positions from which `so_far` times the shifts have been subtracted.
    shifts : ndarray, shape (n, 2)
        Derivatives of the positions of all detections (`by_readout`).
    priors : CameraPriors
        Priors of the camera in the adjustment.
    sigma : float
        Prior standard deviation of the readout time over the exposure; the prior mean is 0.
    so_far : float
        Estimate of the readout time over the exposure that has been subtracted so far.

    Returns
    -------
    Estimate and ndarray, shape (3 + k,)
        The estimate, including `so_far`, and the response of the fitted parameters to its error.
    """
    design, adjusted = named.fitted_design, named.adjusted
    shift = named.rounded(shifts.take(named.detection, axis=0)[:, :, None])
    free = np.flatnonzero(adjusted.camera_sigmas > 0)
    held = np.concatenate((np.zeros(3), 1 / np.maximum(priors.sigmas[free], 1e-300) ** 2))
    weighted = (design * named.precision[:, None, None]).reshape(2 * len(design), -1)
    normal = weighted.T @ design.reshape(weighted.shape) + np.diag(held)
    mixed = weighted.T @ shift.ravel()
    # The adjustment has already removed its own parameters from the residuals.
    answer = np.asarray(-np.linalg.solve(normal, mixed), dtype=np.float64)
    left = shift.ravel() + design.reshape(weighted.shape) @ answer
    precision = np.repeat(named.precision, 2)
    information = float(shift.ravel() @ (precision * left)) + 1 / sigma**2
    gradient = float(left @ (precision * named.residual.ravel())) - so_far / sigma**2
    return Estimate(so_far + gradient / information, 1 / math.sqrt(information)), answer


def widened_by(adjusted: Adjusted, readout: Estimate, answer: F8) -> Adjusted:
    """Add the uncertainty of the readout time to the covariance of an adjustment."""
    cov = adjusted.cov + readout.sigma**2 * np.outer(answer, answer)
    sigmas = adjusted.camera_sigmas.copy()
    sigmas[np.flatnonzero(sigmas > 0)] = np.sqrt(np.diag(cov)[3:])
    return replace(adjusted, cov=cov, camera_sigmas=sigmas)
