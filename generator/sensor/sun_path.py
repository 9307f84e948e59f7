"""The pixels of a fixed camera that the Sun's image crosses by day, and the duration."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from generator import mitsuba_runtime
from generator.places.sun import sun_terrestrial
from generator.scenario.camera_spec import CameraSpec
from generator.scenario.model import Pointing, pointing_matrix
from generator.scenario.sunburn_spec import SunburnSpec

Floats = NDArray[np.float64]

RADIUS_DEG = 0.2666
"""Radius of the Sun's disk at 1 au: 959.63 arcsec (Auwers 1891, the value of the almanacs)."""
WITHIN_PX = 0.25
"""Distance along u and v from a pixel's centre to the four points that represent it."""
WIDEST_PX = 10.0
"""Upper limit of the angle across a pixel anywhere relative to that on the axis."""


DEG_PER_HOUR = 15.0
"""The Sun's mean motion in hour angle."""


@functools.lru_cache(maxsize=2)
def sun_minutes(burn: SunburnSpec, camera: CameraSpec) -> NDArray[np.float32]:
    """Minutes that each pixel was in the Sun's image, (height, width) array, read-only.

    They are the time that the disk's chord takes at a pixel's declination, summed over the days. The Sun moves uniformly
    in hour angle and declination between the first and the last hour. Refraction (0.1 deg at an altitude of 10 deg), the
    width of the point spread function and the dimming by air are left out.
    """
    attitude = Pointing(azimuth_deg=burn.azimuth_deg, altitude_deg=burn.altitude_deg, roll_deg=burn.roll_deg)
    R_cam = pointing_matrix(attitude)
    v, u = (grid.ravel() for grid in np.mgrid[0 : camera.height, 0 : camera.width].astype(np.float64))
    days = _sun_by_day(burn)
    reach = RADIUS_DEG + np.degrees(WITHIN_PX * WIDEST_PX / camera.projection.f_px)
    declination, _, seen = _equatorial(camera, R_cam, burn.latitude_deg, u, v)
    near = seen & (declination > days[:, :2].min() - reach) & (declination < days[:, :2].max() + reach)
    total = np.zeros(camera.height * camera.width, dtype=np.float32)
    for beside in (-WITHIN_PX, WITHIN_PX):
        for below in (-WITHIN_PX, WITHIN_PX):
            place = _equatorial(camera, R_cam, burn.latitude_deg, u[near] + beside, v[near] + below)
            total[near] += np.where(place[2], _minutes(burn, days, place[0], place[1]), 0) / 4
    minutes = total.reshape(camera.height, camera.width)
    minutes.flags.writeable = False
    return minutes


def _minutes(burn: SunburnSpec, days: Floats, declination: Floats, hour_angle: Floats) -> Floats:
    """Minutes in the Sun's image at places in the sky, (n,) array."""
    hours, parts = np.array(burn.hours_utc).T
    total = np.zeros(len(declination))
    for first_declination, last_declination, first_angle, last_angle in days:
        passed = ((hour_angle - first_angle) % 360) / (last_angle - first_angle)
        share = np.interp(hours[0] + passed * (hours[-1] - hours[0]), hours, parts, left=0.0, right=0.0)
        sun = first_declination + np.minimum(passed, 1) * (last_declination - first_declination)
        half_chord = np.sqrt(np.maximum(RADIUS_DEG**2 - (declination - sun) ** 2, 0))
        rate_deg_min = (last_angle - first_angle) / (60 * (hours[-1] - hours[0])) * np.cos(np.radians(sun))
        total += share * 2 * half_chord / rate_deg_min
    return total


def _sun_by_day(burn: SunburnSpec) -> Floats:
    """The Sun at the first and the last hour of each day, (days, 4) array, deg: declinations, then hour angles, rising."""
    rows = []
    for day in range(burn.days):
        places = []
        for hour in (burn.hours_utc[0][0], burn.hours_utc[-1][0]):
            x, y, z = sun_terrestrial(burn.first_midnight.plus(3600 * (24 * day + hour)))
            places.append((np.degrees(np.arcsin(z)), burn.longitude_deg - np.degrees(np.arctan2(y, x))))
        (first, first_angle), (last, last_angle) = places
        swept = (last_angle - first_angle) % 360
        # On days longer than 24 h by the Sun, 24 h sweep less than a turn, and on shorter ones a turn and a little more.
        if swept < DEG_PER_HOUR / 2 * (burn.hours_utc[-1][0] - burn.hours_utc[0][0]):
            swept += 360
        rows.append((first, last, first_angle, first_angle + swept))
    return np.array(rows)


def _equatorial(
    camera: CameraSpec, R_cam: Floats, latitude_deg: float, u: Floats, v: Floats
) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Declination and hour angle, deg, of places in the frame, and whether the lens shows sky above the horizon there."""
    mi = mitsuba_runtime.start()
    import drjit as dr

    from generator.plugins.lens import make_lens

    number: Any = dr.float64_array_t(mi.Float)
    lens = make_lens(camera.projection, lambda value: dr.opaque(number, value))
    *ray, valid = lens.unproject(number(u), number(v))
    east, north, up = R_cam.T @ np.stack([np.array(part) for part in ray])
    seen = np.array(valid) & (up > 0)
    if camera.image_circle_px is not None:
        projection = camera.projection
        seen &= np.hypot(u - projection.cx_px, v - projection.cy_px) <= camera.image_circle_px
    sine, cosine = np.sin(np.radians(latitude_deg)), np.cos(np.radians(latitude_deg))
    declination = np.degrees(np.arcsin(np.clip(up * sine + north * cosine, -1, 1)))
    hour_angle = np.degrees(np.arctan2(-east, up * cosine - north * sine))
    return declination, hour_angle, seen
