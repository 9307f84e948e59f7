"""Components of the scatter of single stars: a floor, the stated centroid error, and the air, which grows with the airmass.

The variance along an axis is ``floor + claimed x own^2 + air x X``, with X the airmass. Image motion in turbulent air has a
variance proportional to the airmass (Roddier 1981, Progress in Optics 19, 281; Martin 1987, PASP 99, 1360), and stars that a
long path through the air blurs and dims are also measured less well. The components are estimated by maximum likelihood
from the residuals of the frame itself; where the simpler law explains them as well, it is kept.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from celnav.detecting.star_shape import median

F8 = NDArray[np.float64]

MOST_AIRMASS = 15.0
"""Airmass also for stars below 3 deg of altitude, because no measurement reaches lower."""
FEWEST_STARS = 30
# Twice the gain in log-likelihood that two additional parameters reach by chance in one frame of a hundred.
LEAST_GAIN = 9.21
_ROUNDS = 60
# If no component's score reaches this many standard deviations, the gain in log-likelihood does not reach `LEAST_GAIN`.
_LEAST_SCORE = 2.0


def airmass(sine_altitude: F8) -> F8:
    """Return the airmass for the sine of the apparent altitude, shape (n,), at most `MOST_AIRMASS`.

    Source: Kasten & Young 1989, Applied Optics 28, 4735.
    """
    altitude_deg = np.degrees(np.arcsin(np.clip(sine_altitude, 0.0, 1.0)))
    mass = 1 / (np.clip(sine_altitude, 0.0, 1.0) + 0.50572 * (altitude_deg + 6.07995) ** -1.6364)
    return np.asarray(np.minimum(mass, MOST_AIRMASS))


def relative_sigmas(half_square: F8, weight: F8, rows: NDArray[np.intp], own: F8, mass: F8 | None) -> F8 | None:
    """Estimate standard deviations of detections up to a common factor.

    Parameters
    ----------
    half_square : ndarray, shape (m,)
        Half the squared residual of each identified star, px^2.
    weight : ndarray, shape (m,)
        Probability that the identification is right.
    rows : ndarray, shape (m,)
        Indices of their detections.
    own : ndarray, shape (n,)
        Stated standard deviations of the detections, up to a common factor.
    mass : ndarray, shape (n,), or None
        Airmass of the detections; None if no vertical is known.

    Returns
    -------
    ndarray, shape (n,), or None
        Standard deviations; None if `own` explains the residuals as well.

    Notes
    -----
    The components are variances, so they must not become negative. The multiplicative rule of Févotte & Idier 2011, Neural
    Computation 23(9) 2421, for the likelihood of exponentially distributed squares, keeps them non-negative and raises the
    likelihood in every round.
    """
    if float(weight.sum()) < FEWEST_STARS:
        return None
    scale = median(own[rows])
    parts = [(own / scale) ** 2, np.ones(len(own))]
    if mass is not None:
        parts.append(mass)
    design = np.stack(parts)
    named = design[:, rows]
    total = float(weight.sum())
    claimed = float(np.sum(weight * half_square / named[0])) / total
    if not claimed > 0:
        return None
    if not _may_gain(half_square / (claimed * named[0]), weight, named[1:] / named[0]):
        return None
    simple = -2 * float(np.sum(weight * np.log(named[0]))) - 2 * total * (1 + math.log(claimed))
    components = np.full(len(parts), claimed / len(parts))
    variance = components @ named
    for _ in range(_ROUNDS):
        rise = named @ (weight * half_square / variance**2)
        fall = named @ (weight / variance)
        components = components * np.sqrt(rise / fall)
        variance = components @ named
    full = -2 * float(np.sum(weight * (np.log(variance) + half_square / variance)))
    if full - simple < LEAST_GAIN:
        return None
    return np.asarray(np.sqrt(components @ design))


def _may_gain(excess: F8, weight: F8, ratios: F8) -> bool:
    """Return whether the normalised squares grow with any component, given by its ratios to the stated variance.

    The squared length of two normally distributed numbers, divided by its expectation, has a variance of 1.
    """
    total = float(weight.sum())
    for ratio in ratios:
        apart = ratio - float(weight @ ratio) / total
        spread = float(weight @ apart**2)
        if spread > 0 and abs(float(weight @ (apart * (excess - 1)))) > _LEAST_SCORE * spread**0.5:
            return True
    return False
