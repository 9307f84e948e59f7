"""Twilight: measured zenith brightness in five bands, brighter towards the Sun."""

from __future__ import annotations

import numpy as np

from generator.errors import GeneratorError
from generator.light.photometry import ARCSEC2_PER_SR, BESSELL_V, GRID_NM
from generator.sky.component import SkyTable, black_sky
from generator.sky.directions import sky_grid

Floats = np.ndarray[tuple[int, ...], np.dtype[np.float64]]

# Zenith brightness m = a0 + a1 (z - 95) + a2 (z - 95)^2, mag/arcsec^2, for the Sun's zenith distance z from 95 to 105 deg.
# Source: Patat, Ugolnikov & Postylyakov 2006, A&A 455, 385, table 1.
PATAT = {
    "U": (11.78, 1.376, -0.039),
    "B": (11.84, 1.411, -0.041),
    "V": (11.84, 1.518, -0.057),
    "R": (11.40, 1.567, -0.064),
    "I": (10.93, 1.470, -0.062),
}
NIGHT_MAG = {"U": 22.28, "B": 22.64, "V": 21.61, "R": 20.87, "I": 19.71}
"""Night sky of the same site, which is in those figures. Source: Patat 2003, A&A 400, 1183."""
EFFECTIVE_NM = {"U": 360.0, "B": 438.0, "V": 545.0, "R": 641.0, "I": 798.0}
ZERO_POINTS = {"U": 756e5, "B": 1393.5e5, "V": 995.9e5, "R": 702.5e5, "I": 452.3e5}
"""Photons s^-1 m^-2 nm^-1 of magnitude 0. Source: Bessell, Castelli & Plez 1998, A&A 333, 231."""

SUNSET_V_MAG, CIVIL_V_MAG = 7.4, 9.6
"""Zenith at Sun depressions of 0 and 3 deg: mean of Koomen et al. 1952, J. Opt. Soc. Am. 42, 353 (two sites)."""
NIGHT_DEPRESSION_DEG = 16.0
"""The Sun this deep adds nothing: Patat et al. find the night level at 105 to 106 deg."""


def zenith_magnitude(band: str, depression_deg: float) -> float:
    """Brightness of the zenith in twilight, night sky included, mag/arcsec^2, of the Sun `depression_deg` below the horizon.

    Above 5 deg of depression, where Patat's figures begin, V follows Koomen's measurements and the colour stays.
    """
    a0, a1, a2 = PATAT[band]
    if depression_deg < 5:
        v = float(np.interp(depression_deg, [0, 3, 5], [SUNSET_V_MAG, CIVIL_V_MAG, PATAT["V"][0]]))
        return v + a0 - PATAT["V"][0]
    x = min(depression_deg, NIGHT_DEPRESSION_DEG) - 5
    return a0 + a1 * x + a2 * x * x


def zenith_spectrum(depression_deg: float) -> Floats:
    """Radiance of the zenith by twilight alone, photons s^-1 m^-2 nm^-1 sr^-1 at GRID_NM.

    Through the five bands' photon radiances less the night's, linear in the logarithm, with the V-band mean exact.
    """
    if depression_deg >= NIGHT_DEPRESSION_DEG:
        return np.zeros_like(GRID_NM)
    light = {}
    for band in PATAT:
        excess = 10 ** (-0.4 * zenith_magnitude(band, depression_deg)) - 10 ** (-0.4 * NIGHT_MAG[band])
        light[band] = ZERO_POINTS[band] * ARCSEC2_PER_SR * excess
    if light["V"] <= 0:
        return np.zeros_like(GRID_NM)
    # Near the end of twilight a band may fall below its night level within the fit's 0.2 mag: it keeps the V band's share.
    floor = 0.05 * light["V"]
    values = [max(light[band], floor) for band in EFFECTIVE_NM]
    spectrum = np.exp(np.interp(GRID_NM, list(EFFECTIVE_NM.values()), np.log(values)))
    return spectrum * light["V"] / float(BESSELL_V.mean(GRID_NM, spectrum))


def twilight(sun_enu: Floats) -> SkyTable:
    """Twilight at the ground.

    Away from the zenith the brightness goes as Schaefer's twilight formula: inversely as the distance from the Sun, times
    the scattering path 1 - 10^(-0.4 k X), times 10^(0.4 z / (360 deg k)) towards the horizon. Source: Schaefer 1998, Sky &
    Telescope 95 (5), 57; k = 0.2.

    Raises
    ------
    GeneratorError
        The Sun is up.
    """
    depression = -float(np.degrees(np.arcsin(sun_enu[2])))
    if depression >= NIGHT_DEPRESSION_DEG:
        return black_sky()
    if depression < 0:
        raise GeneratorError(
            f"the Sun is {-depression:.1f} deg above the horizon at this time and place; choose a time between sunset and "
            "sunrise, or leave 'twilight' out of sky.components"
        )
    grid = sky_grid()
    k = 0.2
    zenith_angle = 90 - grid.altitude_deg[:, None]
    from_sun = np.degrees(np.arccos(np.clip(grid.enu @ sun_enu, -1, 1)))
    path = 1 / (np.cos(np.radians(zenith_angle)) + 0.025 * np.exp(-11 * np.cos(np.radians(zenith_angle))))
    shape = 10 ** (0.4 * zenith_angle / (360 * k)) * (1 - 10 ** (-0.4 * k * path)) / np.maximum(from_sun, 10)
    shape = shape / shape[-1, 0]
    return SkyTable(shape[None].astype(np.float32), zenith_spectrum(depression)[None])
