"""Conversion of catalogue places to apparent directions at a site: ERFA's full chain.

Proper motion, parallax, light deflection, annual aberration, precession-nutation (IAU 2006/2000A), Earth rotation with
UT1, polar motion and diurnal aberration are ERFA's. The parameters of an instant come from ``apco13`` and ``apio13``; the
operations that ``atciq`` and ``atioq`` apply to one star are applied here to the vectors of all stars at once. Refraction
is :mod:`generator.places.refraction`.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any

import erfa
import numpy as np
from numpy.typing import NDArray

from generator.places.catalogue import StarCatalogue
from generator.places.ray_bending import REFERENCE_NM, StandardAir
from generator.places.refraction import refraction_deg, refraction_of_apparent_deg, refraction_of_vectors_rad
from generator.places.times import EarthOrientation, Instant

MAS_TO_RAD = np.pi / (180 * 3600 * 1000)
J2000_MJD = 51544.5
DAYS_PER_JULIAN_YEAR = 365.25
LIGHT_YEARS_PER_AU = erfa.AULT / erfa.DAYSEC / erfa.DJY


@dataclass(frozen=True)
class Site:
    """Place of the camera: WGS84 geodetic latitude and longitude (deg, east positive), ellipsoidal height (m)."""

    latitude_deg: float
    longitude_deg: float
    height_m: float = 0.0


@dataclass(frozen=True)
class Air:
    """Refracting air: pressure (hPa; 0 switches refraction off), temperature (deg C), relative humidity (0-1)."""

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

    def __getitem__(self, rows: NDArray[np.intp]) -> ApparentPlaces:
        return ApparentPlaces(self.enu.T[:, rows].T)

    def midway_to(self, other: ApparentPlaces) -> ApparentPlaces:
        """Return places midway between these and others close to them."""
        return ApparentPlaces(_unit(self.enu.T + other.enu.T).T)

    @functools.cached_property
    def azimuth_deg(self) -> NDArray[np.float64]:
        """Azimuth from north through east, 0 to 360 deg, (n,) array."""
        azimuth = np.degrees(np.arctan2(self.enu[:, 0], self.enu[:, 1]))
        return np.where(azimuth < 0, azimuth + 360, azimuth)

    @functools.cached_property
    def altitude_deg(self) -> NDArray[np.float64]:
        """Altitude above the horizon, deg, (n,) array."""
        east, north, up = self.enu.T
        return np.degrees(np.arctan2(up, np.sqrt(east * east + north * north)))


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
        Air, whose refraction is computed for 550 nm.

    Returns
    -------
    ApparentPlaces
        Places in the order of `stars`.
    """
    places = intermediate_places(stars, site, instant, orientation)
    return observed_places(places, site, instant, orientation, air)


@functools.lru_cache(maxsize=4)
def star_parameters(site: Site, instant: Instant, orientation: EarthOrientation) -> Any:
    """ERFA's star-independent parameters for places above the air (``apco13``)."""
    astrom, _ = erfa.apco13(*_observer(site, instant, orientation))
    return astrom


def _observer(site: Site, instant: Instant, orientation: EarthOrientation) -> tuple[float, ...]:
    """Arguments that ERFA's functions for terrestrial observers share, without air."""
    return (
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


@dataclass(frozen=True)
class IntermediatePlaces:
    """Places in the celestial intermediate system (CIRS), with everything applied except the Earth's rotation and the air.

    They include diurnal aberration, which turns with the observer by less than 0.1 arcsec per hour; this change is
    neglected within an exposure.

    Attributes
    ----------
    cirs : (n, 3) array
        Unit vectors.
    """

    cirs: NDArray[np.float64]

    def __getitem__(self, rows: NDArray[np.intp]) -> IntermediatePlaces:
        return IntermediatePlaces(self.cirs.T[:, rows].T)


def intermediate_places(
    stars: StarCatalogue, site: Site, instant: Instant, orientation: EarthOrientation
) -> IntermediatePlaces:
    """Intermediate places of n catalogue stars; parameters as in :func:`apparent_places`.

    The steps are those of ERFA's ``pmpx``, ``ldsun``, ``ab`` and the rotation to CIRS, components first.
    """
    context = star_parameters(site, instant, orientation)
    icrs, motion = stars.icrs.T, stars.motion_rad_yr.T
    observer, velocity = context["eb"], context["v"]
    # Light takes longer to an observer beyond the barycentre (Roemer's delay).
    years = float(context["pmt"]) + LIGHT_YEARS_PER_AU * (observer @ icrs)
    parallax = np.maximum(stars.parallax_mas, 0.0) * MAS_TO_RAD
    place = _unit(icrs + years * motion - parallax * observer[:, None])

    sun, distance_au = context["eh"][:, None], float(context["em"])
    along = context["eh"] @ place
    limit = 1e-6 / max(distance_au**2, 1.0)
    potential = erfa.SRS / distance_au
    bend = potential / np.maximum(1 + along, limit)
    place = place + bend * (sun - along * place)

    along = velocity @ place
    shrink = float(context["bm1"])
    forward = 1 + along / (1 + shrink) + potential
    place = _unit((shrink - potential * along) * place + forward * velocity[:, None])
    return IntermediatePlaces((context["bpn"] @ place).T)


def _unit(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Normalise vectors (3, n) to length 1."""
    x, y, z = vectors
    return vectors / np.sqrt(x * x + y * y + z * z)


def observed_places(
    places: IntermediatePlaces, site: Site, instant: Instant, orientation: EarthOrientation, air: Air
) -> ApparentPlaces:
    """Apparent places of n stars at an instant from their intermediate places near it (same hour)."""
    # Precession and nutation, which take longer than everything else, are contained in the intermediate places.
    context = erfa.apio13(*_observer(site, instant, orientation))
    return ApparentPlaces(refracted(_enu_from_cirs(context) @ places.cirs.T, site, air).T)


def refracted(enu: NDArray[np.float64], site: Site, air: Air) -> NDArray[np.float64]:
    """Return apparent unit vectors (3, n), east, north, up, for those above the air."""
    # The components are the first axis, so that each is contiguous.
    east, north, up = enu
    level = np.sqrt(east * east + north * north)
    lift = refraction_of_vectors_rad(level, up, air_around(site, air))
    # Sine and cosine of a small angle: the next terms are below 1e-12.
    square = lift * lift
    sine, cosine = lift * (1 - square / 6), 1 - square * (0.5 - square / 24)
    stretch = cosine - up * sine / np.maximum(level, 1e-300)
    return np.stack([stretch * east, stretch * north, up * cosine + level * sine])


def unrefracted(enu: NDArray[np.float64], site: Site, air: Air) -> NDArray[np.float64]:
    """Return unit vectors (3, n) above the air for apparent ones: the inverse of :func:`refracted`."""
    east, north, up = enu
    level = np.hypot(east, north)
    apparent = np.arctan2(up, level)
    true = apparent - np.radians(refraction_of_apparent_deg(np.degrees(apparent), air_around(site, air)))
    stretch = np.cos(true) / np.maximum(level, 1e-300)
    return np.stack([stretch * east, stretch * north, np.sin(true)])


def lift_deg(true_altitude_deg: NDArray[np.float64], site: Site, air: Air) -> NDArray[np.float64]:
    """Refraction, deg, at true altitudes (n,) seen from a site."""
    return refraction_deg(true_altitude_deg, air_around(site, air))


def air_around(site: Site, air: Air, wavelength_nm: float = REFERENCE_NM) -> StandardAir:
    """Return the air around an observer from its values at the site."""
    at_observer = (air.pressure_hpa, air.temperature_c, air.relative_humidity)
    return StandardAir(*at_observer, site.height_m, site.latitude_deg, wavelength_nm)


def _enu_from_cirs(context: Any) -> NDArray[np.float64]:
    """Rotation (3, 3) with the Earth's rotation angle, polar motion and the site's latitude, as in ERFA's ``atioq``."""
    sine, cosine = np.sin(context["eral"]), np.cos(context["eral"])
    turn = np.array([[cosine, sine, 0], [-sine, cosine, 0], [0, 0, 1]])
    sx, cx, sy, cy = (f(context[name]) for name in ("xpl", "ypl") for f in (np.sin, np.cos))
    wobble = np.array([[cx, 0, sx], [sx * sy, cy, -cx * sy], [-sx * cy, sy, cx * cy]])
    sine, cosine = context["sphi"], context["cphi"]
    # The axes are the meridian (towards the zenith's side), east, and the pole.
    horizon = np.array([[0, 1, 0], [-sine, 0, cosine], [cosine, 0, sine]])
    return horizon @ wobble @ turn


def stars_within(stars: StarCatalogue, axis_icrs: NDArray[np.float64], angle_deg: float) -> NDArray[np.bool_]:
    """Whether each of n stars is within an angle of an ICRS unit vector, from places at J2000.0, (n,) array."""
    if angle_deg >= 180:
        return np.ones(len(stars), bool)
    return stars.icrs @ axis_icrs > np.cos(np.radians(angle_deg))


def places_of_date(stars: StarCatalogue, instant: Instant) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """ICRS right ascension and declination, deg, with proper motion applied from J2000.0 to `instant`."""
    years = (instant.mjd - J2000_MJD) / DAYS_PER_JULIAN_YEAR
    x, y, z = stars.icrs.T + years * stars.motion_rad_yr.T
    ra_deg = np.degrees(np.arctan2(y, x))
    return np.where(ra_deg < 0, ra_deg + 360, ra_deg), np.degrees(np.arctan2(z, np.sqrt(x * x + y * y)))


def true_equator_of_date(icrs: NDArray[np.float64], instant: Instant) -> NDArray[np.float64]:
    """Rotate an ICRS vector (3,) to the true equator and equinox of date (IAU 2006/2000A)."""
    tai1, tai2 = erfa.utctai(instant.utc1, instant.utc2)
    return np.asarray(erfa.pnm06a(*erfa.taitt(tai1, tai2)) @ icrs)
