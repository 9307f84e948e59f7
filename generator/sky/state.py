"""Directions of Sun and Moon, rotation of the celestial sphere, and cloud at the middle of a frame's exposure."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from generator.places.astrometry import Air, Site
from generator.places.ephemeris import MOON, SUN, Body, apparent_enu, icrs_from_enu, observe
from generator.places.times import SECONDS_PER_DAY, EarthOrientation, Instant
from generator.scenario.model import CloudSpec
from generator.seeds import random_stream
from generator.sky.clouds import CloudField, CloudPattern, cloud_pattern
from generator.sky.moonlight import moon_v_mag

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class SkyState:
    """Quantities beyond the scenario on which the sky of a frame depends.

    Attributes
    ----------
    icrs_from_enu : (3, 3) array
    sun_icrs : (3,) array
    sun_enu, moon_enu : (3,) arrays
        Apparent.
    moon : Body
    moon_v_mag : float
        Above the atmosphere.
    clouds : CloudField or None
    """

    icrs_from_enu: Floats
    sun_icrs: Floats
    sun_enu: Floats
    moon_enu: Floats
    moon: Body
    moon_v_mag: float
    clouds: CloudField | None

    @property
    def sun_altitude_deg(self) -> float:
        """Apparent, deg."""
        return float(np.degrees(np.arcsin(self.sun_enu[2])))

    @property
    def moon_altitude_deg(self) -> float:
        """Apparent, deg."""
        return float(np.degrees(np.arcsin(self.moon_enu[2])))


@dataclass(frozen=True)
class UnderClouds:
    """Where the camera is below the cloud.

    Attributes
    ----------
    wind_days : float
        How long the wind has carried the cloud, days.
    moved_km : (east, north)
        How far the camera has moved.
    """

    wind_days: float
    moved_km: tuple[float, float] = (0.0, 0.0)


def sky_state(
    site: Site,
    instant: Instant,
    orientation: EarthOrientation,
    air: Air,
    clouds: CloudSpec | None,
    seed: int,
    under: UnderClouds | None = None,
) -> SkyState:
    """State of the sky at an instant; `under`: in a sequence, for others the wind blows since midnight."""
    sun, moon = (observe(body, site, instant, orientation) for body in (SUN, MOON))
    return SkyState(
        icrs_from_enu=icrs_from_enu(site, instant, orientation),
        sun_icrs=sun.icrs,
        sun_enu=apparent_enu(sun, site, instant, orientation, air),
        moon_enu=apparent_enu(moon, site, instant, orientation, air),
        moon=moon,
        moon_v_mag=float(moon_v_mag(moon.phase_angle_deg, moon.distance_km)),
        clouds=None if clouds is None else drifted_clouds(clouds, under or UnderClouds(instant.mjd % 1.0), seed),
    )


@functools.lru_cache(maxsize=4)
def _pattern(spec: CloudSpec, seed: int) -> CloudPattern:
    return cloud_pattern(
        spec.mean_optical_depth,
        spec.coverage,
        spec.spectral_slope,
        spec.outer_scale_km,
        random_stream(seed, "clouds", 0),
    )


def drifted_clouds(spec: CloudSpec, under: UnderClouds, seed: int) -> CloudField:
    """The scenario's cloud where the wind has carried it; all frames of a scenario share one field (stream ``clouds``)."""
    carried_km = spec.wind_m_s * under.wind_days * SECONDS_PER_DAY / 1000
    turn = np.radians(spec.wind_azimuth_deg)
    pattern = _pattern(spec, seed)
    east_km, north_km = carried_km * float(np.sin(turn)), carried_km * float(np.cos(turn))
    return CloudField(spec.altitude_km, pattern, east_km - under.moved_km[0], north_km - under.moved_km[1])
