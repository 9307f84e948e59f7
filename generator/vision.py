"""What the naked eye can see: the faintest star against a sky."""

from __future__ import annotations

import math

TYPICAL_FIELD_FACTOR = 2.0
"""Crumey's F, which gathers the observer's acuity and experience: 1.4 to 2.4."""


def naked_eye_limit(mag_arcsec2: float, field_factor: float = TYPICAL_FIELD_FACTOR) -> float:
    """Faintest star seen by the naked eye on a sky of given brightness, V.

    Source: Crumey 2014, MNRAS 442, 2600: the threshold for a point on a background of 10^-5 to 3 x 10^4 cd/m^2.

    Parameters
    ----------
    mag_arcsec2 : float
        V mag/arcsec^2.
    field_factor : float
    """
    b = 10 ** ((12.58 - mag_arcsec2) / 2.5)
    a = (5.949e-8, -2.389e-7, 2.459e-7, 4.120e-4, -4.225e-4)
    threshold = (
        math.sqrt(a[0] * b**0.5 + a[1] * b**0.75 + a[2] * b) + a[3] * b**0.25 + a[4] * b**0.5
    ) ** 2 * field_factor
    return -2.5 * math.log10(threshold) - 13.99
