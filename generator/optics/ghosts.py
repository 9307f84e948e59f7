"""Ghosts: light that is reflected twice in a lens forms an image of its pupil.

To first order that image is a disk whose centre is at a fixed multiple of the point's own distance from the principal
point, negative beyond it (Lee & Eisemann 2013, "Practical real-time lens-flare rendering", Computer Graphics Forum 32(4),
1: lens systems as matrices).
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from generator.optics.cell_kernels import Cells, on_pixels
from generator.optics.light_cells import CellGrid
from generator.optics.wings import COARSE_PX
from generator.scenario.camera_spec import CameraSpec
from generator.scenario.lens.stray_light_spec import GhostSpec

Floats = NDArray[np.float64]

FINE = 5
"""Samples per cell and axis where a disk's edge crosses it."""
CELLS_ACROSS = 20
"""Least number of cells across a ghost's disk, if cells are larger than pixels."""
LEAST_EXPANSION = 0.5
"""Magnification from which the sky's ghost is looked up per cell; for smaller ones the sky's cells are gathered."""


def ghost_light(
    ghost: GhostSpec, sky: Floats, points: Sequence[tuple[Floats, Floats, Floats]], grid: CellGrid, camera: CameraSpec
) -> Any:
    """Electrons that a ghost contributes to each pixel, a Float (height x width,).

    Parameters
    ----------
    ghost : GhostSpec
    sky : array of the grid's `shape`
        Electrons per pixel of the diffuse sky in all coarse cells.
    points : sequence of (u, v, electrons)
        Points of light, px; (m,) arrays.
    grid : CellGrid
    camera : CameraSpec
    """
    # This import takes a quarter of a second, which frames without ghosts need not wait for.
    from scipy.signal import fftconvolve

    side = 2 ** max(0, min(3, math.floor(math.log2(ghost.diameter_px / CELLS_ACROSS))))
    rim = math.ceil(ghost.diameter_px / 2 / side) + 2
    shape = math.ceil(camera.height / side) + 2 * rim, math.ceil(camera.width / side) + 2 * rim
    light = _sky_ghost(ghost, sky, grid, camera, shape, rim, side)
    for u, v, electrons in points:
        light += _gathered(*_moved(u, v, ghost, camera), electrons / side**2, shape, rim, side)
    spread = np.maximum(fftconvolve(light, disk(ghost.diameter_px / side), mode="same"), 0)
    return on_pixels(Cells.of(ghost.share * spread), side, rim, (camera.height, camera.width))


@functools.lru_cache(maxsize=16)
def disk(diameter: float) -> Floats:
    """Return a uniform disk on whole cells, with sum 1; cells on its edge are weighted by their area within it."""
    half = int(np.ceil(diameter / 2 + 0.5))
    fine = (np.arange((2 * half + 1) * FINE) + 0.5) / FINE - half - 0.5
    inside = (np.hypot(fine, fine[:, None]) <= diameter / 2).astype(np.float64)
    shape = inside.reshape(2 * half + 1, FINE, 2 * half + 1, FINE).sum(axis=(1, 3))
    return np.asarray(shape / shape.sum())


def _moved(u: Floats, v: Floats, ghost: GhostSpec, camera: CameraSpec) -> tuple[Floats, Floats]:
    """Centres of the ghosts of points, px."""
    middle = camera.projection
    return (
        middle.cx_px + ghost.magnification * (u - middle.cx_px),
        middle.cy_px + ghost.magnification * (v - middle.cy_px),
    )


def _gathered(u: Floats, v: Floats, light: Floats, shape: tuple[int, int], rim: int, side: int) -> Floats:
    """Distribute points of light over the four nearest cells."""
    with np.errstate(invalid="ignore"):
        column, row = ((place + 0.5) / side - 0.5 + rim for place in (u, v))
        inside = (column >= 0) & (row >= 0) & (column < shape[1] - 1) & (row < shape[0] - 1)
    column, row, light = column[inside], row[inside], light[inside]
    left, top = np.floor(column).astype(np.intp), np.floor(row).astype(np.intp)
    cells = np.zeros(shape[0] * shape[1])
    for down in (0, 1):
        for right in (0, 1):
            share = np.abs(1 - right - (column - left)) * np.abs(1 - down - (row - top))
            cells += np.bincount((top + down) * shape[1] + left + right, light * share, len(cells))
    return cells.reshape(shape)


def _sky_ghost(
    ghost: GhostSpec, sky: Floats, grid: CellGrid, camera: CameraSpec, shape: tuple[int, int], rim: int, side: int
) -> Floats:
    """The ghost of the diffuse sky before it is spread over the disk, electrons per pixel on cells."""
    from scipy import ndimage

    if abs(ghost.magnification) < LEAST_EXPANSION:
        row, column = np.divmod(np.arange(sky.size), sky.shape[1])
        u, v = ((place - grid.margin + 0.5) * COARSE_PX - 0.5 for place in (column, row))
        light = sky.ravel() * (COARSE_PX / side) ** 2
        return _gathered(*_moved(u, v, ghost, camera), light, shape, rim, side)
    v, u = np.mgrid[0 : shape[0], 0 : shape[1]]
    u, v = ((place - rim + 0.5) * side - 0.5 for place in (u, v))
    middle, scale = camera.projection, ghost.magnification
    u, v = middle.cx_px + (u - middle.cx_px) / scale, middle.cy_px + (v - middle.cy_px) / scale
    places = [(place + 0.5) / COARSE_PX - 0.5 + grid.margin for place in (v, u)]
    return np.asarray(ndimage.map_coordinates(sky, places, order=1, mode="constant") / scale**2)
