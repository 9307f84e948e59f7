"""Integrals over a disk of lamps: light that air scatters once, light on a layer of cloud, and any function of position.

Lamps close to the foot of a point matter most, and discrete spots that represent areas miss them. Seen from height h,
ground at distance d contributes dA / d^2 = du dphi with u = ln(d / h). In these coordinates about the foot the kernel of
Garstang 1986 (PASP 98, 364) is smooth, and a few nodes integrate it over the disk.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from generator.light.atmosphere import aerosol_optical_depth, rayleigh_optical_depth
from generator.light.bake_grids import BakedAir
from generator.light.emission import PATTERNS, lamp_patterns
from generator.light.single_scattering import aerosol_phase, rayleigh_phase

Floats = NDArray[np.float64]

_CROWDING = 0.3
"""Bearings are closer by this factor along the line of sight, from where light that aerosol scatters forward comes."""


def disk_single(
    air: BakedAir,
    wavelength_nm: Floats,
    aerosol_tau_550: float,
    distance_km: float,
    radius_km: float,
    directions: Floats,
    steps: int = 64,
    bearings: int = 24,
    distances: int = 8,
) -> Floats:
    """Radiance scattered once from a disk of lamps on flat ground, mean over its area.

    Parameters
    ----------
    air : BakedAir
    wavelength_nm : (w,) array
    aerosol_tau_550 : float
    distance_km, radius_km : float
        Distance of the disk's centre from the observer, along y, and radius of the disk.
    directions : (m, 3) array
        Directions in which the observer at the origin looks (z up), upwards.
    steps, bearings, distances : int
        Nodes along the line of sight (logarithmic in height), around each point's foot and outwards from it.

    Returns
    -------
    (patterns, w, m) array
        Radiance per unit photon output above the horizon in each of PATTERNS, km^-2 sr^-1.
    """
    edge = np.concatenate([[0], np.geomspace(1e-3, air.top_km, steps)])
    height = (edge[1:] + edge[:-1]) / 2
    depths = (
        rayleigh_optical_depth(wavelength_nm, air.pressure_hpa),
        aerosol_optical_depth(wavelength_nm, aerosol_tau_550, air.angstrom_exponent),
    )
    below = [-np.expm1(-height / h) for h in (air.rayleigh_height_km, air.aerosol_height_km)]
    density = [
        np.exp(-height / air.rayleigh_height_km) / air.rayleigh_height_km,
        np.exp(-height / air.aerosol_height_km) / air.aerosol_height_km * air.aerosol_albedo,
    ]
    node, weight = np.polynomial.legendre.leggauss(distances)
    result = np.zeros((len(PATTERNS), len(wavelength_nm), len(directions)))
    for m, (east, north, up) in enumerate(directions):
        along = height / up
        foot = np.stack([east * along, north * along - distance_km], axis=-1)
        bearing, nearest, farthest, arc = _chords(foot, radius_km, bearings, float(np.arctan2(east, north)), _CROWDING)
        inner, outer = (0.5 * np.log1p(np.square(d / height[:, None])) for d in (nearest, farthest))
        u = 0.5 * ((outer + inner)[..., None] + (outer - inner)[..., None] * node)
        solid = 0.5 * (arc * (outer - inner))[..., None] * weight
        secant = np.exp(u)
        cosine = 1 / secant
        outwards = np.sqrt(np.maximum(1 - cosine**2, 0))
        # From the lamp to the point, then from the point to the observer.
        level = east * np.sin(bearing) + north * np.cos(bearing)
        turn = outwards * level[..., None] - cosine * up
        source = lamp_patterns(cosine) * solid
        phase = [density[0][:, None, None] * rayleigh_phase(turn), density[1][:, None, None] * aerosol_phase(turn)]
        path = secant + 1 / up
        step = np.diff(edge) / up
        for w in range(len(wavelength_nm)):
            dimmed = np.exp(-(depths[0][w] * below[0] + depths[1][w] * below[1])[:, None, None] * path)
            scattered = dimmed * (depths[0][w] * phase[0] + depths[1][w] * phase[1])
            result[:, w, m] = np.einsum("ksbu,sbu,s->k", source, scattered, step)
    return result / (np.pi * radius_km**2)


def disk_irradiance(
    place_km: Floats,
    height_km: float,
    radius_km: float,
    depths: Floats | None = None,
    bearings: int = 24,
    distances: int = 8,
) -> Floats:
    """Light of a disk of lamps on a level plane above it, dimmed by level air in between.

    Parameters
    ----------
    place_km : (n, 2) array
        Points of the plane, relative to the point above the disk's centre.
    height_km, radius_km : float
        Height of the plane above the lamps, and radius of the disk.
    depths : (m,) array or None
        Vertical optical depths of the air; None for no air.
    bearings, distances : int
        Nodes around each point's foot and outwards from it.

    Returns
    -------
    (m, patterns, n) array
        Irradiance per unit photon output above the horizon in each of PATTERNS, km^-2, behind each depth; m is 1 without air.
    """
    _, nearest, farthest, arc = _chords(place_km, radius_km, bearings)
    inner, outer = (0.5 * np.log1p(np.square(d / height_km)) for d in (nearest, farthest))
    node, weight = np.polynomial.legendre.leggauss(distances)
    cosine = np.exp(-0.5 * ((outer + inner)[..., None] + (outer - inner)[..., None] * node))
    solid = 0.5 * (arc * (outer - inner))[..., None] * weight
    light = lamp_patterns(cosine) * cosine * solid / (np.pi * radius_km**2)
    if depths is None:
        return np.asarray(light.sum(axis=(-2, -1))[None])
    return np.stack([np.einsum("knbu,nbu->kn", light, np.exp(-depth / cosine)) for depth in depths])


def disk_nodes(
    distance_km: float,
    radius_km: float,
    line_of_sight_deg: float,
    core_km: float,
    bearings: int = 48,
    distances: int = 12,
) -> tuple[Floats, Floats, Floats]:
    """Nodes over a disk for a function of the distance from the observer and the azimuth from the line of sight.

    Parameters
    ----------
    distance_km, radius_km : float
        Distance of the disk's centre from the observer, and radius of the disk.
    line_of_sight_deg : float
        Azimuth of the line of sight relative to the disk's centre.
    core_km : float
        Distances are spaced evenly below it, and logarithmically beyond.
    bearings, distances : int
        Nodes around the observer and outwards.

    Returns
    -------
    distance_km, relative_azimuth_deg, weight : (bearings * distances,) arrays
        The weights add up to 1.
    """
    line_of_sight = float(np.radians(line_of_sight_deg))
    chords = _chords(np.array([[0.0, -distance_km]]), radius_km, bearings, line_of_sight, _CROWDING)
    bearing, nearest, farthest, arc = (each[0][:, None] for each in chords)
    node, weight = np.polynomial.legendre.leggauss(distances)
    inner, outer = np.log1p(nearest / core_km), np.log1p(farthest / core_km)
    u = 0.5 * (outer + inner + (outer - inner) * node)
    distance = core_km * np.expm1(u)
    area = arc * 0.5 * (outer - inner) * weight * distance * (distance + core_km)
    relative = np.broadcast_to(np.degrees(bearing) - line_of_sight_deg, distance.shape)
    return distance.ravel(), relative.ravel(), (area / area.sum()).ravel()


def _chords(
    foot: Floats, radius_km: float, bearings: int, middle_bearing: float = 0.0, crowding: float = 1.0
) -> tuple[Floats, Floats, Floats, Floats]:
    """Directions from feet over a disk around the origin: bearing, distances at which the disk begins and ends, arc.

    Parameters
    ----------
    foot : (s, 2) array
    radius_km : float
    bearings : int
        Number of nodes for each foot.
    middle_bearing, crowding : float
        For feet inside the disk: a bearing that is a node, rad, and the factor by which nodes are closer there.

    Returns
    -------
    bearing, nearest, farthest, arc : (s, bearings) arrays
        Radians, km, km, and the radians that each node represents.
    """
    away = np.hypot(foot[:, 0], foot[:, 1])[:, None]
    inside = away < radius_km
    towards = np.arctan2(-foot[:, 0], -foot[:, 1])[:, None]
    turn = (np.arange(bearings) / bearings - 0.5) * 2 * np.pi
    around = middle_bearing + 2 * np.arctan(crowding * np.tan(turn / 2)) - towards
    around_arc = 2 * np.pi / bearings * crowding / (np.cos(turn / 2) ** 2 + (crowding * np.sin(turn / 2)) ** 2)
    # From outside, the disk fills a cone; the sine of the bearing is parametrised over it by an angle, in which chords
    # are smooth.
    angle = (np.arange(bearings) + 0.5) * np.pi / bearings - np.pi / 2
    ratio = radius_km / np.maximum(away, radius_km)
    across = np.arcsin(np.clip(ratio * np.sin(angle), -1, 1))
    arc = np.where(inside, around_arc, np.pi / bearings * ratio * np.cos(angle) / np.maximum(np.cos(across), 1e-12))
    relative = np.where(inside, around, across)
    middle = away * np.cos(relative)
    half = np.sqrt(np.maximum(radius_km**2 - np.square(away * np.sin(relative)), 0))
    nearest = np.where(inside, 0.0, middle - half)
    return towards + relative, nearest, middle + half, arc
