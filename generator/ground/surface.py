"""View of a landscape, apart from the light of the night: maps that many frames share.

A landscape's light is a sum over its surfaces. Upright ones return the light that falls on the wall of their azimuth,
level ones that of the ground, each in three colours; the air in front of them shines as the sky at the horizon does
(:mod:`generator.ground.lighting`). The fraction of each texel for every one of these seven surfaces, SURFACES, does not
change between frames. Their brightness, the terms, depends only on azimuth and channel. A pixel's light is therefore the
mean of seven maps over its area, times seven terms. With alpha there are eight maps, which processors read at once.
"""

from __future__ import annotations

import functools
import math

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d

from generator.ground.lighting import ROWS, WALLS, SkyLight, transmission, walls_around
from generator.ground.panorama import Layers, column_azimuths
from generator.ground.reflectance import primaries

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]

SURFACES = 7
"""Upright red, green, blue; level red, green, blue; air."""
REFLECTING = 5
"""Numbers of a texel that describe all of them: alpha, whose sign marks level ones, red, green, blue, air."""
AZIMUTHS = 4 * WALLS
"""Number of azimuths of the terms, evenly spaced from north: they include all nodes between which terms are linear."""
CELL_DEG = 1.0
REACH_STEP_DEG = 0.05
CELLS = (round(180 / CELL_DEG), round(360 / CELL_DEG))
"""Rows from the zenith and columns from north of the grid that marks where there is a landscape."""


def surface_maps(layers: Layers, extinction_per_km: float) -> Singles:
    """Alpha and the fraction of each of SURFACES, behind air of a given extinction, (1 + SURFACES, ny, nx) array."""
    maps = np.zeros((1 + SURFACES, *layers.alpha.shape), np.float32)
    maps[0] = layers.alpha
    passed = transmission(layers, extinction_per_km)
    colours = np.moveaxis(layers.reflectance, -1, 0)
    if passed is not None:
        colours = colours * passed
        maps[7] = (1 - passed) * layers.alpha
    level = np.broadcast_to(layers.level, layers.alpha.shape)
    np.copyto(maps[1:4], colours, where=~level)
    np.copyto(maps[4:7], colours, where=level)
    return maps


def surface_terms(lit: Floats, light: SkyLight, response: Floats) -> Singles:
    """Light of each of SURFACES through the camera's response, by channel and azimuth, (channels, AZIMUTHS, SURFACES) array.

    The air in front of objects adds the light of the sky at the horizon in the proportion in which it dims their light
    (Koschmieder 1924; Middleton 1952, "Vision through the atmosphere", chapter 4).

    Parameters
    ----------
    lit : (WALLS + 1, n) array
        Irradiance from :func:`generator.ground.lighting.irradiance`.
    light : SkyLight
    response : (channels, n) array
        Response of each channel at GRID_NM.
    """
    terms = np.zeros((len(response), AZIMUTHS, SURFACES))
    reflected = np.einsum("sn,bn,cn->csb", lit / np.pi, primaries(), response, optimize=True)
    azimuth = np.arange(AZIMUTHS) * 360 / AZIMUTHS
    wall, weight = walls_around(azimuth)
    weight = weight[None, :, None]
    terms[:, :, 0:3] = reflected[:, wall] * (1 - weight) + reflected[:, (wall + 1) % WALLS] * weight
    terms[:, :, 3:6] = reflected[:, -1:]
    lowest = light.maps.reshape(len(light.maps), -1, 2 * ROWS)[:, -1]
    around = (response @ light.spectra.T) @ lowest
    for channel, row in enumerate(around):
        terms[channel, :, 6] = np.interp(azimuth, column_azimuths(2 * ROWS), row, period=360)
    return terms.astype(np.float32)


def covered_cells(alpha: Singles, layers: Layers) -> NDArray[np.bool_]:
    """Cells, CELLS, in which any texel of layers has an alpha (ny, nx) above 0."""
    rows, columns = CELLS
    row = np.clip(((90 - layers.altitude_deg) / CELL_DEG).astype(np.intp), 0, rows - 1)
    column = np.clip((layers.azimuth_deg / CELL_DEG).astype(np.intp), 0, columns - 1)
    by_row = np.zeros((rows, alpha.shape[1]), bool)
    np.logical_or.at(by_row, row, alpha > 0)
    cells = np.zeros((columns, rows), bool)
    np.logical_or.at(cells, column, by_row.T)
    return cells.T


def grown_cells(cells: NDArray[np.bool_], reach_deg: float) -> NDArray[np.bool_]:
    """Cells of a grid of all directions (rows from the zenith) that may be within an angle of one of those given."""
    # Frames of a set have nearly the same reach.
    return _grown(cells.tobytes(), cells.shape, math.ceil(reach_deg / REACH_STEP_DEG) * REACH_STEP_DEG)


@functools.lru_cache(maxsize=4)
def _grown(packed: bytes, shape: tuple[int, int], reach_deg: float) -> NDArray[np.bool_]:
    cells = np.frombuffer(packed, dtype=bool).reshape(shape)
    rows, columns = shape
    half = math.ceil(reach_deg / CELL_DEG) + 1
    tall = maximum_filter1d(cells, 2 * half + 1, axis=0, mode="constant")
    result = np.zeros_like(cells)
    for row in range(rows):
        # The cell farthest from the horizon that is near the row.
        steepest = abs(90 - (row + 0.5) * CELL_DEG) + half * CELL_DEG + reach_deg
        wide = columns if steepest >= 89 else math.ceil(reach_deg / math.cos(math.radians(steepest)) / CELL_DEG) + 1
        if 2 * wide + 1 >= columns:
            result[row] = tall[row].any()
        else:
            result[row] = maximum_filter1d(tall[row], 2 * wide + 1, mode="wrap")
    return result
