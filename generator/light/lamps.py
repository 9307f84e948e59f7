"""Lamps of cities: their spectra, and a city as a disk of lamps."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from generator.csv_table import CsvError, read_csv
from generator.errors import DataFileError
from generator.light.photometry import BESSELL_V, GRID_NM, GRID_STEP_NM, PLANCK_LIGHT_ERG_NM

Floats = NDArray[np.float64]

LAMPS_PATH = Path(__file__).parents[1] / "data" / "lamps.csv"
MOST_WAVELENGTHS = 10_000
"""Limit far above the number of rows of the package's table."""

LUMEN_PER_WATT = 683.0
"""Luminous efficacy of light of 555 nm."""
# Luminous efficiency every 5 nm from 380 to 780 nm. Source: CIE 1924, photopic vision.
_EFFICIENCY: Floats = np.array([
    3.9e-05, 6.4e-05, 0.00012, 0.000217, 0.000396, 0.00064, 0.00121, 0.00218, 0.004, 0.0073, 0.0116, 0.01684, 0.023,
    0.0298, 0.038, 0.048, 0.06, 0.0739, 0.09098, 0.1126, 0.13902, 0.1693, 0.20802, 0.2586, 0.323, 0.4073, 0.503, 0.6082,
    0.71, 0.7932, 0.862, 0.91485, 0.954, 0.9803, 0.99495, 1, 0.995, 0.9786, 0.952, 0.9154, 0.87, 0.8163, 0.757, 0.6949,
    0.631, 0.5668, 0.503, 0.4412, 0.381, 0.321, 0.265, 0.217, 0.175, 0.1382, 0.107, 0.0816, 0.061, 0.04458, 0.032, 0.0232,
    0.017, 0.01192, 0.00821, 0.005723, 0.004102, 0.002929, 0.002091, 0.001484, 0.001047, 0.00074, 0.00052, 0.0003611,
    0.0002492, 0.0001719, 0.00012, 8.48e-05, 6e-05, 4.24e-05, 3e-05, 2.12e-05, 1.499e-05
])  # fmt: skip
LAMP_MIX = (("HPS", 0.5), ("LED", 0.5))
"""Fractions of the light of a town, in V-band photons: high-pressure sodium and white light-emitting diodes."""
LARGEST_DISTANCE_KM = 150.0
"""Distance at which the Earth's curvature reduces the light at the zenith by 13 %; the bake's rings end at 180 km."""


@dataclass(frozen=True)
class City:
    """A disk of lamps.

    Attributes
    ----------
    distance_km, azimuth_deg : float
        Place of its centre, seen from the observer.
    radius_km : float
    upward_mlm : float
        Upward light, megalumen.
    horizon_share : float or None
        Fraction of the upward light in Garstang's pattern near the horizon, the rest by Lambert's law; None means that
        all leaves as from a built-up area (:func:`generator.light.emission.built_up`).
    lamps : tuple of (name, share)
        Names of :func:`lamp_spectra`, shares in V-band photons.
    """

    distance_km: float
    azimuth_deg: float
    radius_km: float
    upward_mlm: float = 100.0
    horizon_share: float | None = None
    lamps: tuple[tuple[str, float], ...] = LAMP_MIX


@functools.cache
def lamp_spectra() -> dict[str, Floats]:
    """Photon spectra of street lamps at GRID_NM, each with a V-band mean of 1; zero below 380 nm."""
    try:
        table = read_csv(LAMPS_PATH, str(LAMPS_PATH), least_rows=2, most_rows=MOST_WAVELENGTHS, increasing=True)
    except CsvError as error:
        raise DataFileError(f"not a table of lamp spectra: {error}; reinstall skybench") from error
    wavelength, *powers = table.values.T
    photons = {
        name: np.interp(GRID_NM, wavelength, watts * wavelength, left=0, right=0)
        for name, watts in zip(table.columns[1:], powers, strict=True)
    }
    return {name: spectrum / BESSELL_V.mean(GRID_NM, spectrum) for name, spectrum in photons.items()}


@functools.cache
def _lumen_per_photon() -> Floats:
    """Lumen per photon s^-1 nm^-1 at GRID_NM, with the weights of an integral over wavelength, (n,) array."""
    efficiency = np.interp(GRID_NM, np.arange(380.0, 781.0, 5.0), _EFFICIENCY, left=0, right=0)
    joule_per_photon = PLANCK_LIGHT_ERG_NM * 1e-7 / GRID_NM
    return np.asarray(LUMEN_PER_WATT * efficiency * joule_per_photon * GRID_STEP_NM)


def luminous(spectra: Floats) -> Floats:
    """Luminous flux of photon spectra (..., n) at GRID_NM, photons s^-1 nm^-1: lumen, (...) array.

    Photons s^-1 m^-2 nm^-1 give lux. A star of V = 0 gives 2.54e-6 lx (Crumey 2014, MNRAS 442, 2600), light of sodium of
    the same V 30 % more.
    """
    return np.asarray(spectra @ _lumen_per_photon())


def mixed_lamps(lamps: tuple[tuple[str, float], ...]) -> Floats:
    """Photon spectrum of a mix of lamps at GRID_NM with a V-band mean of 1."""
    whole = sum(share for _, share in lamps)
    return np.sum([share / whole * lamp_spectra()[name] for name, share in lamps], axis=0)
