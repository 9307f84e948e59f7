"""Scintillation: how much a star's light varies from one exposure to the next."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]

SATURATION_SIGMA = 0.35
"""Largest standard deviation: small apertures near the horizon are outside the validity of the weak-turbulence law, and
measured intensities of stars seen by eye or through a small lens vary by 0.2 to 0.4 (Dravins et al. 1997, PASP 109, 173)."""
SCALE_HEIGHT_M = 8000.0


def scintillation_sigma(aperture_mm: float, airmass: ArrayLike, exposure_s: float, height_m: float) -> Floats:
    """Relative standard deviation of a star's light in one exposure.

    Young's law 0.09 D^(-2/3) X^1.75 exp(-h/h0) (2t)^(-1/2), D in cm, t in s (Young 1967, AJ 72, 747), smoothly limited to
    SATURATION_SIGMA; the law does not hold for apertures below the Fresnel scale of about 7 cm.

    Parameters
    ----------
    aperture_mm : float
    airmass : array_like
    exposure_s : float
    height_m : float
        Height of the site.
    """
    path = np.asarray(airmass, float) ** 1.75
    young = 0.09 * (aperture_mm / 10) ** (-2 / 3) * path * np.exp(-height_m / SCALE_HEIGHT_M) / np.sqrt(2 * exposure_s)
    return young / np.sqrt(1 + (young / SATURATION_SIGMA) ** 2)


def scintillation_factors(sigma: Floats, random: np.random.Generator) -> Floats:
    """Factors on the light of stars, lognormal with mean 1 and relative standard deviation `sigma`, like `sigma`."""
    log_variance = np.log1p(sigma**2)
    return np.exp(np.sqrt(log_variance) * random.standard_normal(sigma.shape) - log_variance / 2)
