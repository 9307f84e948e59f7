"""The scenario as frozen, validated data.

A scenario describes one frame, or many by *sweeps*: any value may be replaced by ``{sweep: [a, b, c]}``. Sweeps
multiply (cartesian, the last written varies fastest); sweeps that share a ``zip`` name advance together. Files are read
by :mod:`generator.scenario.file`.
"""

from __future__ import annotations

from typing import Annotated, Literal, get_args

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from generator.light.atmosphere import SEA_LEVEL_C, SEA_LEVEL_HPA, usual_pressure_hpa, usual_temperature_c
from generator.light.bake_grids import DEFAULT_ALBEDO
from generator.light.lamps import LAMP_MIX, LARGEST_DISTANCE_KM, City, lamp_spectra
from generator.places.times import Instant
from generator.scenario.camera_spec import CameraSpec
from generator.scenario.foreground_spec import ForegroundSpec
from generator.scenario.ground.landscape_spec import check_place
from generator.scenario.gyro_log import check_motion
from generator.scenario.lens.drift_spec import DriftSpec
from generator.scenario.motion_spec import MotionSpec
from generator.scenario.presets.camera_presets import with_preset
from generator.scenario.sensor_spec import SensorSpec
from generator.scenario.sky.cloud_spec import CloudSpec, GroundAlbedo
from generator.scenario.strict import Fraction, Strict


def _check_utc(text: str) -> str:
    Instant.parse(text)
    return text


Utc = Annotated[str, AfterValidator(_check_utc)]


LOWEST_SITE_M, HIGHEST_SITE_M = -500.0, 20000.0
HIGHEST_GROUND_M = 9000.0
"""Above this height, a camera is in the air."""


class SiteSpec(Strict):
    """Where the camera stands (WGS84)."""

    latitude_deg: Annotated[float, Field(ge=-90, le=90)]
    """Geodetic latitude, deg."""
    longitude_deg: Annotated[float, Field(ge=-180, le=360)]
    """Longitude, deg, east positive."""
    height_m: Annotated[float, Field(ge=LOWEST_SITE_M, le=HIGHEST_SITE_M)] = 0.0
    """Height above the ellipsoid, m."""
    ground_height_m: Annotated[float, Field(ge=LOWEST_SITE_M, le=HIGHEST_SITE_M)] | None = None
    """Height of the ground that makes the horizon, m, at most height_m; unless given, the height of the site up to 9000 m,
    and sea level for a camera above that, where there is no ground."""

    @model_validator(mode="after")
    def _over_the_ground(self) -> SiteSpec:
        if self.ground_height_m is not None and self.ground_height_m > self.height_m:
            raise ValueError(f"ground_height_m: {self.ground_height_m:g} lies above height_m, {self.height_m:g}")
        return self

    @property
    def horizon_ground_m(self) -> float:
        """Height of the ground that makes the horizon, m."""
        if self.ground_height_m is not None:
            return self.ground_height_m
        return self.height_m if self.height_m <= HIGHEST_GROUND_M else 0.0


class TimeSpec(Strict):
    """Start and length of the exposure."""

    utc_start: Utc
    """Start of the exposure, ISO 8601 with Z."""
    exposure_s: Annotated[float, Field(gt=0, le=3600)]
    """Length of the exposure, s."""


class Pointing(Strict):
    """Where the boresight points; at roll 0 the image's up is towards the zenith along the vertical circle."""

    azimuth_deg: Annotated[float, Field(ge=-360, le=360)]
    """From north through east, deg."""
    altitude_deg: Annotated[float, Field(ge=-90, le=90)]
    """Apparent altitude, deg."""
    roll_deg: Annotated[float, Field(ge=-360, le=360)] = 0.0
    """Clockwise turn of the camera about its boresight, deg."""


Pressure = Annotated[float, Field(ge=0, le=1100)]
Temperature = Annotated[float, Field(ge=-90, le=60)]


class AtmosphereSpec(Strict):
    """The air above the site."""

    pressure_hpa: Pressure | None = None
    """Pressure at the site, hPa; unless given, 1010 at sea level, falling with height as in the standard atmosphere."""
    temperature_c: Temperature | None = None
    """Temperature at the site, deg C; unless given, 10 at sea level and 6.5 less for each km, up to 11 km."""
    relative_humidity: Fraction = 0.5
    """Relative humidity, 0-1."""
    aerosol_tau_550: Annotated[float, Field(ge=0, le=5)] = 0.1
    """Vertical optical depth of aerosol at 550 nm."""
    angstrom_exponent: Annotated[float, Field(ge=-1, le=4)] = 1.3
    """Angstrom exponent of the aerosol."""
    ozone_du: Annotated[float, Field(ge=0, le=1000)] = 300.0
    """Column of ozone, Dobson units."""
    precipitable_water_mm: Annotated[float, Field(ge=0, le=100)] | None = None
    """Water vapour above the site, mm of liquid, for its absorption bands; unless given, derived from temperature and
    humidity."""
    refraction: bool = True
    """Whether refraction displaces the light."""
    # Excluded from the scenario's hash unless given, as if the key did not exist.
    refraction_factor: Annotated[float, Field(ge=0.5, le=2)] = Field(
        default=1.0, exclude_if=lambda factor: factor == 1.0
    )
    """Factor on the refraction of air with these values, which instruments measure to about 1 %: {normal: [1.0, 0.01]}."""
    extinction: bool = True
    """Whether there is air that dims and scatters light. Without it, the sky has no twilight, moonlight or scattered
    starlight, and city light is that of standard air."""


class LocalAtmosphereSpec(AtmosphereSpec):
    """The air above a site of known height, every value fixed."""

    pressure_hpa: Pressure = SEA_LEVEL_HPA
    """Pressure at the site, hPa."""
    temperature_c: Temperature = SEA_LEVEL_C
    """Temperature at the site, deg C."""


def height_followers(atmosphere: object) -> tuple[str, ...]:
    """Return the keys of an atmosphere as written (a mapping, or None) whose values follow the site's height."""
    given = atmosphere if isinstance(atmosphere, dict) else {}
    return tuple(key for key in ("pressure_hpa", "temperature_c") if given.get(key) is None)


def _local(atmosphere: object, site: object) -> object:
    """Return an atmosphere whose pressure and temperature follow the site's height unless they are given."""
    if isinstance(atmosphere, LocalAtmosphereSpec):
        return atmosphere
    if isinstance(atmosphere, AtmosphereSpec):
        atmosphere = atmosphere.model_dump()
    if not isinstance(atmosphere, dict):
        return atmosphere
    found = site.height_m if isinstance(site, SiteSpec) else site.get("height_m") if isinstance(site, dict) else None
    height_m = 0.0
    # An invalid height gets a message of its own.
    if isinstance(found, int | float) and LOWEST_SITE_M <= found <= HIGHEST_SITE_M:
        height_m = float(found)
    usual = {
        "pressure_hpa": float(usual_pressure_hpa(height_m)),
        "temperature_c": float(usual_temperature_c(height_m)),
    }
    return atmosphere | {key: usual[key] for key in height_followers(atmosphere)}


Component = Literal["airglow", "zodiacal", "milky_way", "starlight", "skyglow", "moonlight", "twilight"]
"""Name of a component of the diffuse sky."""
COMPONENTS: tuple[Component, ...] = get_args(Component)
"""Components of the diffuse sky, in the order in which they are added."""


def _check_lamps(lamps: dict[str, float]) -> dict[str, float]:
    unknown = sorted(set(lamps) - set(lamp_spectra()))
    if unknown:
        raise ValueError(f"{unknown[0]!r} is not one of the lamps {sorted(lamp_spectra())}")
    if not sum(lamps.values()) > 0:
        raise ValueError("the lamps' shares must add up to more than 0")
    return lamps


def _as_tuple(value: object) -> object:
    return tuple(value) if isinstance(value, list) else value


class CitySpec(Strict):
    """A disk of lamps."""

    distance_km: Annotated[float, Field(ge=0, le=LARGEST_DISTANCE_KM)]
    """Distance of its centre from the observer, km."""
    azimuth_deg: Annotated[float, Field(ge=-360, le=360)]
    """Azimuth of its centre, deg."""
    radius_km: Annotated[float, Field(gt=0, le=20)]
    """Radius of the disk, km."""
    upward_mlm: Annotated[float, Field(gt=0, le=1e7)] = 100.0
    """Light that leaves the city upwards over ground of albedo 0.15, megalumen; relative where bortle or
    zenith_mag_arcsec2 is given."""
    horizon_share: Fraction | None = None
    """Fraction of the upward light that follows Garstang's pattern near the horizon; the rest follows Lambert's law. Unless
    given, all of it leaves as from a built-up area, between obstacles."""
    lamps: Annotated[dict[str, Annotated[float, Field(ge=0)]], AfterValidator(_check_lamps)] = Field(
        default_factory=lambda: dict(LAMP_MIX)
    )
    """Shares of the lamps' light in V."""

    def city(self) -> City:
        """The city in the form that the sky model uses."""
        lamps = tuple(self.lamps.items())
        return City(self.distance_km, self.azimuth_deg, self.radius_km, self.upward_mlm, self.horizon_share, lamps)


class SkySpec(Strict):
    """The diffuse sky: a Bortle class, a zenith brightness, cities, or a list of components; empty for a black sky."""

    bortle: Annotated[int, Field(ge=1, le=9)] | None = None
    """Bortle class: a default city, and zenith_mag_arcsec2 from the table in docs/physics.md."""
    zenith_mag_arcsec2: Annotated[float, Field(ge=5, le=30)] | None = None
    """Total brightness of the frame's zenith without Moon, twilight and cloud, V mag/arcsec^2."""
    cities: Annotated[tuple[CitySpec, ...], BeforeValidator(_as_tuple), Field(max_length=32)] | None = None
    """Layout of cities instead of the default one."""
    components: Annotated[tuple[Component, ...], BeforeValidator(_as_tuple)] | None = None
    """Components that contribute light; all of them by default, if a brightness or cities are given."""
    solar_flux_sfu: Annotated[float, Field(ge=50, le=400)] = 70.0
    """Radio flux of the Sun at 10.7 cm, solar flux units, which scales airglow: 70 at solar minimum, 200 at maximum."""
    airglow_factor: Annotated[float, Field(ge=0, le=10)] = 1.0
    """Airglow of the night relative to its mean at this solar flux. To let nights vary: {normal: [1.0, 0.3], limits: [0.4,
    2.0]}."""
    ground_albedo: GroundAlbedo = DEFAULT_ALBEDO
    """Fraction of the light that the ground reflects: a number, points [nm, 0-1], or land (0.15), snow, water, desert."""
    clouds: CloudSpec | None = None
    """A layer of thin cloud."""

    @model_validator(mode="after")
    def _one_of_two(self) -> SkySpec:
        if self.bortle is not None and self.zenith_mag_arcsec2 is not None:
            raise ValueError("give either bortle or zenith_mag_arcsec2, not both")
        return self

    @property
    def active_components(self) -> tuple[Component, ...]:
        """Names of the components that contribute light."""
        if self.components is not None:
            return self.components
        return COMPONENTS if self.bortle or self.zenith_mag_arcsec2 is not None or self.cities else ()


class StarsSpec(Strict):
    """Which stars are drawn."""

    limiting_magnitude: Annotated[float, Field(ge=-2, le=15)] = 9.0
    """Magnitude of the faintest star or planet drawn, Johnson V; the sky's brightness (sky.bortle) does not change it."""
    catalogue: Literal["ybsc+hipparcos", "tycho2"] = "ybsc+hipparcos"
    """Source of the stars. tycho2 adds 1.4 million stars to V 11.5; the map provides the light of those beyond the limit."""
    listed_magnitude: Annotated[float, Field(ge=-2, le=15)] | None = Field(
        default=None, exclude_if=lambda mag: mag is None
    )
    """Magnitude of the faintest star or planet in the truth, if fainter ones are drawn; null lists all."""
    planets: bool = True
    """Draw Mercury, Venus and Mars to Neptune."""
    scintillation: bool = False
    """Whether each star's light varies by scintillation; off by default, so that electrons_e is the mean."""
    # Excluded from the scenario's hash unless given, as if the keys did not exist.
    scatter_arcsec: Annotated[float, Field(ge=0, le=36_000)] = Field(default=0.0, exclude_if=lambda sigma: sigma == 0.0)
    """Standard deviation of each star's position about the catalogue's along each of two axes, drawn anew for each frame,
    arcsec."""
    scatter_mag: Annotated[float, Field(ge=0, le=3)] = Field(default=0.0, exclude_if=lambda sigma: sigma == 0.0)
    """Standard deviation of each star's brightness about the catalogue's, drawn anew for each frame, mag."""


def _named_attitude(value: object) -> object:
    if isinstance(value, str):
        if value not in NAMED_ATTITUDES:
            raise ValueError(
                f"found {value!r}, expected one of {sorted(NAMED_ATTITUDES)} or azimuth_deg, altitude_deg and roll_deg"
            )
        return NAMED_ATTITUDES[value]
    return value


NAMED_ATTITUDES = {"zenith-north-up": Pointing(azimuth_deg=180.0, altitude_deg=90.0)}
Attitude = Annotated[Pointing, BeforeValidator(_named_attitude)]


class SceneSpec(Strict):
    """Common part of a single frame and a sequence of frames."""

    attitude: Attitude = NAMED_ATTITUDES["zenith-north-up"]
    """``zenith-north-up``, or azimuth, altitude and roll."""
    camera: CameraSpec
    # Excluded from the scenario's hash unless given, as if the key did not exist.
    drift: DriftSpec | None = Field(default=None, exclude_if=lambda drift: drift is None)
    """Deviation of lens and mount from the camera and attitude that solvers receive."""
    sensor: SensorSpec = SensorSpec()
    motion: MotionSpec = MotionSpec()
    foreground: ForegroundSpec = ForegroundSpec()
    atmosphere: AtmosphereSpec = AtmosphereSpec()
    sky: SkySpec = SkySpec()
    stars: StarsSpec = StarsSpec()

    @model_validator(mode="before")
    @classmethod
    def _fill_from_preset(cls, tree: object) -> object:
        return with_preset(tree)


class FrameSpec(SceneSpec):
    """One frame, every value fixed."""

    site: SiteSpec
    time: TimeSpec
    atmosphere: LocalAtmosphereSpec = LocalAtmosphereSpec()

    @model_validator(mode="before")
    @classmethod
    def _follow_the_height(cls, tree: object) -> object:
        if not isinstance(tree, dict):
            return tree
        return tree | {"atmosphere": _local(tree.get("atmosphere", {}), tree.get("site"))}

    @model_validator(mode="after")
    def _motion_covers_the_exposure(self) -> FrameSpec:
        check_motion(self.motion, self.shutter_s)
        return self

    @model_validator(mode="after")
    def _lights_and_particles_fit_the_exposure(self) -> FrameSpec:
        self.foreground.check_exposure(self.shutter_s)
        self.sensor.check_exposure(self.time.exposure_s)
        return self

    @model_validator(mode="after")
    def _site_has_a_landscape(self) -> FrameSpec:
        if self.foreground.landscape is not None:
            check_place(self.foreground.landscape, self.site.latitude_deg, self.site.longitude_deg)
        return self

    @model_validator(mode="after")
    def _whole_video_frames(self) -> FrameSpec:
        self.sensor.exposures(self.time.exposure_s)
        odd = self.camera.width % 2 or self.camera.height % 2
        if odd and self.sensor.video is not None and self.sensor.video.codec == "h264":
            raise ValueError("sensor.video.codec: h264 needs an even camera.width and camera.height")
        return self

    @property
    def shutter_s(self) -> float:
        """Time from the start of the exposure of the first row to the end of that of the last, s."""
        return self.time.exposure_s + self.sensor.read_out_s(self.camera.height)

    @property
    def R_cam(self) -> NDArray[np.float64]:
        """Rotation ENU to camera, (3, 3), from the scenario's attitude, without motion during the exposure."""
        return pointing_matrix(self.attitude)


def pointing_matrix(pointing: Pointing) -> NDArray[np.float64]:
    """Rotation ENU to camera (3, 3) of a boresight direction and a roll about it."""
    azimuth, altitude, roll = np.radians([pointing.azimuth_deg, pointing.altitude_deg, pointing.roll_deg])
    boresight = np.array([np.sin(azimuth) * np.cos(altitude), np.cos(azimuth) * np.cos(altitude), np.sin(altitude)])
    up = np.array([-np.sin(azimuth) * np.sin(altitude), -np.cos(azimuth) * np.sin(altitude), np.cos(altitude)])
    right = np.cross(boresight, up)
    turned_right = np.cos(roll) * right - np.sin(roll) * up
    turned_down = -(np.sin(roll) * right + np.cos(roll) * up)
    return np.stack([turned_right, turned_down, boresight])


def pointing_of(R_cam: NDArray[np.float64]) -> Pointing:
    """Boresight and roll of a rotation ENU to camera (3, 3); the inverse of :func:`pointing_matrix`.

    Azimuth is 0 to 360, roll -180 to 180; at the zenith and the nadir azimuth is 180.
    """
    east, north, up = R_cam[2]
    level = float(np.hypot(east, north))
    # At the zenith and nadir, azimuth and roll are one angle; the azimuth of the named attitude is as good as any.
    azimuth_deg = float(np.degrees(np.arctan2(east, north))) % 360 if level > 1e-12 else 180.0
    altitude_deg = float(np.degrees(np.arctan2(up, level)))
    level_right, level_down, _ = pointing_matrix(Pointing(azimuth_deg=azimuth_deg, altitude_deg=altitude_deg))
    roll = np.arctan2(level_down @ R_cam[0], level_right @ R_cam[0])
    return Pointing(azimuth_deg=azimuth_deg, altitude_deg=altitude_deg, roll_deg=float(np.degrees(roll)))
