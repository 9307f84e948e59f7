"""Astronomical refraction from the true to the apparent direction."""

from __future__ import annotations

import erfa
import numpy as np
from numpy.typing import NDArray

LOWEST_ALTITUDE_OF_SERIES_DEG = 15.0
LOWEST_ALTITUDE_DEG = -1.0
NEWTON_STEPS = 2


def _saemundsson_arcmin(true_altitude_deg: NDArray[np.float64]) -> NDArray[np.float64]:
    """Refraction, arcmin, for 1010 hPa and 10 deg C. Source: Saemundsson 1986, Sky & Telescope 72, 70."""
    h = np.maximum(true_altitude_deg, LOWEST_ALTITUDE_DEG)
    return 1.02 / np.tan(np.radians(h + 10.3 / (h + 5.11)))


def _series_deg(true_zenith_distance_rad: NDArray[np.float64], refa_rad: float, refb_rad: float) -> NDArray[np.float64]:
    """Solve z_true = z_obs + A tan z_obs + B tan^3 z_obs for the refraction, deg, by Newton's method."""
    observed = true_zenith_distance_rad.copy()
    # From the true zenith distance, two steps come within 1e-9 arcsec above 15 deg.
    for _ in range(NEWTON_STEPS):
        tangent = np.tan(observed)
        square = tangent * tangent
        excess = observed + (refa_rad + refb_rad * square) * tangent - true_zenith_distance_rad
        observed -= excess / (1 + (refa_rad + 3 * refb_rad * square) * (1 + square))
    return np.degrees(true_zenith_distance_rad - observed)


def refraction_deg(
    true_altitude_deg: NDArray[np.float64],
    *,
    pressure_hpa: float,
    temperature_c: float,
    relative_humidity: float,
    wavelength_nm: float = 550.0,
) -> NDArray[np.float64]:
    """Refraction to add to a true altitude.

    Above 15 deg this is ERFA's ``refco`` with its A tan z + B tan^3 z (good to some 0.05 arcsec there). Lower, where that
    series fails, it is Saemundsson's formula, scaled to meet ERFA's value at 15 deg; below a true altitude of -1 deg,
    where no light arrives, it stays constant.

    Parameters
    ----------
    true_altitude_deg : (n,) array
        Altitude without refraction, deg.
    pressure_hpa, temperature_c, relative_humidity, wavelength_nm : float
        Air at the observer (hPa, deg C, 0-1) and the wavelength (nm).

    Returns
    -------
    (n,) array
        Refraction, deg.
    """
    if pressure_hpa == 0:
        return np.zeros_like(true_altitude_deg)
    refa, refb = erfa.refco(pressure_hpa, temperature_c, relative_humidity, wavelength_nm / 1000)
    series_altitude = np.maximum(true_altitude_deg, LOWEST_ALTITUDE_OF_SERIES_DEG)
    series = _series_deg(np.radians(90 - series_altitude), float(refa), float(refb))
    seam = np.array([LOWEST_ALTITUDE_OF_SERIES_DEG])
    scale = _series_deg(np.radians(90 - seam), float(refa), float(refb)) / _saemundsson_arcmin(seam)
    low = np.flatnonzero(true_altitude_deg < LOWEST_ALTITUDE_OF_SERIES_DEG)
    series[low] = scale * _saemundsson_arcmin(true_altitude_deg[low])
    return series
