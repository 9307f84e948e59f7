"""Peaks in texture: knots and edges of clouds, trees and walls, which the noise of a tile does not tell from its clear sky.

The surroundings of a star are quiet. In texture, which is of all sizes, a ring around a peak scatters by a quarter of the
peak's height and more, and its pixels by more than their noise. Both must be so: the filter leaves hollows around bright
stars, and noise that is correlated scatters more under the filter than white noise.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from celnav.detecting.noise_map import NoiseMap

F4 = NDArray[np.float32]
F8 = NDArray[np.float64]
Mask = NDArray[np.bool_]
Places = NDArray[np.intp]

# The ring begins where a star's light has faded, at this many of its standard deviations and pixels, and is this wide.
_INNER_SIGMA, _INNER_PX, _WIDE_PX = 3.5, 1.5, 9.0
# Distance of the pixels of the ring that are looked at, along rows and columns.
_STEP_PX = 3.0
# Fractions of the pixels that are below the values that count, and these values in a normal distribution. A few stars on the
# ring change neither.
_WITHIN, _NORMAL_WITHIN = 0.8, 1.2816
_BELOW, _NORMAL_BELOW = 0.16, 0.9945
# Scatter over noise from which there is texture; less is faint stars of the Milky Way, or chance.
_TEXTURE = 2.5


def in_texture(filtered: F4, light: F4, noise: NoiseMap, uv: F8, least: F8, sigma_px: float) -> Mask:
    """Return which peaks do not stand out from the texture around them, shape (n,).

    Parameters
    ----------
    filtered : ndarray, shape (height, width)
        The image under the matched filter.
    light : ndarray, shape (height, width)
        The image without its background.
    noise : NoiseMap
        Standard deviation of its pixels.
    uv : ndarray, shape (n, 2)
        Positions of the peaks, inside the image.
    least : ndarray, shape (n,)
        Scatter of the filtered image from which a peak does not stand out.
    sigma_px : float
        Standard deviation of the star image.
    """
    columns, rows = np.rint(uv).astype(np.intp).T
    places = _ring(sigma_px)
    textured = amid_scatter(filtered, uv, least, sigma_px)
    some = np.flatnonzero(textured)
    # Means of opposite places are free of gradients, such as that of glare.
    half = len(places) // 2
    ring = _around(light, rows[some], columns[some], places)
    means = (ring[:, :half] + ring[:, : -half - 1 : -1]) / 2
    means.partition((below := round(_BELOW * half), half // 2), axis=1)
    excess = (means[:, half // 2] - means[:, below]) / _NORMAL_BELOW
    textured[some] = excess > _TEXTURE / np.sqrt(2) * noise.at(rows[some], columns[some])
    return textured


def amid_scatter(filtered: F4, uv: F8, least: F8, sigma_px: float) -> Mask:
    """Return around which peaks the filtered image alone scatters by more than `least`, shape (n,); as `in_texture`."""
    columns, rows = np.rint(uv).astype(np.intp).T
    places = _ring(sigma_px)
    some = np.arange(len(uv))
    for scatter in (_of_both_sides, _of_lower_side):  # the smaller one counts
        some = some[scatter(_around(filtered, rows[some], columns[some], places)) > least[some]]
    amid = np.zeros(len(uv), dtype=bool)
    amid[some] = True
    return amid


def _ring(sigma_px: float) -> Places:
    """Return offsets of columns and rows, shape (n, 2), that a turned or mirrored image has too.

    The k-th last is opposite to the k-th.
    """
    inner = _INNER_SIGMA * sigma_px + _INNER_PX
    outer = inner + _WIDE_PX * max(sigma_px, 1.0)
    step = round(_STEP_PX * max(sigma_px, 1.0))
    line = np.arange(-int(outer / step), int(outer / step) + 1) * step
    square = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
    distance = np.hypot(*square.T)
    return square[(distance >= inner) & (distance <= outer)]


def _around(values: F4, rows: Places, columns: Places, places: Places) -> F4:
    """Return the values of pixels at offsets from others, shape (n, places); beyond the border, of the outermost ones."""
    height, width = values.shape
    return values[
        (rows[:, None] + places[:, 1]).clip(0, height - 1), (columns[:, None] + places[:, 0]).clip(0, width - 1)
    ]


def _of_both_sides(ring: F4) -> F4:
    """Return standard deviations about zero by the absolute values, shape (n,)."""
    within = round(_WITHIN * ring.shape[1])
    return np.asarray(np.partition(np.abs(ring), within, axis=1)[:, within] / np.float32(_NORMAL_WITHIN))


def _of_lower_side(ring: F4) -> F4:
    """Return standard deviations about zero by the values below it, shape (n,)."""
    below = round(_BELOW * ring.shape[1])
    return np.asarray(-np.partition(ring, below, axis=1)[:, below] / np.float32(_NORMAL_BELOW))
