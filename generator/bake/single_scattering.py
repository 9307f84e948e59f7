"""Light scattered once, by quadrature along the line of sight, in the air of the bake.

City light has the form of Garstang's kernel (Garstang 1986, PASP 98, 364) for two exponential layers; moonlight that of a
homogeneous plane-parallel layer (Chandrasekhar 1950, "Radiative Transfer", section 7).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from generator.atmosphere import aerosol_optical_depth, rayleigh_optical_depth
from generator.bake.grids import BakedAir

Floats = NDArray[np.float64]

GARSTANG_NORMALISATION = 0.554
LAMP_HEIGHT_KM = 0.0005


def rayleigh_phase(cosine: ArrayLike) -> Floats:
    """Rayleigh's phase function, sr^-1."""
    return 3 / (16 * np.pi) * (1 + np.square(cosine))


def henyey_greenstein_phase(cosine: ArrayLike, asymmetry: float) -> Floats:
    """Phase function of Henyey & Greenstein 1941, ApJ 93, 70, sr^-1."""
    g = asymmetry
    return (1 - g * g) / (4 * np.pi) / (1 + g * g - 2 * g * np.asarray(cosine)) ** 1.5


def lamp_patterns(cosine: Floats) -> Floats:
    """Intensity per unit output above the horizon, sr^-1, Lambert and near the horizon (Garstang 1986), (2, ...) array."""
    angle = np.arccos(np.clip(cosine, -1, 1))
    up = cosine > 0
    return np.where(up, np.stack([cosine / np.pi, GARSTANG_NORMALISATION * angle**4 / (2 * np.pi)]), 0.0)


def disk_points(radius_km: float, rings: int = 4, spokes: int = 8) -> Floats:
    """Points of equal weight over a disk, (rings * spokes, 2) array: midpoints in the square of the radius and in azimuth."""
    square = (np.arange(rings) + 0.5) / rings
    angle = (np.arange(spokes) + 0.5 * (np.arange(rings)[:, None] % 2)) * 2 * np.pi / spokes
    radius = radius_km * np.sqrt(square)[:, None]
    return np.stack([radius * np.sin(angle), radius * np.cos(angle)], axis=-1).reshape(-1, 2)


def city_single(
    air: BakedAir,
    wavelength_nm: Floats,
    aerosol_tau_550: float,
    spots_km: Floats,
    directions: Floats,
    steps: int = 96,
    spot_radius_km: float = 0.0,
) -> Floats:
    """Radiance scattered once from lamps on the ground, mean over the lamps' places.

    Parameters
    ----------
    air : BakedAir
    wavelength_nm : (w,) array
    aerosol_tau_550 : float
    spots_km : (p, 2) array
        Places of the lamps, x and y.
    directions : (m, 3) array
        Where the observer at the origin looks (z up).
    steps : int
        Points of the quadrature, on a logarithmic scale of height.
    spot_radius_km : float
        What area each lamp stands for: its light is softened to 1 / (distance^2 + radius^2), so that a lamp close to the
        line of sight is a patch of the city and not a point.

    Returns
    -------
    (2, w, m) array
        Per unit photon output above the horizon in each pattern, km^-2 sr^-1.
    """
    rayleigh = rayleigh_optical_depth(wavelength_nm, air.pressure_hpa)[:, None]
    aerosol = aerosol_optical_depth(wavelength_nm, aerosol_tau_550, air.angstrom_exponent)[:, None]
    edge = np.concatenate([[0], np.geomspace(1e-3, air.top_km, steps)])
    height = (edge[1:] + edge[:-1]) / 2
    below_r = 1 - np.exp(-height / air.rayleigh_height_km)
    below_a = 1 - np.exp(-height / air.aerosol_height_km)
    depth = rayleigh * below_r + aerosol * below_a
    scatter_r = rayleigh * np.exp(-height / air.rayleigh_height_km) / air.rayleigh_height_km
    scatter_a = aerosol * np.exp(-height / air.aerosol_height_km) / air.aerosol_height_km * air.aerosol_albedo
    result = np.zeros((2, len(wavelength_nm), len(directions)))
    for m, direction in enumerate(directions):
        point = direction * (height / direction[2])[:, None]
        path = np.diff(edge) / direction[2]
        across = point[:, None, :2] - spots_km[None]
        rise = height - LAMP_HEIGHT_KM
        distance2 = np.sum(across**2, axis=-1) + (rise**2)[:, None]
        distance = np.sqrt(distance2)
        cosine = rise[:, None] / distance
        onward = np.concatenate([across, np.broadcast_to(rise[:, None, None], (*distance.shape, 1))], axis=-1)
        # From lamp to point, then from point to observer: the angle between the two legs.
        turn = -(onward @ direction) / distance
        dimmed = np.exp(-depth[:, :, None] / np.maximum(cosine, 1e-4)) * np.exp(-depth / direction[2])[:, :, None]
        phase = scatter_r[:, :, None] * rayleigh_phase(turn)
        phase = phase + scatter_a[:, :, None] * henyey_greenstein_phase(turn, air.aerosol_asymmetry)
        source = lamp_patterns(cosine) / (distance2 + spot_radius_km**2)
        result[:, :, m] = np.einsum("ksp,wsp,s->kw", source, dimmed * phase, path) / len(spots_km)
    return result


def moon_single(
    rayleigh_depth: ArrayLike,
    aerosol_depth: ArrayLike,
    moon_airmass: ArrayLike,
    view_airmass: ArrayLike,
    cosine: ArrayLike,
    air: BakedAir,
) -> Floats:
    """Moonlight scattered once by a well-mixed layer, per unit irradiance above the air, sr^-1 (arguments broadcast).

    Parameters
    ----------
    rayleigh_depth, aerosol_depth : array_like
        Vertical optical depths.
    moon_airmass, view_airmass : array_like
    cosine : array_like
        Of the angle between the line of sight and the Moon.
    air : BakedAir
        For the aerosol's albedo and asymmetry.
    """
    rayleigh, aerosol = np.asarray(rayleigh_depth, float), np.asarray(aerosol_depth, float)
    moon, view = np.asarray(moon_airmass, float), np.asarray(view_airmass, float)
    depth = rayleigh + aerosol
    scattering = rayleigh * rayleigh_phase(cosine)
    scattering = scattering + aerosol * air.aerosol_albedo * henyey_greenstein_phase(cosine, air.aerosol_asymmetry)
    excess = depth * (view - moon)
    small = np.abs(excess) < 1e-6
    share = np.where(small, 1.0, -np.expm1(-np.where(small, 1.0, excess)) / np.where(small, 1.0, excess))
    return scattering * view * np.exp(-depth * moon) * share
