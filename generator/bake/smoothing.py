"""Smoothing of a Monte Carlo map: the exponential of a polynomial in all coordinates, fitted to means over its cells."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from generator.light.chebyshev import Axis, evaluated

Floats = NDArray[np.float64]

GAUSS_POINTS = 3


def within_cells(edges: Floats) -> tuple[Floats, Floats]:
    """Gauss-Legendre places and weights (sum 1 per cell) in the cells of an axis, (cells * GAUSS_POINTS,) arrays."""
    node, weight = np.polynomial.legendre.leggauss(GAUSS_POINTS)
    middle, half = (edges[1:] + edges[:-1]) / 2, np.diff(edges) / 2
    return (middle[:, None] + half[:, None] * node).ravel(), np.tile(weight / 2, len(middle))


def smooth(
    mean: Floats,
    relative_error: Floats,
    axes: Sequence[Axis],
    points: Sequence[Floats],
    cells: Sequence[tuple[Floats, Floats]],
    total_degree: int,
    rounds: int = 12,
) -> tuple[Floats, Floats, float]:
    """Fit a map by a generalised linear model: logarithmic link, standard deviation proportional to the mean.

    Its estimating equation balances ratios of values to the fit, not logarithms, so that the fit preserves the mean of
    samples whose errors have long tails (McCullagh & Nelder 1989, "Generalized Linear Models", chapter 8). A value may be
    the mean of the function over a cell; the function itself is fitted.

    Parameters
    ----------
    mean, relative_error : (n_1, ..., n_d) arrays
    axes : sequence of d Axis
    points : sequence of arrays
        Coordinates of the first axes, on which `mean` contains values at points.
    cells : sequence of (edges, weight) pairs of arrays
        For the other axes: edges of the cells, and the weight of a place within them as a function of the coordinate, at
        the points of :func:`within_cells`.
    total_degree : int
        Largest sum of degrees.
    rounds : int
        Rounds of Newton's iteration.

    Returns
    -------
    coefficients : array
        Coefficients for :func:`evaluated`; its exponential is the map.
    covariance_root : (terms, terms) array
        The norm of the product of its rows with the terms of a place is the relative error there.
    scatter : float
        Root mean square of the residuals in units of the samples' errors: 1 if there is only noise.
    """
    shape = [axis.degree + 1 for axis in axes]
    chosen = chosen_terms(axes, total_degree)
    middles = [(edges[1:] + edges[:-1]) / 2 for edges, _ in cells]
    at_middle = [axis.basis(at) for axis, at in zip(axes, [*points, *middles], strict=True)]
    inside = [within_cells(edges)[0] for edges, _ in cells]
    at_inside = [axis.basis(at) for axis, at in zip(axes, [*points, *inside], strict=True)]
    terms = design(at_middle, chosen)
    weight = 1 / smooth_error(relative_error, axes, at_middle).ravel() ** 2
    covariance = np.linalg.inv((terms * weight[:, None]).T @ terms)
    coefficients = np.zeros(shape)
    flat = mean.ravel()
    start = np.log(np.where(flat > 0, flat, flat[flat > 0].min()))
    solution = covariance @ (terms.T @ (weight * start))
    for _ in range(rounds):
        coefficients[tuple(chosen.T)] = solution
        over_cells = np.exp(evaluated(coefficients, at_inside))
        for k, (edges, share) in enumerate(cells):
            over_cells = averaged(over_cells, len(points) + k, len(edges) - 1, share)
        residual = mean / over_cells - 1
        solution = solution + covariance @ (terms.T @ (weight * np.clip(residual.ravel(), -1, 1)))
    coefficients[tuple(chosen.T)] = solution
    scatter = float(np.sqrt(np.sum(weight * residual.ravel() ** 2) / (flat.size - len(chosen))))
    return coefficients, np.linalg.cholesky(covariance).T * max(scatter, 1.0), scatter


def chosen_terms(axes: Sequence[Axis], total_degree: int) -> NDArray[np.intp]:
    """Degrees of the terms that are used, (terms, d) array."""
    powers = itertools.product(*(range(axis.degree + 1) for axis in axes))
    return np.array([p for p in powers if sum(p) <= total_degree])


def design(bases: Sequence[Floats], chosen: NDArray[np.intp]) -> Floats:
    """Terms on the product grid of the bases, (points, terms) array."""
    table = np.ones((1, len(chosen)))
    for basis, degree in zip(bases, chosen.T, strict=True):
        table = (table[:, None, :] * basis[None, :, degree]).reshape(-1, len(chosen))
    return table


def averaged(values: Floats, axis: int, cells: int, weight: Floats) -> Floats:
    """Weighted mean over the points of :func:`within_cells` along one axis."""
    shape = list(values.shape)
    shape[axis : axis + 1] = [cells, GAUSS_POINTS]
    along = [1] * len(shape)
    along[axis : axis + 2] = [cells, GAUSS_POINTS]
    share = weight.reshape(along)
    return np.sum(values.reshape(shape) * share, axis=axis + 1) / np.sum(share, axis=axis + 1)


def smooth_error(relative_error: Floats, axes: Sequence[Axis], bases: Sequence[Floats]) -> Floats:
    """Smooth the samples' relative errors, which come from few batches, by a cubic fit to their logarithms."""
    chosen = chosen_terms([Axis(axis.low, axis.high, min(axis.degree, 3)) for axis in axes], 3)
    terms = design(bases, chosen)
    known = np.isfinite(relative_error.ravel()) & (relative_error.ravel() > 0)
    target = np.log(np.where(known, relative_error.ravel(), 1.0))
    solution = np.linalg.lstsq(terms[known], target[known], rcond=None)[0]
    return np.exp(terms @ solution).reshape(relative_error.shape)
