"""The baked map of multiply scattered twilight: exponentials of polynomials, evaluated between the bake's airs."""

from __future__ import annotations

import functools
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from generator.light.bake_grids import BakedAir, TwilightGrid, content_hash
from generator.light.baked_maps import FOLDER, read
from generator.light.chebyshev import Axis, evaluated
from generator.twilight.twilight_single import ScatteredSunlight, TwilightDepths

Floats = NDArray[np.float64]

TWILIGHT_FILE: Path = FOLDER / "twilight.npz"
TOTAL_DEGREE, GROUND_DEGREE = 9, 2
"""Largest sums of degrees, for the light and for its part that the ground has reflected."""
OVERHEAD_DEG = 20.0
"""Angle from the zenith within which differences between azimuths fade."""
_AROUND_DEG: Floats = np.arange(15.0, 180.0, 30.0)
_AXES = (("rayleigh", 5), ("altitude", 7), ("depression", 8), ("azimuth", 5))


def coordinates(axis: str, at: ArrayLike) -> Floats:
    """The variable of the polynomials on an axis of the map, in which the light is smooth."""
    value = np.asarray(at, float)
    if axis == "rayleigh":
        return np.log(value)
    if axis == "altitude":
        return np.sqrt(np.maximum(value, 0))
    # The light is the same on both sides of the Sun.
    return np.asarray(np.cos(np.radians(value))) if axis == "azimuth" else value


def polynomial_axes(grid: TwilightGrid) -> tuple[Axis, ...]:
    """Axes of the polynomials: Rayleigh depth, altitude of the line of sight, depression and azimuth of the Sun."""
    values = (grid.rayleigh_tau, grid.view_altitude_deg, grid.depression_deg, grid.relative_azimuth_deg)
    axes = []
    for (name, degree), nodes in zip(_AXES, values, strict=True):
        at = coordinates(name, nodes)
        axes.append(Axis(float(at.min()), float(at.max()), degree))
    return tuple(axes)


def twilight_map(part: str = "coefficients") -> Floats:
    """The map; (observer, aerosol, 4, ...) coefficients.

    The four are the light at the three depths of ozone and, at the second, its part that the ground has reflected. The
    parts 'walked' and 'walked_error' are the random walks' means and relative errors, 'relative_error' that of the fit.

    Raises
    ------
    DataFileError
    """
    return read(TWILIGHT_FILE, content_hash(BakedAir(), TwilightGrid()), part)


@functools.cache
def _coefficients() -> Floats:
    return twilight_map()


def lagrange(nodes: Floats, at: ArrayLike) -> Floats:
    """Weights of the polynomial through all nodes, (nodes, ...) array."""
    place = np.asarray(at, float)
    rows = [
        np.prod([(place - other) / (own - other) for k, other in enumerate(nodes) if k != own_k], axis=0)
        for own_k, own in enumerate(nodes)
    ]
    return np.stack([np.broadcast_to(row, place.shape) for row in rows])


def twilight_multiple(
    depths: TwilightDepths,
    observer_km: float,
    depression_deg: float,
    altitude_deg: Floats,
    relative_azimuth_deg: Floats,
    ground_albedo: Floats,
) -> ScatteredSunlight:
    """Sunlight scattered more than once, or by the ground.

    Beyond the map's range the nearest value is used (observer above 12 km, aerosol above 0.3, wavelengths beyond 345 to
    1,100 nm); thinner aerosol is extrapolated.

    Parameters
    ----------
    depths : TwilightDepths
    observer_km : float
    depression_deg : float
        0 to 18.
    altitude_deg, relative_azimuth_deg : (views,), (azimuths,) arrays
    ground_albedo : (w,) array
        Albedo of the ground. The ground's part of the light is taken as proportional to it, including that of several
        reflections.

    Returns
    -------
    ScatteredSunlight
        (w, views, azimuths) arrays.
    """
    grid, axes = TwilightGrid(), polynomial_axes(TwilightGrid())
    rayleigh = np.clip(depths.rayleigh, grid.rayleigh_tau[0], grid.rayleigh_tau[-1])
    azimuth = np.append(relative_azimuth_deg, _AROUND_DEG)
    at = (rayleigh, np.maximum(altitude_deg, 0), np.array([depression_deg]), azimuth)
    bases = [axis.basis(coordinates(name, v)) for (name, _), axis, v in zip(_AXES, axes, at, strict=True)]
    height = lagrange(np.array(grid.observer_km), min(max(observer_km, 0.0), grid.observer_km[-1]))
    haze = lagrange(np.sqrt(grid.aerosol_tau), np.sqrt(np.minimum(depths.aerosol, grid.aerosol_tau[-1])))
    at_height = np.tensordot(height, _coefficients(), axes=1)
    # Axes (aerosol, kind, rayleigh, altitude, azimuth), then the aerosol of each wavelength.
    tables = np.stack([np.stack([evaluated(kind, bases)[:, :, 0] for kind in each]) for each in at_height])
    logs = np.einsum("aw,akwvz->kwvz", haze, tables)
    # At the zenith all azimuths are the same direction, which the fit does not know.
    mean = logs[..., len(relative_azimuth_deg) :].mean(axis=-1, keepdims=True)
    apart = np.minimum((90 - altitude_deg) / OVERHEAD_DEG, 1)[:, None]
    apart = apart * (2 - apart)
    logs = mean + (logs[..., : len(relative_azimuth_deg)] - mean) * apart
    nodes = np.array(grid.ozone_tau)
    light = np.exp(np.einsum("kw,kwvz->wvz", lagrange(nodes, depths.ozone), logs[:3]))
    path = -np.einsum("kw,kwvz->wvz", _slopes(nodes, depths.ozone), logs[:3])
    ground = np.exp(np.minimum(logs[3] - logs[1], 0))
    return ScatteredSunlight(light * (1 + ground * (ground_albedo / BakedAir().ground_albedo - 1)[:, None, None]), path)


def _slopes(nodes: Floats, at: Floats) -> Floats:
    """Derivatives of :func:`lagrange` for three nodes."""
    rows = []
    for k, own in enumerate(nodes):
        first, second = np.delete(nodes, k)
        rows.append((2 * at - first - second) / ((own - first) * (own - second)))
    return np.stack(rows)
