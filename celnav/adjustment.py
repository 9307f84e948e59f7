"""Adjustment of the whole field: one least-squares problem over all stars for orientation, and the camera if asked.

Each detection that has a predicted star nearby is that star, or clutter that happens to be there: the probability of
either, from the residual, the noise and the density of unexplained detections, is its weight (expectation
maximisation; Dempster, Laird & Rubin 1977, J. R. Statist. Soc. B 39, 1), a robust loss whose scale comes from the frame.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from celnav.camera import Camera
from celnav.identification.verification import mutual_nearest, rotation_of, turning_derivatives

F8 = NDArray[np.float64]

PARAMETERS = ("log_f", "cx_px", "cy_px", "q1", "q2")


@dataclass(frozen=True)
class CameraPriors:
    """Standard deviations of what self-calibration may change; zero keeps the camera's value.

    Attributes
    ----------
    focal : float
        Of the logarithm of the focal length.
    centre_px : float
        Of the principal point along each axis.
    distortion : float
        Of the two radial terms: positions move from the principal point by the factor 1 + q1 r^2 + q2 r^4, with r the
        distance from it over half the diagonal of the frame.
    """

    focal: float = 0.0
    centre_px: float = 0.0
    distortion: float = 0.0

    @property
    def sigmas(self) -> F8:
        """Standard deviations in the order of `PARAMETERS`."""
        return np.array([self.focal, self.centre_px, self.centre_px, self.distortion, self.distortion])


@dataclass(frozen=True, eq=False)
class Adjusted:
    """The orientation that explains the field best.

    Attributes
    ----------
    rotation : ndarray, shape (3, 3)
        Terrestrial frame to camera.
    cov_rad2 : ndarray, shape (3, 3)
        Covariance of a small rotation in the camera frame.
    camera_values, camera_sigmas : ndarray, shape (5,)
        What was added to the camera, in the order of `PARAMETERS`, and standard deviations (0: kept fixed).
    detection, star : ndarray, shape (m,)
        Pairs: rows of the positions and of the stars.
    weight : ndarray, shape (m,)
        Probability that the pair belongs together.
    residual_px : ndarray, shape (m, 2)
        Observed minus predicted.
    sigma_px : float
        Estimated standard deviation of a centroid along each axis (for detections of unit relative sigma).
    """

    rotation: F8
    cov_rad2: F8
    camera_values: F8
    camera_sigmas: F8
    detection: NDArray[np.intp]
    star: NDArray[np.intp]
    weight: F8
    residual_px: F8
    sigma_px: float


def predict(camera: Camera, dirs: F8, values: F8) -> F8:
    """Project directions, shape (n, 3), with the camera changed by `values` (in the order of `PARAMETERS`)."""
    return _changed(camera, camera.project(dirs), values)


def _changed(camera: Camera, ideal: F8, values: F8) -> F8:
    if not values.any():
        return ideal
    from_centre = ideal - [camera.cx_px, camera.cy_px]
    r2 = np.sum(from_centre**2, axis=1) / _half_diagonal(camera) ** 2
    factor = math.exp(values[0]) * (1 + values[3] * r2 + values[4] * r2**2)
    return np.asarray([camera.cx_px + values[1], camera.cy_px + values[2]] + factor[:, None] * from_centre)


def _half_diagonal(camera: Camera) -> float:
    return math.hypot(camera.width, camera.height) / 2


def _design(camera: Camera, dirs: F8, values: F8, free: NDArray[np.intp]) -> tuple[F8, F8]:
    """Predicted positions (n, 2) and their derivatives by rotation and the free camera parameters, (n, 2, 3 + k)."""
    ideal, by_direction = camera.project_with_derivatives(dirs)
    from_centre = ideal - [camera.cx_px, camera.cy_px]
    r2 = (np.sum(from_centre**2, axis=1) / _half_diagonal(camera) ** 2)[:, None]
    focal = math.exp(values[0])
    factor = focal * (1 + values[3] * r2 + values[4] * r2**2)
    design = np.empty((len(dirs), 2, 3 + len(free)))
    # The distortion's own change along the radius is of second order in it.
    design[:, :, :3] = factor[:, :, None] * turning_derivatives(dirs, by_direction)
    ones, zeros = np.ones(len(dirs)), np.zeros(len(dirs))
    columns = (
        factor * from_centre,
        np.column_stack((ones, zeros)),
        np.column_stack((zeros, ones)),
        focal * r2 * from_centre,
        focal * r2**2 * from_centre,
    )
    for k, parameter in enumerate(free):
        design[:, :, 3 + k] = columns[parameter]
    predicted = [camera.cx_px + values[1], camera.cy_px + values[2]] + factor * from_centre
    return np.asarray(predicted), design


def adjust(
    camera: Camera,
    uv: F8,
    relative_sigma: F8 | None,
    stars: F8,
    rotation: F8,
    *,
    log_f: float,
    sigma_px: float,
    priors: CameraPriors,
    area_px: float,
    min_sigma_px: float = 0.01,
    rematches: int = 2,
) -> Adjusted | None:
    """Fit the field.

    Parameters
    ----------
    camera : Camera
        The camera as it is thought to be.
    uv : ndarray, shape (n, 2)
        Detections, refraction taken off.
    relative_sigma : ndarray, shape (n,), or None
        Standard deviations of the detections up to a common factor.
    stars : ndarray, shape (k, 3)
        Directions of the stars that are bright enough to be seen, terrestrial frame.
    rotation : ndarray, shape (3, 3)
        Terrestrial frame to camera, nearly.
    log_f : float
        Starting value of the focal length's logarithm; used only where its prior leaves it free.
    sigma_px : float
        First guess of the noise.
    priors : CameraPriors
        What may change in the camera.
    area_px : float
        Area of the image that can hold stars.
    min_sigma_px : float
        Floor of the estimated noise: catalogue and refraction are no better.
    rematches : int
        How often stars and detections are paired anew.

    Returns
    -------
    Adjusted or None
        None where fewer than three pairs remain.
    """
    sigmas = priors.sigmas
    free = np.flatnonzero(sigmas > 0)
    values = np.zeros(5)
    if sigmas[0] > 0:
        values[0] = log_f
    relative = np.ones(len(uv)) if relative_sigma is None else relative_sigma / np.median(relative_sigma)
    information = np.zeros((3 + len(free), 3 + len(free)))
    detection = star = np.empty(0, dtype=np.intp)
    weight, residual = np.empty(0), np.empty((0, 2))
    for rematch in range(rematches):
        predicted = predict(camera, stars @ rotation.T, values)
        seen = np.flatnonzero(
            np.isfinite(predicted[:, 0]) & camera.in_frame(np.nan_to_num(predicted, nan=-1e9), 4 * sigma_px)
        )
        radius = max(4.5 * sigma_px, 0.25) if rematch else max(4.5 * sigma_px, 1.0)
        detection, star = mutual_nearest(uv, predicted[seen], radius)
        star = seen[star]
        if 2 * len(detection) < 3 + len(free) + 3:
            return None
        # Unexplained detections, and stars without one, decide how often chance puts a detection near a star.
        share = min(max(len(detection) / max(len(seen), 1), 0.02), 0.995)
        clutter = (len(uv) - len(detection) + 1) / area_px * (1 - share)
        dirs_of_stars, own = stars[star], relative[detection]
        for round_ in range(4 if rematch == rematches - 1 else 2):
            expected, design = _design(camera, dirs_of_stars @ rotation.T, values, free)
            residual = uv[detection] - expected
            square = np.sum(residual**2, axis=1) / own**2
            if round_ or rematch:
                density = share / (2 * math.pi * (sigma_px * own) ** 2) * np.exp(-0.5 * square / sigma_px**2)
                weight = density / (density + clutter)
            else:
                weight = 1.0 / (1.0 + square / (3 * sigma_px) ** 2)
            rows = design.reshape(-1, design.shape[2])
            scale = np.repeat(weight / own**2, 2)
            information = rows.T @ (rows * scale[:, None])
            gradient = rows.T @ (residual.reshape(-1) * scale)
            dof = max(2 * float(weight.sum()) - 3 - len(free), 1.0)
            sigma_px = max(math.sqrt(float(np.sum(weight * square)) / dof), min_sigma_px)
            for k, parameter in enumerate(free):
                information[3 + k, 3 + k] += (sigma_px / sigmas[parameter]) ** 2
                gradient[3 + k] -= (sigma_px / sigmas[parameter]) ** 2 * values[parameter]
            try:
                step = np.linalg.solve(information, gradient)
            except np.linalg.LinAlgError:
                return None
            rotation = rotation_of(step[:3]) @ rotation
            values = values.copy()
            values[free] += step[3:]
            if round_ and float(np.abs(step[:3]).max()) < 1e-9:
                break
    covariance = sigma_px**2 * np.linalg.inv(information)
    camera_sigmas = np.zeros(5)
    camera_sigmas[free] = np.sqrt(np.diag(covariance)[3:])
    return Adjusted(
        rotation, covariance[:3, :3], values, camera_sigmas, detection, star, weight, residual, float(sigma_px)
    )
