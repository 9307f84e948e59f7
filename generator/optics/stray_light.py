"""Stray light of a lens: wings around all sources, veiling glare, haze, and ghosts.

- Wings: :mod:`generator.optics.wings`.
- Veiling glare: light that has lost its direction in the lens and its barrel falls evenly on the sensor. Its measure is
  that of ISO 9358 (Veiling glare of image-forming systems): for an evenly lit hemisphere, the fraction that reaches the
  image of a black spot. Here it is a fraction of the hemisphere's mean radiance, weighted as the entrance pupil sees it.
- Haze: light that a scratched dome or window scatters widely reaches the lens from everywhere, like a uniform field. Its
  measure is the field's radiance over the hemisphere's mean. It falls within the image circle, with the lens' vignetting
  (:mod:`generator.frame.scattered_light`).
- Ghosts: :mod:`generator.optics.ghosts`.

Each takes its fraction from the image of a point and distributes it over all pixels, inside or outside the frame: light
is moved, not created. A uniform field keeps its brightness. Stars, planets, the Moon, lamps, flying objects and the
diffuse sky are treated alike, inside the frame and around it, as far as the wings reach and the lens sees.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from generator import mitsuba_runtime
from generator.device_arrays import aligned
from generator.optics.cell_kernels import Cells, PixelSums
from generator.optics.ghosts import ghost_light
from generator.optics.light_cells import RIM, CellGrid, block_mean, cells_outside
from generator.optics.wings import COARSE_PX, mixture, wide_kernel
from generator.scenario.camera_spec import CameraSpec
from generator.scenario.lens.stray_light_spec import BarrelRingSpec, BloomSpec

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Pattern = tuple[tuple[int, int], tuple[int, int]]
"""Channels of the first 2 x 2 pixels, by row and column."""


@dataclass(frozen=True)
class PointSources:
    """Light of m points.

    Attributes
    ----------
    u_px, v_px : (m,) arrays
        Places of the points, also outside the frame; NaN if the lens does not image them.
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
        Electrons of a pixel on the axis that receives the mean of all light in front of the lens, points included.
    walls: (3, azimuths, channels) array; azimuths are 0 for a lens without a barrel's ring
        Electrons of a pixel on the axis that receives the light of a white Lambertian wall around the lens, by azimuth
        from +u to +v in equal steps: the wall lit by all light in front of it, from the opposite side; then the lobes of
        light from its own and from the opposite side.
    """

    sky: Floats
    hemisphere: Floats
    walls: Floats


def cell_grid(camera: CameraSpec, colour: bool) -> CellGrid:
    """Cells for a camera's stray light; those of a colour sensor are at least as large as its filter pattern."""
    finest = min((part.cell_px for bloom in camera.wings for part in mixture(bloom)), default=COARSE_PX)
    margin = max([RIM + 1, *(math.ceil(bloom.reach_px / COARSE_PX) for bloom in camera.wings)])
    return CellGrid(camera.width, camera.height, max(finest, 2 if colour else 1), margin)


def pixel_sums(grid: CellGrid, planes: int, pattern: Pattern | None) -> list[PixelSums]:
    """Sums of pixels that form the fine cells of each channel.

    Parameters
    ----------
    grid : CellGrid
    planes : int
        Number of values of a pixel: one per channel; or a single one, of the channel that the pixel records.
    pattern : Pattern or None
        Channels that pixels record, if only these values count; None if all do.
    """
    side = grid.fine_px
    places = [(row, column) for row in range(side) for column in range(side)]
    channels = planes if pattern is None else 1 + max(max(row) for row in pattern)
    found = []
    for channel in range(channels):
        here = [place for place in places if pattern is None or pattern[place[0] % 2][place[1] % 2] == channel]
        plane = channel if planes > 1 else 0
        parts = tuple((row, column, plane, 1 / len(here)) for row, column in here)
        found.append(PixelSums(side, planes, parts, mirrored=pattern is not None))
    return found


def stray_light(
    frame: Any,
    points: Sequence[PointSources],
    surround: Surround,
    grid: CellGrid,
    camera: CameraSpec,
    pattern: Pattern | None = None,
) -> list[Any]:
    """Electrons of stray light in each pixel.

    Parameters
    ----------
    frame : TensorXf
        (height, width, planes): electrons in the frame as imaged by a lens without stray light, without those of `points`.
    points : sequence of PointSources
        Further light: points for the ghosts, and light outside the frame.
    surround : Surround
    grid : CellGrid
        Grid from :func:`cell_grid`.
    camera : CameraSpec
    pattern : Pattern, optional
        For a colour sensor, the channel of each pixel, of which only the light counts; see :func:`pixel_sums`.

    Returns
    -------
    list of Float
        Stray light of each channel, (height x width,).
    """
    mi = mitsuba_runtime.start()
    import drjit as dr

    placed = [(one, grid.place(one.u_px, one.v_px)) for one in points] if camera.wings else []
    planes = []
    for channel, sums in enumerate(pixel_sums(grid, frame.shape[2], pattern)):
        even = camera.veiling_glare * float(surround.hemisphere[channel])
        light = dr.opaque(mi.Float, even)
        if camera.wings:
            around = _around(surround, grid, channel)
            shares = [grid.points_from(around, places, one.electrons[:, channel]) for one, places in placed]
            near = [share for share in shares if share is not None]
            fine = grid.fine_from(frame.array, sums, around, functools.reduce(np.add, near) if near else None)
            for bloom in camera.wings:
                wide = wing_light(fine, around, grid, bloom)
                light = light + dr.opaque(mi.Float, bloom.share) * dr.maximum(wide.values, 0)
            dr.eval(light)
            light = grid.on_pixels(Cells(light, *grid.fine_shape))
        else:
            light = light + dr.zeros(mi.Float, camera.height * camera.width)
        for ring in camera.rings:
            lit = ring_light(ring, surround.walls[:, :, channel], float(surround.hemisphere[channel]), camera)
            light = light + mi.Float(aligned(lit.ravel()))
        planes.append(light)
    return planes


def ghosts(
    sky: Any,
    points: Sequence[PointSources],
    surround: Surround,
    grid: CellGrid,
    camera: CameraSpec,
    pattern: Pattern | None = None,
) -> list[Any]:
    """Electrons of a camera's ghosts in each pixel, from a sky like that of :func:`stray_light` and from all points."""
    planes = []
    for channel, sums in enumerate(pixel_sums(grid, sky.shape[2], pattern)):
        around = _around(surround, grid, channel)
        smooth = coarse_cells(grid.fine_from(sky.array, sums, around).array(), around, grid)
        lights = [(source.u_px, source.v_px, source.electrons[:, channel]) for source in points]
        planes.append(sum(ghost_light(ghost, smooth, lights, grid, camera) for ghost in camera.all_ghosts))
    return planes


def _around(surround: Surround, grid: CellGrid, channel: int) -> Floats:
    """Light of the sky around the frame on coarse cells."""
    index, _, _ = cells_outside(grid)
    around = np.zeros(grid.shape)
    around.ravel()[index] = surround.sky[:, channel]
    return around


def ring_light(ring: BarrelRingSpec, walls: Floats, hemisphere: float, camera: CameraSpec) -> Singles:
    """Electrons from the barrel's wall, (height, width) array: a Gaussian profile across the ring, by azimuth along it.

    `walls` and `hemisphere` are those of a :class:`Surround`, for one channel.
    """
    middle = camera.projection
    du = np.arange(camera.width) - middle.cx_px
    dv = np.arange(camera.height)[:, None] - middle.cy_px
    across = (np.hypot(du, dv) - ring.radius_px) / ring.width_px
    steps = walls.shape[1]
    azimuth = np.arctan2(dv, du) / (2 * math.pi) * steps
    lit = np.array([ring.reflectance, ring.near_side, ring.far_side]) @ walls + ring.even * hemisphere
    along = np.interp(azimuth, np.arange(steps), lit, period=steps)
    return (along * np.exp(-0.5 * across**2)).astype(np.float32)


def coarse_cells(fine: Singles, around: Floats, grid: CellGrid) -> Floats:
    """Return light on all coarse cells from that on the fine cells and beyond them."""
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


def wing_light(fine: Cells, around: Floats, grid: CellGrid, bloom: BloomSpec) -> Cells:
    """Return the wings of light on cells, as light on the fine cells; rounding may make it slightly negative."""
    # This import takes a while, which frames without stray light need not wait for.
    from scipy import fft

    levels = []
    cells, side = fine, grid.fine_px
    while side < COARSE_PX:
        here = [part for part in mixture(bloom) if max(part.cell_px, grid.fine_px) == side]
        blurred = [cells.blurred(math.sqrt(part.left_px2(grid.fine_px)) / side, part.share) for part in here]
        levels.append(Cells(sum(part.values for part in blurred), cells.rows, cells.columns))
        cells, side = cells.halved(), 2 * side
    whole = coarse_cells(cells.array(), around, CellGrid(grid.width, grid.height, COARSE_PX, grid.margin))
    size = tuple(fft.next_fast_len(length + RIM, real=True) for length in whole.shape)
    spread = fft.irfft2(fft.rfft2(whole, size) * _kernel_spectrum(bloom, grid.margin, grid.fine_px, size), size)
    # The kernel's centre is at its index `margin`; light that wraps around stays within the margin.
    rows, columns = grid.inner
    first = 2 * grid.margin - RIM
    wide = Cells.of(spread[first : first + rows + 2 * RIM, first : first + columns + 2 * RIM])
    for light in reversed(levels):
        wide = light.plus_enlarged(wide)
    return wide
