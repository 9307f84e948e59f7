"""Widths of stars: windowed second moments, in a photograph and in its twin alike."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from benchmark.photographed.star_light import StarLight, squares

Floats = NDArray[np.float64]

WINDOW_PX = 1.5
"""Standard deviation of the Gaussian that weights the light. Under it the noise moves the width of a star of an SNR of 10 by
an eighth; under a wider one the noise far from the star would decide."""
HALF_PX = 6
"""Half side of the square that is weighted."""
ROUNDS = 6
"""Rounds of the centroid under the window."""


def star_widths(pixels: NDArray[np.floating], light: StarLight) -> Floats:
    """Measure the standard deviations of stars.

    The light above the sky is weighted with a Gaussian around the star's centroid (as SExtractor's windowed moments are:
    Bertin and Arnouts 1996, A&AS 117, 393). Of a Gaussian star of variance s^2 under a window of variance w^2 the moment is
    s^2 w^2 / (s^2 + w^2), which is solved for s. Of other stars it is the width of the Gaussian with the same moment. The
    area of the pixels is not taken out: it adds 1/12 px^2 to the variance.

    Parameters
    ----------
    pixels : (height, width) array
        DN.
    light : StarLight
        Centroids and skies of n stars, from `star_light`.

    Returns
    -------
    (n,) array
        Mean over the axes of the image, px; NaN where the light has no such width, and for stars without a centroid.
    """
    height, width = pixels.shape
    place = np.rint(np.where(np.isfinite(light.uv), light.uv, -1e6)).astype(np.int64)
    inside = ((place >= HALF_PX) & (place < np.array([width, height]) - HALF_PX)).all(axis=1)
    found = np.full(len(place), np.nan)
    if not inside.any():
        return found
    above = squares(pixels, place[inside], HALF_PX).astype(np.float64) - light.sky[inside, None, None]
    v, u = np.mgrid[-HALF_PX : HALF_PX + 1, -HALF_PX : HALF_PX + 1]
    centre = light.uv[inside] - place[inside]
    with np.errstate(divide="ignore", invalid="ignore"):
        for _ in range(ROUNDS):
            weighted, du, dv = _weighted(above, u, v, centre)
            total = weighted.sum(axis=(1, 2))
            moved = np.column_stack(((weighted * du).sum(axis=(1, 2)), (weighted * dv).sum(axis=(1, 2))))
            # The window pulls the centroid towards itself, by half for a star of its own width.
            centre = centre + np.clip(np.nan_to_num(2.0 * moved / total[:, None]), -0.5, 0.5)
        weighted, du, dv = _weighted(above, u, v, centre)
        moment = (weighted * (du**2 + dv**2)).sum(axis=(1, 2)) / (2.0 * weighted.sum(axis=(1, 2)))
        variance = 1.0 / (1.0 / moment - 1.0 / WINDOW_PX**2)
    found[inside] = np.sqrt(np.where((moment > 0.0) & (variance > 0.0), variance, np.nan))
    return found


def _weighted(
    above: Floats, u: NDArray[np.int64], v: NDArray[np.int64], centre: Floats
) -> tuple[Floats, Floats, Floats]:
    """Light under the window around centres (n, 2), and the offsets from them along u and v; (n, side, side) each."""
    du, dv = u - centre[:, 0, None, None], v - centre[:, 1, None, None]
    return above * np.exp(-(du**2 + dv**2) / (2.0 * WINDOW_PX**2)), du, dv
