"""Electrons that a spectrum makes in each channel of a film: integrals over wavelength as products of matrices.

The film is asked once what it makes of light of each of a few wavelengths, evenly spread over the whole range; every spectrum
is then a weighted sum. For stars the sums are tabulated over colour and airmass, on which alone they depend.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from generator.photometry import GRID_NM, GRID_START_NM
from generator.plugins.spectra import SPECTRAL_RANGE_NM, stratified_wavelengths

Floats = NDArray[np.float64]

WAVELENGTH_GROUPS = 33
"""Wavelengths over four: one every 4.9 nm."""
AIRMASS_NODES = 192
LARGEST_AIRMASS = 40.0
AIRMASS_SCALE = 0.5
"""Nodes of the table of stars are evenly spaced in log(airmass + this)."""
DARK = 1e-300
STARS_AT_ONCE = 4096
"""So that the steps of their computation find each other's numbers in the processor's cache."""


@dataclass(frozen=True)
class FilmResponse:
    """What a camera's film makes of light.

    Attributes
    ----------
    wavelength_nm : (m,) array
    electrons : (channels, m) array
        Electrons per photon nm^-1 at each wavelength, over the spectral range: the sum of response times spectrum is the
        integral.
    """

    wavelength_nm: Floats
    electrons: Floats

    @property
    def channels(self) -> int:
        """Of the film."""
        return len(self.electrons)

    def of(self, spectra: Floats) -> Floats:
        """Integrals of k spectra (k, n) on GRID_NM, linear in between: (channels, k) array."""
        return self.electrons @ self._at_wavelengths(spectra).T

    def of_stars(
        self, colour_table: Floats, optical_depth: Floats, colour_row: Floats, airmass: Floats, bands: int
    ) -> Floats:
        """Integrals of n extinguished star spectra in equal bands of the spectral range.

        Linear in the row, as the spectra are; between nodes of the airmass the logarithm is linear, which is within
        1e-4 in clear and 5e-4 in hazy air (aerosol optical depth 0.6).

        Parameters
        ----------
        colour_table : (rows, len(GRID_NM)) array
        optical_depth : (len(GRID_NM),) array
            Vertical.
        colour_row, airmass : (n,) arrays
            Fractional row, and relative airmass.
        bands : int

        Returns
        -------
        (n, channels, bands) array
        """
        nodes = AIRMASS_SCALE * np.expm1(np.linspace(0, np.log1p(LARGEST_AIRMASS / AIRMASS_SCALE), AIRMASS_NODES))
        shapes = self._at_wavelengths(colour_table)
        passed = np.exp(-nodes[:, None] * self._at_wavelengths(optical_depth[None])[0])
        band = np.minimum(((self.wavelength_nm - GRID_START_NM) * (bands / SPECTRAL_RANGE_NM)).astype(int), bands - 1)
        table = np.empty((len(shapes), AIRMASS_NODES, self.channels, bands))
        for channel, response in enumerate(self.electrons):
            for number in range(bands):
                chosen = band == number
                table[:, :, channel, number] = (shapes[:, chosen] * response[chosen]) @ passed[:, chosen].T
        # Filters leave a channel blind in most bands.
        table = table.reshape(-1, self.channels * bands)
        seen = np.flatnonzero(table.any(axis=0))
        logarithm = np.log(np.maximum(table[:, seen], DARK))
        place = np.log1p(airmass / AIRMASS_SCALE) * ((AIRMASS_NODES - 1) / np.log1p(LARGEST_AIRMASS / AIRMASS_SCALE))
        node = np.clip(place.astype(np.intp), 0, AIRMASS_NODES - 2)
        along = ((airmass - nodes[node]) / (nodes[node + 1] - nodes[node]))[:, None]
        row = np.minimum(colour_row.astype(np.intp), len(shapes) - 2)
        across = (colour_row - row)[:, None]
        lower = row * AIRMASS_NODES + node
        result = np.zeros((len(colour_row), self.channels * bands))
        for start in range(0, len(colour_row), STARS_AT_ONCE):
            some = slice(start, start + STARS_AT_ONCE)
            low, high = (
                np.exp(
                    logarithm.take(first, axis=0) * (1 - along[some]) + logarithm.take(first + 1, axis=0) * along[some]
                )
                for first in (lower[some], lower[some] + AIRMASS_NODES)
            )
            result[some, seen] = low * (1 - across[some]) + high * across[some]
        return result.reshape(-1, self.channels, bands)

    @property
    def on_grid(self) -> Floats:
        """The same for spectra at GRID_NM, linear in between: (channels, len(GRID_NM)) array."""
        return self.of(np.eye(len(GRID_NM)))

    def _at_wavelengths(self, spectra: Floats) -> Floats:
        """Spectra (k, n) on GRID_NM at the response's wavelengths, (k, m) array."""
        position = np.interp(self.wavelength_nm, GRID_NM, np.arange(len(GRID_NM)))
        lower = np.minimum(position.astype(np.intp), len(GRID_NM) - 2)
        weight = position - lower
        return spectra[:, lower] * (1 - weight) + spectra[:, lower + 1] * weight


def film_response(camera: Any, groups: int = WAVELENGTH_GROUPS) -> FilmResponse:
    """Ask a camera's film for its response at 4 x `groups` wavelengths; the film must be prepared."""
    film = camera.film()
    channels = film.create_block().channel_count() - 1
    sample = (np.arange(groups) + 0.5) / (4 * groups)
    wavelengths = stratified_wavelengths(mi.Float(sample.astype(np.float32)))
    weight = camera.spectral_weight(wavelengths)
    electrons = np.empty((channels, 4, groups))
    for lane in range(4):
        single = mi.Spectrum(0)
        single[lane] = weight[lane]
        values = film.prepare_sample(single, wavelengths, channels + 1)[:channels]
        dr.eval(values)
        for channel, value in enumerate(values):
            electrons[channel, lane] = np.array(value) / groups
    return FilmResponse(np.array(wavelengths, dtype=np.float64).ravel(), electrons.reshape(channels, -1))
