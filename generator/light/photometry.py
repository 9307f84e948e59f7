"""Magnitudes and photons: the Johnson-Cousins B, V and I bands, their zero points, and surface brightness."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]

ARCSEC2_PER_SR = (180 * 3600 / np.pi) ** 2
PHOTONS_M2_NM_PER_CM2_ANGSTROM = 1e5

GRID_START_NM, GRID_STOP_NM, GRID_STEP_NM = 350.0, 1000.0, 5.0
GRID_NM: Floats = np.arange(GRID_START_NM, GRID_STOP_NM + GRID_STEP_NM / 2, GRID_STEP_NM)
"""Wavelengths, nm, at which every spectrum of the generator is tabulated; linear in between."""


@dataclass(frozen=True, eq=False)
class Band:
    """A photometric band.

    Attributes
    ----------
    wavelength_nm, response : (n,) arrays
        Relative response to photons (not to their energy), linear between the points, zero outside.
    zero_point : float
        Mean photon irradiance of a star of magnitude 0 in the band, photons s^-1 m^-2 nm^-1.
    """

    wavelength_nm: Floats
    response: Floats
    zero_point: float

    def mean(self, wavelength_nm: Floats, photons: Floats) -> Floats:
        """Response-weighted mean of photon spectra over the band.

        Parameters
        ----------
        wavelength_nm : (n,) array
            Increasing.
        photons : (..., n) array
            Photon spectra on these wavelengths, linear in between.

        Returns
        -------
        (...) array
            Means in the unit of `photons`.
        """
        first, last = self.wavelength_nm[0], self.wavelength_nm[-1]
        inside = wavelength_nm[(wavelength_nm > first) & (wavelength_nm < last)]
        fine = np.unique(np.concatenate([self.wavelength_nm, inside, np.arange(first, last, 1.0)]))
        response = np.interp(fine, self.wavelength_nm, self.response)
        flat = np.reshape(photons, (-1, len(wavelength_nm)))
        weighted = [np.trapezoid(np.interp(fine, wavelength_nm, spectrum) * response, fine) for spectrum in flat]
        return np.reshape(weighted, np.shape(photons)[:-1]) / np.trapezoid(response, fine)

    def magnitude(self, wavelength_nm: Floats, photons: Floats) -> Floats:
        """Magnitude of photon spectra (photons s^-1 m^-2 nm^-1); shapes as in :meth:`mean`."""
        return -2.5 * np.log10(self.mean(wavelength_nm, photons) / self.zero_point)


PLANCK_LIGHT_ERG_NM = 1.98644586e-9
"""Planck's constant times the speed of light, erg nm: the energy of a photon times its wavelength."""


def _band_of_energy(first_nm: float, energy_response: list[float], f_lambda: float) -> Band:
    """Return a band whose response to energy is tabulated every 10 nm.

    Parameters
    ----------
    first_nm : float
    energy_response : list of float
    f_lambda : float
        Mean irradiance of magnitude 0, weighted by that response, erg s^-1 cm^-2 A^-1.
    """
    energy: Floats = np.array(energy_response, dtype=float)
    wavelength: Floats = first_nm + 10.0 * np.arange(len(energy), dtype=float)
    # A response to photons is one to energy over the wavelength: each photon counts once, whatever its energy.
    photon = energy / wavelength
    fine = np.arange(wavelength[0], wavelength[-1] + 0.05, 0.1)
    response = np.interp(fine, wavelength, photon)
    photons = f_lambda * np.sum(response * fine) / np.sum(response) / PLANCK_LIGHT_ERG_NM
    return Band(wavelength, photon / photon.max(), float(photons) * PHOTONS_M2_NM_PER_CM2_ANGSTROM)


# Passbands: Bessell 1990, PASP 102, 1181, table 2. They are responses to energy: divided by the wavelength, V is the
# photonic passband of Bessell & Murphy 2012, PASP 124, 140, table 1, up to 560 nm, from where they have changed it. Zero
# points of B and V: Bessell, Castelli & Plez 1998, A&A 333, 231, table A2.
BESSELL_B = _band_of_energy(
    360,
    [0, 0.030, 0.134, 0.567, 0.920, 0.978, 1.000, 0.978, 0.935, 0.853, 0.740, 0.640, 0.536, 0.424, 0.325, 0.235, 0.150,
     0.095, 0.043, 0.009, 0],
    6.320e-9,
)  # fmt: skip
BESSELL_V = _band_of_energy(
    470,
    [0, 0.030, 0.163, 0.458, 0.780, 0.967, 1.000, 0.973, 0.898, 0.792, 0.684, 0.574, 0.461, 0.359, 0.270, 0.197, 0.135,
     0.081, 0.045, 0.025, 0.017, 0.013, 0.009, 0],
    3.631e-9,
)  # fmt: skip
# Zero point of I: Vega (CALSPEC) has V-I 0.00 with 1.138e-9, and the Sun (ASTM G173's spectrum above the air) has 0.702
# (Ramirez et al. 2012, ApJ 752, 5) with 1.165e-9; the value is between these. Bessell, Castelli & Plez 1998 have 1.126e-9.
BESSELL_I = _band_of_energy(
    700,
    [0, 0.024, 0.232, 0.555, 0.785, 0.910, 0.965, 0.985, 0.990, 0.995, 1.000, 1.000, 0.990, 0.980, 0.950, 0.910, 0.860,
     0.750, 0.560, 0.330, 0.150, 0.030, 0],
    1.151e-9,
)  # fmt: skip


def radiance_from_surface_brightness(mag_arcsec2: ArrayLike) -> Floats:
    """V-band mean photon radiance, photons s^-1 m^-2 nm^-1 sr^-1, of a surface brightness in V mag/arcsec^2."""
    return BESSELL_V.zero_point * 10 ** (-0.4 * np.asarray(mag_arcsec2, float)) * ARCSEC2_PER_SR


def surface_brightness_from_radiance(photon_radiance: ArrayLike) -> Floats:
    """Surface brightness, V mag/arcsec^2, of a V-band mean photon radiance (photons s^-1 m^-2 nm^-1 sr^-1)."""
    return -2.5 * np.log10(np.asarray(photon_radiance, float) / ARCSEC2_PER_SR / BESSELL_V.zero_point)
