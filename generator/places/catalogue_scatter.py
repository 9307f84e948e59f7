"""Stars whose places and magnitudes deviate from the catalogue's.

Catalogues disagree. Proper motions of Hipparcos and Gaia differ by about 1 mas/yr (Lindegren et al. 2018, A&A 616, A2),
0.03 arcsec in 30 years; V in an instrument's band scatters about a transformation by 0.05 to 0.1 mag (Young 1994, A&A
288, 683). Larger scatters represent the position noise in tests of star trackers (Rijlaarsdam et al. 2020, Sensors 20,
2579).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from generator.places.catalogue import StarCatalogue


def scattered(stars: StarCatalogue, sigma_arcsec: float, sigma_mag: float, rng: np.random.Generator) -> StarCatalogue:
    """Move n stars along two axes each, and change their magnitudes, by Gaussian amounts.

    Parameters
    ----------
    stars : StarCatalogue
    sigma_arcsec : float
        Standard deviation along each axis.
    sigma_mag : float
    rng : Generator
    """
    north, east, mag = rng.normal(size=(3, len(stars)))
    angle, away = np.radians(sigma_arcsec / 3600 * np.hypot(north, east)), np.arctan2(east, north)
    # A step of `angle` in the direction `away` on the sphere, which is valid at the poles, too.
    dec, ra = np.radians(stars.dec_deg), np.radians(stars.ra_deg)
    new_dec = np.arcsin(np.clip(np.sin(dec) * np.cos(angle) + np.cos(dec) * np.sin(angle) * np.cos(away), -1, 1))
    turn = np.arctan2(np.sin(away) * np.sin(angle) * np.cos(dec), np.cos(angle) - np.sin(dec) * np.sin(new_dec))
    return replace(
        stars,
        ra_deg=np.degrees(ra + turn) % 360.0,
        dec_deg=np.degrees(new_dec),
        v_mag=stars.v_mag + sigma_mag * mag,
    )
