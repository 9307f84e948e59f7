"""Errors of an adjusted field that single stars do not show: shared residuals, and the uncertainty of the lens."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from celnav.adjustment import Adjusted, CameraPriors, design_of
from celnav.attitude import Attitude
from celnav.camera import Camera
from celnav.detecting.star_shape import median
from celnav.fix import Estimate
from celnav.horizon import horizontal_frame
from celnav.uncertainty.lens_errors import lens_covariance, lens_derivatives, turn_by_lens
from celnav.uncertainty.noise_components import airmass, relative_sigmas
from celnav.uncertainty.refraction_errors import refraction_derivatives
from celnav.uncertainty.shared_residuals import SharedField, Sway, shared_field, sway

F8 = NDArray[np.float64]
Rows = NDArray[np.intp]

SAME_VERTICAL_DEG = 0.2
"""An attitude whose vertical is this close to that of the camera's calibration is assumed to come from that calibration:
mounts move by hundredths of a degree, and no level agrees with a calibration so well by chance."""
# Less likely pairs carry no information about the field.
_LEAST_WEIGHT = 0.05
CLEAR_SIGMAS = 4.0
"""Refraction is corrected if it is off by this many standard deviations, those of the stars and of the inputs combined."""
MOST_REFRACTION = 0.35
"""Largest relative error of the refraction that a wrong height or weather can cause (3,000 m of height cause 0.25); a larger
one comes from the lens."""
_FEWEST_NUMBERS = 60
_WORST_CONDITION = 1e10


@dataclass(frozen=True, eq=False)
class FieldOfStars:
    """The inputs of an adjustment.

    Attributes
    ----------
    camera : Camera
        The camera as supplied.
    uv, rays : ndarray, shapes (n, 2) and (n, 3)
        Detections with refraction removed.
    relative_sigma : ndarray, shape (n,), or None
        Standard deviations of the detections up to a common factor.
    dirs : ndarray, shape (k, 3)
        Directions of the stars, terrestrial frame.
    up : ndarray, shape (3,), or None
        Zenith in the camera frame; None if it is unknown or there is no air.
    air : tuple of float
        Pressure (hPa) and temperature (deg C).
    air_sigma : float
        Relative standard deviation of the refraction.
    whitening : ndarray, shape (n, 2, 2), or None
        Matrices that make the errors of the detections isotropic, up to a factor; used instead of `relative_sigma`.
    """

    camera: Camera
    uv: F8
    rays: F8
    relative_sigma: F8 | None
    dirs: F8
    up: F8 | None
    air: tuple[float, float]
    air_sigma: float
    whitening: F8 | None = None

    @cached_property
    def mass(self) -> F8 | None:
        """Airmass of each detection, shape (n,)."""
        return None if self.up is None else airmass(self.rays @ self.up)


@dataclass(frozen=True, eq=False)
class NamedStars:
    """The informative pairs of an adjustment, and their derivatives by possible errors.

    Attributes
    ----------
    field : FieldOfStars
        Inputs of the adjustment.
    adjusted : Adjusted
        Its result.
    rows, detection : ndarray of int, shape (n,)
        Indices of the pairs, and of their detections.
    precision : ndarray, shape (n,)
        Inverse variances, px^-2; for streaks, from the geometric mean of the standard deviations along and across them.
    rounding : ndarray, shape (n, 2, 2), or None
        For streaks: matrices of unit determinant under which the errors are isotropic.
    turned : ndarray, shape (n, 3)
        Directions of the stars, camera frame.
    free : ndarray of int, shape (k,)
        Indices of the focal length and of the camera parameters that were fitted.
    design : ndarray, shape (n, 2, 3 + k)
        Derivatives of the predictions by a rotation and by the parameters `free`, after `rounding`. `by_air` and the
        residuals are after `rounding` too.
    by_air : ndarray, shape (n, 2, 1), or None
        Derivatives by the relative error of the refraction; None if no vertical is known or there is no air.
    """

    field: FieldOfStars
    adjusted: Adjusted
    rows: Rows
    detection: Rows
    precision: F8
    rounding: F8 | None
    turned: F8
    free: Rows
    design: F8
    by_air: F8 | None

    @classmethod
    def of(cls, field: FieldOfStars, adjusted: Adjusted) -> NamedStars:
        """Select the informative pairs and compute their derivatives."""
        rows = np.flatnonzero(adjusted.weight > _LEAST_WEIGHT)
        detection, star = adjusted.detection[rows], adjusted.star[rows]
        own, rounding = np.ones(len(rows)), None
        if field.whitening is not None:
            white = field.whitening.take(detection, axis=0)
            own = np.abs(np.linalg.det(white)) ** -0.5
            rounding = white * own[:, None, None]
        elif field.relative_sigma is not None:
            own = (field.relative_sigma / median(field.relative_sigma))[detection]
        precision = adjusted.weight[rows] / (adjusted.sigma_px * own) ** 2
        turned = field.dirs.take(star, axis=0) @ adjusted.rotation.T
        free = np.flatnonzero(adjusted.camera_sigmas > 0)
        if not len(free) or free[0]:
            free = np.concatenate((np.zeros(1, dtype=np.intp), free))
        design = design_of(field.camera, turned, adjusted.camera_values, free)
        by_air = None if field.up is None else refraction_derivatives(field.camera, turned, field.up, *field.air)
        if rounding is not None:
            design, by_air = rounding @ design, None if by_air is None else rounding @ by_air
        return cls(field, adjusted, rows, detection, precision, rounding, turned, free, design, by_air)

    @property
    def residual(self) -> F8:
        """Measured minus predicted, px, shape (n, 2)."""
        return self.rounded(self.adjusted.residual_px.take(self.rows, axis=0)[:, :, None])[:, :, 0]

    def rounded(self, moved: F8) -> F8:
        """Apply `rounding` to shifts of the stars, shape (n, 2, m), so that they are in the axes of `design`."""
        return moved if self.rounding is None else np.asarray(self.rounding @ moved)

    @property
    def fitted_design(self) -> F8:
        """The design matrix, without the focal length if that was not fitted."""
        if self.adjusted.camera_sigmas[0] > 0:
            return self.design
        return np.concatenate((self.design[:, :, :3], self.design[:, :, 4:]), axis=2)


def measured_sigmas(field: FieldOfStars, adjusted: Adjusted) -> F8 | None:
    """Estimate relative standard deviations of the detections; None if the supplied ones explain the residuals."""
    own = np.ones(len(field.uv)) if field.relative_sigma is None else field.relative_sigma
    half_square = np.einsum("ni,ni->n", adjusted.residual_px, adjusted.residual_px) / 2
    if field.whitening is not None:
        white = (field.whitening.take(adjusted.detection, axis=0) @ adjusted.residual_px[:, :, None])[:, :, 0]
        half_square = np.einsum("ni,ni->n", white, white) / 2 * own.take(adjusted.detection) ** 2
    return relative_sigmas(half_square, adjusted.weight, adjusted.detection, own, field.mass)


def with_shared_errors(
    named: NamedStars, priors: CameraPriors, attitude: Attitude | None
) -> tuple[Adjusted, SharedField | None]:
    """Widen the covariance of an adjustment by errors shared by neighbours and by the uncertainties of air and lens.

    Parameters
    ----------
    named : NamedStars
        The adjusted stars and the result.
    priors : CameraPriors
        Priors of the camera in the adjustment.
    attitude : Attitude or None
        The attitude with which the orientation will be compared.
    """
    field, adjusted, precision, design = named.field, named.adjusted, named.precision, named.fitted_design
    free = np.flatnonzero(adjusted.camera_sigmas > 0)
    held = np.concatenate((np.zeros(3), 1 / np.maximum(priors.sigmas[free], 1e-300) ** 2))
    together = _calibrated_together(field.camera, attitude)
    shared = shared_field(
        field.uv.take(named.detection, axis=0),
        named.residual,
        precision,
        design,
        held,
        None if field.mass is None else field.mass.take(named.detection),
        (field.camera.width, field.camera.height),
        _reference(field) if together else None,
    )
    if shared is not None:
        cov = adjusted.cov + shared.cov
        of_camera = adjusted.camera_sigmas.copy()
        of_camera[free] = np.sqrt(np.diag(cov)[3:])
        adjusted = replace(adjusted, cov=cov, camera_sigmas=of_camera)
    cov = adjusted.cov.copy()
    if named.by_air is not None:
        turn = turn_by_lens(design, named.by_air, precision, held)
        cov[:3, :3] += field.air_sigma**2 * turn @ turn.T
    uncertainty = field.camera.uncertainty
    if uncertainty is not None:
        by_lens = named.rounded(lens_derivatives(field.camera, named.turned, uncertainty.names))
        turn = turn_by_lens(design, by_lens, precision, held)
        cov[:3, :3] += lens_covariance(uncertainty, turn, np.array(uncertainty.turn_by_lens) if together else None)
    return replace(adjusted, cov=cov), shared


def shown_refraction(named: NamedStars) -> Estimate | None:
    """Return the relative error of the refraction if the stars show it clearly whatever the focal length, else None.

    It is fitted in one linear problem together with a rotation, the focal length and the camera parameters that were fitted.
    The radial terms of a lens that was calibrated on stars contain the refraction error of those nights, so for such a lens
    the result is None.
    """
    field = named.field
    known = field.camera.uncertainty
    if named.by_air is None or (known is not None and "f_px" in known.names) or 2 * len(named.rows) < _FEWEST_NUMBERS:
        return None
    columns = np.concatenate((named.design, named.by_air), axis=2)
    weighted = (columns * named.precision[:, None, None]).reshape(2 * len(columns), -1)
    normal = weighted.T @ columns.reshape(weighted.shape)
    scale = np.sqrt(np.diag(normal))
    if not (scale > 0).all():
        return None
    normal /= np.outer(scale, scale)
    eigenvalues = np.linalg.eigvalsh(normal)
    if not eigenvalues[-1] <= _WORST_CONDITION * eigenvalues[0]:
        return None
    inverse = np.linalg.inv(normal)
    fitted = inverse[-1] @ (weighted.T @ named.residual.ravel() / scale)
    value, sigma = float(fitted / scale[-1]), math.sqrt(float(inverse[-1, -1])) / float(scale[-1])
    clear = abs(value) > CLEAR_SIGMAS * math.hypot(sigma, field.air_sigma)
    return Estimate(value, sigma) if clear and abs(value) < MOST_REFRACTION else None


def _calibrated_together(camera: Camera, attitude: Attitude | None) -> bool:
    """Return whether the vertical of an attitude is the one that was calibrated with the camera."""
    if attitude is None or camera.uncertainty is None or not camera.uncertainty.R_cam:
        return False
    apart = horizontal_frame(attitude)[:, 2] - np.array(camera.uncertainty.R_cam)[:, 2]
    return float(np.linalg.norm(apart)) < np.radians(SAME_VERTICAL_DEG)


def _reference(field: FieldOfStars) -> Sway | None:
    """Return how residuals at the star positions of the calibration have rotated its attitude."""
    assert field.camera.uncertainty is not None
    cells = np.array(field.camera.uncertainty.star_cells)
    rays = field.camera.to_rays(cells[:, :2])
    seen = np.isfinite(rays[:, 0])
    cells, rays = cells[seen], rays[seen]
    if len(cells) < 3:
        return None
    mass = np.ones(len(rays)) if field.up is None else airmass(rays @ field.up)
    design = design_of(field.camera, rays, np.zeros(5), np.empty(0, dtype=np.intp))
    return sway(cells[:, :2], mass, design, cells[:, 2], np.zeros(3))
