"""Position of the Sun over the Earth, for choosing times of night and for paths by day."""

from __future__ import annotations

import erfa
import numpy as np
from numpy.typing import NDArray

from generator.places.times import Instant


def sun_altitude_deg(instant: Instant, latitude_deg: float, longitude_deg: float) -> float:
    """Geometric altitude of the Sun's centre, deg, without refraction, accurate to 0.01 deg.

    Parameters
    ----------
    instant : Instant
    latitude_deg, longitude_deg : float
        Geodetic coordinates, WGS84.
    """
    terrestrial = sun_terrestrial(instant)
    latitude, longitude = np.radians(latitude_deg), np.radians(longitude_deg)
    up = np.array([np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude), np.sin(latitude)])
    return float(np.degrees(np.arcsin(up @ terrestrial)))


def sun_terrestrial(instant: Instant) -> NDArray[np.float64]:
    """Unit vector (3,) to the Sun's centre in the frame that rotates with the Earth.

    ERFA's analytic Earth (``epv00``), aberration by the Earth's velocity, IAU 2006/2000A rotation with UT1 = UTC:
    accurate to 0.01 deg (15 arcsec for each second of UT1-UTC).
    """
    tai1, tai2 = erfa.utctai(instant.utc1, instant.utc2)
    tt1, tt2 = erfa.taitt(tai1, tai2)
    heliocentric, barycentric = erfa.epv00(tt1, tt2)
    direction = -heliocentric["p"] / np.linalg.norm(heliocentric["p"])
    au_per_day_over_c = erfa.DAU / 86400 / erfa.CMPS
    direction = direction + barycentric["v"] * au_per_day_over_c
    rotation = erfa.c2t06a(tt1, tt2, instant.utc1, instant.utc2, 0.0, 0.0)
    return np.asarray(rotation @ (direction / np.linalg.norm(direction)))
