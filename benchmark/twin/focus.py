"""The focus of a night: how wide stars are beside those of the scene's camera, by the light in their brightest pixels."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmark.twin.star_light import star_light
from generator.scenario.camera_spec import CameraSpec

Floats = NDArray[np.float64]

FACTORS = (0.6, 0.8, 1.0, 1.3)
"""Widths that are rendered; between them the share of the brightest pixel is interpolated."""
LEAST_SNR, LEAST_STARS = 10.0, 12
"""Of stars that tell: in fainter ones noise makes the brightest pixel. At an SNR of 12 it moves the median share by 2 % at
most. Brighter ones alone would be few under the Moon."""


def focused_psf(camera: CameraSpec, factor: float) -> dict[str, Any]:
    """Keys of a camera whose Gaussian point spread function is wider by a factor; empty where it is of another kind."""
    if camera.psf is None:
        return {"psf_sigma_px": round(camera.psf_sigma_px * factor, 4)}
    field = camera.psf.field_gaussian
    if field is None:
        return {}
    widths = {
        name: [[place, round(sigma * factor, 4)] for place, sigma in getattr(field, name)]
        for name in ("radial_sigma_px", "tangential_sigma_px")
    }
    return {"psf": {"field_gaussian": widths, "support_px": camera.psf.support_px}}


def fit_focus(
    pixels: NDArray[np.floating], uv: Floats, highest: float, stars_alone: Callable[[float], NDArray[np.floating]]
) -> float | None:
    """Find the factor on the width of stars at which their brightest pixels have the photograph's share of their light.

    Parameters
    ----------
    pixels : (height, width) array
        The photograph, DN.
    uv : (n, 2) array
        Places of stars without neighbours.
    highest : float
        DN from which a pixel is taken for full.
    stars_alone : function
        Of a factor: the stars rendered without sky and noise.

    Returns
    -------
    float or None
        Within `FACTORS`; None with fewer than `LEAST_STARS`.
    """
    real = star_light(pixels, uv, search_px=2.0)
    tells = (real.snr > LEAST_SNR) & (real.peak < highest)
    shares = [star_light(stars_alone(factor), uv, search_px=2.0) for factor in FACTORS]
    for each in shares:
        tells &= each.flux > 0
    if tells.sum() < LEAST_STARS:
        return None
    wanted = np.median(real.nearest_share[tells])
    medians = np.array([np.median(each.nearest_share[tells]) for each in shares])
    # The sharper, the larger the share.
    return float(np.interp(wanted, medians[::-1], FACTORS[::-1]))
