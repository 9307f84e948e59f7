"""Apparent positions of stars: from the catalogue to the directions that an observer sees.

The chain is celnav's own: proper motion and parallax, annual aberration, precession-nutation (IAU 2006/2000A, CIO
based), Earth rotation angle with UT1, polar motion, the observer's horizon on WGS84, diurnal aberration, refraction.
Light deflection by the Sun is neglected: at night, more than 90 deg from the Sun, it stays below 4 mas.
Sources: Kaplan 2005, USNO Circular 179; Urban & Seidelmann 2013, Explanatory Supplement, chapter 7; pyerfa for the
Earth's ephemeris and precession-nutation.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import erfa
import numpy as np
from numpy.typing import NDArray

from celnav.sky.catalog import StarCatalog, propagate
from celnav.sky.earth_rotation import EarthOrientation, earth_orientation
from celnav.sky.refraction import refract
from celnav.sky.utc import Utc, parse_utc
from celnav.sky.wgs84 import ROTATION_RAD_S, SEMI_MAJOR_AXIS_KM

F8 = NDArray[np.float64]

AU_PER_DAY_IN_C = 499.004783836 / 86400.0  # light time of one astronomical unit, in days
ARCSEC = np.radians(1.0 / 3600.0)
# Speed of the equator over the speed of light: 0.320 arcsec.
DIURNAL_ABERRATION = ROTATION_RAD_S * SEMI_MAJOR_AXIS_KM * 1000 / 299792458.0


@dataclass(frozen=True, eq=False)
class TerrestrialStars:
    """Directions of stars in the terrestrial frame (ITRS), shape (n, 3), which depend on the observer only by a rotation.

    An instance belongs to one instant; each observer's position takes one rotation.
    """

    dirs: F8

    def enu(self, lat_deg: float, lon_deg: float) -> F8:
        """Return geometric (unrefracted) ENU unit vectors, shape (n, 3), at a geodetic position."""
        rotation = enu_rotation(lat_deg, lon_deg)
        seen = self.dirs @ rotation.T
        seen[:, 0] += DIURNAL_ABERRATION * np.cos(np.radians(lat_deg))
        return np.asarray(seen / np.linalg.norm(seen, axis=1, keepdims=True))


def enu_rotation(lat_deg: float, lon_deg: float) -> F8:
    """Return the 3x3 matrix that takes the terrestrial frame to east-north-up at a geodetic position."""
    lat, lon = np.radians(lat_deg), np.radians(lon_deg)
    sin_lat, cos_lat, sin_lon, cos_lon = np.sin(lat), np.cos(lat), np.sin(lon), np.cos(lon)
    return np.array(
        [
            [-sin_lon, cos_lon, 0.0],
            [-sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat],
            [cos_lat * cos_lon, cos_lat * sin_lon, sin_lat],
        ]
    )


def terrestrial_stars(
    stars: StarCatalog, utc: Utc, orientation: EarthOrientation, to_terrestrial: F8 | None = None
) -> TerrestrialStars:
    """Compute the directions of catalogue stars in the terrestrial frame at an instant.

    Parameters
    ----------
    stars : StarCatalog
        n stars.
    utc : Utc
        The instant.
    orientation : EarthOrientation
        UT1-UTC and polar motion at that instant.
    to_terrestrial : ndarray, shape (3, 3), optional
        `celestial_to_terrestrial` at that instant, if already computed.
    """
    tt1, tt2 = utc.tt
    years = (tt1 - 2451545.0 + tt2) / 365.25 + 2000.0 - stars.epoch_jyear
    barycentric = propagate(stars.vectors, stars.motion, years)
    earth = earth_at(utc)
    seen = barycentric - (stars.parallax_mas * (1e-3 * ARCSEC))[:, None] * earth.barycentric
    seen /= np.sqrt(np.einsum("ni,ni->n", seen, seen))[:, None]
    seen = aberrate(seen, earth.beta)
    rotation = celestial_to_terrestrial(utc, orientation) if to_terrestrial is None else to_terrestrial
    return TerrestrialStars(seen @ rotation.T)


@dataclass(frozen=True, eq=False)
class Earth:
    """Position and velocity of the Earth's centre.

    Attributes
    ----------
    heliocentric, barycentric : ndarray, shape (3,)
        Position, astronomical units, ICRS axes.
    beta : ndarray, shape (3,)
        Barycentric velocity in units of the speed of light.
    """

    heliocentric: F8
    barycentric: F8
    beta: F8


@lru_cache(maxsize=4)
def earth_at(utc: Utc) -> Earth:
    """Return the Earth at an instant (ERFA's ``epv00``, 11 km; TT is used for TDB, 2 ms, in which it moves 60 m)."""
    heliocentric, barycentric = erfa.epv00(*utc.tt)
    beta = np.asarray(barycentric["v"]) * AU_PER_DAY_IN_C
    return Earth(np.asarray(heliocentric["p"]), np.asarray(barycentric["p"]), beta)


def celestial_to_terrestrial(utc: Utc, orientation: EarthOrientation) -> F8:
    """Return the rotation, shape (3, 3), from the celestial (GCRS) to the terrestrial frame (ITRS), IAU 2006/2000A."""
    tt1, tt2 = utc.tt
    celestial_to_intermediate = erfa.c2i06a(tt1, tt2)
    rotation_angle = erfa.era00(*utc.ut1(orientation.dut1_s))
    polar = erfa.pom00(orientation.xp_arcsec * ARCSEC, orientation.yp_arcsec * ARCSEC, erfa.sp00(tt1, tt2))
    return np.asarray(erfa.c2tcio(celestial_to_intermediate, rotation_angle, polar))


def aberrate(dirs: F8, beta: F8) -> F8:
    """Apply aberration to unit vectors, shape (n, 3), for an observer with velocity `beta`, shape (3,), in units of c.

    This is the relativistic formula of the Explanatory Supplement (7.40).
    """
    inverse_gamma = np.sqrt(1.0 - beta @ beta)
    along = dirs @ beta
    seen = inverse_gamma * dirs + (1.0 + along / (1.0 + inverse_gamma))[:, None] * beta
    return np.asarray(seen / (1.0 + along)[:, None])


def apparent_enu(
    stars: StarCatalog,
    utc: Utc | str,
    lat_deg: float,
    lon_deg: float,
    *,
    pressure_hpa: float = 1010.0,
    temperature_c: float = 10.0,
    orientation: EarthOrientation | None = None,
) -> F8:
    """Compute the directions in which an observer sees stars (forward model).

    Parameters
    ----------
    stars : StarCatalog
        n stars.
    utc : Utc or str
        The instant.
    lat_deg, lon_deg : float
        Geodetic position on WGS84; longitude is positive to the east.
    pressure_hpa, temperature_c : float
        Air at the observer, for refraction; pressure 0 gives directions without refraction.
    orientation : EarthOrientation, optional
        Earth orientation; taken from the IERS table unless given.

    Returns
    -------
    ndarray, shape (n, 3)
        Unit vectors, east-north-up.
    """
    instant = parse_utc(utc)
    orientation = earth_orientation(instant) if orientation is None else orientation
    seen = terrestrial_stars(stars, instant, orientation).enu(lat_deg, lon_deg)
    return refract(seen, pressure_hpa, temperature_c) if pressure_hpa > 0 else seen
