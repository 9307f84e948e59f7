"""Universal Transverse Mercator coordinates on the ellipsoid WGS84.

It is Krueger's series in the third flattening to the fourth order, accurate to a micrometre within a zone (Krueger 1912;
Karney 2011, "Transverse Mercator with an accuracy of a few nanometers", J. Geodesy 85, 475, eqs. 7 to 11, 14, 35). The
ellipsoid GRS80 of ETRS89 and NAD83 differs by 0.1 mm.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from generator.places.wgs84 import FLATTENING, SEMI_MAJOR_M, SQUARED_ECCENTRICITY

Floats = NDArray[np.float64]

SCALE = 0.9996
FALSE_EASTING_M, FALSE_NORTHING_SOUTH_M = 500_000.0, 10_000_000.0
_N = FLATTENING / (2 - FLATTENING)
_RADIUS_M = SEMI_MAJOR_M / (1 + _N) * (1 + _N**2 / 4 + _N**4 / 64)
_ALPHA = (
    _N / 2 - 2 * _N**2 / 3 + 5 * _N**3 / 16 + 41 * _N**4 / 180,
    13 * _N**2 / 48 - 3 * _N**3 / 5 + 557 * _N**4 / 1440,
    61 * _N**3 / 240 - 103 * _N**4 / 140,
    49561 * _N**4 / 161280,
)


def utm(latitude_deg: Floats, longitude_deg: Floats, zone: int, south: bool) -> tuple[Floats, Floats]:
    """Easting and northing, m, of geodetic positions (any shape) in a zone (1 to 60) of either hemisphere."""
    latitude = np.radians(latitude_deg)
    east = np.radians((np.asarray(longitude_deg) - (6 * zone - 183) + 180) % 360 - 180)
    eccentricity = np.sqrt(SQUARED_ECCENTRICITY)
    tangent = np.tan(latitude)
    shift = np.sinh(eccentricity * np.arctanh(eccentricity * np.sin(latitude)))
    conformal = tangent * np.hypot(1, shift) - shift * np.hypot(1, tangent)
    xi = np.arctan2(conformal, np.cos(east))
    eta = np.arcsinh(np.sin(east) / np.hypot(conformal, np.cos(east)))
    x, y = eta.copy(), xi.copy()
    for order, coefficient in enumerate(_ALPHA, start=1):
        x += coefficient * np.cos(2 * order * xi) * np.sinh(2 * order * eta)
        y += coefficient * np.sin(2 * order * xi) * np.cosh(2 * order * eta)
    northing = SCALE * _RADIUS_M * y + (FALSE_NORTHING_SOUTH_M if south else 0.0)
    return FALSE_EASTING_M + SCALE * _RADIUS_M * x, northing
