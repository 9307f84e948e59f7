"""Smoothing of the random walks of twilight: for each height and aerosol, exp of a polynomial in the other axes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from generator.bake.smoothing import chosen_terms, design, smooth
from generator.light.bake_grids import TwilightGrid
from generator.light.chebyshev import Axis
from generator.twilight.twilight_map import GROUND_DEGREE, TOTAL_DEGREE, coordinates, polynomial_axes

Floats = NDArray[np.float64]


def fitted(grid: TwilightGrid, mean: Floats, error: Floats) -> tuple[Floats, Floats, Floats]:
    """Fit all quantities of the walks.

    Parameters
    ----------
    grid : TwilightGrid
    mean, error : (observer, aerosol, rayleigh, view, 4, depression, azimuth) arrays

    Returns
    -------
    coefficients : (observer, aerosol, 4, ...) array
    relative : (observer, aerosol, rayleigh, view, depression, azimuth) array
        Relative error of the fit at the second ozone depth.
    scatter : (observer, aerosol, 4) array
        Root mean square of the residuals in units of the samples' errors.
    """
    axes = polynomial_axes(grid)
    points = [
        coordinates(*pair)
        for pair in (
            ("rayleigh", np.array(grid.rayleigh_tau)),
            ("altitude", np.array(grid.view_altitude_deg)),
            ("depression", np.array(grid.depression_deg)),
            ("azimuth", np.array(grid.relative_azimuth_deg)),
        )
    ]
    shape = mean.shape[:2]
    coefficients = np.zeros((*shape, 4, *(axis.degree + 1 for axis in axes)))
    relative, scatters = np.zeros((*shape, *mean[0, 0, :, :, 0].shape)), np.zeros((*shape, 4))
    for index in np.ndindex(shape):
        for k in range(4):
            values, errors = mean[index][:, :, k], np.where(mean[index][:, :, k] > 0, error[index][:, :, k], np.inf)
            degree = GROUND_DEGREE if k == 3 else TOTAL_DEGREE
            fit, spread, scatters[*index, k] = smooth(values, errors, axes, points, (), degree)
            coefficients[*index, k] = fit
            if k == 1:
                relative[index] = _spread_at(spread, axes, points, degree).reshape(relative[index].shape)
    return coefficients, relative, scatters


def _spread_at(spread: Floats, axes: tuple[Axis, ...], points: list[Floats], degree: int) -> Floats:
    terms = design([axis.basis(at) for axis, at in zip(axes, points, strict=True)], chosen_terms(axes, degree))
    result: Floats = np.sqrt(np.sum((terms @ spread.T) ** 2, axis=1))
    return result
