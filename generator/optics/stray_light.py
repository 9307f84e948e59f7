"""Light that a lens sends astray: wings around everything that shines, veiling glare, and ghosts.

- Wings: :mod:`generator.optics.wings`.
- Veiling glare: what has lost its direction in the lens and its barrel falls evenly on the sensor. Its measure is that of
  ISO 9358 (Veiling glare of image-forming systems): of an evenly lit hemisphere, the share that reaches the image of a black
  spot. Here that share is of the hemisphere's mean radiance, weighted as the entrance pupil sees it.
- Ghosts: :mod:`generator.optics.ghosts`.

Each takes its share from the image of a point and gives it to all pixels, in the frame or not: light is moved, not made. An
evenly lit field keeps its brightness. Stars, planets, the Moon, lamps, flying objects and the diffuse sky are treated alike,
inside the frame and around it, as far as the wings reach and the lens sees.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from generator.optics.ghosts import ghost_light
from generator.optics.light_cells import RIM, CellGrid, block_mean, cells_outside, enlarged, halved
from generator.optics.wings import COARSE_PX, TRUNCATE, mixture, wide_kernel
from generator.scenario.camera_spec import CameraSpec
from generator.scenario.lens.stray_light_spec import BarrelRingSpec, BloomSpec

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]


@dataclass(frozen=True)
class PointSources:
    """Light of m points.

    Attributes
    ----------
    u_px, v_px : (m,) arrays
        Where it falls, also outside the frame; NaN where the lens does not image it.
    electrons : (m, channels) array
    """

    u_px: Floats
    v_px: Floats
    electrons: Floats


@dataclass(frozen=True)
class Surround:
    """Light that does not fall on the frame itself.

    Attributes
    ----------
    sky : (n, channels) array
        Electrons per pixel from the diffuse sky in the coarse cells of `generator.optics.light_cells.cells_outside`.
    hemisphere : (channels,) array
        Electrons of a pixel on the axis if the lens saw the mean of all light in front of it, points included.
    walls: (azimuths, channels) array; azimuths are 0 for a lens without a barrel's ring
        Electrons of a pixel on the axis if the lens saw a white Lambert wall around itself, by azimuth from +u to +v, even
        steps; that wall lit by all light in front of it.
    """

    sky: Floats
    hemisphere: Floats
    walls: Floats


def cell_grid(camera: CameraSpec, colour: bool) -> CellGrid:
    """Cells for a camera's stray light; those of a colour sensor are at least as large as its filter pattern."""
    finest = min((part.cell_px for bloom in camera.wings for part in mixture(bloom)), default=COARSE_PX)
    margin = max([RIM + 1, *(math.ceil(bloom.reach_px / COARSE_PX) for bloom in camera.wings)])
    return CellGrid(camera.width, camera.height, max(finest, 2 if colour else 1), margin)


def stray_light(
    frame: Singles, points: Sequence[PointSources], surround: Surround, grid: CellGrid, camera: CameraSpec
) -> Singles:
    """Electrons that reach each pixel astray.

    Parameters
    ----------
    frame : (height, width, channels) array
        Electrons in the frame, as a lens without stray light images them, without those of `points`.
    points : sequence of PointSources
        Further light: that of ghosts of points, and what lies outside the frame.
    surround : Surround
    grid : CellGrid
        Of :func:`cell_grid`.
    camera : CameraSpec

    Returns
    -------
    (height, width, channels) array
    """
    planes = []
    index, _, _ = cells_outside(grid)
    for channel in range(frame.shape[2]):
        around = np.zeros(grid.shape)
        around.ravel()[index] = surround.sky[:, channel]
        fine = grid.fine_from(np.ascontiguousarray(frame[:, :, channel]), around)
        for source in points:
            grid.add_points(fine, around, source.u_px, source.v_px, source.electrons[:, channel])
        even = np.float32(camera.veiling_glare * surround.hemisphere[channel])
        light = np.full_like(fine, even)
        for bloom in camera.wings:
            wide = wing_light(fine, around, grid, bloom)
            wide *= np.float32(bloom.share)
            light += wide
        planes.append(grid.on_pixels(light))
        if camera.barrel_ring is not None:
            planes[-1] += ring_light(camera.barrel_ring, surround.walls[:, channel], camera)
    return planes[0][:, :, None] if len(planes) == 1 else np.stack(planes, axis=2)


def ghosts(
    sky: Singles, points: Sequence[PointSources], surround: Surround, grid: CellGrid, camera: CameraSpec
) -> Singles:
    """Electrons of a camera's ghosts in each pixel; of a sky as that of :func:`stray_light`, and of all points."""
    result = np.zeros_like(sky)
    index, _, _ = cells_outside(grid)
    for channel in range(sky.shape[2]):
        around = np.zeros(grid.shape)
        around.ravel()[index] = surround.sky[:, channel]
        smooth = coarse_cells(grid.fine_from(np.ascontiguousarray(sky[:, :, channel]), around), around, grid)
        lights = [(source.u_px, source.v_px, source.electrons[:, channel]) for source in points]
        for ghost in camera.all_ghosts:
            result[:, :, channel] += ghost_light(ghost, smooth, lights, grid, camera)
    return result


def ring_light(ring: BarrelRingSpec, walls: Floats, camera: CameraSpec) -> Singles:
    """Electrons from the barrel's wall, (height, width) array: a Gaussian profile across the ring, by azimuth along it."""
    middle = camera.projection
    du = np.arange(camera.width) - middle.cx_px
    dv = np.arange(camera.height)[:, None] - middle.cy_px
    across = (np.hypot(du, dv) - ring.radius_px) / ring.width_px
    azimuth = np.arctan2(dv, du) / (2 * math.pi) * len(walls)
    along = np.interp(azimuth, np.arange(len(walls)), walls, period=len(walls))
    return (ring.reflectance * along * np.exp(-0.5 * across**2)).astype(np.float32)


def coarse_cells(fine: Singles, around: Floats, grid: CellGrid) -> Floats:
    """Light on all coarse cells, of that on the fine cells and beyond them."""
    whole = around.copy()
    rows, columns = grid.inner
    skip = grid.margin - RIM
    inner = block_mean(fine, COARSE_PX // grid.fine_px)
    whole[skip : skip + rows + 2 * RIM, skip : skip + columns + 2 * RIM] = inner
    return whole


@functools.lru_cache(maxsize=4)
def _kernel_spectrum(bloom: BloomSpec, margin: int, fine_px: int, size: tuple[int, ...]) -> NDArray[np.complex128]:
    """Transform of the kernel on coarse cells."""
    from scipy import fft

    return np.asarray(fft.rfft2(wide_kernel(bloom, margin, fine_px), size))


def wing_light(fine: Singles, around: Floats, grid: CellGrid, bloom: BloomSpec) -> Singles:
    """The wings of light on cells, as light on the fine cells."""
    # Take a while to import, which frames without stray light need not wait for.
    from scipy import fft, ndimage

    levels = []
    cells, side = fine, grid.fine_px
    while side < COARSE_PX:
        light = np.float32(0) * cells
        for part in mixture(bloom):
            if max(part.cell_px, grid.fine_px) == side:
                sigma = math.sqrt(part.left_px2(grid.fine_px)) / side
                blurred = ndimage.gaussian_filter(cells, sigma, mode="constant", truncate=TRUNCATE)
                blurred *= np.float32(part.share)
                light += blurred
        levels.append(light)
        cells, side = halved(cells), 2 * side
    whole = coarse_cells(cells, around, CellGrid(grid.width, grid.height, COARSE_PX, grid.margin))
    size = tuple(fft.next_fast_len(length + RIM, real=True) for length in whole.shape)
    spread = fft.irfft2(fft.rfft2(whole, size) * _kernel_spectrum(bloom, grid.margin, grid.fine_px, size), size)
    # The kernel's middle is at its index `margin`; what wraps around stays within the margin.
    rows, columns = grid.inner
    first = 2 * grid.margin - RIM
    wide = spread[first : first + rows + 2 * RIM, first : first + columns + 2 * RIM].astype(np.float32)
    for light in reversed(levels):
        wide = enlarged(np.pad(wide, 1, mode="edge"), 2)
        wide += light
    return np.maximum(wide, 0, out=wide)
