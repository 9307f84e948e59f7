"""Scintillation: how much a star's light varies from one exposure to the next."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]

SATURATION_SIGMA = 0.35
"""Largest standard deviation. Turbulence is not weak near the horizon, nor does an exposure of a few milliseconds average
over it; intensities of stars seen by eye or through a small lens vary by 0.2 to 0.4 (Dravins et al. 1997, PASP 109, 173)."""
SCALE_HEIGHT_M = 8000.0
LAYER_M = 10_000.0
"""Height above the site of the turbulence that makes stars scintillate: the tropopause's."""
WAVELENGTH_M = 550e-9
FRESNEL_SHARE = 0.836
"""Diameter, in Fresnel scales sqrt(wavelength x distance), at which Young's law gives the scintillation of a point-like
aperture. It is the ratio to the power -3/4 of two integrals over spatial frequencies f across the wind: that of f^(-11/3)
sin^2(pi f^2), 4.416, and that of Young's asymptote, pi^2 f^(1/3) (2 J1(pi f) / (pi f))^2, 3.480."""


def scintillation_sigma(aperture_mm: float, airmass: ArrayLike, exposure_s: float, height_m: float) -> Floats:
    """Relative standard deviation of a star's light in one exposure.

    Young's law 0.09 D^(-2/3) X^1.75 exp(-h/h0) (2t)^(-1/2), D in cm, t in s (Young 1967, AJ 72, 747), holds for apertures
    above the Fresnel scale of about 7 cm. Smaller ones average no less, because diffraction blurs the shadows: D is replaced
    by the root of the sum of the squares of D and FRESNEL_SHARE Fresnel scales, at the distance X LAYER_M of the layer. This
    is within 6 % of the integral over the spectrum of one layer (Tatarskii; Dravins et al. 1998, PASP 110, 610; Kornilov
    2011, A&A 530, A56) for every aperture, and exact for small and large ones. The law is that of exposures in which the
    wind carries the shadows across the aperture, from some hundredths of a second on; it is smoothly limited to
    SATURATION_SIGMA, which matters for shorter ones and near the horizon.

    Parameters
    ----------
    aperture_mm : float
    airmass : array_like
    exposure_s : float
    height_m : float
        Height of the site.
    """
    path = np.asarray(airmass, float)
    fresnel_m = np.sqrt(WAVELENGTH_M * LAYER_M * path)
    diameter_cm = 100 * np.hypot(aperture_mm / 1000, FRESNEL_SHARE * fresnel_m)
    young = 0.09 * diameter_cm ** (-2 / 3) * path**1.75 * np.exp(-height_m / SCALE_HEIGHT_M) / np.sqrt(2 * exposure_s)
    return young / np.sqrt(1 + (young / SATURATION_SIGMA) ** 2)


def scintillation_factors(sigma: Floats, random: np.random.Generator) -> Floats:
    """Factors on the light of stars, lognormal with mean 1 and relative standard deviation `sigma`, like `sigma`."""
    log_variance = np.log1p(sigma**2)
    return np.exp(np.sqrt(log_variance) * random.standard_normal(sigma.shape) - log_variance / 2)
