"""Rejection of reference stars that carry little information about the position.

One star gives two equations (altitude, and azimuth times cos altitude) for two unknowns (latitude, and longitude times
cos latitude). The determinant of their derivatives is cos dec cos H / cos lat in absolute value, with H the star's hour
angle: the fix from one star fails near the poles of the sky *and* six hours from the meridian. The thesis (section 5.ii)
rejects by |dec| alone.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

F8 = NDArray[np.float64]


def position_determinant(enu: F8, lat_rad: float) -> float:
    """Return |det J| = |cos dec cos H| / cos lat for a star seen in a direction.

    Parameters
    ----------
    enu : ndarray, shape (3,)
        Unit vector towards the star: east, north, up.
    lat_rad : float
        Latitude of the observer; not a pole.

    Notes
    -----
    cos dec cos H is the component of the direction along the equator's meridian point, cos lat up - sin lat north.
    """
    return abs(float(enu[2]) * math.cos(lat_rad) - float(enu[1]) * math.sin(lat_rad)) / math.cos(lat_rad)


def latitudes_of_star(enu: F8, dec_rad: float) -> tuple[float, ...]:
    """Return the latitudes in radians (none, one or two) at which a star of given declination is seen in a direction.

    They follow from sin dec = sin lat up + cos lat north. For a part of the sky, both roots are within -90 to 90 deg; this is
    the ambiguity of a fix from one star.
    """
    length = math.hypot(float(enu[1]), float(enu[2]))
    if length == 0.0 or abs(math.sin(dec_rad)) > length:
        return ()
    middle = math.atan2(float(enu[2]), float(enu[1]))
    spread = math.acos(math.sin(dec_rad) / length)
    found = {math.remainder(middle + sign * spread, 2 * math.pi) for sign in (1, -1)}
    return tuple(sorted(lat for lat in found if abs(lat) <= math.pi / 2))


def smallest_determinant(enu: F8, dec_rad: float) -> float:
    """Return the smaller |det J| at the latitudes that one star leaves possible; 0 if there is none."""
    latitudes = [lat for lat in latitudes_of_star(enu, dec_rad) if math.cos(lat) > 1e-12]
    return min((position_determinant(enu, lat) for lat in latitudes), default=0.0)
