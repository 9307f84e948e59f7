"""Focus of a night: the width of stars relative to the scene's camera, from the light in their brightest pixels."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmark.photographed.star_light import star_light
from generator.scenario.camera_spec import CameraSpec

Floats = NDArray[np.float64]

FACTORS = (0.6, 0.8, 1.0, 1.3)
"""Widths that are rendered; the fraction in the brightest pixel is interpolated between them."""
LEAST_SNR, LEAST_STARS = 10.0, 12
"""Limits for the stars that are used: in fainter ones the brightest pixel is determined by noise. At an SNR of 12 the noise
moves the median fraction by 2 % at most. With brighter stars alone there would be too few under the Moon."""


def focused_psf(camera: CameraSpec, factor: float) -> dict[str, Any]:
    """Keys of a camera with a Gaussian point spread function widened by a factor; empty where it is of another kind."""
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
    """Find the factor on the width of stars with which their brightest pixels have the same light fraction as the photograph.

    Parameters
    ----------
    pixels : (height, width) array
        The photograph, DN.
    uv : (n, 2) array
        Positions of stars without neighbours.
    highest : float
        DN from which a pixel counts as saturated.
    stars_alone : function
        Maps a factor to the stars rendered without sky and noise.

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
    # The sharper the stars, the larger the fraction.
    return float(np.interp(wanted, medians[::-1], FACTORS[::-1]))
