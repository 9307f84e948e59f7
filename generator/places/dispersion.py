"""Atmospheric dispersion: how far light of other wavelengths is seen from the place at the reference wavelength."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from generator.places.astrometry import Air, Site, air_around
from generator.places.refraction import refraction_table

Floats = NDArray[np.float64]

LARGEST_SHARE = 0.05
"""Bound of the dispersion from 350 to 1000 nm over the refraction."""


def dispersion_deg(apparent_altitude_deg: Floats, wavelength_nm: Floats, site: Site, air: Air) -> Floats:
    """Lift, deg, of light at wavelengths (b,) over the reference's, by apparent altitudes (n,) there: (n, b) array.

    From the refraction of :mod:`generator.places.refraction` at each wavelength; 9 arcsec between 450 and 650 nm at 5 deg.
    """
    if air.pressure_hpa == 0:
        return np.zeros((len(apparent_altitude_deg), len(wavelength_nm)))

    lifted = refraction_table(air_around(site, air)).of_apparent(apparent_altitude_deg)
    true = apparent_altitude_deg - lifted
    tables = [refraction_table(air_around(site, air, float(nm))) for nm in wavelength_nm]
    return np.stack([table.of_true(true) - lifted for table in tables], axis=1)


def may_disperse(apparent_altitude_deg: Floats, least_deg: float, site: Site, air: Air) -> NDArray[np.bool_]:
    """Where dispersion may exceed an angle, (n,) array: a bound that needs no further wavelength."""
    if air.pressure_hpa == 0 or not len(apparent_altitude_deg):
        return np.zeros(len(apparent_altitude_deg), bool)
    table = refraction_table(air_around(site, air))
    return LARGEST_SHARE * table.of_apparent(apparent_altitude_deg) > least_deg
