"""Topocentric positions of Sun, Moon and planets from JPL's DE421.

Positions come from the kernel in the package ``skyfield-data`` (Folkner et al. 2009, IPN Progress Report 42-178; 1899 to
2053), corrected for light time. For aberration, precession, nutation and the rest, the same ERFA chain is used as for the
stars.
"""

from __future__ import annotations

import atexit
import functools
from dataclasses import dataclass
from pathlib import Path

import erfa
import numpy as np
import skyfield_data
from jplephem.spk import SPK
from numpy.typing import NDArray

from generator.errors import TimeRangeError
from generator.places.astrometry import Air, ApparentPlaces, Site, apparent_places, star_parameters
from generator.places.catalogue import StarCatalogue
from generator.places.times import EarthOrientation, Instant

Floats = NDArray[np.float64]

KERNEL_PATH = Path(skyfield_data.__file__).parent / "data" / "de421.bsp"
AU_KM = 149_597_870.7
LIGHT_KM_PER_DAY = 299_792.458 * 86400
SUN, MOON, EARTH = 10, 301, 399
PLANETS = {"mercury": 199, "venus": 299, "mars": 4, "jupiter": 5, "saturn": 6, "uranus": 7, "neptune": 8}
PLANET_IDS = {"mercury": 199, "venus": 299, "mars": 499, "jupiter": 599, "saturn": 699, "uranus": 799, "neptune": 899}
"""NAIF numbers; a planet's id in the truth tables is PLANET_ID_BASE plus this."""
PLANET_ID_BASE = 900_000_000
PLANET_BV_MAG = {
    "mercury": 0.97, "venus": 0.70, "mars": 1.36, "jupiter": 0.86, "saturn": 1.07, "uranus": 0.50, "neptune": 0.39,
}  # fmt: skip
"""B-V of the planets. Source: Mallama, Krobusek & Pavlov 2017, Icarus 282, 19, table 3."""
PLANET_VI_MAG = {
    "mercury": 0.96, "venus": 0.62, "mars": 1.26, "jupiter": 0.35, "saturn": 0.79, "uranus": -1.15, "neptune": -1.27,
}  # fmt: skip
"""V-I (Cousins) of the planets: the Sun's, plus 2.5 lg of the geometric albedo in Ic over that in V. Source: the same."""
MOON_RADIUS_KM = 1737.4


@dataclass(frozen=True)
class Body:
    """A body as seen from the site.

    Attributes
    ----------
    ra_deg, dec_deg : float
        Astrometric place (corrected only for light time), ICRS, topocentric.
    distance_km, sun_distance_km : float
    phase_angle_deg : float
        Angle Sun - body - observer.
    towards_sun : (3,) array
        ICRS unit vector from the body to the Sun.
    """

    ra_deg: float
    dec_deg: float
    distance_km: float
    sun_distance_km: float
    phase_angle_deg: float
    towards_sun: Floats

    @property
    def icrs(self) -> Floats:
        """Astrometric unit vector."""
        ra, dec = np.radians([self.ra_deg, self.dec_deg])
        return np.array([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)])


@functools.cache
def _kernel() -> SPK:
    kernel = SPK.open(str(KERNEL_PATH))
    atexit.register(kernel.close)
    return kernel


def _barycentric(target: int, tdb1: float, tdb2: float) -> Floats:
    """Position of a body relative to the solar system's barycentre, km."""
    kernel = _kernel()
    if target in (MOON, EARTH):
        return np.array(kernel[0, 3].compute(tdb1, tdb2)) + np.array(kernel[3, target].compute(tdb1, tdb2))
    position = np.array(kernel[0, target // 100 if target > 100 else target].compute(tdb1, tdb2))
    if target > 100:
        position = position + np.array(kernel[target // 100, target].compute(tdb1, tdb2))
    return position


@functools.lru_cache(maxsize=4)
def _observer(site: Site, instant: Instant, orientation: EarthOrientation) -> tuple[float, float, Floats]:
    """Return two-part TDB, and the place of the site relative to the solar system's barycentre, km (3,)."""
    tai = erfa.utctai(instant.utc1, instant.utc2)
    tdb1, tdb2 = (float(part) for part in erfa.taitt(*tai))
    start, end = float(_kernel()[0, 3].start_jd), float(_kernel()[0, 3].end_jd)
    if not start + 1 < tdb1 + tdb2 < end - 1:
        raise TimeRangeError(f"{instant.isoformat()} lies outside DE421 (1899 to 2053); choose a time inside it")
    # TDB - TT is below 2 ms, during which the Moon moves by 2 m.
    astrom = star_parameters(site, instant, orientation)
    # ERFA's own ephemeris of the Earth is accurate to some km, which is too coarse for the Moon: only the observer's
    # geocentric position is taken from it.
    _, erfa_earth = erfa.epv00(tdb1, tdb2)
    on_earth_km = (np.array(astrom["eb"]) - np.array(erfa_earth["p"])) * AU_KM
    return tdb1, tdb2, _barycentric(EARTH, tdb1, tdb2) + on_earth_km


def observe(target: int, site: Site, instant: Instant, orientation: EarthOrientation) -> Body:
    """Position of a body (kernel number) for an observer at the site.

    Raises
    ------
    TimeRangeError
        The instant is outside DE421's range.
    """
    tdb1, tdb2, observer = _observer(site, instant, orientation)
    light_days = 0.0
    # The second position is off by the light time's own error: 1 km for the Moon, 50 km for Neptune, 0.002 arcsec.
    for _ in range(2):
        position = _barycentric(target, tdb1, tdb2 - light_days)
        light_days = float(np.linalg.norm(position - observer)) / LIGHT_KM_PER_DAY
    line = position - observer
    distance = float(np.linalg.norm(line))
    to_sun = _barycentric(SUN, tdb1, tdb2 - light_days) - position
    sun_distance = float(np.linalg.norm(to_sun))
    towards_sun = to_sun / sun_distance if sun_distance > 0 else -line / distance
    cosine = float(np.clip(towards_sun @ (-line / distance), -1, 1))
    return Body(
        ra_deg=float(np.degrees(np.arctan2(line[1], line[0])) % 360),
        dec_deg=float(np.degrees(np.arcsin(line[2] / distance))),
        distance_km=distance,
        sun_distance_km=sun_distance,
        phase_angle_deg=float(np.degrees(np.arccos(cosine))),
        towards_sun=towards_sun,
    )


def as_stars(
    ra_deg: Floats, dec_deg: Floats, v_mag: Floats, bv_mag: Floats, vi_mag: Floats, other_id: NDArray[np.int32]
) -> StarCatalogue:
    """Return directions as catalogue stars without proper motion or parallax."""
    nothing = np.zeros(len(ra_deg))
    none = np.zeros(len(ra_deg), np.int32)
    return StarCatalogue(
        hip=none,
        hr=none,
        ra_deg=ra_deg,
        dec_deg=dec_deg,
        pm_ra_mas_yr=nothing,
        pm_dec_mas_yr=nothing,
        parallax_mas=nothing,
        v_mag=v_mag,
        bv_mag=bv_mag,
        vi_mag=vi_mag,
        bv_assumed=none.astype(bool),
        other_id=other_id,
    )


def apparent_enu(body: Body, site: Site, instant: Instant, orientation: EarthOrientation, air: Air) -> Floats:
    """Apparent unit vector (3,) of a body."""
    one = np.ones(1)
    star = as_stars(body.ra_deg * one, body.dec_deg * one, 0 * one, 0 * one, 0 * one, np.zeros(1, np.int32))
    return apparent_places(star, site, instant, orientation, air).enu[0]


def icrs_from_enu(site: Site, instant: Instant, orientation: EarthOrientation) -> Floats:
    """Rotation (3, 3) from horizontal directions without refraction to ICRS, without aberration (20 arcsec)."""
    ra = np.array([0.0, 90.0, 180.0, 270.0, 0.0, 0.0])
    dec = np.array([0.0, 0.0, 0.0, 0.0, 90.0, -90.0])
    stars = as_stars(ra, dec, np.zeros(6), np.zeros(6), np.zeros(6), np.zeros(6, np.int32))
    places: ApparentPlaces = apparent_places(stars, site, instant, orientation, Air(0.0, 10.0, 0.5))
    a, d = np.radians(ra), np.radians(dec)
    icrs = np.stack([np.cos(d) * np.cos(a), np.cos(d) * np.sin(a), np.sin(d)], axis=-1)
    left, _, right = np.linalg.svd(icrs.T @ places.enu)
    return left @ np.diag([1.0, 1.0, float(np.sign(np.linalg.det(left @ right)))]) @ right


def planet_v_mag(name: str, body: Body) -> float:
    """V of a planet. Source: Mallama & Hilton 2018, Astronomy and Computing 25, 10 (rotation of Mars left out: 0.06 mag)."""
    a = body.phase_angle_deg
    distance = 5 * np.log10(body.distance_km / AU_KM * body.sun_distance_km / AU_KM)
    if name == "mercury":
        coefficients = [-0.613, 6.3280e-2, -1.6336e-3, 3.3644e-5, -3.4265e-7, 1.6893e-9, -3.0334e-12]
    elif name == "venus":
        coefficients = (
            [-4.384, -1.044e-3, 3.687e-4, -2.814e-6, 8.938e-9] if a < 163.7 else [236.05828, -2.81914, 8.39034e-3]
        )
    elif name == "mars":
        coefficients = [-1.601, 2.267e-2, -1.302e-4] if a <= 50 else [-0.367, -2.573e-2, 3.445e-4]
    elif name == "jupiter":
        coefficients = [-9.395, -3.7e-4, 6.16e-4]
    elif name == "saturn":
        ra, dec = np.radians([40.589, 83.537])  # pole of the rings, IAU 2015
        pole = np.array([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)])
        sine = abs(float(pole @ body.icrs))
        ring = -1.825 * sine - 0.378 * sine * np.exp(-2.25 * a)
        return float(distance - 8.914 + ring + 0.026 * a)
    elif name == "uranus":
        coefficients = [-7.110, 6.587e-3, 1.045e-4]
    else:
        coefficients = [-7.00, 7.944e-3, 9.617e-5]
    return float(distance + np.polynomial.polynomial.polyval(a, coefficients))


def planets(site: Site, instant: Instant, orientation: EarthOrientation) -> StarCatalogue:
    """Return the planets except the Earth as stars at their astrometric places."""
    bodies = {name: observe(number, site, instant, orientation) for name, number in PLANETS.items()}
    return as_stars(
        np.array([body.ra_deg for body in bodies.values()]),
        np.array([body.dec_deg for body in bodies.values()]),
        np.array([planet_v_mag(name, body) for name, body in bodies.items()]),
        np.array([PLANET_BV_MAG[name] for name in bodies]),
        np.array([PLANET_VI_MAG[name] for name in bodies]),
        np.array([PLANET_ID_BASE + PLANET_IDS[name] for name in bodies], np.int32),
    )
