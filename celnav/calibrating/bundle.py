"""Joint adjustment of one lens and the attitudes of its frames to matched stars, by weighted least squares.

The method is Gauss-Newton on pixel residuals (Triggs et al. 2000, Bundle Adjustment: A Modern Synthesis, sections 4 and 6).
Derivatives by the lens are central differences; those by the attitudes are analytic, through the projection. The loss is
quadratic for stars accepted as true, or Cauchy's (Holland & Welsch 1977, Commun. Stat. A 6(9) 813) while wrong matches may
still be among them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from celnav.calibrating.lens_form import LensForm
from celnav.errors import CameraError
from celnav.identification.verification import rotation_of, turning_derivatives

F8 = NDArray[np.float64]
Rows = NDArray[np.intp]

_ROUNDS = 40
# Size of a step, in standard deviations, at which its effect on any parameter is negligible.
_SETTLED = 1e-3
_CAUCHY = 3.0
# Weight, relative and absolute, of directions that nothing determines; without it the equations would be singular.
_RIDGE, _TINY = 1e-11, 1e-6


@dataclass(frozen=True, eq=False)
class Observations:
    """Stars matched to detections.

    Attributes
    ----------
    uv : ndarray, shape (n, 2)
        Measured positions.
    dirs : ndarray, shape (n, 3)
        Apparent directions, east-north-up.
    sigma_px : ndarray, shape (n,)
        Standard deviation of a measured position along each axis.
    frame : ndarray, shape (n,)
        Number of the frame.
    detection, star : ndarray, shape (n,)
        Rows of the frame's detections and of its sky.
    pull_px : ndarray, shape (n,)
        Distance by which the light of neighbours may pull the position, pixels.
    """

    uv: F8
    dirs: F8
    sigma_px: F8
    frame: Rows
    detection: Rows
    star: Rows
    pull_px: F8

    def __len__(self) -> int:
        return len(self.uv)

    def take(self, rows: Rows | NDArray[np.bool_]) -> Observations:
        """Return the selected observations."""
        return Observations(*(getattr(self, one.name)[rows] for one in fields(self)))


@dataclass(frozen=True, eq=False)
class Bundle:
    """A lens and the attitudes of groups of frames.

    Attributes
    ----------
    form : LensForm
        The lens parameters that were fitted.
    size : tuple of int
        Width and height of the frames.
    values : ndarray, shape (m,)
        Parameters of the lens, in the order of `form.names`.
    rotations : ndarray, shape (g, 3, 3)
        East-north-up to camera, for each group of frames that shares one attitude.
    cov : ndarray, shape (m, m), or None
        Covariance of the lens parameters, with the attitudes free.
    turn_cov : ndarray, shape (g, 3, 3), or None
        Covariance of a small rotation of each group in the camera frame, radians squared, with the lens held fixed.
    turn_by_lens : ndarray, shape (g, 3, m), or None
        Rotation of each group in the camera frame, radians, per unit of each lens parameter.
    centre_sigma_px : float
        Expected standard deviation of the principal point about the centre of the frame. In a narrow field the principal
        point cannot be separated from the attitude, and nothing else constrains it.
    """

    form: LensForm
    size: tuple[int, int]
    values: F8
    rotations: F8
    cov: F8 | None = None
    turn_cov: F8 | None = None
    turn_by_lens: F8 | None = None
    centre_sigma_px: float = math.inf

    def predict(self, dirs: F8, group: Rows) -> F8:
        """Project directions, shape (n, 3), east-north-up, each with the attitude of its group."""
        camera = self.form.camera(self.values, self.size)
        return camera.project(np.einsum("nij,nj->ni", self.rotations[group], dirs))


def adjust(bundle: Bundle, seen: Observations, group: Rows, *, robust: bool, prior: F8 | None = None) -> Bundle:
    """Fit lens and attitudes.

    Parameters
    ----------
    bundle : Bundle
        Starting values.
    seen : Observations
        n matched stars.
    group : ndarray, shape (n,)
        Index of the attitude that each star belongs to.
    robust : bool
        Use Cauchy's loss instead of squares.
    prior : ndarray, shape (m,), optional
        Weights (inverse variances) that hold lens parameters to their starting values. None: all are free.

    Returns
    -------
    Bundle
        The fit, with its covariance: the inverse of the information for the standard deviations in `seen`.
    """
    held, begun = _expected(bundle, np.zeros(len(bundle.values)) if prior is None else prior)
    order = np.argsort(group, kind="stable")
    seen, group = seen.take(order), group[order]
    first = np.searchsorted(group, np.arange(len(bundle.rotations) + 1))
    cost = _cost(bundle, seen, group, robust) + float(held @ (bundle.values - begun) ** 2)
    damping = 0.0
    normal = _normal(bundle, seen, group, first, robust, held, begun)
    for _ in range(_ROUNDS):
        better = False
        for _ in range(8):
            step = normal.step(damping)
            moved = _moved(bundle, step)
            if moved is not None:
                new = _cost(moved, seen, group, robust) + float(held @ (moved.values - begun) ** 2)
                if new <= cost * (1 + 1e-9):
                    better = True
                    break
            damping = max(10 * damping, 1e-6)
        if not better or moved is None:
            break
        settled = float(np.concatenate((step[0], step[1].ravel())) @ normal.gradient) < _SETTLED**2
        bundle, cost, damping = moved, new, damping / 10 if damping > 1e-9 else 0.0
        normal = _normal(bundle, seen, group, first, robust, held, begun)
        if settled:
            break
    return replace(bundle, cov=normal.lens_cov, turn_cov=normal.turn_cov, turn_by_lens=normal.turn_by_lens)


def _expected(bundle: Bundle, prior: F8) -> tuple[F8, F8]:
    """Return weights and values, shapes (m,), of the priors: `prior` about the start, principal point about the centre."""
    weights, values = prior.copy(), bundle.values.copy()
    if math.isfinite(bundle.centre_sigma_px):
        weight = 1 / bundle.centre_sigma_px**2
        for name, size in zip(("cx_px", "cy_px"), bundle.size, strict=True):
            column = bundle.form.names.index(name)
            values[column] = (prior[column] * values[column] + weight * (size - 1) / 2) / (prior[column] + weight)
            weights[column] += weight
    return weights, values


@dataclass(frozen=True, eq=False)
class _Normal:
    """Normal equations in blocks: lens (m, m), attitudes (g, 3, 3), cross terms (g, m, 3); and gradients."""

    lens: F8
    turn: F8
    cross: F8
    of_lens: F8
    of_turn: F8

    @property
    def gradient(self) -> F8:
        """Gradient of all parameters, shape (m + 3 g,)."""
        return np.concatenate((self.of_lens, self.of_turn.ravel()))

    def step(self, damping: float) -> tuple[F8, F8]:
        """Solve by elimination of the attitudes (Schur complement); undetermined directions stay unchanged."""
        damped = self._turn(damping)
        eliminated = np.linalg.solve(damped, np.swapaxes(self.cross, 1, 2))  # (g, 3, m)
        of_turn = np.linalg.solve(damped, self.of_turn[:, :, None])[:, :, 0]
        complement = self.lens - np.einsum("gmi,gin->mn", self.cross, eliminated)
        gradient = self.of_lens - np.einsum("gmi,gi->m", self.cross, of_turn)
        scale = 1 / np.sqrt(np.maximum(np.diag(self.lens), 1e-100))
        scaled = complement * scale[:, None] * scale + (damping + _RIDGE) * np.eye(len(scale))
        of_lens = scale * np.linalg.solve(scaled, scale * gradient)
        return of_lens, of_turn - np.einsum("gim,m->gi", eliminated, of_lens)

    def _turn(self, damping: float = 0.0) -> F8:
        """Return the damped blocks of the attitudes, regular even where stars leave a direction undetermined."""
        diagonal = np.einsum("gii->gi", self.turn)
        ridge = damping * diagonal + _RIDGE * diagonal.sum(axis=1)[:, None] + _TINY
        return np.asarray(self.turn + ridge[:, :, None] * np.eye(3))

    @property
    def lens_cov(self) -> F8:
        """Covariance of the lens, with the attitudes free."""
        eliminated = np.linalg.solve(self._turn(), np.swapaxes(self.cross, 1, 2))
        complement = self.lens - np.einsum("gmi,gin->mn", self.cross, eliminated)
        scale = 1 / np.sqrt(np.maximum(np.diag(self.lens), 1e-100))
        inverse = np.linalg.inv(complement * scale[:, None] * scale + _RIDGE * np.eye(len(scale)))
        return np.asarray(inverse * scale[:, None] * scale)

    @property
    def turn_cov(self) -> F8:
        """Covariance of each attitude, with the lens held fixed."""
        return np.asarray(np.linalg.inv(self._turn()))

    @property
    def turn_alone(self) -> F8:
        """Rotation of each attitude, shape (g, 3), that the residuals call for with the lens held fixed."""
        return np.asarray(np.linalg.solve(self._turn(), self.of_turn[:, :, None])[:, :, 0])

    @property
    def turn_by_lens(self) -> F8:
        """Rotation of each attitude per unit of each lens parameter."""
        return np.asarray(-np.linalg.solve(self._turn(), np.swapaxes(self.cross, 1, 2)))


def residuals(bundle: Bundle, seen: Observations, group: Rows) -> F8:
    """Return measured minus predicted positions, shape (n, 2); NaN where the lens cannot show the direction."""
    return np.asarray(seen.uv - bundle.predict(seen.dirs, group))


def _moved(bundle: Bundle, step: tuple[F8, F8]) -> Bundle | None:
    values = bundle.values + step[0]
    try:
        bundle.form.camera(values, bundle.size)
    except CameraError:
        return None
    turned = np.stack([rotation_of(s) @ r for s, r in zip(step[1], bundle.rotations, strict=True)])
    return Bundle(bundle.form, bundle.size, values, turned, centre_sigma_px=bundle.centre_sigma_px)


def _square(residual: F8, sigma_px: F8) -> F8:
    square = np.einsum("ni,ni->n", residual, residual) / sigma_px**2
    # A star outside the lens's field counts as a very distant one.
    return np.nan_to_num(square, nan=1e6)


def _cost(bundle: Bundle, seen: Observations, group: Rows, robust: bool) -> float:
    square = _square(residuals(bundle, seen, group), seen.sigma_px)
    if not robust:
        return float(square.sum())
    return float(np.sum(_CAUCHY**2 * np.log1p(square / _CAUCHY**2)))


def _weights(residual: F8, sigma_px: F8, robust: bool) -> F8:
    weight = 1 / sigma_px**2
    if robust:
        weight = weight / (1 + _square(residual, sigma_px) / _CAUCHY**2)
    return np.where(np.isfinite(residual[:, 0]), weight, 0.0)


def _linear(bundle: Bundle, seen: Observations, group: Rows) -> tuple[F8, F8, F8]:
    """Residuals (n, 2), and derivatives of predictions by the lens (n, 2, m) and by a rotation of the group (n, 2, 3)."""
    turned = np.einsum("nij,nj->ni", bundle.rotations[group], seen.dirs)
    camera = bundle.form.camera(bundle.values, bundle.size)
    predicted, by_direction = camera.project_with_derivatives(turned)
    of_lens = np.empty((len(seen), 2, len(bundle.values)))
    for column, step in enumerate(bundle.form.steps(bundle.values)):
        change = np.zeros(len(bundle.values))
        change[column] = step
        ahead = bundle.form.camera(bundle.values + change, bundle.size).project(turned)
        behind = bundle.form.camera(bundle.values - change, bundle.size).project(turned)
        of_lens[:, :, column] = (ahead - behind) / (2 * step)
    of_turn = turning_derivatives(turned, by_direction)
    return seen.uv - predicted, np.nan_to_num(of_lens), np.nan_to_num(of_turn)


def response(bundle: Bundle, seen: Observations, group: Rows, moved_px: F8) -> tuple[F8, F8]:
    """Return how a fit follows when the measured positions move.

    Parameters
    ----------
    bundle : Bundle
        The fit.
    seen : Observations
        The n stars that it was fitted to.
    group : ndarray, shape (n,)
        Index of the attitude that each star belongs to.
    moved_px : ndarray, shape (c, n, 2)
        Shifts of the positions by each of c causes.

    Returns
    -------
    lens : ndarray, shape (c, m)
        Changes of the lens parameters, with the attitudes free.
    turn : ndarray, shape (c, g, 3)
        Rotations of the groups in the camera frame, radians, with the lens held fixed.
    """
    order = np.argsort(group, kind="stable")
    seen, group = seen.take(order), group[order]
    first = np.searchsorted(group, np.arange(len(bundle.rotations) + 1))
    held, _ = _expected(bundle, np.zeros(len(bundle.values)))
    _, of_lens, of_turn = _linear(bundle, seen, group)
    weight = 1 / seen.sigma_px**2
    normals = [_equations(of_lens, of_turn, weight, moved[order], first, held) for moved in moved_px]
    lens = np.array([normal.step(0.0)[0] for normal in normals])
    return lens, np.array([normal.turn_alone for normal in normals])


def _normal(bundle: Bundle, seen: Observations, group: Rows, first: Rows, robust: bool, held: F8, begun: F8) -> _Normal:
    """Normal equations at a bundle; rows are sorted by group, and `first` holds the first row of each group."""
    residual, of_lens, of_turn = _linear(bundle, seen, group)
    weight = _weights(residual, seen.sigma_px, robust)
    normal = _equations(of_lens, of_turn, weight, np.nan_to_num(residual), first, held)
    return replace(normal, of_lens=normal.of_lens - held * (bundle.values - begun))


def _equations(of_lens: F8, of_turn: F8, weight: F8, residual: F8, first: Rows, held: F8) -> _Normal:
    """Normal equations of residuals, shape (n, 2), with the derivatives of `_linear`; `held` are weights of the lens."""
    weighted = of_lens * weight[:, None, None]
    m, n_groups = of_lens.shape[2], len(first) - 1
    lens = weighted.reshape(-1, m).T @ of_lens.reshape(-1, m) + np.diag(held)
    gradient = weighted.reshape(-1, m).T @ residual.ravel()
    turn, cross, turn_gradient = np.zeros((n_groups, 3, 3)), np.zeros((n_groups, m, 3)), np.zeros((n_groups, 3))
    for g in range(n_groups):
        part = slice(first[g], first[g + 1])
        rows = of_turn[part].reshape(-1, 3)
        w = np.repeat(weight[part], 2)[:, None]
        turn[g] = rows.T @ (rows * w)
        cross[g] = weighted[part].reshape(-1, m).T @ rows
        turn_gradient[g] = (rows * w).T @ residual[part].ravel()
    return _Normal(lens, turn, cross, gradient, turn_gradient)
