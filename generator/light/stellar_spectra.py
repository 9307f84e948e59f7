"""Spectra of stars from V, B-V and V-I.

V-I (Cousins) selects among Pickles' templates, which contain the lines and the bands of titanium oxide. A power of the
wavelength on either side of 550 nm then adjusts the synthetic B-V and V-I to the requested ones, and the scale adjusts V.
All three magnitudes are thus exact by construction, however reddened the star is.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from generator.csv_table import CsvError, read_csv
from generator.errors import DataFileError
from generator.light.photometry import BESSELL_B, BESSELL_I, BESSELL_V, GRID_NM, Band
from generator.light.star_colours import usual_vi

Floats = NDArray[np.float64]

TEMPLATES_PATH = Path(__file__).parents[1] / "data" / "stellar_templates.csv"
MOST_WAVELENGTHS = 10_000
"""Limit far above the number of rows of the package's table."""
HINGE_NM = 550.0
"""Wavelength at which the two powers meet."""
VI_STEP_MAG = 0.1
VI_NODES_MAG: Floats = np.round(np.arange(-0.4, 4.45, VI_STEP_MAG), 1)
EXCESS_NODES_MAG: Floats = np.array(
    [-1.5, -1.0, -0.7, -0.5, -0.3, -0.2, -0.1, 0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.7, 1.0, 1.5, 2.0, 3.0, 4.0]
)
"""B-V minus that of the template at the same V-I; multiples of VI_STEP_MAG."""
_EXCESS_COLUMNS: Floats = np.interp(
    np.arange(EXCESS_NODES_MAG[0], EXCESS_NODES_MAG[-1] + VI_STEP_MAG / 2, VI_STEP_MAG),
    EXCESS_NODES_MAG,
    np.arange(len(EXCESS_NODES_MAG)),
)
"""Fractional column at each multiple, for a look-up that is much faster than searching the nodes."""


@dataclass(frozen=True)
class ColourGrid:
    """Photon spectra of V = 0 stars over V-I and B-V.

    Attributes
    ----------
    bv_mag : (len(VI_NODES_MAG),) array
        B-V of the templates at VI_NODES_MAG.
    spectra : (len(VI_NODES_MAG), len(EXCESS_NODES_MAG), n) array
        Photons s^-1 m^-2 nm^-1 at GRID_NM.
    """

    bv_mag: Floats
    spectra: Floats


@functools.cache
def templates() -> Floats:
    """Pickles' templates at GRID_NM, relative photons, (types, n) array.

    Source: Pickles 1998, PASP 110, 863: dwarfs O5 to G8, giants G5 to M8 (M8 III: V-I 4.4).
    """
    try:
        table = read_csv(TEMPLATES_PATH, str(TEMPLATES_PATH), least_rows=2, most_rows=MOST_WAVELENGTHS, increasing=True)
    except CsvError as error:
        raise DataFileError(f"not a table of stellar templates: {error}; reinstall skybench") from error
    wavelength, *columns = table.values.T
    return np.array([np.interp(GRID_NM, wavelength, column) for column in columns])


@functools.cache
def band_weights(band: Band) -> Floats:
    """Weights of the mean over a band at GRID_NM, (n,) array."""
    return np.asarray(band.mean(GRID_NM, np.eye(len(GRID_NM))))


def colours(spectra: Floats) -> tuple[Floats, Floats]:
    """Synthetic B-V and V-I of photon spectra (..., n) at GRID_NM: two (...) arrays."""
    b, v, i = (
        -2.5 * np.log10(spectra @ band_weights(band) / band.zero_point) for band in (BESSELL_B, BESSELL_V, BESSELL_I)
    )
    return b - v, v - i


def tilted(spectra: Floats, bv_mag: Floats, vi_mag: Floats) -> Floats:
    """Return spectra (..., n), multiplied by powers of the wavelength on both sides of HINGE_NM to have these colours."""
    logarithm = np.log(GRID_NM / HINGE_NM)
    sides = np.stack([np.minimum(logarithm, 0), np.maximum(logarithm, 0)])
    powers = np.zeros((*np.shape(spectra)[:-1], 2))
    step = 1e-3

    def error(at: Floats) -> Floats:
        bv, vi = colours(spectra * np.exp(at @ sides))
        return np.stack([bv - bv_mag, vi - vi_mag], axis=-1)

    for _ in range(12):
        now = error(powers)
        slope = np.stack([(error(powers + step * unit) - now) / step for unit in np.eye(2)], axis=-1)
        powers -= np.linalg.solve(slope, now[..., None])[..., 0]
    return spectra * np.exp(powers @ sides)


@functools.cache
def colour_grid() -> ColourGrid:
    """Return the spectra from which those of all stars are interpolated."""
    spectra = templates()
    bv, vi = colours(spectra)
    place = np.interp(VI_NODES_MAG, vi, np.arange(len(vi)))
    lower = np.minimum(place.astype(np.intp), len(vi) - 2)
    weight = (place - lower)[:, None]
    # Between templates the logarithm is interpolated linearly, because absorption by molecules is multiplicative.
    between = np.exp((1 - weight) * np.log(spectra[lower]) + weight * np.log(spectra[lower + 1]))
    reference = np.interp(VI_NODES_MAG, vi, bv)
    wanted_bv = reference[:, None] + EXCESS_NODES_MAG
    grid = np.broadcast_to(between[:, None], (*wanted_bv.shape, len(GRID_NM)))
    grid = tilted(grid, wanted_bv, np.broadcast_to(VI_NODES_MAG[:, None], wanted_bv.shape))
    return ColourGrid(reference, grid * (BESSELL_V.zero_point / (grid @ band_weights(BESSELL_V)))[..., None])


def colour_place(bv_mag: ArrayLike, vi_mag: ArrayLike) -> tuple[Floats, Floats]:
    """Fractional row (V-I) and column (B-V) of :func:`colour_grid`; colours beyond the grid take its edge."""
    row = np.clip((np.asarray(vi_mag, float) - VI_NODES_MAG[0]) * (1 / VI_STEP_MAG), 0.0, len(VI_NODES_MAG) - 1.0)
    excess = np.asarray(bv_mag, float) - _between(colour_grid().bv_mag, row)
    fine = np.clip((excess - EXCESS_NODES_MAG[0]) * (1 / VI_STEP_MAG), 0.0, len(_EXCESS_COLUMNS) - 1.0)
    return row, _between(_EXCESS_COLUMNS, fine)


def _between(table: Floats, place: Floats) -> Floats:
    """Linear interpolation in a table at fractional indices."""
    lower = np.minimum(place.astype(np.int32), len(table) - 2)
    start = table.take(lower)
    return start + (place - lower) * (table.take(lower + 1) - start)


def star_spectra(v_mag: ArrayLike, bv_mag: ArrayLike, vi_mag: ArrayLike | None = None) -> Floats:
    """Photon spectra of stars above the atmosphere.

    Parameters
    ----------
    v_mag, bv_mag : (m,) array_like
        Johnson V and B-V.
    vi_mag : (m,) array_like or None
        V-I in Cousins' system; None for the usual one of B-V (:func:`generator.light.star_colours.usual_vi`).

    Returns
    -------
    (m, n) array
        Photons s^-1 m^-2 nm^-1 at GRID_NM.
    """
    grid = colour_grid().spectra
    row, column = colour_place(bv_mag, usual_vi(bv_mag) if vi_mag is None else vi_mag)
    r, c = (
        np.minimum(place.astype(np.intp), size - 2) for place, size in zip((row, column), grid.shape[:2], strict=True)
    )
    down, across = (row - r)[:, None], (column - c)[:, None]
    first = (1 - across) * grid[r, c] + across * grid[r, c + 1]
    second = (1 - across) * grid[r + 1, c] + across * grid[r + 1, c + 1]
    shape: Floats = (1 - down) * first + down * second
    return shape * 10 ** (-0.4 * np.asarray(v_mag, float))[:, None]
