"""From catalogue places to apparent directions at a site: ERFA's full chain.

Proper motion, parallax, light deflection, annual aberration, precession-nutation (IAU 2006/2000A), Earth rotation with
UT1, polar motion and diurnal aberration are ERFA's ``apco13``, ``atciq`` and ``atioq``; refraction is
:mod:`generator.refraction`.
"""

from __future__ import annotations

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
HORIZON_MARGIN_DEG = 3.0


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
    """Apparent directions of stars at a site.

    Attributes
    ----------
    azimuth_deg, altitude_deg : (n,) arrays
        Apparent (refracted) horizontal coordinates, deg.
    enu : (n, 3) array
        The same as unit vectors east, north, up.
    """

    azimuth_deg: NDArray[np.float64]
    altitude_deg: NDArray[np.float64]

    @property
    def enu(self) -> NDArray[np.float64]:
        """Unit vectors east, north, up, (n, 3)."""
        azimuth, altitude = np.radians(self.azimuth_deg), np.radians(self.altitude_deg)
        return np.stack(
            [np.sin(azimuth) * np.cos(altitude), np.cos(azimuth) * np.cos(altitude), np.sin(altitude)], axis=-1
        )


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
    """Places in the celestial intermediate system (CIRS), rad: everything applied but the Earth's rotation and the air.

    They change by less than 0.1 arcsec an hour (diurnal aberration turns with the observer), which exposures neglect.
    """

    ri: NDArray[np.float64]
    di: NDArray[np.float64]

    def __getitem__(self, selection: NDArray[np.bool_]) -> IntermediatePlaces:
        return IntermediatePlaces(self.ri[selection], self.di[selection])


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
    return IntermediatePlaces(ri, di)


def observed_places(
    places: IntermediatePlaces, site: Site, instant: Instant, orientation: EarthOrientation, air: Air
) -> ApparentPlaces:
    """Apparent places of n stars at an instant from their intermediate places near it (same hour)."""
    azimuth, zenith_distance, *_ = erfa.atioq(places.ri, places.di, _context(site, instant, orientation))
    true_altitude = 90 - np.degrees(zenith_distance)
    lift = refraction_deg(
        true_altitude,
        pressure_hpa=air.pressure_hpa,
        temperature_c=air.temperature_c,
        relative_humidity=air.relative_humidity,
    )
    return ApparentPlaces(np.degrees(azimuth) % 360, true_altitude + lift)


def possibly_up(stars: StarCatalogue, site: Site, instant: Instant) -> NDArray[np.bool_]:
    """Which of n stars can stand above the horizon: all that do, and none deeper than about 4 deg below it.

    The zenith is taken at the Earth rotation angle, in ICRS axes; precession since J2000.0 and UT1-UTC stay within the margin
    for a century.
    """
    right_ascension = erfa.era00(instant.utc1, instant.utc2) + np.radians(site.longitude_deg)
    latitude = np.radians(site.latitude_deg)
    declination = np.radians(stars.dec_deg)
    hour_angle = right_ascension - np.radians(stars.ra_deg)
    sine = np.sin(latitude) * np.sin(declination) + np.cos(latitude) * np.cos(declination) * np.cos(hour_angle)
    return sine > np.sin(np.radians(-HORIZON_MARGIN_DEG))


def places_of_date(stars: StarCatalogue, instant: Instant) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """ICRS right ascension and declination, deg, with proper motion applied from J2000.0 to `instant`."""
    years = (instant.mjd - J2000_MJD) / DAYS_PER_JULIAN_YEAR
    return propagate(stars.ra_deg, stars.dec_deg, stars.pm_ra_mas_yr, stars.pm_dec_mas_yr, years)
