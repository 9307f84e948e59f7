"""Electrons from a spectrum in each channel of a film: integrals over wavelength as products of matrices.

The film's response is evaluated once at a few wavelengths, evenly spread over the whole range; the integral of any
spectrum is then a weighted sum. For stars the sums are tabulated over colour and airmass, on which alone they depend.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from generator.device_arrays import aligned
from generator.light.airmass_nodes import LEVEL_NODES, airmass_nodes, node_place
from generator.light.photometry import GRID_NM, GRID_START_NM
from generator.plugins.spectra import SPECTRAL_RANGE_NM, stratified_wavelengths

Floats = NDArray[np.float64]

WAVELENGTH_GROUPS = 33
"""Number of groups of four wavelengths: one wavelength every 4.9 nm."""
DARK = 1e-30
STARS_AT_ONCE = 16384
"""Number of stars per step, few enough for the intermediate arrays to fit into the processor's cache."""


@dataclass(frozen=True)
class FilmResponse:
    """Spectral response of a camera's film.

    Attributes
    ----------
    wavelength_nm : (m,) array
    electrons : (channels, m) array
        Electrons per photon nm^-1 at each wavelength, over the spectral range; the sum of response times spectrum is the
        integral.
    """

    wavelength_nm: Floats
    electrons: Floats

    @property
    def channels(self) -> int:
        """Number of channels of the film."""
        return len(self.electrons)

    def of(self, spectra: Floats) -> Floats:
        """Integrals of k spectra (k, n) on GRID_NM, linear in between: (channels, k) array."""
        return self.electrons @ self._at_wavelengths(spectra).T

    def of_stars(
        self,
        colour_table: Floats,
        optical_depth: Floats,
        colour_row: Floats,
        colour_column: Floats,
        airmass: Floats,
        bands: int,
    ) -> Floats:
        """Integrals of n extinguished star spectra in equal bands of the spectral range.

        They are linear in row and column, as the spectra are; between nodes of the airmass the logarithm is linear, which
        is accurate to 1e-4 in clear and 5e-4 in hazy air (aerosol optical depth 0.6).

        Parameters
        ----------
        colour_table : (rows, columns, len(GRID_NM)) array
        optical_depth : (len(GRID_NM),) or (nodes, len(GRID_NM)) array
            Optical depth per airmass: for any path, or for the nodes of :func:`generator.light.airmass_nodes.airmass_nodes`.
        colour_row, colour_column, airmass : (n,) arrays
            Fractional row and column, and relative airmass.
        bands : int

        Returns
        -------
        (n, channels, bands) array
        """
        table = _star_table(
            self.wavelength_nm.tobytes(),
            self.electrons.tobytes(),
            colour_table.tobytes(),
            colour_table.shape[1],
            optical_depth.tobytes(),
            bands,
        )
        nodes, count = table.airmass, len(table.airmass)
        airmass = np.minimum(airmass, nodes[-1])
        node = np.clip(node_place(airmass, count).astype(np.intp), 0, count - 2)
        along = ((airmass - nodes[node]) / (nodes[node + 1] - nodes[node])).astype(np.float32)
        rows, columns = colour_table.shape[:2]
        row = np.minimum(colour_row.astype(np.intp), rows - 2)
        column = np.minimum(colour_column.astype(np.intp), columns - 2)
        down, across = (colour_row - row).astype(np.float32), (colour_column - column).astype(np.float32)
        # Columns come last, so that of the eight interpolated values, each group of four is adjacent in memory.
        lower = (row * count + node) * columns + column
        steps = (0, 1, columns * count, columns * count + 1)
        shares = ((1 - down) * (1 - across), (1 - down) * across, down * (1 - across), down * across)
        result = np.zeros((len(colour_row), self.channels * bands))
        for start in range(0, len(colour_row), STARS_AT_ONCE):
            some = slice(start, start + STARS_AT_ONCE)
            corners = [(lower[some] + step, share[some]) for step, share in zip(steps, shares, strict=True)]
            near, far = 1 - along[some], along[some]
            for number, logarithm in zip(table.columns, table.logarithms, strict=True):
                result[some, number] = sum(
                    np.exp(logarithm.take(corner) * near + logarithm.take(corner + columns) * far) * share
                    for corner, share in corners
                )
        return result.reshape(-1, self.channels, bands)

    @property
    def on_grid(self) -> Floats:
        """Response for spectra at GRID_NM, linear in between: (channels, len(GRID_NM)) array."""
        return self.of(np.eye(len(GRID_NM)))

    def _at_wavelengths(self, spectra: Floats) -> Floats:
        return _at_wavelengths(self.wavelength_nm, spectra)


def _at_wavelengths(wavelength_nm: Floats, spectra: Floats) -> Floats:
    """Interpolate spectra (k, n) on GRID_NM at m wavelengths, (k, m) array."""
    position = np.interp(wavelength_nm, GRID_NM, np.arange(len(GRID_NM)))
    lower = np.minimum(position.astype(np.intp), len(GRID_NM) - 2)
    weight = position - lower
    return spectra[:, lower] * (1 - weight) + spectra[:, lower + 1] * weight


@dataclass(frozen=True)
class _StarTable:
    """Electrons of stars by colour and airmass.

    Attributes
    ----------
    airmass : (nodes,) array
    columns : list of int
        Channels and bands (channel x bands + band) in which the film has any response.
    logarithms : list of (rows x nodes x columns,) float32 arrays
        Logarithms of the electrons in each of these; their rounding changes the light by 2e-6.
    """

    airmass: Floats
    columns: list[int]
    logarithms: list[NDArray[np.float32]]


@functools.lru_cache(maxsize=4)
def _star_table(
    wavelength_nm: bytes,
    electrons: bytes,
    colours: bytes,
    colour_columns: int,
    optical_depth: bytes,
    bands: int,
) -> _StarTable:
    """Table for :meth:`FilmResponse.of_stars`, cached by its arrays as bytes: frames of one camera and air share it."""
    wavelengths = np.frombuffer(wavelength_nm)
    depth = np.frombuffer(optical_depth).reshape(-1, len(GRID_NM))
    nodes = airmass_nodes(len(depth) if len(depth) > 1 else LEVEL_NODES)
    count = len(nodes)
    shapes = _at_wavelengths(wavelengths, np.frombuffer(colours).reshape(-1, len(GRID_NM)))
    passed = np.exp(-nodes[:, None] * _at_wavelengths(wavelengths, depth))
    band = np.minimum(((wavelengths - GRID_START_NM) * (bands / SPECTRAL_RANGE_NM)).astype(int), bands - 1)
    columns, logarithms = [], []
    for channel, response in enumerate(np.frombuffer(electrons).reshape(-1, len(wavelengths))):
        for number in range(bands):
            chosen = band == number
            # Filters block some bands for a channel.
            if (response[chosen] > 0).any():
                light = (shapes[:, chosen] * response[chosen]) @ passed[:, chosen].T
                columns.append(channel * bands + number)
                logarithm = np.log(np.maximum(light, DARK)).reshape(-1, colour_columns, count)
                logarithms.append(logarithm.transpose(0, 2, 1).astype(np.float32).ravel())
    return _StarTable(nodes, columns, logarithms)


def film_response(camera: Any, groups: int = WAVELENGTH_GROUPS) -> FilmResponse:
    """Evaluate the response of a camera's film at 4 x `groups` wavelengths; the film must be prepared."""
    film = camera.film()
    channels = film.create_block().channel_count() - 1
    sample = (np.arange(groups) + 0.5) / (4 * groups)
    wavelengths = stratified_wavelengths(mi.Float(aligned(sample.astype(np.float32))))
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
