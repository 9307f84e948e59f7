"""Scattered moonlight: single scattering by quadrature, multiple scattering from the baked map, and the Moon's twilight."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from generator.light.atmosphere import (
    Atmosphere,
    aerosol_optical_depth,
    airmass,
    ozone_optical_depth,
    rayleigh_optical_depth,
)
from generator.light.bake_grids import DEFAULT_ALBEDO, VIEW_ALTITUDES_DEG, WAVELENGTHS_NM, BakedAir
from generator.light.baked_maps import moon_multiple
from generator.light.ground import Albedo, albedo_at, ground_glow, ground_light, spherical_albedo
from generator.light.molecular_bands import ozone_airmass
from generator.light.photometry import GRID_NM, GRID_START_NM, GRID_STOP_NM
from generator.light.single_scattering import aerosol_phase, moon_single, moon_single_by_layer, rayleigh_phase
from generator.sky.component import SkyTable, black_sky, total
from generator.sky.directions import irradiance_weights, sky_grid
from generator.sky.moon_irradiance import moon_spectrum
from generator.sky.state import SkyState
from generator.sky.twilight import light_from_below, nodes_nm
from generator.sky.zodiacal import column_weights, upsampled_rows

Floats = NDArray[np.float64]

FULL_MOON_NIGHT_DEG, FULL_MOON_V_MAG, FALL_MAG_PER_DEG = 9.0, -12.7, 0.9
"""Depression at which the full Moon adds at most 1 % to the darkest sky, low above it; V of the full Moon; and the decrease
of the light per degree there. The light is that of the Sun at this depression divided by 400,000."""
TWILIGHT_TO_DEG = 3.0
"""Apparent altitude of the Moon from which its light is that of :func:`moonlight` alone."""
NODES_NM: Floats = np.array([GRID_START_NM, *WAVELENGTHS_NM, GRID_STOP_NM])


def node_weights() -> Floats:
    """Hat functions of NODES_NM on GRID_NM, (nodes, n) array."""
    return np.array([np.interp(GRID_NM, NODES_NM, row) for row in np.eye(len(NODES_NM))])


def moonlight(
    moon_enu: Floats,
    v_mag: float,
    atmosphere: Atmosphere | None,
    albedo: Albedo = DEFAULT_ALBEDO,
    phase_angle_deg: float = 0.0,
) -> SkyTable:
    """Scattered moonlight at the ground from a Moon above the horizontal; black for one below, or without scattering air.

    Parameters
    ----------
    moon_enu : (3,) array
        Apparent direction of the Moon.
    v_mag : float
        Above the atmosphere.
    atmosphere : Atmosphere or None
    albedo : float or points
        Albedo of the ground.
    phase_angle_deg : float
        Phase angle, which sets the colour of the Moon.
    """
    altitude = float(np.degrees(np.arcsin(moon_enu[2])))
    if atmosphere is None or not atmosphere.scatters or altitude <= 0:
        return black_sky()
    grid, air = sky_grid(), BakedAir()
    rows = np.unique(np.append(np.arange(0, grid.shape[0], 6), grid.shape[0] - 1))
    columns = np.arange(0, grid.shape[1], 6)
    azimuth = float(np.degrees(np.arctan2(moon_enu[0], moon_enu[1])))
    multiple = moon_multiple(atmosphere, altitude, grid.altitude_deg[rows], grid.azimuth_deg[columns] - azimuth)
    baked = np.clip(np.arange(len(NODES_NM)) - 1, 0, len(WAVELENGTHS_NM) - 1)
    rayleigh = rayleigh_optical_depth(GRID_NM, atmosphere.pressure_hpa)
    aerosol = aerosol_optical_depth(GRID_NM, atmosphere.aerosol_tau_550, atmosphere.angstrom_exponent)
    at_node = [np.interp(NODES_NM, GRID_NM, depth) for depth in (rayleigh, aerosol)]
    view = airmass(grid.altitude_deg)[None, :]
    moon = float(airmass(altitude))
    cosine = (grid.enu @ moon_enu).astype(np.float32)
    phases = [np.asarray(phase(cosine), np.float32) for phase in (rayleigh_phase, aerosol_phase)]
    once = moon_single_by_layer(air, at_node[0], at_node[1], moon, airmass(grid.altitude_deg))
    parts = [np.broadcast_to(part[:, :, None].astype(np.float32), (*part.shape, len(columns))) for part in once]
    # Multiply scattered light is smooth, so few columns suffice.
    measure = moon_single(at_node[0][:, None], at_node[1][:, None], moon, view, 0.0, air)
    parts.append((upsampled_rows(multiple[baked], rows, grid.shape[0]) * measure[:, :, None]).astype(np.float32))
    phases.append(np.ones_like(cosine))
    across = column_weights(columns, grid.shape[1])
    if albedo != DEFAULT_ALBEDO:
        direct = np.sin(np.radians(altitude)) * np.exp(-moon * (at_node[0] + at_node[1]))
        around = sum(
            np.einsum("nrm,rm->nr", part, phase @ across.T) for part, phase in zip(parts, phases, strict=True)
        ) / len(grid.azimuth_deg)
        parts[-1] = parts[-1] + from_ground(around, direct, atmosphere, albedo).astype(np.float32)[:, :, None]
    # Between nodes the light is interpolated over the scattering optical depth, which removes most of the curvature.
    depth = rayleigh + aerosol
    irradiance = moon_spectrum(v_mag, phase_angle_deg)
    irradiance = irradiance * np.exp(-ozone_optical_depth(GRID_NM, atmosphere.ozone_du) * ozone_airmass(altitude))
    node_depth = np.maximum(np.interp(NODES_NM, GRID_NM, depth), 1e-12)
    spectra = node_weights() * (depth / node_depth[:, None]) * irradiance
    return SkyTable(np.concatenate(parts), np.tile(spectra, (len(parts), 1)), np.stack(phases), across=across)


def night_depression_deg(moon_v_mag: float) -> float:
    """Depression of a Moon of magnitude V at which its light no longer counts."""
    return max(0.0, FULL_MOON_NIGHT_DEG - max(0.0, moon_v_mag - FULL_MOON_V_MAG) / FALL_MAG_PER_DEG)


def moonlit_sky(state: SkyState, atmosphere: Atmosphere | None, albedo: Albedo = DEFAULT_ALBEDO) -> SkyTable:
    """Light of the sky that originates from the Moon, which may be above or below the horizon.

    For a Moon below the horizon it is twilight with the Moon's spectrum: the air above the Earth's shadow is lit as by
    the Sun. Up to TWILIGHT_TO_DEG above it, where neither plane layers nor shells alone are accurate, the two are
    blended.
    """
    if (
        atmosphere is None
        or not atmosphere.scatters
        or state.moon_depression_deg >= night_depression_deg(state.moon_v_mag)
    ):
        return black_sky()
    up = float(np.clip(state.moon_altitude_deg / TWILIGHT_TO_DEG, 0.0, 1.0))
    above = moonlight(state.moon_enu, state.moon_v_mag, atmosphere, albedo, state.moon.phase_angle_deg)
    if up == 1:
        return above
    low = light_from_below(
        state.moon_enu,
        state.moon_depression_deg,
        state.moon_spectrum,
        atmosphere,
        state.height_m,
        albedo_at(albedo, nodes_nm()),
    )
    return total([above.scaled(up), low.scaled(1 - up)])


def from_ground(around: Floats, direct: Floats, atmosphere: Atmosphere, albedo: Albedo) -> Floats:
    """Change of moonlight if the ground's albedo differs from the bake's, by altitude, (nodes, ny) array.

    Light that a Lambertian ground reflects does not depend on azimuth, so it follows from the light on the ground and the
    glow of the air above a glowing ground (Chandrasekhar 1950, section 72).

    Parameters
    ----------
    around : (nodes, ny) array
        Light of the sky above the bake's ground, mean over azimuth.
    direct : (nodes,) array
        Light that reaches the ground unscattered, in the maps' units times sr.
    atmosphere : Atmosphere
    albedo : float or points
    """
    baked = np.clip(np.arange(len(NODES_NM)) - 1, 0, len(WAVELENGTHS_NM) - 1)
    returned, glow = spherical_albedo(atmosphere)[baked], ground_glow(atmosphere)[baked]
    on_ground = direct + np.pi * around @ irradiance_weights()
    black = on_ground * (1 - DEFAULT_ALBEDO * returned)
    change = ground_light(albedo_at(albedo, NODES_NM), black, returned) - DEFAULT_ALBEDO * on_ground
    views = np.log(VIEW_ALTITUDES_DEG)
    at = np.log(np.maximum(sky_grid().altitude_deg, VIEW_ALTITUDES_DEG[0]))
    return change[:, None] * np.array([np.interp(at, views, row) for row in glow])
