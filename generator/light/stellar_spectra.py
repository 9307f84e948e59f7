"""Spectra of stars from V and B-V.

A star's spectrum is a blackbody of Ballesteros' temperature for its B-V, tilted by a power of the wavelength so that its
synthetic B-V is the catalogue's, and scaled so that its synthetic V is. The colour is thus right by construction, the
lines and the Balmer jump are missing.
"""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import ArrayLike, NDArray

from generator.light.photometry import BESSELL_B, BESSELL_V, GRID_NM

Floats = NDArray[np.float64]

BV_START_MAG, BV_STOP_MAG, BV_STEP_MAG = -0.5, 6.0, 0.025
REFERENCE_NM = 550.0
_SECOND_RADIATION_CONSTANT_NM_K = 1.438776877e7


def ballesteros_temperature_k(bv_mag: ArrayLike) -> Floats:
    """Effective temperature, K, from B-V. Source: Ballesteros 2012, EPL 97, 34008, eq. 14."""
    bv = np.asarray(bv_mag, float)
    return 4600 * (1 / (0.92 * bv + 1.7) + 1 / (0.92 * bv + 0.62))


def blackbody_photons(wavelength_nm: Floats, temperature_k: Floats) -> Floats:
    """Planck's law in photons, relative to REFERENCE_NM.

    Parameters
    ----------
    wavelength_nm : (n,) array
    temperature_k : (m,) array

    Returns
    -------
    (m, n) array
    """

    def planck(wavelength: Floats) -> Floats:
        return wavelength**-4 / np.expm1(_SECOND_RADIATION_CONSTANT_NM_K / (wavelength * temperature_k[:, None]))

    return planck(wavelength_nm[None, :]) / planck(np.array([[REFERENCE_NM]]))


@functools.cache
def colour_table() -> Floats:
    """Photon spectra of V = 0 stars over a grid of B-V.

    Returns
    -------
    (m, n) array
        Photons s^-1 m^-2 nm^-1 at GRID_NM, one row for each B-V from BV_START_MAG to BV_STOP_MAG by BV_STEP_MAG.
    """
    bv = np.arange(BV_START_MAG, BV_STOP_MAG + BV_STEP_MAG / 2, BV_STEP_MAG)
    blackbody = blackbody_photons(GRID_NM, ballesteros_temperature_k(bv))
    log_wavelength = np.log(GRID_NM / REFERENCE_NM)[None, :]
    tilt = np.zeros_like(bv)
    step = 1e-3
    for _ in range(12):
        error = _synthetic_bv(blackbody * np.exp(tilt[:, None] * log_wavelength)) - bv
        slope = (_synthetic_bv(blackbody * np.exp((tilt + step)[:, None] * log_wavelength)) - bv - error) / step
        tilt -= error / slope
    spectra = blackbody * np.exp(tilt[:, None] * log_wavelength)
    return spectra * (BESSELL_V.zero_point / BESSELL_V.mean(GRID_NM, spectra))[:, None]


def _synthetic_bv(photons: Floats) -> Floats:
    return BESSELL_B.magnitude(GRID_NM, photons) - BESSELL_V.magnitude(GRID_NM, photons)


def colour_row(bv_mag: ArrayLike) -> Floats:
    """Fractional row of :func:`colour_table` for B-V; bluer or redder stars than the table take its ends."""
    return (np.clip(np.asarray(bv_mag, float), BV_START_MAG, BV_STOP_MAG) - BV_START_MAG) / BV_STEP_MAG


def star_spectra(v_mag: ArrayLike, bv_mag: ArrayLike) -> Floats:
    """Photon spectra of stars above the atmosphere.

    Parameters
    ----------
    v_mag, bv_mag : (m,) array_like

    Returns
    -------
    (m, n) array
        Photons s^-1 m^-2 nm^-1 at GRID_NM.
    """
    table = colour_table()
    row = colour_row(bv_mag)
    lower = np.minimum(row.astype(np.intp), len(table) - 2)
    weight = (row - lower)[:, None]
    shape = (1 - weight) * table[lower] + weight * table[lower + 1]
    return shape * 10 ** (-0.4 * np.asarray(v_mag, float))[:, None]
