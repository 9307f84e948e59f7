"""Naked-eye visibility: the faintest star against a sky."""

from __future__ import annotations

import math

TYPICAL_FIELD_FACTOR = 2.0
"""Crumey's F, which combines the observer's acuity and experience: 1.4 to 2.4."""


def naked_eye_limit(mag_arcsec2: float, field_factor: float = TYPICAL_FIELD_FACTOR) -> float:
    """Faintest star seen by the naked eye on a sky of given brightness, V.

    Source: Crumey 2014, MNRAS 442, 2600: threshold F (r1 B^1/4 + r2 B^1/2)^2 lux on a background of B cd/m^2, one pair of
    coefficients for night vision and one above 0.0708 cd/m^2.

    Parameters
    ----------
    mag_arcsec2 : float
        Brightness of the sky, V mag/arcsec^2.
    field_factor : float
    """
    background = 10 ** ((12.58 - mag_arcsec2) / 2.5)
    r1, r2 = (6.505e-4, -8.461e-4) if background < 7.08e-2 else (1.772e-4, 7.167e-5)
    threshold = field_factor * (r1 * background**0.25 + r2 * background**0.5) ** 2
    return -2.5 * math.log10(threshold) - 13.99
