"""Place of the Moon at the moments of a frame's exposure, and orientation of its disk."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from generator.frame.plan import FramePlan, refracting_air
from generator.places.astrometry import Air, Site, refracted
from generator.places.ephemeris import MOON, MOON_RADIUS_KM, SUN, apparent_enu, observe
from generator.places.times import EarthOrientation, Instant

Floats = NDArray[np.float64]

NO_AIR = Air(0.0, 10.0, 0.5)


@dataclass(frozen=True, eq=False)
class MoonPath:
    """The Moon's disk without refraction at k moments, evenly spaced over the shutter's time.

    Attributes
    ----------
    centre, towards_sun, across : (k, 3) arrays
        Unit vectors (ENU) at right angles to each other: to the disk's centre, and its axes, one of them towards the Sun.
    radius_rad : (k,) array
        Angular radius.
    """

    centre: Floats
    towards_sun: Floats
    across: Floats
    radius_rad: Floats

    def points(self, x: Floats, y: Floats) -> Floats:
        """Unit vectors (n, k, 3), above the air, of places on the disk in units of its radius, (n,) arrays."""
        scale = np.tan(self.radius_rad)[:, None]
        points = x[:, None, None] * (scale * self.towards_sun)
        points += y[:, None, None] * (scale * self.across)
        points += self.centre
        points /= np.sqrt(np.einsum("nkx,nkx->nk", points, points))[..., None]
        return points

    def offsets(self, directions: Floats) -> Floats:
        """Places on the disk, (n, k, 2) in units of its radius, of unit vectors (n, k, 3) above the air near it."""
        away = np.einsum("nkx,akx->nka", directions, np.stack([self.towards_sun, self.across]))
        ahead = np.einsum("nkx,kx->nk", directions, self.centre)
        return np.asarray(away / (ahead * np.tan(self.radius_rad))[..., None])


def site_of(plan: FramePlan) -> Site:
    """Return the site of a frame's camera."""
    place = plan.spec.site
    return Site(place.latitude_deg, place.longitude_deg, place.height_m)


def moon_path(plan: FramePlan) -> MoonPath:
    """The Moon at the moments of the plan's `directions`; in between, points move along chords as the stars do."""
    moments = plan.directions.shape[1]
    return _path(site_of(plan), plan.utc_start, plan.spec.shutter_s, moments, plan.orientation)


def seen_through_air(plan: FramePlan, above_air: Floats) -> Floats:
    """Apparent unit vectors (..., 3) for directions above the air, each refracted individually."""
    flat = np.ascontiguousarray(above_air.reshape(-1, 3).T)
    return refracted(flat, site_of(plan), refracting_air(plan.spec.atmosphere)).T.reshape(above_air.shape)


@functools.lru_cache(maxsize=4)
def _path(site: Site, start: Instant, shutter_s: float, moments: int, orientation: EarthOrientation) -> MoonPath:
    centre, sun, radius = [], [], []
    for after in np.linspace(0, shutter_s, moments):
        instant = start.plus(float(after))
        bodies = [observe(body, site, instant, orientation) for body in (MOON, SUN)]
        moon_enu, sun_enu = (apparent_enu(body, site, instant, orientation, NO_AIR) for body in bodies)
        centre.append(moon_enu)
        sun.append(sun_enu)
        radius.append(math.asin(MOON_RADIUS_KM / bodies[0].distance_km))
    return disk_frame(np.array(centre), np.array(sun), np.array(radius))


def disk_frame(centre: Floats, sun: Floats, radius_rad: Floats) -> MoonPath:
    """Path of disks from the unit vectors (k, 3) to their centres and to the Sun."""
    towards = sun - np.einsum("kx,kx->k", sun, centre)[:, None] * centre
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    return MoonPath(centre, towards, np.cross(centre, towards), radius_rad)
