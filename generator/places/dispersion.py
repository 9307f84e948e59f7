"""Atmospheric dispersion: displacement of light of other wavelengths from the place at the reference wavelength."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import barycentric_interpolate

from generator.places.astrometry import Air, Site, air_around
from generator.places.refraction import refraction_table

Floats = NDArray[np.float64]

NODES = 3
"""Number of wavelengths at which refraction is integrated; between them it is a polynomial in the refractivity of dry air."""
LARGEST_SHARE = 0.05
"""Upper limit of the dispersion from 350 to 1000 nm relative to the refraction."""


def dispersion_deg(apparent_altitude_deg: Floats, wavelength_nm: Floats, site: Site, air: Air) -> Floats:
    """Lift, deg, of light at wavelengths (b,) relative to the reference's, at apparent altitudes (n,) there: (n, b) array.

    It follows from the refraction of :mod:`generator.places.refraction`: 9 arcsec between 450 and 650 nm at 5 deg. If
    there are more than NODES wavelengths, those in between are interpolated in the refractivity of dry air, in which
    refraction is nearly linear: within 0.001 arcsec from 1 deg of altitude up, 0.02 at the horizon.
    """
    if air.pressure_hpa == 0:
        return np.zeros((len(apparent_altitude_deg), len(wavelength_nm)))

    lifted = refraction_table(air_around(site, air)).of_apparent(apparent_altitude_deg)
    true = apparent_altitude_deg - lifted
    nodes = wavelength_nm
    if len(wavelength_nm) > NODES:
        # Evenly spaced in the refractivity.
        refractivity = dry_refractivity(wavelength_nm)
        wanted = np.linspace(refractivity.min(), refractivity.max(), NODES)
        order = np.argsort(refractivity)
        nodes = np.interp(wanted, refractivity[order], wavelength_nm[order])
    tables = [refraction_table(air_around(site, air, float(nm))) for nm in nodes]
    lift = np.stack([table.of_true(true) - lifted for table in tables], axis=1)
    if nodes is wavelength_nm:
        return lift
    weights = barycentric_interpolate(dry_refractivity(nodes), np.eye(len(nodes)), refractivity)
    return np.asarray(lift @ weights.T)


def dry_refractivity(wavelength_nm: Floats) -> Floats:
    """Refractive index of dry air minus 1, relative to that without dispersion, (b,) array.

    Source: Hohenkerk & Sinclair 1985, NAO Technical Note 63, as in :class:`generator.places.ray_bending.Layers`.
    """
    inverse_square = (1000 / wavelength_nm) ** 2
    return np.asarray(1 + (1.62887 + 0.01360 * inverse_square) * inverse_square / 287.6155)


def may_disperse(apparent_altitude_deg: Floats, least_deg: float, site: Site, air: Air) -> NDArray[np.bool_]:
    """Whether dispersion may exceed an angle, (n,) array: an upper limit that needs no further wavelength."""
    if air.pressure_hpa == 0 or not len(apparent_altitude_deg):
        return np.zeros(len(apparent_altitude_deg), bool)
    table = refraction_table(air_around(site, air))
    return LARGEST_SHARE * table.of_apparent(apparent_altitude_deg) > least_deg
