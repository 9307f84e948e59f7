"""Directions of Sun and Moon, rotation of the celestial sphere, and cloud at mid-exposure of a frame."""

from __future__ import annotations

import dataclasses
import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from generator.light.cloud_kinds import CLOUD_KINDS, of_ice, point_share, usual_particle_um
from generator.places.astrometry import Air, Site, air_around
from generator.places.ephemeris import MOON, SUN, Body, apparent_enu, icrs_from_enu, observe
from generator.places.refraction import lowest_ray_deg
from generator.places.times import SECONDS_PER_DAY, EarthOrientation, Instant
from generator.scenario.sky.cloud_spec import CloudSpec
from generator.seeds import random_stream
from generator.sky.clouds import CloudField, CloudPattern, Texture, cloud_pattern
from generator.sky.moon_irradiance import moon_spectrum, moon_v_mag

Floats = NDArray[np.float64]

NO_AIR = Air(0.0, 0.0, 0.0)


@dataclass(frozen=True)
class SkyState:
    """Quantities beyond the scenario on which the sky of a frame depends.

    Attributes
    ----------
    icrs_from_enu : (3, 3) array
    sun_icrs : (3,) array
    sun_enu, moon_enu : (3,) arrays
        Apparent directions.
    sun_depression_deg, moon_depression_deg : float
        Depression of their true places below the horizontal, without refraction.
    lowest_ray_deg : float
        True altitude from which the lowest ray arrives that the Earth does not hide.
    sun : Body
    moon : Body
    moon_v_mag : float
        V of the Moon above the atmosphere.
    clouds : CloudField or None
        Cloud above the camera.
    height_m : float
        Height of the site.
    """

    icrs_from_enu: Floats
    sun_icrs: Floats
    sun_enu: Floats
    moon_enu: Floats
    sun_depression_deg: float
    moon_depression_deg: float
    lowest_ray_deg: float
    sun: Body
    moon: Body
    moon_v_mag: float
    clouds: CloudField | None
    height_m: float

    @property
    def moon_spectrum(self) -> Floats:
        """Photon irradiance of the Moon above the atmosphere, photons s^-1 m^-2 nm^-1 at GRID_NM."""
        return moon_spectrum(self.moon_v_mag, self.moon.phase_angle_deg)

    @property
    def sun_altitude_deg(self) -> float:
        """Apparent altitude, deg; the true one where the Earth hides the Sun."""
        return self._altitude_deg(self.sun_enu, self.sun_depression_deg)

    @property
    def moon_altitude_deg(self) -> float:
        """Apparent altitude, deg; the true one where the Earth hides the Moon."""
        return self._altitude_deg(self.moon_enu, self.moon_depression_deg)

    def _altitude_deg(self, enu: Floats, depression_deg: float) -> float:
        if -depression_deg < self.lowest_ray_deg:
            return -depression_deg
        return float(np.degrees(np.arcsin(enu[2])))


@dataclass(frozen=True)
class UnderClouds:
    """Place of the camera below the cloud.

    Attributes
    ----------
    wind_days : float
        Time during which the wind has carried the cloud, days.
    moved_km : (east, north)
        Displacement of the camera.
    night : int
        Modified Julian day on which the wind started; cloud of a kind differs from day to day.
    camera_km : float
        Height of the camera above the ground.
    """

    wind_days: float
    moved_km: tuple[float, float] = (0.0, 0.0)
    night: int = 0
    camera_km: float = 0.0

    @classmethod
    def since_midnight(cls, instant: Instant) -> UnderClouds:
        """Return the place for wind that has blown since midnight."""
        return cls(instant.mjd % 1.0, night=int(instant.mjd // 1))


@dataclass(frozen=True)
class ThroughClouds:
    """How a camera sees through the cloud.

    Attributes
    ----------
    shutter_s : float
    capture_rad : float
        Angular radius of a star's image.
    """

    shutter_s: float
    capture_rad: float


def sky_state(
    site: Site,
    instant: Instant,
    orientation: EarthOrientation,
    air: Air,
    clouds: CloudSpec | None,
    seed: int,
    under: UnderClouds | None = None,
    shutter: ThroughClouds | None = None,
) -> SkyState:
    """State of the sky at an instant; `under` is for sequences, otherwise the wind blows since midnight."""
    sun, moon = (observe(body, site, instant, orientation) for body in (SUN, MOON))
    true_sun, true_moon = (apparent_enu(body, site, instant, orientation, NO_AIR) for body in (sun, moon))
    return SkyState(
        icrs_from_enu=icrs_from_enu(site, instant, orientation),
        sun_icrs=sun.icrs,
        sun_enu=apparent_enu(sun, site, instant, orientation, air),
        moon_enu=apparent_enu(moon, site, instant, orientation, air),
        sun_depression_deg=-float(np.degrees(np.arcsin(true_sun[2]))),
        moon_depression_deg=-float(np.degrees(np.arcsin(true_moon[2]))),
        lowest_ray_deg=lowest_ray_deg(air_around(site, air)),
        sun=sun,
        moon=moon,
        moon_v_mag=float(moon_v_mag(moon.phase_angle_deg, moon.distance_km)),
        clouds=drifted_clouds(clouds, under or UnderClouds.since_midnight(instant), seed, shutter) if clouds else None,
        height_m=site.height_m,
    )


@functools.lru_cache(maxsize=4)
def _pattern(spec: CloudSpec, seed: int, night: int) -> CloudPattern:
    kind = None if spec.kind is None else CLOUD_KINDS[spec.kind]
    texture = Texture(thickness_km=spec.thickness_km)
    if kind is not None:
        texture = Texture(kind.stretch, spec.wind_azimuth_deg, kind.cell_km, spec.thickness_km)
    return cloud_pattern(
        mean_depth(spec, seed, night),
        spec.coverage,
        spec.spectral_slope,
        spec.outer_scale_km,
        random_stream(seed, f"clouds {spec.draw}" if spec.draw else "clouds", night),
        texture,
    )


def mean_depth(spec: CloudSpec, seed: int, night: int) -> float:
    """Mean optical depth of a layer with its clear parts: given, or drawn for kind and night (stream ``cloud depth``)."""
    if spec.mean_optical_depth is not None:
        return spec.mean_optical_depth
    if spec.optical_depth is not None:
        return spec.coverage * spec.optical_depth
    assert spec.kind is not None
    return spec.coverage * CLOUD_KINDS[spec.kind].drawn_depth(random_stream(seed, "cloud depth", night))


def drifted_clouds(
    spec: CloudSpec, under: UnderClouds, seed: int, through: ThroughClouds | None = None
) -> CloudField | None:
    """Return the scenario's cloud, displaced by the wind; None for a camera at the layer's height or above.

    All frames of a scenario share one field (stream ``clouds``, or ``clouds N`` for another draw); cloud of a kind
    differs for each day of UTC.
    """
    altitude_km = spec.altitude_km - under.camera_km
    if altitude_km <= 0:
        return None
    carried_km = spec.wind_m_s * under.wind_days * SECONDS_PER_DAY / 1000
    turn = np.radians(spec.wind_azimuth_deg)
    towards = np.array([np.sin(turn), np.cos(turn)])
    pattern = _pattern(spec, seed, 0 if spec.kind is None else under.night)
    east_km, north_km = (carried_km * towards - under.moved_km).tolist()
    ice = of_ice(spec.kind, spec.altitude_km)
    particle_um = usual_particle_um(spec.altitude_km) if spec.particle_um is None else spec.particle_um
    field = CloudField(
        altitude_km, pattern, east_km, north_km, particle_um=particle_um, ice=ice, camera_km=under.camera_km
    )
    if through is None:
        return field
    east, north = (spec.wind_m_s * through.shutter_s / 1000 * towards).tolist()
    # If aureoles are drawn, images keep only light that is not diffracted at all.
    share = 1.0 if spec.star_aureoles else point_share(particle_um, through.capture_rad)
    return dataclasses.replace(field, swept_km=(east, north), point_share=share)
