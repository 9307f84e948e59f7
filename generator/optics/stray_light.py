"""Light that a lens sends astray: bloom around every point of light, and ghosts by two reflections inside.

- Bloom: surface roughness and dust scatter a share of the light into wide wings, w(r) = 1 / (1 + (r / core)^slope), the ABg
  form of scatter (Pfisterer 2011, "Approximated scatter models for stray light analysis", Optics & Photonics News 22(10),
  16). Around stars the observed slope is 2 (King 1971, PASP 83, 199: the aureole falls as the inverse square). The wings end
  at `reach_px`.
- Ghosts: to first order light that is reflected twice falls into the image of the pupil, a disk whose middle lies at a fixed
  multiple of the point's own distance from the principal point, negative beyond it (Lee & Eisemann 2013, "Practical real-time
  lens-flare rendering", Computer Graphics Forum 32(4), 1: lens systems as matrices).

A share of the light that reaches the frame is moved, none is made or lost but what leaves the frame. The diffuse sky is left
as it is: what a smooth field loses by scatter it gets back. Light from outside the frame scatters nothing into it.
"""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray

from generator.scenario.camera_spec import BloomSpec, CameraSpec, GhostSpec

Floats = NDArray[np.float64]

FINE = 5
"""Samples per pixel and axis where a disk's edge crosses it."""


def with_stray_light(points: NDArray[np.float32], camera: CameraSpec) -> NDArray[np.float32]:
    """Image of points of light with the camera's bloom and ghosts.

    Parameters
    ----------
    points : (height, width, channels) array
        Electrons from stars, planets, Moon, or flying objects, without the diffuse sky.
    camera : CameraSpec

    Returns
    -------
    (height, width, channels) array
    """
    if camera.direct_share == 1:
        return points
    image = np.empty_like(points)
    for channel in range(points.shape[2]):
        light = points[:, :, channel].astype(np.float64)
        total = camera.direct_share * light
        if camera.bloom is not None:
            total += camera.bloom.share * _convolved(light, bloom_wings(camera.bloom))
        for ghost in camera.ghosts:
            total += ghost.share * _convolved(_mapped(light, ghost, camera), disk(ghost.diameter_px))
        image[:, :, channel] = total
    return image


@functools.lru_cache(maxsize=8)
def bloom_wings(bloom: BloomSpec) -> Floats:
    """Wings of the bloom on whole pixels, (2 reach + 1)^2, with sum 1."""
    axis = np.arange(-bloom.reach_px, bloom.reach_px + 1)
    radius = np.hypot(axis, axis[:, None])
    wings = np.where(radius <= bloom.reach_px, 1 / (1 + (radius / bloom.core_px) ** bloom.slope), 0.0)
    return wings / wings.sum()


@functools.lru_cache(maxsize=8)
def disk(diameter_px: float) -> Floats:
    """An evenly lit disk on whole pixels, with sum 1; pixels on its edge by their area within it."""
    half = int(np.ceil(diameter_px / 2 + 0.5))
    fine = (np.arange((2 * half + 1) * FINE) + 0.5) / FINE - half - 0.5
    inside = (np.hypot(fine, fine[:, None]) <= diameter_px / 2).astype(np.float64)
    shape = inside.reshape(2 * half + 1, FINE, 2 * half + 1, FINE).sum(axis=(1, 3))
    return shape / shape.sum()


def _mapped(light: Floats, ghost: GhostSpec, camera: CameraSpec) -> Floats:
    """The light moved to the ghost's distances from the principal point, shared between the four nearest pixels."""
    height, width = light.shape
    rows, columns = np.nonzero(light)
    projection = camera.projection
    u = projection.cx_px + ghost.magnification * (columns - projection.cx_px)
    v = projection.cy_px + ghost.magnification * (rows - projection.cy_px)
    left, top = np.floor(u).astype(np.intp), np.floor(v).astype(np.intp)
    image = np.zeros(light.size)
    for down in (0, 1):
        for right in (0, 1):
            share = np.abs(1 - right - (u - left)) * np.abs(1 - down - (v - top))
            column, row = left + right, top + down
            inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
            amount = (light[rows, columns] * share)[inside]
            image += np.bincount(row[inside] * width + column[inside], amount, light.size)
    return image.reshape(height, width)


def _convolved(light: Floats, kernel: Floats) -> Floats:
    """Convolution, light that leaves the frame dropped; without the transform's negative rounding errors."""
    # Takes a quarter of a second to import, which frames without stray light need not wait for.
    from scipy.signal import fftconvolve

    return np.maximum(fftconvolve(light, kernel, mode="same"), 0)
