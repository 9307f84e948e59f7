"""Adjustment of the whole field: one least-squares problem over all stars for the orientation and, if asked, the camera.

A detection is one of the stars predicted near it, or clutter. The probability of each, from the distance, the noise and the
density of unexplained detections, is its weight (expectation maximisation; Dempster, Laird & Rubin 1977, J. R. Statist. Soc.
B 39, 1). The effect is a robust loss whose scale comes from the frame itself. The covariance is the inverse of the observed
information of that mixture (Louis 1982, J. R. Statist. Soc. B 44, 226), which accounts for confusion. It is that of Student's
distribution, because a few residuals determine the noise only poorly.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from celnav.camera import Camera
from celnav.checking import bounded, check_fields
from celnav.detecting.star_shape import median
from celnav.identification.verification import rotation_of, turning_derivatives

F8 = NDArray[np.float64]

PARAMETERS = ("log_f", "cx_px", "cy_px", "q1", "q2")


@dataclass(frozen=True)
class CameraPriors:
    """Prior standard deviations of the camera parameters in self-calibration; zero keeps the camera's value.

    Attributes
    ----------
    focal : float
        Standard deviation of the logarithm of the focal length.
    centre_px : float
        Standard deviation of the principal point along each axis, pixels.
    distortion : float
        Standard deviation of the two radial terms: positions move from the principal point by the factor
        1 + q1 r^2 + q2 r^4, with r the distance from it over half the diagonal of the frame.
    """

    focal: float = bounded(0.0, 0)
    centre_px: float = bounded(0.0, 0)
    distortion: float = bounded(0.0, 0)

    def __post_init__(self) -> None:
        check_fields(self)

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
    cov : ndarray, shape (3 + k, 3 + k)
        Covariance of a small rotation in the camera frame (rad^2), followed by the camera parameters that were free.
    camera_values, camera_sigmas : ndarray, shape (5,)
        Changes of the camera, in the order of `PARAMETERS`, and their standard deviations (0: kept fixed).
    detection, star : ndarray, shape (m,)
        Pairs that may belong together: rows of the positions and of the stars.
    weight : ndarray, shape (m,)
        Probability that each pair belongs together.
    residual_px : ndarray, shape (m, 2)
        Observed minus predicted position of each pair.
    sigma_px : float
        Estimated standard deviation of a centroid along each axis (for detections of unit relative sigma).
    """

    rotation: F8
    cov: F8
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
    centre, focal = np.array([camera.cx_px, camera.cy_px]), math.exp(values[0])
    if not values[3:].any():
        return np.asarray(focal * ideal + ((1 - focal) * centre + values[1:3]))
    from_centre = ideal - centre
    r2 = np.einsum("ni,ni->n", from_centre, from_centre) / _half_diagonal(camera) ** 2
    factor = focal * (1 + values[3] * r2 + values[4] * r2**2)
    return np.asarray(centre + values[1:3] + factor[:, None] * from_centre)


def _half_diagonal(camera: Camera) -> float:
    return math.hypot(camera.width, camera.height) / 2


def design_of(camera: Camera, dirs: F8, values: F8, free: NDArray[np.intp]) -> F8:
    """Derivatives of predicted positions by a rotation and by the free camera parameters, shape (n, 2, 3 + k)."""
    ideal, by_direction = camera.project_with_derivatives(dirs)
    factor = np.full((len(dirs), 1), math.exp(values[0]))
    design = np.empty((len(dirs), 2, 3 + len(free)))
    if len(free):
        from_centre = ideal - [camera.cx_px, camera.cy_px]
        r2 = (np.einsum("ni,ni->n", from_centre, from_centre) / _half_diagonal(camera) ** 2)[:, None]
        focal = math.exp(values[0])
        factor = focal * (1 + values[3] * r2 + values[4] * r2**2)
        ones, zeros = np.ones(len(dirs)), np.zeros(len(dirs))
        for k, parameter in enumerate(free):
            if parameter == 0:
                design[:, :, 3 + k] = factor * from_centre
            elif parameter <= 2:
                design[:, :, 3 + k] = np.column_stack((ones, zeros) if parameter == 1 else (zeros, ones))
            else:
                design[:, :, 3 + k] = focal * r2 ** (parameter - 2) * from_centre
    # The change of the distortion itself along the radius is a second-order effect and is neglected.
    design[:, :, :3] = factor[:, :, None] * turning_derivatives(dirs, by_direction)
    return design


def associate(
    detection: NDArray[np.intp], star: NDArray[np.intp], ratio: F8, link: F8, rounds: int = 2
) -> tuple[F8, F8]:
    """Probabilities that pairs belong together, if a detection is at most one star and a star at most one detection.

    Computed by belief propagation (Williams & Lau 2014, IEEE Trans. Aerosp. Electron. Syst. 50(4) 2942).

    Parameters
    ----------
    detection, star : ndarray, shape (m,)
        The pairs.
    ratio : ndarray, shape (m,)
        Likelihood of the pair, divided by the likelihood that the detection is clutter and the star is not seen.
    link : ndarray, shape (m,)
        Messages from detections to stars to start from; all ones at first.
    rounds : int
        Number of rounds of the propagation.

    Returns
    -------
    tuple of two ndarrays, shape (m,)
        The probabilities, and the messages.
    """
    for _ in range(rounds):
        offered = ratio * link
        by_star = np.bincount(star, weights=offered)[star] - offered
        answer = ratio / (1 + np.maximum(by_star, 0))
        by_detection = np.bincount(detection, weights=answer)[detection] - answer
        link = 1 / (1 + np.maximum(by_detection, 0))
    offered = ratio * link
    return np.asarray(offered / (1 + np.bincount(star, weights=offered)[star])), link


def _information(design: F8, residual: F8, weight: F8, starts: NDArray[np.intp], variance: float) -> tuple[F8, F8, F8]:
    """Return the complete-data information (pairs taken as known), the observed information, and the gradient.

    Pairs are sorted by detection; `starts` holds the first pair of each detection. The design has the shape
    (2, parameters, pairs).
    """
    across, down = design
    complete = ((across * weight) @ across.T + (down * weight) @ down.T) / variance
    scores = across * (residual[:, 0] / variance) + down * (residual[:, 1] / variance)
    weighted = scores * weight
    of_detection = np.add.reduceat(weighted, starts, axis=1)
    return complete, complete - weighted @ scores.T + of_detection @ of_detection.T, scores @ weight


def noise_known_by(freedom: float) -> float:
    """Factor on the covariance of a fit whose noise is estimated from its own residuals, with `freedom` degrees of freedom.

    The unknowns then have Student's distribution, whose variance is n / (n - 2) times that of the normal distribution
    (Johnson, Kotz & Balakrishnan 1995, Continuous Univariate Distributions 2, chapter 28). Fewer than 3 degrees of freedom,
    for which the variance has no bound, get the factor for 3.
    """
    freedom = max(freedom, 3.0)
    return freedom / (freedom - 2)


def adjust(
    camera: Camera,
    uv: F8,
    relative_sigma: F8 | None,
    stars: F8,
    pairs: tuple[NDArray[np.intp], NDArray[np.intp]],
    rotation: F8,
    *,
    values: F8,
    sigma_px: float,
    priors: CameraPriors,
    area_px: float,
    min_sigma_px: float = 0.01,
    max_rounds: int = 40,
    whitening: F8 | None = None,
) -> Adjusted | None:
    """Fit orientation and camera parameters to the field.

    Parameters
    ----------
    camera : Camera
        The camera as supplied.
    uv : ndarray, shape (n, 2)
        Detections with refraction removed.
    relative_sigma : ndarray, shape (n,), or None
        Standard deviations of the detections up to a common factor.
    stars : ndarray, shape (k, 3)
        Directions, terrestrial frame, of the stars of the field that are bright enough to be seen.
    pairs : tuple of two ndarrays, shape (m,)
        Rows of detections and of stars that may belong together.
    rotation : ndarray, shape (3, 3)
        Approximate rotation from the terrestrial frame to the camera.
    values : ndarray, shape (5,)
        Starting values of the camera parameters, in the order of `PARAMETERS`.
    sigma_px : float
        Initial guess of the noise.
    priors : CameraPriors
        Prior standard deviations of the camera parameters, which decide what may change.
    area_px : float
        Area of the image that can show stars.
    min_sigma_px : float
        Floor of the estimated noise, since catalogue and refraction are not more accurate.
    max_rounds : int
        Largest number of iterations.
    whitening : ndarray, shape (n, 2, 2), or None
        Matrices that make the errors of the detections isotropic, up to a factor; used instead of `relative_sigma`.

    Returns
    -------
    Adjusted or None
        None if fewer stars remain than the unknowns need, or the information matrix is not positive definite.
    """
    sigmas = priors.sigmas
    free = np.flatnonzero(sigmas > 0)
    n_free = 3 + len(free)
    detection, star = pairs
    if 2 * len(detection) < n_free + 3:
        return None
    order = np.argsort(detection, kind="stable")
    detection, star = detection[order], star[order]
    starts = np.flatnonzero(np.concatenate(([True], detection[1:] != detection[:-1])))
    on_diagonal = np.diag_indices(n_free)
    prior = np.zeros(n_free)
    prior[3:] = 1 / sigmas[free] ** 2
    own = np.ones(len(detection))
    if relative_sigma is not None and whitening is None:
        own = (relative_sigma / median(relative_sigma))[detection]
    own_square = own * own
    white = None if whitening is None else whitening.take(detection, axis=0)
    if white is not None:
        own_square = 1 / np.abs(np.linalg.det(white))
    dirs, observed = stars.take(star, axis=0), uv.take(detection, axis=0)
    # Axes are (axis, parameter, pair), so that every step passes over the pairs in memory order.
    design = design_of(camera, dirs @ rotation.T, values, free)
    design = np.ascontiguousarray((design if white is None else white @ design).transpose(1, 2, 0)) / own
    share, n_explained = 0.8, 0.8 * min(len(uv), len(stars))
    link = np.ones(len(detection))
    weight, residual = np.empty(0), np.empty((0, 2))
    information: F8 = np.empty((0, 0))
    for round_ in range(max_rounds):
        residual = observed - predict(camera, dirs @ rotation.T, values)
        scaled = residual / own[:, None] if white is None else (white @ residual[:, :, None])[:, :, 0]
        square = np.einsum("ni,ni->n", scaled, scaled)
        clutter = (max(len(uv) - n_explained, 0.0) + 1) / area_px
        ratio = share / (1 - share) / clutter / (2 * math.pi * sigma_px**2 * own_square)
        weight, link = associate(detection, star, ratio * np.exp(-0.5 * square / sigma_px**2), link)
        n_explained = float(weight.sum())
        if 2 * n_explained < n_free + 2:
            return None
        share = min(max(n_explained / len(stars), 0.02), 0.998)
        variance = max(float(np.sum(weight * square)) / (2 * n_explained - n_free), min_sigma_px**2)
        settled = abs(variance / sigma_px**2 - 1) < 0.01
        sigma_px = math.sqrt(variance)
        complete, observed_information, gradient = _information(design, scaled, weight, starts, variance)
        complete[on_diagonal] += prior
        observed_information[on_diagonal] += prior
        gradient[3:] -= prior[3:] * values[free]
        try:
            positive = bool(np.linalg.eigvalsh(observed_information)[0] > 0)
            information = observed_information if positive else complete
            # A compromise between Newton's step, which overshoots where stars compete, and that of expectation maximisation.
            damped = 0.5 * (complete + observed_information) if positive else complete
            step = np.asarray(np.linalg.solve(damped, gradient), dtype=np.float64)
        except np.linalg.LinAlgError:
            return None
        rotation = rotation_of(step[:3]) @ rotation
        values = values.copy()
        values[free] += step[3:]
        # Stop at steps below a thirtieth of their standard deviation.
        if round_ and settled and positive and float(step @ observed_information @ step) < 1e-3:
            break
    else:
        if not positive:
            return None
    try:
        covariance = np.asarray(np.linalg.inv(information), dtype=np.float64)
        # Parameters known from their prior do not count as unknowns: no residual makes them better or worse.
        told = float(prior @ np.diag(covariance))
        factor = noise_known_by(2 * n_explained - n_free + told)
        information = information / factor
        information[on_diagonal] += prior * (1 - 1 / factor)
        covariance = np.asarray(np.linalg.inv(information), dtype=np.float64)
    except np.linalg.LinAlgError:
        return None
    camera_sigmas = np.zeros(5)
    camera_sigmas[free] = np.sqrt(np.diag(covariance)[3:])
    return Adjusted(rotation, covariance, values, camera_sigmas, detection, star, weight, residual, float(sigma_px))


def without_focal(adjusted: Adjusted) -> Adjusted:
    """Return the adjustment as it would be with the focal length held fixed: the conditional Gaussian."""
    rest = [row for row in range(len(adjusted.cov)) if row != 3]
    gain = adjusted.cov[rest, 3] / adjusted.cov[3, 3]
    cov = adjusted.cov[rest][:, rest] - gain[:, None] * adjusted.cov[3, rest]
    free = np.flatnonzero(adjusted.camera_sigmas > 0)[1:]
    values, sigmas = np.zeros(5), np.zeros(5)
    values[free] = adjusted.camera_values[free] - gain[3:] * adjusted.camera_values[0]
    sigmas[free] = np.sqrt(np.diag(cov)[3:])
    turned = rotation_of(-gain[:3] * adjusted.camera_values[0]) @ adjusted.rotation
    return replace(adjusted, rotation=turned, cov=cov, camera_values=values, camera_sigmas=sigmas)
