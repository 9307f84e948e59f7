"""Starlight scattered in the air: the glow between the stars, to which all stars contribute."""

from __future__ import annotations

import functools

import numpy as np

from generator.light.atmosphere import Atmosphere, aerosol_optical_depth, airmass, optical_depth, rayleigh_optical_depth
from generator.light.bake_grids import BakedAir
from generator.light.photometry import ARCSEC2_PER_SR, GRID_NM
from generator.light.stellar_spectra import star_spectra
from generator.sky.component import SkyTable, black_sky, low_rank
from generator.sky.directions import sky_grid
from generator.sky.milky_way import BV_MAG, S10_MAG_ARCSEC2, VI_MAG

AEROSOL_FROM_ABOVE = 0.8
"""Fraction of the light that an aerosol scatters downwards that came from above (Henyey-Greenstein, g = 0.7)."""

RANK = 4


@functools.lru_cache(maxsize=16)
def scattered_starlight(sky_mean_s10: float, atmosphere: Atmosphere | None) -> SkyTable:
    """Starlight scattered once out of a hemisphere of even brightness, at the ground.

    The source function is that of a plane-parallel layer lit evenly from above (Chandrasekhar 1950, section 7): of the
    light scattered towards the ground, half came from above for molecules and four fifths for aerosol. It amounts to
    about 10 S10 at the zenith, compared with 15 S10 including higher orders and reflection from the ground in Roach &
    Gordon 1973, "The Light of the Night Sky". The part that replaces direct diffuse light is in the diffuse extinction
    factor.

    Parameters
    ----------
    sky_mean_s10 : float
        Mean S10(V) of all stars, points included, over the sky.
    atmosphere : Atmosphere or None
        Scattering air; None gives a black sky.
    """
    if atmosphere is None:
        return black_sky()
    air = BakedAir()
    depth = optical_depth(GRID_NM, atmosphere)
    rayleigh = rayleigh_optical_depth(GRID_NM, atmosphere.pressure_hpa)
    aerosol = aerosol_optical_depth(GRID_NM, atmosphere.aerosol_tau_550, atmosphere.angstrom_exponent)
    share = (0.5 * rayleigh + AEROSOL_FROM_ABOVE * air.aerosol_albedo * aerosol) / np.maximum(depth, 1e-12)
    spectrum = sky_mean_s10 * star_spectra([S10_MAG_ARCSEC2], [BV_MAG], [VI_MAG])[0] * ARCSEC2_PER_SR
    path = airmass(sky_grid().altitude_deg)
    table = -np.expm1(-path[:, None] * depth) * share * spectrum
    a, b = low_rank(table, RANK)
    return SkyTable(a[:, :, None].astype(np.float32), b)
