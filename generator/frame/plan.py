"""The plan of a frame, made before any light is computed: times, Earth orientation, and the stars above the horizon."""

from __future__ import annotations

import dataclasses
import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from generator.frame.flying.objects import FlyingObjects, joined
from generator.frame.flying.orbits import Watch
from generator.frame.flying.planning import plan_glints, plan_objects
from generator.light.atmosphere import Atmosphere, airmass
from generator.light.molecular_bands import precipitable_water_cm
from generator.light.points import PointLights
from generator.light.scintillation import scintillation_factors, scintillation_sigma
from generator.optics.drift import Drift, drift_at
from generator.optics.motion import Motion, plan_motion
from generator.optics.psf import PSF_REACH_SIGMAS, equivalent_sigma_px
from generator.places.astrometry import (
    Air,
    ApparentPlaces,
    Site,
    intermediate_places,
    observed_places,
    places_of_date,
    stars_within,
    true_equator_of_date,
)
from generator.places.catalogue import StarCatalogue, load_catalogue
from generator.places.catalogue_scatter import scattered
from generator.places.ephemeris import PLANET_ID_BASE, planets
from generator.places.horizon import LEVEL, Horizon, horizon_of
from generator.places.times import SECONDS_PER_DAY, EarthOrientation, Instant, earth_orientation
from generator.places.tycho2 import load_with_tycho2
from generator.scenario.camera_spec import CameraSpec
from generator.scenario.file import Scenario
from generator.scenario.model import FrameSpec, LocalAtmosphereSpec
from generator.scenario.sequences.sequence import Passage
from generator.seeds import random_stream
from generator.sky.clouds import LEAST_TRANSMISSION, behind_cloud, level_or_up
from generator.sky.state import SkyState, ThroughClouds, UnderClouds, sky_state

Floats = NDArray[np.float64]

EPOCH = Instant.parse("2000-01-01T12:00:00Z")
LONGEST_STEP_S = 60.0
"""Longest time between two moments at which places are computed; in between, stars move along chords, within 0.5 arcsec of
their arcs."""
LONGEST_CHORD_S = 1.0
"""Longest exposure for which the places at mid-exposure are taken midway between the first and the last: within 0.2 mas of
the exact ones from altitudes of 5 deg up, within 2 mas at the horizon."""
LONGEST_LIGHT_S = 120.0
"""Longest exposure for which extinction and the diffuse sky are those of mid-exposure. At the end of civil twilight, when
light falls fastest (20 times in 20 minutes), the mean over this time is 0.4 percent above the light at its middle."""

SKY_RATE_DEG_S = 15.05 / 3600
"""Rotation of the sky, rounded up."""
FIELD_MARGIN_DEG = 2.5
"""Upper limit of the displacement of a star by refraction, aberration, and proper motion over a century."""
LARGEST_CHROMATIC_SHARE = 2.5
"""Longest shift of a wavelength band relative to the point spread function's lateral chromatic shift."""


@dataclass(frozen=True)
class FramePlan:
    """One frame of a scenario, ready to render.

    Attributes
    ----------
    scenario : Scenario
    index : int
    spec : FrameSpec
    utc_start, utc_mid : Instant
    orientation : EarthOrientation
        At mid-exposure.
    stars : StarCatalogue
        The n stars above the horizon, brighter than the limit, whose light may touch the frame; some are a few degrees
        outside it. They are above it at mid-exposure or, in a long exposure, at some time.
    unlisted : PointLights or None
        Fainter stars that are drawn but not in the truth, dimmed by cloud; None if all drawn stars are listed.
    unlisted_v_mag : array or None
        Their V without cloud.
    ra_deg, dec_deg : (n,) arrays
        ICRS, proper motion applied to mid-exposure.
    start, middle, end : ApparentPlaces
        Places when the shutter opens, at mid-exposure, and when it closes.
    directions : (n, k, 3) array
        Apparent unit vectors (ENU), evenly spaced over the shutter's time.
    motion : Motion
        Rotation of the camera.
    objects : FlyingObjects
        Satellites, aircraft, meteors and false stars.
    airmass : (n,) array
        Airmass at mid-exposure, that of the horizon for stars below it; 0 if extinction is off.
    sky : SkyState
        At mid-exposure.
    cloud_optical_depth : (n,) array
        Optical depth along the line of sight to each star at mid-exposure; 0 without cloud.
    cloud_transmission : (n,) array
        Fraction of each star's light that passes through the cloud into its image, without a drawn aureole; 1 without cloud.
    scintillation : (n,) array
        Factor on each star's light; 1 for planets, and if scintillation is off.
    passage : Passage or None
        The frame's part of its sequence; None for an independent frame.
    horizon : Horizon
        Boundary between ground and sky.
    drift : Drift or None
        Drift of lens and mount; None if the scenario has none. `spec.camera` and `motion` are the true ones.
    told_camera : CameraSpec or None
    told_motion : Motion or None
        Camera and motion that a solver receives instead, if there is drift.
    """

    scenario: Scenario
    index: int
    spec: FrameSpec
    utc_start: Instant
    utc_mid: Instant
    orientation: EarthOrientation
    stars: StarCatalogue
    ra_deg: Floats
    dec_deg: Floats
    start: ApparentPlaces
    middle: ApparentPlaces
    end: ApparentPlaces
    directions: Floats
    motion: Motion
    objects: FlyingObjects
    airmass: Floats
    sky: SkyState
    cloud_optical_depth: Floats
    cloud_transmission: Floats
    scintillation: Floats
    passage: Passage | None = None
    horizon: Horizon = LEVEL
    drift: Drift | None = None
    told_camera: CameraSpec | None = None
    told_motion: Motion | None = None
    unlisted: PointLights | None = None
    unlisted_v_mag: Floats | None = None

    @property
    def is_long(self) -> bool:
        """Whether light changes over the exposure, so that it is rendered in parts."""
        return is_long(self.spec)

    @property
    def dimmed_v_mag(self) -> Floats:
        """V of the stars with cloud and scintillation, without extinction by clear air, (n,) array."""
        passed = np.maximum(self.cloud_transmission * self.scintillation, LEAST_TRANSMISSION)
        return self.stars.v_mag - 2.5 * np.log10(passed)

    @property
    def lens(self) -> CameraSpec:
        """The camera without drift."""
        return self.spec.camera if self.told_camera is None else self.told_camera

    @property
    def start_s(self) -> float:
        """Start of the exposure, seconds since noon of 2000 January 1."""
        return self.utc_start.since(EPOCH)

    @property
    def frame_id(self) -> str:
        """Stem of the frame's files."""
        return f"frame-{self.index:05d}"


def is_long(spec: FrameSpec) -> bool:
    """Whether a frame's light changes over its exposure."""
    return spec.time.exposure_s > LONGEST_LIGHT_S


def plan_frame(scenario: Scenario, index: int) -> FramePlan:
    """Plan frame `index` of a scenario. The plan depends only on the scenario and the index.

    Raises
    ------
    TimeRangeError
        The exposure is outside the Earth orientation table.
    """
    spec = scenario.frame(index)
    utc_start = Instant.parse(spec.time.utc_start)
    utc_mid = utc_start.plus(spec.shutter_s / 2)
    orientation = earth_orientation(utc_mid)
    site = Site(spec.site.latitude_deg, spec.site.longitude_deg, spec.site.height_m)
    air = refracting_air(spec.atmosphere)
    passage = scenario.passage(index)
    under = under_clouds(spec, utc_mid, passage)
    sky = sky_state(site, utc_mid, orientation, air, spec.sky.clouds, scenario.seed, under, through_clouds(spec))
    carried = passage.R_cam if passage is not None and passage.moves else None
    motion = plan_motion(spec, scenario.seed, index, carried)
    drift, told_camera, told_motion = None, None, None
    if spec.drift is not None:
        drift = drift_at(spec.drift, scenario.seed, utc_mid.mjd, spec.atmosphere.temperature_c)
        told_camera, told_motion = spec.camera, motion
        spec, motion = spec.model_copy(update={"camera": drift.camera(told_camera)}), drift.motion(told_motion)
    horizon = horizon_of(site, air, spec.site.horizon_ground_m)
    stars = _stars_around(spec, motion, sky, site, utc_mid, orientation, horizon.altitude_deg)
    unlisted = None
    if (listed := spec.stars.listed_magnitude) is not None:
        bright = stars.v_mag <= listed
        unlisted, stars = stars[~bright], stars[bright]
    if spec.stars.scatter_arcsec or spec.stars.scatter_mag:
        rng = random_stream(scenario.seed, "star_scatter", index)
        stars = scattered(stars, spec.stars.scatter_arcsec, spec.stars.scatter_mag, rng)

    def up(stars: StarCatalogue) -> tuple[StarCatalogue, ApparentPlaces, list[ApparentPlaces]]:
        """Return stars above the horizon, their places at mid-exposure, and their path over the shutter's time."""
        places = intermediate_places(stars, site, utc_mid, orientation)
        path = [
            observed_places(places, site, utc_start.plus(float(after)), orientation, air)
            for after in np.linspace(0, spec.shutter_s, 2 + int(spec.shutter_s / LONGEST_STEP_S))
        ]
        if spec.shutter_s <= LONGEST_CHORD_S:
            middle = path[0].midway_to(path[1])
        else:
            middle = observed_places(places, site, utc_mid, orientation, air)
        above_horizon = middle.enu[:, 2] > horizon.sine
        if is_long(spec):
            above_horizon |= np.any([moment.enu[:, 2] > horizon.sine for moment in path], axis=0)
        if above_horizon.all():
            return stars, middle, path
        rows = np.flatnonzero(above_horizon)
        return stars[rows], middle[rows], [places[rows] for places in path]

    stars, middle, path = up(stars)
    ra_deg, dec_deg = places_of_date(stars, utc_mid)
    air_path = airmass_above(horizon, middle.altitude_deg)
    scintillation = np.ones(len(stars))
    if spec.stars.scintillation:
        sigma = scintillation_sigma(spec.camera.aperture_mm, air_path, spec.time.exposure_s, spec.site.height_m)
        factors = scintillation_factors(sigma, random_stream(scenario.seed, "scintillation", index))
        # Planets are disks, over which scintillation averages out.
        scintillation = np.where(stars.star_id < PLANET_ID_BASE, factors, 1.0)
    watch = Watch(
        start=utc_start,
        shutter_s=spec.shutter_s,
        site=site,
        orientation=orientation,
        air=air,
        horizon_sine=horizon.sine,
        seed=scenario.seed,
        sun=true_equator_of_date(sky.sun_icrs, utc_mid),
        dims=dimming_atmosphere(spec.atmosphere),
        clouds=sky.clouds,
    )
    objects = plan_objects(spec.foreground, watch)
    if (glints := spec.foreground.glints) is not None:
        rng = random_stream(scenario.seed, "glints", index)
        objects = joined([objects, plan_glints(glints, spec.camera, motion.R_mid, spec.foreground.flying_count, rng)])
    depth, transmission = np.zeros(len(stars)), np.ones(len(stars))
    if sky.clouds is not None:
        depth, transmission = sky.clouds.depth_and_transmission(level_or_up(middle.enu))
    unlisted_lights, unlisted_v_mag = None, None
    if unlisted is not None:
        unlisted, halfway, tracks = up(unlisted)
        unlisted_lights = _lights(unlisted, halfway, tracks, sky, horizon, spec.atmosphere.extinction)
        unlisted_v_mag = unlisted.v_mag
    return FramePlan(
        scenario=scenario,
        index=index,
        spec=spec,
        utc_start=utc_start,
        utc_mid=utc_mid,
        orientation=orientation,
        stars=stars,
        ra_deg=ra_deg,
        dec_deg=dec_deg,
        start=path[0],
        middle=middle,
        end=path[-1],
        directions=np.stack([places.enu for places in path], axis=1),
        motion=motion,
        objects=objects,
        airmass=air_path if spec.atmosphere.extinction else np.zeros(len(stars)),
        sky=sky,
        cloud_optical_depth=depth,
        cloud_transmission=transmission,
        scintillation=scintillation,
        passage=passage,
        horizon=horizon,
        drift=drift,
        told_camera=told_camera,
        told_motion=told_motion,
        unlisted=unlisted_lights,
        unlisted_v_mag=unlisted_v_mag,
    )


def _lights(
    stars: StarCatalogue,
    middle: ApparentPlaces,
    path: list[ApparentPlaces],
    sky: SkyState,
    horizon: Horizon,
    extinction: bool,
) -> PointLights:
    """Stars as points of light, dimmed by cloud; they do not scintillate."""
    return PointLights.in_the_open(
        np.stack([places.enu for places in path], axis=1),
        behind_cloud(stars.v_mag, sky.clouds, middle.enu),
        stars.bv_mag,
        stars.vi_mag,
        airmass_above(horizon, middle.altitude_deg) if extinction else np.zeros(len(stars)),
    )


def airmass_to(horizon: Horizon, altitude_deg: Floats) -> Floats:
    """Relative airmass at apparent altitudes, including those between the horizon and the horizontal."""
    return airmass(np.where(horizon.dips, np.abs(altitude_deg), altitude_deg)) + horizon.further(altitude_deg)


def airmass_above(horizon: Horizon, altitude_deg: Floats) -> Floats:
    """Relative airmass at apparent altitudes, below the horizon that of the horizon."""
    return airmass_to(horizon, np.maximum(altitude_deg, horizon.altitude_deg))


def under_clouds(spec: FrameSpec, utc_mid: Instant, passage: Passage | None) -> UnderClouds:
    """Return the camera's place under the cloud; within a sequence, the wind's time does not restart at midnight."""
    camera_km = (spec.site.height_m - spec.site.horizon_ground_m) / 1000
    if passage is None:
        return dataclasses.replace(UnderClouds.since_midnight(utc_mid), camera_km=camera_km)
    first = passage.first.mjd
    days = first % 1.0 + passage.middle_s / SECONDS_PER_DAY
    return UnderClouds(days, passage.moved_km, int(first // 1), camera_km)


def through_clouds(spec: FrameSpec) -> ThroughClouds:
    """Return how the camera looks through cloud.

    A star's image reaches to two standard deviations of the point spread function (86 % of a Gaussian's light).
    """
    return ThroughClouds(spec.shutter_s, 2 * equivalent_sigma_px(spec.camera) / spec.camera.projection.f_px)


def _stars_around(
    spec: FrameSpec,
    motion: Motion,
    sky: SkyState,
    site: Site,
    instant: Instant,
    orientation: EarthOrientation,
    horizon_deg: float,
) -> StarCatalogue:
    """Return a superset of the stars and planets that are above the horizon and in the frame at some time of the exposure."""
    catalogue = load_catalogue() if spec.stars.catalogue == "ybsc+hipparcos" else load_with_tycho2()
    boresight = motion.R_mid[2]
    turned = np.degrees(np.arccos(np.clip(motion.R_cam[:, 2] @ boresight, -1, 1))).max()
    risen_deg = spec.shutter_s / 2 * SKY_RATE_DEG_S if is_long(spec) else 0.0
    field_deg = field_radius_deg(spec.camera) + turned + spec.shutter_s * SKY_RATE_DEG_S + FIELD_MARGIN_DEG
    parts = [catalogue]
    if spec.stars.planets:
        parts.append(planets(site, instant, orientation))
    chosen = []
    for part in parts:
        wanted = part.v_mag <= spec.stars.limiting_magnitude
        wanted &= stars_within(part, sky.icrs_from_enu[:, 2], 90 - horizon_deg + FIELD_MARGIN_DEG + risen_deg)
        wanted &= stars_within(part, sky.icrs_from_enu @ boresight, field_deg)
        chosen.append(part[wanted])
    return chosen[0].joined(chosen[1]) if len(chosen) > 1 else chosen[0]


@functools.lru_cache(maxsize=64)
def field_radius_deg(camera: CameraSpec) -> float:
    """Angle from the boresight, deg, beyond which no star's light touches the frame of a stationary camera."""
    reach_px = PSF_REACH_SIGMAS * equivalent_sigma_px(camera)
    if camera.psf is not None:
        drawn_px = camera.psf.support_px + abs(camera.psf.lateral_chromatic_px) * LARGEST_CHROMATIC_SHARE
        reach_px = max(reach_px, drawn_px)
    return camera.projection.angle_deg(camera.corner_px + reach_px + 2)


def refracting_air(spec: LocalAtmosphereSpec) -> Air:
    """Return the refracting air; without pressure if refraction is off."""
    # Refraction is proportional to the air's density.
    bending_hpa = spec.refraction_factor * spec.pressure_hpa if spec.refraction else 0.0
    return Air(bending_hpa, spec.temperature_c, spec.relative_humidity)


def dimming_atmosphere(spec: LocalAtmosphereSpec) -> Atmosphere | None:
    """Return the atmosphere that dims the light, or None if extinction is off."""
    if not spec.extinction:
        return None
    water_cm = (
        precipitable_water_cm(spec.temperature_c, spec.relative_humidity)
        if spec.precipitable_water_mm is None
        else spec.precipitable_water_mm / 10
    )
    return Atmosphere(spec.pressure_hpa, spec.aerosol_tau_550, spec.angstrom_exponent, spec.ozone_du, water_cm)
