"""Reflection by the ground: its albedo by wavelength, and the additional light of the sky that results."""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RegularGridInterpolator

from generator.light.atmosphere import Atmosphere
from generator.light.bake_grids import DEFAULT_ALBEDO, VIEW_ALTITUDES_DEG, WAVELENGTHS_NM, CityGrid, GroundGrid
from generator.light.baked_maps import baked_equivalent, ground_map

Floats = NDArray[np.float64]
Albedo = float | tuple[tuple[float, float], ...]
"""A grey ground's albedo, or points (nm, albedo) with increasing wavelengths."""


def albedo_at(albedo: Albedo, wavelength_nm: Floats) -> Floats:
    """Albedo at some wavelengths, (n,) array: linear between its points, constant beyond them."""
    if isinstance(albedo, tuple):
        points = np.array(albedo)
        return np.interp(wavelength_nm, points[:, 0], points[:, 1])
    return np.full(np.shape(wavelength_nm), float(albedo))


@functools.cache
def _interpolators() -> tuple[RegularGridInterpolator, RegularGridInterpolator]:
    """Interpolators of the logarithms of the glow and of the lamps' light in those of aerosol depth and wavelength."""
    grid = GroundGrid()
    axes = (np.log(grid.aerosol_tau_550), np.log(grid.wavelength_nm))
    lamps = np.moveaxis(ground_map(), 0, 3)
    return RegularGridInterpolator(axes, np.log(ground_map("glow"))), RegularGridInterpolator(axes, np.log(lamps))


def _points(atmosphere: Atmosphere) -> Floats:
    """Points of the bake at which its air scatters as this one does at WAVELENGTHS_NM, or the nearest ones, (w, 2)."""
    grid = GroundGrid()
    wavelength, tau = baked_equivalent(np.array(WAVELENGTHS_NM), atmosphere)
    wavelength = np.clip(wavelength, grid.wavelength_nm[0], grid.wavelength_nm[-1])
    tau = np.clip(tau, grid.aerosol_tau_550[0], grid.aerosol_tau_550[-1])
    return np.stack([np.log(tau), np.log(wavelength)], axis=-1)


def ground_glow(atmosphere: Atmosphere) -> Floats:
    """Radiance of the air above an infinite Lambertian ground that emits light of 1, sr^-1, (w, views) array.

    The ground does not reflect the returning light again. Axes: WAVELENGTHS_NM, the bake's view altitudes.
    """
    return np.exp(_interpolators()[0](_points(atmosphere)))


def spherical_albedo(atmosphere: Atmosphere) -> Floats:
    """Fraction of the light from an infinite Lambertian ground that the air returns to it, (w,) array at WAVELENGTHS_NM."""
    sine = np.sin(np.radians(VIEW_ALTITUDES_DEG))
    glow = ground_glow(atmosphere)
    # Down to the horizon, the radiance of the lowest view altitude is used.
    below = np.pi * sine[0] ** 2 * glow[:, 0]
    return np.asarray(below + 2 * np.pi * np.trapezoid(glow * sine, sine, axis=1))


def ground_light(albedo: Floats, falling: Floats, returned: Floats | float) -> Floats:
    """Light that leaves a ground, per area, if the air (or cloud) repeatedly returns a part of it.

    Parameters
    ----------
    albedo : array
    falling : array
        Light that falls on black ground.
    returned : array
        Fraction of the light from the ground that returns. The sum is a geometric series (Chandrasekhar 1950, section 72).
    """
    return albedo * falling / (1 - albedo * returned)


def lamp_light_change(albedo: Floats, atmosphere: Atmosphere) -> Floats:
    """Change of a lamp's multiply scattered light if the ground's albedo differs from the bake's.

    Parameters
    ----------
    albedo : (w,) array
        Albedo at WAVELENGTHS_NM.
    atmosphere : Atmosphere

    Returns
    -------
    (patterns, w, views, rings + 1) array
        Mean over azimuth at the edges of CityGrid's rings, km^-2 sr^-1 per unit output.
    """
    once = np.moveaxis(np.exp(_interpolators()[1](_points(atmosphere))), 2, 0)
    returned = spherical_albedo(atmosphere)
    baked = np.full_like(returned, DEFAULT_ALBEDO)
    gain = ground_light(albedo, np.ones_like(albedo), returned) - ground_light(baked, np.ones_like(baked), returned)
    return once * gain[:, None, None]


def with_ground(kernel: Floats, albedo: Albedo, atmosphere: Atmosphere) -> Floats:
    """Logarithm of the kernel of :func:`generator.light.baked_maps.city_kernel` for ground of another albedo.

    The change has the kernel's shape in azimuth, because light from Lambertian ground around the lamp has lost its direction.
    """
    if albedo == DEFAULT_ALBEDO:
        return kernel
    change = lamp_light_change(albedo_at(albedo, np.array(WAVELENGTHS_NM)), atmosphere)
    edges = CityGrid().edges[1]
    around = np.trapezoid(np.exp(kernel), edges, axis=-1) / 180
    return kernel + np.log(np.maximum(1 + change / around, 1e-3))[..., None]
