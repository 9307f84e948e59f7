"""Scintillation: how much a star's light varies from one exposure to the next."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]

SATURATION_SIGMA = 0.35
"""Largest standard deviation: short exposures near the horizon leave the weak-turbulence law behind, and measured
intensities of stars seen by eye or small lens vary by 0.2 to 0.4 (Dravins et al. 1997, PASP 109, 173)."""
SCALE_HEIGHT_M = 8000.0
SITE_FACTOR = 1.5
"""Median of measured C_Y at observatories. Source: Osborn et al. 2015, MNRAS 452, 1707, table 1."""
TURBULENCE_M, LEAST_DISTANCE_M = 10_000.0, 2_000.0
"""Height of the turbulence that makes scintillation (the tropopause's), and its least distance from a camera in the air."""
WAVELENGTH_M = 550e-9
SMALL_PUPIL_FACTOR = 1.267
"""Ratio of the two limits of the integral of :func:`pupil_factor` at D = sqrt(wavelength x distance)."""


def pupil_factor(pupil_over_fresnel: ArrayLike) -> Floats:
    """Variance of a long exposure over that of the law for wide pupils, by diameter over sqrt(wavelength x distance).

    The variance of a long exposure is the integral, over the spatial frequencies f across the wind, of f^(-11/3)
    sin^2(pi l z f^2) times the pupil's filter (2 J1(pi D f) / (pi D f))^2 (Roddier 1981, Progress in Optics 19, 281,
    sections 8.2 and 8.4; Kornilov 2012, MNRAS 426, 647). A pupil wider than the Fresnel scale averages it as D^(-4/3); for
    one far below it does not depend on D, and is 1.267 (D / sqrt(l z))^(4/3) of what that law gives. In between the two are
    joined within 4 % of the integral.
    """
    small = SMALL_PUPIL_FACTOR * np.asarray(pupil_over_fresnel, float) ** (4 / 3)
    return small / np.sqrt(1 + small * small)


def scintillation_sigma(aperture_mm: float, airmass: ArrayLike, exposure_s: float, height_m: float) -> Floats:
    """Relative standard deviation of a star's light in one exposure.

    For wide pupils the variance is 1e-5 C_Y^2 D^(-4/3) X^3 exp(-2h/h0) / t, D in m, t in s (Young 1967, AJ 72, 747, with the
    constant and the airmass' exponent of Osborn et al. 2015, MNRAS 452, 1707, eq. 7), for pupils below the Fresnel scale of
    some 7 cm less by :func:`pupil_factor`, so that it grows there as X^(7/3); brought smoothly to SATURATION_SIGMA where it
    exceeds it.

    Parameters
    ----------
    aperture_mm : float
    airmass : array_like
    exposure_s : float
    height_m : float
        Of the site.
    """
    path = np.asarray(airmass, float)
    diameter_m = aperture_mm / 1000
    variance = 1e-5 * SITE_FACTOR**2 * diameter_m ** (-4 / 3) * path**3 / exposure_s
    variance = variance * np.exp(-2 * height_m / SCALE_HEIGHT_M)
    distance_m = max(TURBULENCE_M - height_m, LEAST_DISTANCE_M) * path
    long = np.sqrt(variance * pupil_factor(diameter_m / np.sqrt(WAVELENGTH_M * distance_m)))
    return long / np.sqrt(1 + (long / SATURATION_SIGMA) ** 2)


def scintillation_factors(sigma: Floats, random: np.random.Generator) -> Floats:
    """Factors on the light of stars, lognormal with mean 1 and relative standard deviation `sigma`, like `sigma`."""
    log_variance = np.log1p(sigma**2)
    return np.exp(np.sqrt(log_variance) * random.standard_normal(sigma.shape) - log_variance / 2)
