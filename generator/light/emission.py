"""Upward light of a city: three patterns by zenith angle, and their mixture."""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]

GARSTANG_NORMALISATION = 0.554
GARSTANG_HORIZON_SHARE = 0.15 / (0.15 + 0.15 * (1 - 0.15))
"""Fraction of the upward light that leaves in Garstang's pattern near the horizon: F / (F + G (1 - F)) for his F = G = 0.15.
Source: Garstang 1986, PASP 98, 364."""
WORLD_ATLAS_HORIZON_SHARE = 5.2e-4 / (1.9e-3 + 5.2e-4)
"""Fraction of the upward light in Garstang's pattern that fits 20,865 zenith brightnesses of the world atlas, without its 3 %
between the two patterns. Source: Falchi et al. 2016, Science Advances 2, e1600377."""

PATTERNS = ("lambert", "horizon", "built_up")
"""Patterns, in the order of all arrays: Lambert's law, Garstang's psi^4, and a built-up area's."""

DIRECT_SHARE = 0.083
"""Fraction of the lamps' light that leaves the luminaires upwards. Source: inventory of all outdoor lighting of Flagstaff,
Luginbuhl et al. 2009, PASP 121, 185."""
REFLECTED_SHARE = 0.15
"""Fraction of the rest that the ground reflects (Garstang 1986)."""
FRONTAL_AREA_INDEX = 0.4
"""Area of walls and trees, seen from the side, per area of ground. Obstacles at random places transmit exp(-index tan psi) of
the light at a zenith angle psi. With this value 10.3 % of Flagstaff's light leaves (17.9 of 173 Mlm), as found there with
blocking; without obstacles 22 % would leave (Luginbuhl et al. 2009, PASP 121, 185 and 204)."""


def built_up(psi: ArrayLike) -> Floats:
    """Intensity of a built-up area at zenith angles below 90 deg (rad), sr^-1 per light output of its lamps.

    It is Garstang's direct and reflected light, dimmed by the surrounding obstacles.
    """
    angle = np.asarray(psi, float)
    direct = DIRECT_SHARE * GARSTANG_NORMALISATION * angle**4
    reflected = 2 * REFLECTED_SHARE * (1 - DIRECT_SHARE) * np.cos(angle)
    clear = np.exp(-FRONTAL_AREA_INDEX * np.tan(np.minimum(angle, np.pi / 2 - 1e-9)))
    return (direct + reflected) / (2 * np.pi) * clear


@functools.cache
def built_up_output() -> float:
    """Fraction of the light of a built-up area's lamps that leaves it upwards, by Gauss-Legendre quadrature."""
    node, weight = np.polynomial.legendre.leggauss(200)
    psi = (node + 1) * np.pi / 4
    return float(np.sum(weight * built_up(psi) * np.sin(psi)) * np.pi / 4 * 2 * np.pi)


def lamp_patterns(cosine: ArrayLike) -> Floats:
    """Intensity per unit output above the horizon in each of PATTERNS, sr^-1, by the cosine of psi, (3, ...) array."""
    up = np.clip(cosine, 0, 1)
    angle = np.arccos(up)
    horizon = GARSTANG_NORMALISATION * angle**4 / (2 * np.pi)
    return np.where(np.asarray(cosine) > 0, np.stack([up / np.pi, horizon, built_up(angle) / built_up_output()]), 0.0)


@functools.cache
def built_up_direct() -> float:
    """Fraction of a built-up area's upward light that its lamps emit upwards directly, by Gauss-Legendre quadrature."""
    node, weight = np.polynomial.legendre.leggauss(200)
    psi = (node + 1) * np.pi / 4
    lost = np.exp(-FRONTAL_AREA_INDEX * np.tan(psi)) * np.sin(psi) * weight * np.pi / 4
    return DIRECT_SHARE * GARSTANG_NORMALISATION * float(np.sum(psi**4 * lost)) / built_up_output()


def output_over_ground(horizon_share: float | None, albedo: Floats) -> Floats:
    """Upward light of a city on ground of a given albedo, relative to that on ground with REFLECTED_SHARE.

    Light that lamps emit upwards directly is constant, and light that the ground reflects is proportional to its albedo.
    Garstang's near-horizontal light is the former, Lambertian light the latter; a built-up area has a fraction of each.
    Its pattern is kept.
    """
    direct = built_up_direct() if horizon_share is None else horizon_share
    return direct + (1 - direct) * np.asarray(albedo, float) / REFLECTED_SHARE


def pattern_weights(horizon_share: float | None) -> Floats:
    """Fractions of a city's upward light in each of PATTERNS, (3,) array.

    Parameters
    ----------
    horizon_share : float or None
        Fraction near the horizon, the rest by Lambert's law; None means that all leaves as from a built-up area.
    """
    if horizon_share is None:
        return np.array([0.0, 0.0, 1.0])
    return np.array([1 - horizon_share, horizon_share, 0.0])
