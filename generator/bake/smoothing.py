"""Smoothing Monte Carlo maps: a polynomial in all coordinates, fitted to the logarithm with the samples' weights."""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def polynomial_terms(coordinates: list[Floats], degrees: list[int], total_degree: int) -> Floats:
    """Products of Chebyshev polynomials of the coordinates, each scaled to -1..1: (cells, terms) array.

    Parameters
    ----------
    coordinates : list of (n_i,) arrays
        Axes of the map.
    degrees : list of int
        Largest degree in each.
    total_degree : int
        Largest sum of degrees.
    """
    bases = []
    for axis, degree in zip(coordinates, degrees, strict=True):
        x = 2 * (axis - axis.min()) / (axis.max() - axis.min()) - 1
        bases.append(np.polynomial.chebyshev.chebvander(x, degree))
    chosen = [powers for powers in itertools.product(*(range(d + 1) for d in degrees)) if sum(powers) <= total_degree]
    shape = [len(axis) for axis in coordinates]
    columns = []
    for powers in chosen:
        term = np.ones(shape)
        for dimension, (base, power) in enumerate(zip(bases, powers, strict=True)):
            term = term * base[:, power].reshape([-1 if k == dimension else 1 for k in range(len(shape))])
        columns.append(term.ravel())
    return np.stack(columns, axis=-1)


def smooth(
    values: Floats, relative_error: Floats, coordinates: list[Floats], degrees: list[int], total_degree: int
) -> tuple[Floats, Floats, float]:
    """Smooth positive values.

    Three rounds of reweighting (Huber's, at 2.5 sigma) keep cells with a lucky path from pulling the fit.

    Returns
    -------
    smoothed : array like `values`
    error : array like `values`
        Relative standard error of the fit.
    scatter : float
        Robust scatter of the residuals in units of the samples' errors: 1 where noise is all there is.
    """
    terms = polynomial_terms(coordinates, degrees, total_degree)
    log_values = np.log(values).ravel()
    # A heavy tail makes an unlucky cell look precise: no cell counts as better than a third of the median error.
    sigma = np.maximum(relative_error.ravel(), np.median(relative_error) / 3)
    robust = np.ones_like(sigma)
    for _ in range(4):
        weight = np.sqrt(robust) / sigma
        solution, *_ = np.linalg.lstsq(terms * weight[:, None], log_values * weight, rcond=None)
        residual = (log_values - terms @ solution) / sigma
        robust = np.minimum(1, 2.5 / np.maximum(np.abs(residual), 1e-9))
    scatter = float(1.4826 * np.median(np.abs(residual)))
    covariance = np.linalg.inv((terms * weight[:, None]).T @ (terms * weight[:, None]))
    error = np.sqrt(np.einsum("ij,jk,ik->i", terms, covariance, terms)) * max(1.0, scatter)
    return np.exp(terms @ solution).reshape(values.shape), error.reshape(values.shape), scatter
