"""From catalogue places to apparent directions at a site: ERFA's full chain.

Proper motion, parallax, light deflection, annual aberration, precession-nutation (IAU 2006/2000A), Earth rotation with
UT1, polar motion and diurnal aberration are ERFA's ``apco13``, ``atciq`` and ``atioq`` (its rotations and its aberration for
many stars at once); refraction is :mod:`generator.refraction`.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any

import erfa
import numpy as np
from numpy.typing import NDArray

from generator.catalogue import StarCatalogue, propagate
from generator.refraction import refraction_deg
from generator.times import EarthOrientation, Instant

MAS_TO_RAD = np.pi / (180 * 3600 * 1000)
J2000_MJD = 51544.5
DAYS_PER_JULIAN_YEAR = 365.25


@dataclass(frozen=True)
class Site:
    """Where the camera stands: WGS84 geodetic latitude and longitude (deg, east positive), ellipsoidal height (m)."""

    latitude_deg: float
    longitude_deg: float
    height_m: float = 0.0


@dataclass(frozen=True)
class Air:
    """The air that refracts: pressure (hPa; 0 switches refraction off), temperature (deg C), relative humidity (0-1)."""

    pressure_hpa: float
    temperature_c: float
    relative_humidity: float


@dataclass(frozen=True)
class ApparentPlaces:
    """Apparent (refracted) directions of n stars at a site.

    Attributes
    ----------
    enu : (n, 3) array
        Unit vectors east, north, up.
    """

    enu: NDArray[np.float64]

    def __getitem__(self, selection: NDArray[np.bool_]) -> ApparentPlaces:
        return ApparentPlaces(self.enu[selection])

    @functools.cached_property
    def azimuth_deg(self) -> NDArray[np.float64]:
        """From north through east, 0 to 360 deg, (n,) array."""
        return np.degrees(np.arctan2(self.enu[:, 0], self.enu[:, 1])) % 360

    @functools.cached_property
    def altitude_deg(self) -> NDArray[np.float64]:
        """Above the horizon, deg, (n,) array."""
        return np.degrees(np.arctan2(self.enu[:, 2], np.hypot(self.enu[:, 0], self.enu[:, 1])))


def apparent_places(
    stars: StarCatalogue, site: Site, instant: Instant, orientation: EarthOrientation, air: Air
) -> ApparentPlaces:
    """Apparent places of catalogue stars.

    Parameters
    ----------
    stars : StarCatalogue
        Places at J2000.0, n stars.
    site : Site
    instant : Instant
    orientation : EarthOrientation
    air : Air
        Refraction is computed for 550 nm.

    Returns
    -------
    ApparentPlaces
        In the order of `stars`.
    """
    places = intermediate_places(stars, site, instant, orientation)
    return observed_places(places, site, instant, orientation, air)


def _context(site: Site, instant: Instant, orientation: EarthOrientation) -> Any:
    """ERFA's star-independent parameters, without refraction."""
    astrom, _ = erfa.apco13(
        instant.utc1,
        instant.utc2,
        orientation.ut1_utc_s,
        np.radians(site.longitude_deg),
        np.radians(site.latitude_deg),
        site.height_m,
        np.radians(orientation.polar_motion_x_arcsec / 3600),
        np.radians(orientation.polar_motion_y_arcsec / 3600),
        0.0,
        0.0,
        0.0,
        0.55,
    )
    return astrom


@dataclass(frozen=True)
class IntermediatePlaces:
    """Places in the celestial intermediate system (CIRS): everything applied but the Earth's rotation and the air.

    They change by less than 0.1 arcsec an hour (diurnal aberration turns with the observer), which exposures neglect.

    Attributes
    ----------
    cirs : (n, 3) array
        Unit vectors.
    """

    cirs: NDArray[np.float64]

    def __getitem__(self, selection: NDArray[np.bool_]) -> IntermediatePlaces:
        return IntermediatePlaces(self.cirs[selection])


def intermediate_places(
    stars: StarCatalogue, site: Site, instant: Instant, orientation: EarthOrientation
) -> IntermediatePlaces:
    """Intermediate places of n catalogue stars; parameters as in :func:`apparent_places`."""
    declination = np.radians(stars.dec_deg)
    ri, di = erfa.atciq(
        np.radians(stars.ra_deg),
        declination,
        stars.pm_ra_mas_yr * MAS_TO_RAD / np.cos(declination),
        stars.pm_dec_mas_yr * MAS_TO_RAD,
        np.maximum(stars.parallax_mas, 0.0) / 1000,
        np.zeros(len(stars)),
        _context(site, instant, orientation),
    )
    return IntermediatePlaces(erfa.s2c(ri, di))


def observed_places(
    places: IntermediatePlaces, site: Site, instant: Instant, orientation: EarthOrientation, air: Air
) -> ApparentPlaces:
    """Apparent places of n stars at an instant from their intermediate places near it (same hour)."""
    context = _context(site, instant, orientation)
    # Components first: each is contiguous.
    east, north, up = _enu_from_cirs(context) @ places.cirs.T
    # Diurnal aberration, as in ERFA's atioq: the observer moves east.
    speed = float(context["diurab"])
    shrink = 1 - speed * east
    east, north, up = shrink * (east + speed), shrink * north, shrink * up
    level = np.sqrt(east**2 + north**2)
    altitude = np.arctan2(up, level)
    lift = refraction_deg(
        np.degrees(altitude),
        pressure_hpa=air.pressure_hpa,
        temperature_c=air.temperature_c,
        relative_humidity=air.relative_humidity,
    )
    lifted = altitude + np.radians(lift)
    stretch = np.cos(lifted) / np.maximum(level, 1e-300)
    return ApparentPlaces(np.stack([stretch * east, stretch * north, np.sin(lifted)], axis=-1))


def _enu_from_cirs(context: Any) -> NDArray[np.float64]:
    """Rotation (3, 3) by the Earth's rotation angle, polar motion and the site's latitude, as in ERFA's ``atioq``."""
    sine, cosine = np.sin(context["eral"]), np.cos(context["eral"])
    turn = np.array([[cosine, sine, 0], [-sine, cosine, 0], [0, 0, 1]])
    sx, cx, sy, cy = (f(context[name]) for name in ("xpl", "ypl") for f in (np.sin, np.cos))
    wobble = np.array([[cx, 0, sx], [sx * sy, cy, -cx * sy], [-sx * cy, sy, cx * cy]])
    sine, cosine = context["sphi"], context["cphi"]
    # Of the axes meridian (towards the zenith's side), east, pole.
    horizon = np.array([[0, 1, 0], [-sine, 0, cosine], [cosine, 0, sine]])
    return horizon @ wobble @ turn


def stars_within(stars: StarCatalogue, axis_icrs: NDArray[np.float64], angle_deg: float) -> NDArray[np.bool_]:
    """Which of n stars lie within an angle of an ICRS unit vector by their places at J2000.0, (n,) array."""
    if angle_deg >= 180:
        return np.ones(len(stars), bool)
    return stars.icrs @ axis_icrs > np.cos(np.radians(angle_deg))


def places_of_date(stars: StarCatalogue, instant: Instant) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """ICRS right ascension and declination, deg, with proper motion applied from J2000.0 to `instant`."""
    years = (instant.mjd - J2000_MJD) / DAYS_PER_JULIAN_YEAR
    return propagate(stars.ra_deg, stars.dec_deg, stars.pm_ra_mas_yr, stars.pm_dec_mas_yr, years)
