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
    """Smooth positive values by a generalised linear model: logarithmic link, standard deviation proportional to the mean.

    Its estimating equation balances values over fit, not logarithms, so that the fit keeps the mean of samples whose errors
    have long tails (McCullagh & Nelder 1989, "Generalized Linear Models", chapter 8).

    Returns
    -------
    smoothed : array like `values`
    error : array like `values`
        Relative standard error of the fit.
    scatter : float
        Robust scatter of the residuals in units of the samples' errors: 1 where noise is all there is.
    """
    terms = polynomial_terms(coordinates, degrees, total_degree)
    observed = values.ravel()
    solution, *_ = np.linalg.lstsq(terms, np.log(np.maximum(observed, observed[observed > 0].min())), rcond=None)
    inverse = np.linalg.inv(terms.T @ terms)
    for _ in range(30):
        deviation = observed / np.exp(terms @ solution) - 1
        solution = solution + np.clip(inverse @ (terms.T @ deviation), -1, 1)
    fitted = np.exp(terms @ solution)
    residual = observed / fitted - 1
    scatter = float(1.4826 * np.median(np.abs(residual) / np.maximum(relative_error.ravel(), 1e-9)))
    error = np.sqrt(np.einsum("ij,jk,ik->i", terms, inverse, terms)) * float(np.std(residual))
    return fitted.reshape(values.shape), error.reshape(values.shape), scatter
