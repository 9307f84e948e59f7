"""Satellites, aircraft, meteors and false stars: where they are during the exposure, and how bright.

A trail is a great circle at constant angular speed. A two-line element set is propagated with SGP4 (Vallado et al. 2006,
AIAA 2006-6753; the `sgp4` package) to its true-equator frame, turned to the Earth by GMST 1982, and refracted. The scenario
sets a satellite's brightness; the Earth's shadow counts for shells alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import erfa
import numpy as np
from numpy.typing import NDArray
from sgp4.api import Satrec

from generator.errors import ScenarioError
from generator.light.atmosphere import MAG_PER_OPTICAL_DEPTH, Atmosphere, airmass, optical_depth
from generator.places.astrometry import Air, Site, lift_deg
from generator.places.satellite_shells import Shell, sunlit
from generator.places.times import EarthOrientation, Instant
from generator.scenario.camera_spec import CameraSpec
from generator.scenario.foreground_spec import (
    DirectionSpec,
    ForegroundSpec,
    GlintsSpec,
    ShellSpec,
    TleSpec,
    TrailSpec,
    TrainSpec,
)
from generator.seeds import random_stream

Floats = NDArray[np.float64]

KEYFRAMES = 65
"""Directions of each object over the shutter's time; in between they are linear."""
FEWEST_PARTS, MOST_PARTS = 64, 4096
"""Limits of the parts of a light curve, of which the shortest flash has eight."""
SECONDS_PER_DAY = 86400.0
VISUAL_NM = 550.0


@dataclass(frozen=True)
class FlyingObjects:
    """n objects of a frame.

    Attributes
    ----------
    number : (n,) int array
        Place in the scenario.
    kind : tuple of str
    v_mag, bv_mag : (n,) arrays
    directions : (n, k, 3) array
        Apparent unit vectors (ENU), evenly spaced over the shutter's time.
    light_curve : (n, m) array
        Relative brightness in m equal parts of it.
    """

    number: NDArray[np.int32]
    kind: tuple[str, ...]
    v_mag: Floats
    bv_mag: Floats
    directions: Floats
    light_curve: Floats

    def __len__(self) -> int:
        return len(self.kind)


@dataclass(frozen=True)
class Surroundings:
    """What satellites of shells depend on beside place and time.

    Attributes
    ----------
    seed : int
        Of the scenario.
    sun_icrs : (3,) array
    air : Atmosphere or None
        That dims their light.
    """

    seed: int
    sun_icrs: Floats
    air: Atmosphere | None


def plan_objects(
    spec: ForegroundSpec,
    start: Instant,
    shutter_s: float,
    site: Site,
    orientation: EarthOrientation,
    air: Air,
    around: Surroundings,
) -> FlyingObjects:
    """Objects of a frame whose shutter opens at `start` for `shutter_s`.

    Raises
    ------
    ScenarioError
        An element set that SGP4 cannot propagate.
    """
    time = np.linspace(0, shutter_s, KEYFRAMES)
    flash = min((trail.strobe.flash_s for trail in spec.trails if trail.strobe is not None), default=shutter_s)
    parts = int(np.clip(np.ceil(8 * shutter_s / flash), FEWEST_PARTS, MOST_PARTS))
    directions = [trail_directions(trail, time, shutter_s) for trail in spec.trails]
    curves = [light_curve(trail, shutter_s, parts) for trail in spec.trails]
    for number, satellite in enumerate(spec.satellites):
        directions.append(_orbit_directions(satellite, number, start, time, site, orientation, air))
        curves.append(np.ones(parts))
    everything: list[TrailSpec | TleSpec] = [*spec.trails, *spec.satellites]
    fixed = FlyingObjects(
        number=np.arange(len(everything), dtype=np.int32),
        kind=tuple(item.kind if isinstance(item, TrailSpec) else "satellite" for item in everything),
        v_mag=np.array([item.v_mag for item in everything]),
        bv_mag=np.array([item.bv_mag for item in everything]),
        directions=np.array(directions).reshape(-1, KEYFRAMES, 3),
        light_curve=np.array(curves).reshape(-1, parts),
    )
    groups, first = [fixed], len(everything)
    for train in spec.trains:
        groups.append(_train(train, first, time, shutter_s, parts))
        first += train.count
    for number, shell in enumerate(spec.shells):
        groups.append(_shell(shell, number, first, start, time, parts, site, orientation, air, around))
        first += shell.planes * shell.per_plane
    return fixed if len(groups) == 1 else joined(groups)


def joined(groups: list[FlyingObjects]) -> FlyingObjects:
    """Objects of several groups, in their order; light curves of one length."""
    return FlyingObjects(
        np.concatenate([group.number for group in groups]),
        tuple(kind for group in groups for kind in group.kind),
        np.concatenate([group.v_mag for group in groups]),
        np.concatenate([group.bv_mag for group in groups]),
        np.concatenate([group.directions for group in groups]),
        np.concatenate([group.light_curve for group in groups]),
    )


def plan_glints(
    spec: GlintsSpec, camera: CameraSpec, R_cam: Floats, others: FlyingObjects, rng: np.random.Generator
) -> FlyingObjects:
    """False stars, uniform over the image's pixels; of a lens with decentring some stand a little outside of it.

    Parameters
    ----------
    spec : GlintsSpec
    camera : CameraSpec
    R_cam : (3, 3) array
        East-north-up to camera.
    others : FlyingObjects
        Of the frame; numbers follow on theirs.
    rng : Generator
    """
    lens, count = camera.projection, spec.count
    u, v = rng.uniform(-0.5, camera.width - 0.5, count), rng.uniform(-0.5, camera.height - 0.5, count)
    v_mag = rng.uniform(*spec.v_mag, count)
    x, y = (u - lens.cx_px) / lens.f_px, (v - lens.cy_px) / lens.fy_px
    angle = np.radians(lens.axis_angles_deg(np.hypot(x, y)))
    around = np.arctan2(y, x)
    in_camera = np.stack([np.sin(angle) * np.cos(around), np.sin(angle) * np.sin(around), np.cos(angle)], axis=1)
    first = int(others.number.max(initial=-1)) + 1
    return FlyingObjects(
        number=first + np.arange(count, dtype=np.int32),
        kind=("glint",) * count,
        v_mag=v_mag,
        bv_mag=np.full(count, spec.bv_mag),
        directions=np.repeat((in_camera @ R_cam)[:, None], KEYFRAMES, axis=1),
        light_curve=np.ones((count, others.light_curve.shape[1])),
    )


def _train(train: TrainSpec, first: int, time_s: Floats, shutter_s: float, parts: int) -> FlyingObjects:
    """Satellites that follow each other on one path."""
    path = TrailSpec(
        kind="satellite", start=train.start, end=train.end, start_s=train.start_s, end_s=train.end_s, v_mag=train.v_mag
    )
    count = train.count
    return FlyingObjects(
        number=first + np.arange(count, dtype=np.int32),
        kind=("satellite",) * count,
        v_mag=np.full(count, train.v_mag),
        bv_mag=np.full(count, train.bv_mag),
        directions=np.stack([trail_directions(path, time_s - k * train.gap_s, shutter_s) for k in range(count)]),
        light_curve=np.ones((count, parts)),
    )


def _shell(
    spec: ShellSpec,
    number: int,
    first: int,
    start: Instant,
    time_s: Floats,
    parts: int,
    site: Site,
    orientation: EarthOrientation,
    air: Air,
    around: Surroundings,
) -> FlyingObjects:
    """The satellites of a constellation that are in sunlight above the horizon; its nodes by the stream ``shells``."""
    node, argument = random_stream(around.seed, "shells", number).uniform(0, 360, 2)
    shell = Shell(spec.altitude_km, spec.inclination_deg, spec.planes, spec.per_plane, float(node), float(argument))
    seconds = ((start.utc1 - erfa.DJ00) + start.utc2) * SECONDS_PER_DAY + time_s
    position_km = shell.positions_km(seconds)
    day = time_s / SECONDS_PER_DAY
    away = _from_site(position_km, start, day, site, orientation)
    distance_km = np.linalg.norm(away, axis=-1)
    apparent = _refracted(away.reshape(-1, 3), site, air).reshape(away.shape)
    bright = sunlit(position_km, around.sun_icrs)
    seen = np.flatnonzero(((apparent[..., 2] > 0) & bright).any(axis=1))
    middle = len(time_s) // 2
    v_mag = spec.v_mag_1000_km + 5 * np.log10(distance_km[seen, middle] / 1000)
    if around.air is not None:
        altitude = np.degrees(np.arcsin(np.clip(apparent[seen, middle, 2], 0, 1)))
        v_mag = v_mag + MAG_PER_OPTICAL_DEPTH * float(optical_depth([VISUAL_NM], around.air)[0]) * airmass(altitude)
    nearest = np.minimum((np.arange(parts) + 0.5) / parts * len(time_s), len(time_s) - 1).astype(np.intp)
    return FlyingObjects(
        number=(first + seen).astype(np.int32),
        kind=("satellite",) * len(seen),
        v_mag=v_mag,
        bv_mag=np.full(len(seen), spec.bv_mag),
        directions=apparent[seen],
        light_curve=bright[seen][:, nearest].astype(np.float64),
    )


def _unit(direction: DirectionSpec) -> Floats:
    azimuth, altitude = np.radians([direction.azimuth_deg, direction.altitude_deg])
    return np.array([np.sin(azimuth) * np.cos(altitude), np.cos(azimuth) * np.cos(altitude), np.sin(altitude)])


def trail_directions(trail: TrailSpec, time_s: Floats, shutter_s: float) -> Floats:
    """Unit vectors (k, 3) of a trail at times from the start of the exposure."""
    first, last = _unit(trail.start), _unit(trail.end)
    end_s = shutter_s if trail.end_s is None else trail.end_s
    share = ((time_s - trail.start_s) / (end_s - trail.start_s))[:, None]
    across = last - (last @ first) * first
    length = np.linalg.norm(across)
    if length < 1e-12:
        return np.tile(first, (len(time_s), 1))
    angle = np.arctan2(length, last @ first)
    return np.cos(share * angle) * first + np.sin(share * angle) * across / length


def light_curve(trail: TrailSpec, shutter_s: float, parts: int) -> Floats:
    """Mean brightness of a trail, relative to its magnitude, in equal parts of the shutter's time.

    A meteor's brightness rises and falls as a parabola over its path, a first approximation to observed light curves.
    """
    fine = 16
    time = (np.arange(parts * fine) + 0.5) / (parts * fine) * shutter_s
    end_s = shutter_s if trail.end_s is None else trail.end_s
    light = ((time >= trail.start_s) & (time <= end_s)).astype(np.float64)
    if trail.strobe is not None:
        light *= (time - trail.strobe.first_s) % trail.strobe.period_s < trail.strobe.flash_s
    if trail.kind == "meteor":
        share = (time - trail.start_s) / (end_s - trail.start_s)
        light *= np.maximum(4 * share * (1 - share), 0)
    return light.reshape(parts, fine).mean(axis=1)


def _orbit_directions(
    satellite: TleSpec, number: int, start: Instant, time_s: Floats, site: Site, orientation: EarthOrientation, air: Air
) -> Floats:
    """Apparent unit vectors (k, 3) of a satellite."""
    try:
        orbit = Satrec.twoline2rv(satellite.line1, satellite.line2)
    except ValueError as error:
        raise ScenarioError(f"foreground.satellites.{number}: not a two-line element set ({error})") from error
    day = time_s / SECONDS_PER_DAY
    codes, position_km, _ = orbit.sgp4_array(np.full(len(day), start.utc1), start.utc2 + day)
    if codes.any() or not np.isfinite(position_km).all():
        raise ScenarioError(f"foreground.satellites.{number}: SGP4 cannot propagate the elements to this time")
    return _refracted(_from_site(position_km, start, day, site, orientation), site, air)


def _from_site(position_km: Floats, start: Instant, day: Floats, site: Site, orientation: EarthOrientation) -> Floats:
    """East, north, up of places (..., k, 3) in the true-equator frame at k times, km."""
    sidereal = erfa.gmst82(start.utc1, start.utc2 + day + orientation.ut1_utc_s / SECONDS_PER_DAY)
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


def _refracted(enu: Floats, site: Site, air: Air) -> Floats:
    """Apparent unit vectors (m, 3) of directions."""
    azimuth = np.arctan2(enu[:, 0], enu[:, 1])
    altitude_deg = np.degrees(np.arctan2(enu[:, 2], np.hypot(enu[:, 0], enu[:, 1])))
    lift = lift_deg(altitude_deg, site, air)
    altitude = np.radians(altitude_deg + lift)
    return np.stack([np.sin(azimuth) * np.cos(altitude), np.cos(azimuth) * np.cos(altitude), np.sin(altitude)], axis=1)
