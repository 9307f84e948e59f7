"""The scenario's ``foreground`` section: geometry in front of the sky, and flying objects."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import AfterValidator, BeforeValidator, Field, ValidationInfo, model_validator
from sgp4.api import SGP4_ERRORS, Satrec
from sgp4.io import verify_checksum

from generator.scenario.ground.lamp_spec import LampSpec
from generator.scenario.ground.landscape_spec import LandscapeSpec
from generator.scenario.horizon_profile import read_profile
from generator.scenario.strict import File, Fraction, InputFile, Strict, listed

Magnitude = Annotated[float, Field(ge=-20, le=12)]
Metres = Annotated[float, Field(ge=-1e6, le=1e6)]
NO_WAY_RAD = 1e-12
"""Length of a path below which a light counts as standing still."""
MOST_SATELLITES = 100_000
"""Largest number of satellites of all shells: twice those of all constellations that are planned, in 2 GB of memory."""


def _readable_mesh(file: InputFile) -> InputFile:
    from generator.scenario.mesh_file import (
        read_mesh,  # loads Mitsuba, which is slow and unnecessary for scenarios without meshes
    )

    read_mesh(file)
    return file


def _closed_mesh(closed: bool, info: ValidationInfo) -> bool:
    from generator.scenario.mesh_file import read_mesh

    if closed and "file" in info.data:
        file = info.data["file"]
        open_edges = read_mesh(file).open_edges
        if open_edges:
            raise ValueError(
                f"'{file.path}' is not closed: {open_edges} edges do not join exactly two faces; "
                "mend it, or say closed: false for an open sheet"
            )
    return closed


class ShapeSpec(Strict):
    """A mesh, in metres: x east, y north, z up; the camera is at the origin."""

    file: Annotated[File, AfterValidator(_readable_mesh)]
    """Mesh file, PLY or OBJ."""
    translate_m: Annotated[tuple[Metres, Metres, Metres], BeforeValidator(listed)] = (0.0, 0.0, 0.0)
    """Translation after scaling, m."""
    scale: Annotated[float, Field(gt=0, le=1e6)] = 1.0
    reflectance: Fraction = 0.15
    """Diffuse reflectance, 0-1."""
    closed: Annotated[bool, AfterValidator(_closed_mesh)] = Field(default=True, validate_default=True)
    """Whether the mesh must be a closed solid; terrain and skylines may be open sheets (false)."""


class HorizonSpec(Strict):
    """A horizon profile around the camera."""

    file: File
    """CSV with the columns azimuth_deg, elevation_deg; linear in between, closed around the circle."""
    distance_m: Annotated[float, Field(ge=1, le=1e6)] = 1000.0
    """Distance of the wall that represents the profile, m."""
    reflectance: Fraction = 0.15
    """Diffuse reflectance, 0-1."""

    @model_validator(mode="after")
    def _readable(self) -> HorizonSpec:
        read_profile(self.file)
        return self


class DirectionSpec(Strict):
    """An apparent direction."""

    azimuth_deg: Annotated[float, Field(ge=-360, le=360)]
    altitude_deg: Annotated[float, Field(ge=-90, le=90)]

    def opposite(self, other: DirectionSpec) -> bool:
        """Whether another direction is opposite, so that every great circle through one leads to the other."""
        both = [[math.radians(value) for value in (one.azimuth_deg, one.altitude_deg)] for one in (self, other)]
        (x, y, z), (u, v, w) = (
            (math.sin(azimuth) * math.cos(altitude), math.cos(azimuth) * math.cos(altitude), math.sin(altitude))
            for azimuth, altitude in both
        )
        return math.hypot(x + u, y + v, z + w) < NO_WAY_RAD


class StrobeSpec(Strict):
    """Flashes of an aircraft's anti-collision light; `v_mag` is the brightness within a flash."""

    period_s: Annotated[float, Field(gt=0, le=100)] = 1.0
    flash_s: Annotated[float, Field(gt=0, le=10)] = 0.05
    first_s: Annotated[float, Field(ge=-1000, le=1000)] = 0.0
    """Start of a flash, from the start of the exposure, s."""


def _check_way(start: DirectionSpec, end: DirectionSpec) -> None:
    if start.opposite(end):
        raise ValueError(
            "end: is opposite to start, where no single great circle leads; give an end before it, and an earlier end_s"
        )


class TrailSpec(Strict):
    """A light that crosses the sky on a great circle at constant speed."""

    kind: Literal["satellite", "aircraft", "meteor"]
    start: DirectionSpec
    """Direction at `start_s`."""
    end: DirectionSpec
    """Direction at `end_s`."""
    start_s: Annotated[float, Field(ge=-3600, le=3600)] = 0.0
    """Time from the start of the exposure before which the light is off, s."""
    end_s: Annotated[float, Field(ge=-3600, le=7200)] | None = None
    """Time from the start of the exposure after which the light is off, s; the end of the exposure unless given."""
    v_mag: Annotated[float, Field(ge=-20, le=12)]
    """Apparent V at the ground; of a meteor, at its maximum."""
    bv_mag: Annotated[float, Field(ge=-0.5, le=3)] = 0.65
    strobe: StrobeSpec | None = None

    @model_validator(mode="after")
    def _sensible(self) -> TrailSpec:
        if self.end_s is not None and self.end_s <= self.start_s:
            raise ValueError("end_s must come after start_s")
        _check_way(self.start, self.end)
        if self.strobe is not None and self.kind != "aircraft":
            raise ValueError("strobe: only an aircraft has one")
        return self


class TleSpec(Strict):
    """A satellite on the orbit of a two-line element set."""

    line1: Annotated[str, Field(min_length=69, max_length=69)]
    line2: Annotated[str, Field(min_length=69, max_length=69)]
    v_mag: Annotated[float, Field(ge=-20, le=12)]
    """Apparent V at the ground."""
    bv_mag: Annotated[float, Field(ge=-0.5, le=3)] = 0.65

    @model_validator(mode="after")
    def _element_set(self) -> TleSpec:
        try:
            verify_checksum(self.line1, self.line2)
            orbit = Satrec.twoline2rv(self.line1, self.line2)
        except ValueError as error:
            raise ValueError(f"not a two-line element set ({str(error).splitlines()[0]})") from error
        if not (self.line1.startswith("1 ") and self.line2.startswith("2 ") and self.line1[2:7] == self.line2[2:7]):
            raise ValueError("not a two-line element set (lines 1 and 2 of one satellite)")
        if orbit.error:
            raise ValueError(f"not a two-line element set ({SGP4_ERRORS.get(orbit.error, 'unusable elements')})")
        return self


class TrainSpec(Strict):
    """Satellites in a line, one after the other on one great circle, as after a launch."""

    start: DirectionSpec
    """Direction of the first at `start_s`."""
    end: DirectionSpec
    """Direction of the first at `end_s`."""
    start_s: Annotated[float, Field(ge=-3600, le=3600)] = 0.0
    end_s: Annotated[float, Field(ge=-3600, le=7200)]
    count: Annotated[int, Field(ge=1, le=200)] = 20
    gap_s: Annotated[float, Field(gt=0, le=600)] = 2.0
    """Time between two satellites at one place, s."""
    v_mag: Annotated[float, Field(ge=-20, le=12)]
    """Apparent V of each at the ground."""
    bv_mag: Annotated[float, Field(ge=-0.5, le=3)] = 0.65

    @model_validator(mode="after")
    def _sensible(self) -> TrainSpec:
        if self.end_s <= self.start_s:
            raise ValueError("end_s must come after start_s")
        _check_way(self.start, self.end)
        return self


class ShellSpec(Strict):
    """A constellation of satellites on circular orbits; those above the horizon in sunlight are drawn."""

    altitude_km: Annotated[float, Field(ge=200, le=40_000)] = 550.0
    inclination_deg: Annotated[float, Field(ge=0, le=180)] = 53.0
    planes: Annotated[int, Field(ge=1, le=200)] = 72
    per_plane: Annotated[int, Field(ge=1, le=200)] = 22
    v_mag_1000_km: Annotated[float, Field(ge=-5, le=15)] = 7.2
    """V at a distance of 1000 km above the atmosphere; dimmed by air, cloud and the square of the distance."""
    bv_mag: Annotated[float, Field(ge=-0.5, le=3)] = 0.65

    @property
    def count(self) -> int:
        """Number of satellites."""
        return self.planes * self.per_plane


class GlintsSpec(Strict):
    """False stars: lights that stand still and have the image of a star, such as lit dust and distant lamps."""

    count: Annotated[int, Field(ge=0, le=10_000)]
    """Number of lights in the image, at random positions that differ in each frame."""
    v_mag: Annotated[tuple[Magnitude, Magnitude], BeforeValidator(listed)] = (1.0, 6.0)
    """Range of the apparent V at the ground, within which it is uniformly distributed."""
    bv_mag: Annotated[float, Field(ge=-0.5, le=3)] = 0.65

    @model_validator(mode="after")
    def _ordered(self) -> GlintsSpec:
        if self.v_mag[0] > self.v_mag[1]:
            raise ValueError("v_mag: give the brighter limit first")
        return self


class ForegroundSpec(Strict):
    """Geometry in front of the sky, and flying objects."""

    landscape: LandscapeSpec | None = None
    horizon: HorizonSpec | None = None
    shapes: Annotated[tuple[ShapeSpec, ...], Field(max_length=100), BeforeValidator(listed)] = ()
    lamps: Annotated[tuple[LampSpec, ...], Field(max_length=1000), BeforeValidator(listed)] = ()
    lit_directions: Annotated[int, Field(ge=0, le=1024)] = 16
    """Number of sky directions from which geometry is lit, a power of two; 0 leaves black silhouettes."""
    trails: Annotated[tuple[TrailSpec, ...], Field(max_length=1000), BeforeValidator(listed)] = ()
    satellites: Annotated[tuple[TleSpec, ...], Field(max_length=1000), BeforeValidator(listed)] = ()

    trains: Annotated[tuple[TrainSpec, ...], Field(max_length=20), BeforeValidator(listed)] = ()
    shells: Annotated[tuple[ShellSpec, ...], Field(max_length=10), BeforeValidator(listed)] = ()
    # Excluded from the scenario's hash unless given, as if the key did not exist.
    glints: GlintsSpec | None = Field(default=None, exclude_if=lambda glints: glints is None)
    """False stars."""

    @model_validator(mode="after")
    def _countable_satellites(self) -> ForegroundSpec:
        count = sum(shell.count for shell in self.shells)
        if count > MOST_SATELLITES:
            raise ValueError(f"shells: found {count} satellites, at most {MOST_SATELLITES}; lower planes or per_plane")
        return self

    def check_exposure(self, shutter_s: float) -> None:
        """Refuse trails that would never shine in an exposure. Raises ValueError."""
        for number, trail in enumerate(self.trails):
            if trail.end_s is None and trail.start_s >= shutter_s:
                raise ValueError(
                    f"foreground.trails.{number}.start_s: {trail.start_s:g} s is not before the end of the exposure, "
                    f"{shutter_s:g} s, at which the trail ends; give an earlier start_s, or end_s"
                )

    @property
    def flying_count(self) -> int:
        """Number of trails and satellites, those of trains and shells included, whether they are seen or not."""
        in_trains, in_shells = sum(train.count for train in self.trains), sum(shell.count for shell in self.shells)
        return len(self.trails) + len(self.satellites) + in_trains + in_shells

    @property
    def first_lamp(self) -> int:
        """Number of the first lamp in the table of objects, after the flying objects and the false stars."""
        return self.flying_count + (0 if self.glints is None else self.glints.count)

    @property
    def hides_sky(self) -> bool:
        """Whether anything stands in front of the sky."""
        return self.landscape is not None or self.horizon is not None or bool(self.shapes)
