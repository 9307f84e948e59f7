"""Satellites on orbits: two-line element sets and shells, each for as long as it is visible during the exposure.

A two-line element set is propagated with SGP4 (Vallado et al. 2006, AIAA 2006-6753; the `sgp4` package) to its
true-equator frame, rotated to the Earth by GMST 1982, and refracted. The scenario sets a satellite's brightness; the
Earth's shadow is taken into account for shells only.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import erfa
import numpy as np
from numpy.typing import NDArray
from sgp4.api import Satrec

from generator.errors import ScenarioError
from generator.frame.flying.objects import KEYFRAMES, FlyingObjects, steady
from generator.light.atmosphere import MAG_PER_OPTICAL_DEPTH, Atmosphere, airmass, optical_depth
from generator.places.astrometry import Air, Site, lift_deg
from generator.places.satellite_shells import Shell, sunlit
from generator.places.times import EarthOrientation, Instant
from generator.scenario.foreground_spec import ShellSpec, TleSpec
from generator.seeds import random_stream
from generator.sky.clouds import CloudField, behind_cloud

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

SECONDS_PER_DAY = 86400.0
VISUAL_NM = 550.0
HALVINGS = 24
"""Number of halvings of the time between two keyframes when searching for the moment at which a satellite comes into sight:
accurate to 1e-9 of the exposure."""


@dataclass(frozen=True)
class Watch:
    """Properties of an exposure that matter for satellites.

    Attributes
    ----------
    start : Instant
        When the shutter opens.
    shutter_s : float
    site : Site
    orientation : EarthOrientation
    air : Air
        Refracting air.
    horizon_sine : float
        Sine of the horizon's apparent altitude.
    seed : int
        Seed of the scenario.
    sun : (3,) array
        Unit vector to the Sun in the true-equator frame of date, in which satellites move.
    dims : Atmosphere or None
        Air that dims the light of shells.
    clouds : CloudField or None
        Cloud that dims it.
    """

    start: Instant
    shutter_s: float
    site: Site
    orientation: EarthOrientation
    air: Air
    horizon_sine: float
    seed: int
    sun: Floats
    dims: Atmosphere | None
    clouds: CloudField | None


def tle_object(satellite: TleSpec, number: int, of_all: int, watch: Watch) -> FlyingObjects:
    """Return satellite `number` of the element sets, which is object `of_all` of the foreground.

    Raises
    ------
    ScenarioError
        SGP4 cannot propagate the element set.
    """
    try:
        orbit = Satrec.twoline2rv(satellite.line1, satellite.line2)
    except ValueError as error:
        raise ScenarioError(f"foreground.satellites.{number}: not a two-line element set ({error})") from error

    def directions(time_s: Floats) -> Floats:
        """Return directions (1, k, 3) at times (1, k)."""
        day = time_s[0] / SECONDS_PER_DAY
        start1, start2 = watch.start.plain_jd()
        codes, position_km, _ = orbit.sgp4_array(np.full(len(day), start1), start2 + day)
        if codes.any() or not np.isfinite(position_km).all():
            raise ScenarioError(f"foreground.satellites.{number}: SGP4 cannot propagate the elements to this time")
        return _refracted(_from_site(position_km, day, watch), watch)[None]

    def seen(rows: NDArray[np.intp], time_s: Floats) -> Bools:
        return (directions(time_s)[..., 2] > watch.horizon_sine)[rows]

    time_s = np.linspace(0, watch.shutter_s, KEYFRAMES)[None]
    up = seen(np.zeros(1, dtype=np.intp), time_s)
    span = spans_s(up, time_s[0], seen) if up.any() else time_s[:, [0, -1]]
    _, parts, curve = steady(1)
    return FlyingObjects(
        number=np.array([of_all], dtype=np.int32),
        kind=("satellite",),
        v_mag=np.array([satellite.v_mag]),
        bv_mag=np.array([satellite.bv_mag]),
        lit=span / watch.shutter_s,
        directions=directions(np.linspace(span[:, 0], span[:, 1], KEYFRAMES, axis=1)),
        parts=parts,
        light_curve=curve,
    )


def shell_objects(spec: ShellSpec, number: int, first: int, watch: Watch) -> FlyingObjects:
    """Return the satellites of shell `number` that are sunlit and above the horizon; stream ``shells`` draws the nodes."""
    node, argument = random_stream(watch.seed, "shells", number).uniform(0, 360, 2)
    shell = Shell(spec.altitude_km, spec.inclination_deg, spec.planes, spec.per_plane, float(node), float(argument))
    epoch_s = ((watch.start.utc1 - erfa.DJ00) + watch.start.utc2) * SECONDS_PER_DAY

    def at(time_s: Floats, rows: NDArray[np.intp] | None = None) -> tuple[Floats, Floats, Bools]:
        """Return directions (m, k, 3), distances (m, k) and visibility of satellites at times (k,) or (m, k)."""
        position_km = shell.positions_km(epoch_s + time_s, rows)
        away = _from_site(position_km, time_s / SECONDS_PER_DAY, watch)
        apparent = _refracted(away.reshape(-1, 3), watch).reshape(away.shape)
        bright = sunlit(position_km, watch.sun) & (apparent[..., 2] > watch.horizon_sine)
        return apparent, np.linalg.norm(away, axis=-1), bright

    time_s = np.linspace(0, watch.shutter_s, KEYFRAMES)
    directions, distance_km, bright = at(time_s)
    rows = np.flatnonzero(bright.any(axis=1))
    directions, distance_km, bright = directions[rows], distance_km[rows], bright[rows]
    span = spans_s(bright, time_s, lambda some, when: at(when, rows[some])[2])
    some = np.flatnonzero(~(bright[:, 0] & bright[:, -1]))
    if len(some):
        own_s = np.linspace(span[some, 0], span[some, 1], KEYFRAMES, axis=1)
        directions[some], distance_km[some], bright[some] = at(own_s, rows[some])
        # At both ends, keep the visible bound of the bisection.
        bright[:, [0, -1]] = True
    middle = KEYFRAMES // 2
    v_mag = spec.v_mag_1000_km + 5 * np.log10(distance_km[:, middle] / 1000)
    if watch.dims is not None:
        altitude = np.degrees(np.arcsin(np.clip(directions[:, middle, 2], 0, 1)))
        v_mag = v_mag + MAG_PER_OPTICAL_DEPTH * float(optical_depth([VISUAL_NM], watch.dims)[0]) * airmass(altitude)
    v_mag = behind_cloud(v_mag, watch.clouds, directions[:, middle])
    lit = bright.astype(np.float64)
    return FlyingObjects(
        number=(first + rows).astype(np.int32),
        kind=("satellite",) * len(rows),
        v_mag=v_mag,
        bv_mag=np.full(len(rows), spec.bv_mag),
        lit=span / watch.shutter_s,
        directions=directions,
        parts=np.full(len(rows), KEYFRAMES - 1, dtype=np.intp),
        light_curve=(0.5 * (lit[:, 1:] + lit[:, :-1])).ravel(),
    )


def spans_s(seen: Bools, time_s: Floats, seen_at: Callable[[NDArray[np.intp], Floats], Bools]) -> Floats:
    """First and last time at which each of n satellites is visible, s, (n, 2) array.

    Parameters
    ----------
    seen : (n, k) bool array
        Whether each is visible at times (k,); each is at one of them at least.
    time_s : (k,) array
    seen_at : callable
        Returns the visibility of satellites (m,) at an individual time for each, (m, 1), as (m, 1).
    """
    last = seen.shape[1] - 1
    ends = np.stack([seen.argmax(axis=1), last - seen[:, ::-1].argmax(axis=1)], axis=1)
    span = time_s[ends]
    for end, before, outermost in ((0, -1, 0), (1, 1, last)):
        rows = np.flatnonzero(ends[:, end] != outermost)
        if not len(rows):
            continue
        lit, dark = span[rows, end], time_s[ends[rows, end] + before]
        for _ in range(HALVINGS):
            middle = 0.5 * (lit + dark)
            there = seen_at(rows, middle[:, None])[:, 0]
            lit, dark = np.where(there, middle, lit), np.where(there, dark, middle)
        span[rows, end] = lit
    return np.asarray(span)


def _from_site(position_km: Floats, day: Floats, watch: Watch) -> Floats:
    """Convert places (..., k, 3) in the true-equator frame at k times, days from the start, to east, north, up, km."""
    site = watch.site
    start1, start2 = watch.start.plain_jd()
    sidereal = erfa.gmst82(start1, start2 + day + watch.orientation.ut1_utc_s / SECONDS_PER_DAY)
    east, north = np.cos(sidereal), np.sin(sidereal)
    x, y, z = np.moveaxis(position_km, -1, 0)
    fixed = np.stack([east * x + north * y, -north * x + east * y, z], axis=-1)
    longitude, latitude = np.radians([site.longitude_deg, site.latitude_deg])
    away = fixed - erfa.gd2gc(1, longitude, latitude, site.height_m) / 1000
    sin_l, cos_l, sin_p, cos_p = np.sin(longitude), np.cos(longitude), np.sin(latitude), np.cos(latitude)
    axes = np.array(
        [[-sin_l, cos_l, 0], [-sin_p * cos_l, -sin_p * sin_l, cos_p], [cos_p * cos_l, cos_p * sin_l, sin_p]]
    )
    return np.asarray(away @ axes.T)


def _refracted(enu: Floats, watch: Watch) -> Floats:
    """Return apparent unit vectors (m, 3) for directions, by refraction."""
    azimuth = np.arctan2(enu[:, 0], enu[:, 1])
    altitude_deg = np.degrees(np.arctan2(enu[:, 2], np.hypot(enu[:, 0], enu[:, 1])))
    lift = lift_deg(altitude_deg, watch.site, watch.air)
    altitude = np.radians(altitude_deg + lift)
    return np.stack([np.sin(azimuth) * np.cos(altitude), np.cos(azimuth) * np.cos(altitude), np.sin(altitude)], axis=1)
