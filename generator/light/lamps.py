"""Lamps of cities: their spectra, and a city as a disk of lamps."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from generator.csv_table import CsvError, read_csv
from generator.errors import DataFileError
from generator.light.photometry import BESSELL_V, GRID_NM

Floats = NDArray[np.float64]

LAMPS_PATH = Path(__file__).parents[1] / "data" / "lamps.csv"
MOST_WAVELENGTHS = 10_000
"""Limit far above the number of rows of the package's table."""

LUMEN_PER_V_PHOTON = 2.54e-6 / BESSELL_V.zero_point
"""Lumen per photon s^-1 nm^-1 in V: a star of V = 0 gives 2.54e-6 lx. Source: Crumey 2014, MNRAS 442, 2600."""
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


def mixed_lamps(lamps: tuple[tuple[str, float], ...]) -> Floats:
    """Photon spectrum of a mix of lamps at GRID_NM with a V-band mean of 1."""
    whole = sum(share for _, share in lamps)
    return np.sum([share / whole * lamp_spectra()[name] for name, share in lamps], axis=0)
