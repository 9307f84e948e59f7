"""Residuals shared by neighbouring stars: from a wrong lens, moving air or an asymmetric point spread function.

Errors that neighbours share do not average out as independent ones do, and the part of such a field of errors that looks
like a rotation of the camera is not visible in the residuals at all. The field is modelled as a Gaussian process over the
frame. Its variance and correlation length are estimated from the residuals by restricted maximum likelihood (Patterson &
Thompson 1971, Biometrika 58, 545), which allows for what the fit has absorbed. The adjustment itself remains that of
independent stars, but its covariance becomes the one that it has under such errors (White 1980, Econometrica 48, 817, with
a model instead of the products of single residuals). An attitude that was calibrated with the same lens by the same kind
of adjustment is wrong in the same way, so only the difference counts. Stars are first averaged over cells of the frame, so
that the work does not grow with their number.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

F8 = NDArray[np.float64]

CELLS = 8
"""Number of cells along the longer side of the frame."""
LENGTHS = (0.12, 0.35, 1.0)
"""Correlation lengths tried, in half diagonals of the frame: standard deviations of a Gaussian correlation function."""
FEWEST_STARS = 12
LEAST_SCORE = 2.5
"""Score, in standard deviations, from which neighbours are taken to share errors. Chance reaches it in one frame of fifteen,
because the score is the largest of three sums of squares; the covariance of such a frame grows by a third."""
_VARIANCES = np.geomspace(0.05, 5000.0, 21)


@dataclass(frozen=True, eq=False)
class Sway:
    """Response of fitted parameters to residuals at places in the frame.

    Attributes
    ----------
    uv : ndarray, shape (c, 2)
        The places, px.
    mass : ndarray, shape (c,)
        Airmass at each place.
    gain : ndarray, shape (k, c, 2)
        Change of each parameter for a residual of one pixel along each axis.
    """

    uv: F8
    mass: F8
    gain: F8


@dataclass(frozen=True, eq=False)
class SharedField:
    """A field of errors that neighbouring stars share.

    Attributes
    ----------
    rms_px : float
        Root mean square of the field along an axis, at the centre of the frame or, if it grows with the airmass, for
        airmass 1.
    length_px : float
        Standard deviation of its Gaussian correlation function.
    with_air : bool
        Whether the field grows with the airmass.
    score : float
        Standard deviations by which neighbours agree more than independent stars would.
    cov : ndarray, shape (k, k)
        Contribution to add to the covariance of the fitted parameters.
    """

    rms_px: float
    length_px: float
    with_air: bool
    score: float
    cov: F8


@dataclass(frozen=True, eq=False)
class _Cells:
    """Means over cells: position (c, 2), residual (c, 2), design (c, 2, k), airmass (c,); precision along an axis (c,)."""

    uv: F8
    residual: F8
    design: F8
    mass: F8
    precision: F8


def _gather(uv: F8, residual: F8, precision: F8, design: F8, mass: F8, size: tuple[int, int]) -> _Cells:
    """Average over cells of the frame, weighted by precision."""
    column, row = np.floor((uv + 0.5) / (max(size) / CELLS)).astype(np.intp).T
    column -= column.min()
    cell = (row - row.min()) * (int(column.max()) + 1) + column
    k, count = design.shape[2], int(cell.max()) + 1
    values = np.empty((2 * k + 6, len(uv)))
    values[0], values[1:3], values[3:5], values[5] = 1.0, uv.T, residual.T, mass
    values[6:] = design.reshape(-1, 2 * k).T
    values *= precision
    # One bincount sums all quantities: each quantity has its own range of bin numbers.
    numbers = cell + count * np.arange(len(values))[:, None]
    sums = np.bincount(numbers.ravel(), weights=values.ravel(), minlength=count * len(values)).reshape(-1, count)
    sums = sums[:, sums[0] > 0]
    means = (sums[1:] / sums[0]).T
    return _Cells(means[:, :2], means[:, 2:4], means[:, 5:].reshape(-1, 2, k), means[:, 4], sums[0])


def shared_field(
    uv: F8,
    residual: F8,
    precision: F8,
    design: F8,
    held: F8,
    mass: F8 | None,
    size: tuple[int, int],
    reference: Sway | None = None,
) -> SharedField | None:
    """Test for a field of shared errors and estimate it.

    Parameters
    ----------
    uv : ndarray, shape (n, 2)
        Positions of identified stars.
    residual : ndarray, shape (n, 2)
        Measured minus predicted, px.
    precision : ndarray, shape (n,)
        Inverse variance of each along an axis, px^-2.
    design : ndarray, shape (n, 2, k)
        Derivatives of the predictions by the fitted parameters.
    held : ndarray, shape (k,)
        Inverse variances of the priors of the parameters.
    mass : ndarray, shape (n,), or None
        Airmass; None if no vertical is known.
    size : tuple of int
        Width and height of the frame.
    reference : Sway, optional
        Response of an attitude that was fitted with the same lens and so shares its errors. The covariance is then that of
        the difference.

    Returns
    -------
    SharedField or None
        The field; None if neighbours agree no better than by chance.
    """
    if len(uv) < FEWEST_STARS:
        return None
    air = np.ones(len(uv)) if mass is None else mass
    cells = _gather(uv, residual, precision, design, air, size)
    if 2 * len(cells.uv) < design.shape[2] + 6:
        return None
    half = math.hypot(*size) / 2
    apart = _squared_distances(cells.uv)
    correlations = np.exp(apart * (-0.5 / (half * np.array(LENGTHS)) ** 2)[:, None, None])
    score = _score(cells, correlations, held)
    if score < LEAST_SCORE:
        return None
    growths = [(False, np.ones(len(cells.uv)))] + ([] if mass is None else [(True, cells.mass)])
    best = (-math.inf, 0.0, 0.0, False)
    typical = float(np.median(1 / cells.precision))
    for length, correlation in zip(LENGTHS, correlations, strict=True):
        for with_air, growth in growths:
            variances = _VARIANCES * typical / float(np.median(growth)) ** 2
            likelihood = _restricted(cells, correlation * growth[:, None] * growth, variances, held)
            top = int(np.argmax(likelihood))
            best = max(best, (float(likelihood[top]), float(variances[top]), length * half, with_air))
    _, variance, length_px, with_air = best
    swaying = sway(cells.uv, cells.mass, cells.design, cells.precision, held)
    if reference is not None:
        swaying = _difference(swaying, reference)
    cov = variance * _of_parameters(swaying, length_px, with_air)
    return SharedField(math.sqrt(variance), length_px, with_air, score, cov)


def _score(cells: _Cells, correlations: F8, held: F8) -> float:
    """Return the largest score of several correlation matrices, shape (l, c, c).

    The score is the derivative of the restricted likelihood by the variance of the field, in units of its standard deviation
    in the absence of such a field. With P the precisions of both axes, the inverse covariance that the fit leaves is
    P - V V^T; with C the correlation of each axis, only C P and V^T C V are needed.
    """
    count, _, k = cells.design.shape
    design = np.swapaxes(cells.design, 0, 1).reshape(2 * count, k)
    precision = np.tile(cells.precision, 2)
    weighted = design * precision[:, None]
    normal = weighted.T @ design
    normal[np.diag_indices(k)] += held
    fitted = np.linalg.solve(np.linalg.cholesky(normal), weighted.T).reshape(k, 2, count)  # V^T
    residual = cells.residual.T
    sums = cells.precision * residual - np.einsum("kac,k->ac", fitted, np.einsum("kac,ac->k", fitted, residual))
    spreading = fitted @ correlations[:, None]  # V^T C, (l, k, 2, c)
    inner = np.einsum("lkac,jac->lkj", spreading, fitted)
    trace = precision.sum() - np.einsum("lkk->l", inner)
    power = (
        2 * (correlations * correlations @ cells.precision) @ cells.precision
        - 2 * ((spreading * spreading).sum(axis=(1, 2)) @ cells.precision)
        + np.einsum("lkj,lkj->l", inner, inner)
    )
    square = np.einsum("lac,ac->l", sums @ correlations, sums)
    return float(((square - trace) / np.sqrt(2 * power)).max())


def _restricted(cells: _Cells, field: F8, variances: F8, held: F8) -> F8:
    """Return the restricted log-likelihood of a field of unit covariance, shape (c, c), at several variances, shape (v,)."""
    count, _, k = cells.design.shape
    root = np.sqrt(cells.precision)
    eigenvalues, vectors = np.linalg.eigh(field * root[:, None] * root)
    columns = np.concatenate((cells.residual, cells.design.reshape(count, 2 * k)), axis=1)
    turned = vectors.T @ (columns * root[:, None])
    residual, design = turned[:, :2], turned[:, 2:].reshape(count, 2, k)
    weight = 1 / (1 + np.maximum(eigenvalues, 0.0) * variances[:, None])  # (v, c)
    normal = np.einsum("vc,cij->vij", weight, np.einsum("cai,caj->cij", design, design)) + np.diag(held)
    gradient = weight @ np.einsum("cai,ca->ci", design, residual)
    explained = np.einsum("vi,vi->v", gradient, np.linalg.solve(normal, gradient[:, :, None])[:, :, 0])
    square = weight @ (residual**2).sum(axis=1) - explained
    logarithms = -2 * np.log(weight).sum(axis=1) + np.linalg.slogdet(normal)[1]
    return np.asarray(-0.5 * (logarithms + square))


def sway(uv: F8, mass: F8, design: F8, precision: F8, held: F8) -> Sway:
    """Return how residuals at `uv`, shape (c, 2), move parameters that are fitted as if the residuals were independent."""
    weighted = design * precision[:, None, None]
    normal = np.einsum("cai,caj->ij", weighted, design) + np.diag(held)
    return Sway(uv, mass, np.asarray(np.einsum("ij,caj->ica", np.linalg.inv(normal), weighted)))


def _difference(one: Sway, other: Sway) -> Sway:
    """Return the response of the difference of two fits; the second has the first few parameters of the first."""
    gain = np.zeros((len(one.gain), *other.gain.shape[1:]))
    gain[: len(other.gain)] = -other.gain
    return Sway(
        np.concatenate((one.uv, other.uv)), np.concatenate((one.mass, other.mass)),
        np.concatenate((one.gain, gain), axis=1),
    )  # fmt: skip


def _of_parameters(sway: Sway, length_px: float, with_air: bool) -> F8:
    """Covariance of the parameters due to a field of unit variance, shape (k, k)."""
    field = np.exp(-0.5 * _squared_distances(sway.uv) / length_px**2)
    if with_air:
        field = field * sway.mass[:, None] * sway.mass
    return np.asarray(np.einsum("ica,cd,jda->ij", sway.gain, field, sway.gain, optimize=True))


def _squared_distances(uv: F8) -> F8:
    """Squared distances of all pairs of places, shape (c, c)."""
    u, v = uv.T
    return np.asarray(np.subtract.outer(u, u) ** 2 + np.subtract.outer(v, v) ** 2)
