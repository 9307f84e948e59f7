"""Single scattering by quadrature along the line of sight, in the air of the bake.

City light has the form of Garstang's kernel (Garstang 1986, PASP 98, 364) for two exponential layers, and moonlight that
of a homogeneous plane-parallel layer (Chandrasekhar 1950, "Radiative Transfer", section 7).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import erfcx

from generator.light.atmosphere import aerosol_optical_depth, rayleigh_optical_depth
from generator.light.bake_grids import BakedAir
from generator.light.emission import PATTERNS, lamp_patterns

Floats = NDArray[np.float64]
LAYER_NODES = 64
"""Nodes of Gauss' quadrature through the layers; at the horizon the light is accurate to 1e-6."""

LAMP_HEIGHT_KM = 0.0005


def rayleigh_phase(cosine: ArrayLike) -> Floats:
    """Rayleigh's phase function, sr^-1."""
    return 3 / (16 * np.pi) * (1 + np.square(cosine))


def aerosol_phase(cosine: ArrayLike) -> Floats:
    """Phase function of aerosol, sr^-1; its mean cosine is 0.69.

    Fitted to the measured haze of McClatchey et al. 1978, "Handbook of Optics", chapter 14, by Garstang 1991, PASP 103,
    1109; here divided by 1.0027, which makes its integral 1.
    """
    degrees = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
    square = degrees * degrees
    aureole = 7.5 * np.exp(-0.1249 * square / (1 + 0.04996 * square))
    middle = 1.88 * np.exp(-0.07226 * degrees + 0.0002406 * square)
    back = 0.025 + 0.015 * np.sin(np.radians(2.25 * degrees - 369))
    return np.where(degrees <= 10, aureole, np.where(degrees <= 124, middle, back)) / 1.0027


def disk_points(radius_km: float, rings: int = 4, spokes: int = 8) -> Floats:
    """Points of equal weight over a disk, (rings * spokes, 2) array: midpoints in the square of the radius and in azimuth."""
    square = (np.arange(rings) + 0.5) / rings
    angle = (np.arange(spokes) + 0.5 * (np.arange(rings)[:, None] % 2)) * 2 * np.pi / spokes
    radius = radius_km * np.sqrt(square)[:, None]
    return np.stack([radius * np.sin(angle), radius * np.cos(angle)], axis=-1).reshape(-1, 2)


def column_from_ground(length_km: Floats, sine: Floats, scale_height_km: float, earth_radius_km: float) -> Floats:
    """Column of an exponential layer along a ray that starts at the ground, relative to its vertical column.

    To first order in the Earth's curvature a ray that leaves at an angle of sine m has the height m s + (1 - m^2) s^2 /
    (2 R) after the distance s, so the column is a difference of two error functions.

    Parameters
    ----------
    length_km, sine : arrays
    scale_height_km : float
    earth_radius_km : float
        Radius of the Earth; infinite for flat ground.
    """
    curve = np.maximum((1 - sine**2) / (2 * earth_radius_km * scale_height_km), 1e-12)
    root = np.sqrt(curve)
    start = sine / scale_height_km / (2 * root)
    end = start + root * length_km
    rest = erfcx(start) - np.exp(start**2 - end**2) * erfcx(end)
    return np.sqrt(np.pi) / (2 * root) * rest / scale_height_km


def city_single(
    air: BakedAir,
    wavelength_nm: Floats,
    aerosol_tau_550: float,
    spots_km: Floats,
    directions: Floats,
    steps: int = 96,
    spot_radius_km: float = 0.0,
    earth_radius_km: float = np.inf,
) -> Floats:
    """Radiance scattered once from lamps on the ground, mean over the lamps.

    Parameters
    ----------
    air : BakedAir
    wavelength_nm : (w,) array
    aerosol_tau_550 : float
    spots_km : (p, 2) array
        Places of the lamps, x and y along the ground.
    directions : (m, 3) array
        Directions in which the observer at the origin looks (z up).
    steps : int
        Points of the quadrature, on a logarithmic scale of height.
    spot_radius_km : float
        Radius of the area that each lamp represents: its light is softened to 1 / (distance^2 + radius^2), so that a lamp
        close to the line of sight acts as a patch of the city and not as a point.
    earth_radius_km : float
        Radius of the Earth; infinite for flat ground.

    Returns
    -------
    (patterns, w, m) array
        Radiance per unit photon output above the horizon in each of PATTERNS, km^-2 sr^-1.
    """
    rayleigh = rayleigh_optical_depth(wavelength_nm, air.pressure_hpa)[:, None]
    aerosol = aerosol_optical_depth(wavelength_nm, aerosol_tau_550, air.angstrom_exponent)[:, None]
    edge = np.concatenate([[0], np.geomspace(1e-3, air.top_km, steps)])
    height = (edge[1:] + edge[:-1]) / 2
    heights = (air.rayleigh_height_km, air.aerosol_height_km)
    scatter_r = rayleigh * np.exp(-height / air.rayleigh_height_km) / air.rayleigh_height_km
    scatter_a = aerosol * np.exp(-height / air.aerosol_height_km) / air.aerosol_height_km * air.aerosol_albedo
    lamp = np.concatenate([spots_km, -np.sum(spots_km**2, axis=1, keepdims=True) / (2 * earth_radius_km)], axis=1)
    lamp[:, 2] += LAMP_HEIGHT_KM
    upright = np.concatenate([spots_km / earth_radius_km, np.ones((len(lamp), 1))], axis=1)
    result = np.zeros((len(PATTERNS), len(wavelength_nm), len(directions)))
    for m, direction in enumerate(directions):
        sine = direction[2]
        bend = (1 - sine**2) / (2 * earth_radius_km)
        along_edge, along = (2 * h / (sine + np.sqrt(sine**2 + 4 * bend * h)) for h in (edge, height))
        onward = (direction * along[:, None])[:, None] - lamp
        distance2 = np.sum(onward**2, axis=-1)
        distance = np.sqrt(distance2)
        cosine = np.sum(onward * upright, axis=-1) / distance
        up = np.maximum(cosine, 1e-4)
        # From the lamp to the point, then from the point to the observer: the angle between the two paths.
        turn = -(onward @ direction) / distance
        if np.isinf(earth_radius_km):
            columns = [-np.expm1(-height / h)[:, None] * (1 / up + 1 / sine) for h in heights]
        else:
            columns = [
                column_from_ground(distance, up, h, earth_radius_km)
                + column_from_ground(along, np.full_like(along, sine), h, earth_radius_km)[:, None]
                for h in heights
            ]
        dimmed = np.exp(-rayleigh[:, :, None] * columns[0] - aerosol[:, :, None] * columns[1])
        phase = scatter_r[:, :, None] * rayleigh_phase(turn) + scatter_a[:, :, None] * aerosol_phase(turn)
        source = lamp_patterns(cosine) / (distance2 + spot_radius_km**2)
        result[:, :, m] = np.einsum("ksp,wsp,s->kw", source, dimmed * phase, np.diff(along_edge)) / len(spots_km)
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
        Cosine of the angle between the line of sight and the Moon.
    air : BakedAir
        Air with the aerosol's albedo.
    """
    rayleigh, aerosol = np.asarray(rayleigh_depth, float), np.asarray(aerosol_depth, float)
    moon, view = np.asarray(moon_airmass, float), np.asarray(view_airmass, float)
    depth = rayleigh + aerosol
    scattering = rayleigh * rayleigh_phase(cosine)
    scattering = scattering + aerosol * air.aerosol_albedo * aerosol_phase(cosine)
    excess = depth * (view - moon)
    small = np.abs(excess) < 1e-6
    share = np.where(small, 1.0, -np.expm1(-np.where(small, 1.0, excess)) / np.where(small, 1.0, excess))
    return scattering * view * np.exp(-depth * moon) * share


def moon_single_by_layer(
    air: BakedAir, rayleigh_depth: Floats, aerosol_depth: Floats, moon_airmass: float, view_airmass: Floats
) -> tuple[Floats, Floats]:
    """Single scattering by the two exponential layers of the bake without phase functions: by molecules, by aerosol.

    Parameters
    ----------
    air : BakedAir
        Air with the layers' heights and the aerosol's albedo.
    rayleigh_depth, aerosol_depth : (n,) arrays
        Vertical optical depths.
    moon_airmass : float
    view_airmass : (m,) array

    Returns
    -------
    molecules, aerosol : (n, m) arrays
        Factors to be multiplied by the phase functions; sr^-1 per unit irradiance above the air.
    """
    node, weight = np.polynomial.legendre.leggauss(LAYER_NODES)
    edge, weight = (node + 1) / 2, weight / 2
    ratio = air.rayleigh_height_km / air.aerosol_height_km
    above = rayleigh_depth[:, None] * edge + aerosol_depth[:, None] * edge**ratio
    below = (rayleigh_depth + aerosol_depth)[:, None] - above
    dimmed = np.exp(-above * moon_airmass)[:, None] * np.exp(-below[:, None] * view_airmass[:, None])
    molecules = rayleigh_depth[:, None] * view_airmass * (dimmed @ weight)
    aerosol = aerosol_depth[:, None] * view_airmass * (dimmed @ (weight * ratio * edge ** (ratio - 1)))
    return molecules, air.aerosol_albedo * aerosol


def moon_single_in_layers(
    air: BakedAir,
    rayleigh_depth: float,
    aerosol_depth: float,
    moon_altitude_deg: Floats,
    view_altitude_deg: float,
    cosine: Floats,
    steps: int = 4000,
) -> Floats:
    """Moonlight scattered once by the two exponential layers of the bake, per unit irradiance above the air, sr^-1.

    Parameters
    ----------
    air : BakedAir
    rayleigh_depth, aerosol_depth : float
    moon_altitude_deg : (m,) array
    view_altitude_deg : float
    cosine : (m, k) array
        Cosines of the angles between the line of sight and the Moon.
    steps : int
        Steps of the quadrature, equal in exp(-height / Rayleigh's height).

    Returns
    -------
    (m, k) array
    """
    edge = np.linspace(1, 0, steps + 1)
    ratio = air.rayleigh_height_km / air.aerosol_height_km
    left_r, left_a = rayleigh_depth * edge, aerosol_depth * edge**ratio
    above = (left_r + left_a)[:-1] / 2 + (left_r + left_a)[1:] / 2
    below = rayleigh_depth + aerosol_depth - above
    slope = np.sin(np.radians(view_altitude_deg))
    arrives = np.exp(-above / np.sin(np.radians(moon_altitude_deg))[:, None] - below / slope) / slope
    from_r, from_a = (arrives @ -np.diff(left) for left in (left_r, left_a))
    return from_r[:, None] * rayleigh_phase(cosine) + air.aerosol_albedo * from_a[:, None] * aerosol_phase(cosine)
