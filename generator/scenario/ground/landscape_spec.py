"""A landscape around the camera: a picture, a package of Stellarium, hills of an elevation raster, or a skyline."""

from __future__ import annotations

import dataclasses
import functools
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BeforeValidator, Field, model_validator

from generator.ground.linear_picture import read_linear
from generator.ground.panorama import Bytes, Panorama
from generator.ground.picture import equirectangular, fisheye, read_picture
from generator.ground.skylines.stored import stored_skyline
from generator.ground.stellarium.landscape import read_landscape
from generator.ground.terrain.geotiff import Elevation, ElevationError, read_elevation
from generator.ground.terrain.hills import terrain_panorama
from generator.scenario.strict import File, Fraction, InputFile, Strict, listed
from generator.seeds import random_stream

Angle = Annotated[float, Field(ge=-360, le=360)]


LEAST_REFLECTANCE = 1e-3
Skyline = Literal["hills", "forest", "roofs", "masts", "street"]
OF_PICTURES = {"projection", "azimuth_deg", "top_deg", "bottom_deg", "fov_deg", "mirrored", "glow_file"}
"""Keys of pictures, which a package does not take because it contains its own values."""


class LandscapeSpec(Strict):
    """Surroundings of the camera, lit by the night: a picture whose transparent parts show the sky, or a drawn landscape."""

    file: File | None = None
    """Picture with transparency (PNG, TIFF, WebP; OpenEXR of linear values), or a landscape package of Stellarium (.zip)."""
    dem: File | None = None
    """Instead of a file: elevation raster (GeoTIFF, metres, in geographic or UTM coordinates) that contains the site; the
    terrain is drawn as seen from there."""
    skyline: Annotated[tuple[Skyline, ...], BeforeValidator(listed), Field(max_length=8)] = ()
    """Without a file, or in front of an elevation raster: random scenery to draw, from far to near: hills, forest, roofs,
    masts and street."""
    variant: Annotated[int, Field(ge=0, le=1_000_000_000)] = 0
    """Number of the skyline among those that the scenario's seed can produce."""
    projection: Literal["equirectangular", "fisheye"] = "equirectangular"
    """Projection of the picture: once around in equal steps, or a disk with the zenith at its centre."""
    azimuth_deg: Angle = 0.0
    """Azimuth at the left edge of an equirectangular picture, or at the top of a fisheye picture, deg."""
    top_deg: Annotated[float, Field(gt=-90, le=90)] = 90.0
    """Altitude of the upper edge of an equirectangular picture, deg."""
    bottom_deg: Annotated[float, Field(ge=-90, lt=90)] = -90.0
    """Altitude of the lower edge of an equirectangular picture, deg."""
    fov_deg: Annotated[float, Field(gt=0, le=360)] = 180.0
    """Field of view across the circle that touches the nearer edges of a fisheye picture, deg."""
    mirrored: bool = False
    """Whether a fisheye picture with north up has east on the right, as a map has; otherwise it is as seen when looking
    up."""
    reflectance: Fraction = 1.0
    """Diffuse reflectance of the picture's white (of the value 1 in OpenEXR); that of its other colours is in proportion."""
    glow_file: File | None = None
    """Picture of the same size and projection that shows the light emitted by the landscape itself (windows, signs)."""
    glow_cd_m2: Annotated[float, Field(ge=0, le=1e6)] = 10.0
    """Luminance of that picture's white (of the value 1 in OpenEXR), cd/m^2."""
    eye_height_m: Annotated[float, Field(gt=0, le=10000)] = 1.6
    """Height of the camera above the ground, for the light of lamps on the ground and for the view over an elevation
    raster, m."""
    distance_m: Annotated[float, Field(ge=1, le=1e6)] = 50.0
    """Distance of everything above the horizon, for the light that lamps cast on it, m."""

    @model_validator(mode="after")
    def _readable(self) -> LandscapeSpec:
        if (self.file is None) == (not self.skyline and self.dem is None):
            raise ValueError("give either file, or skyline and dem, or one of these")
        extra = sorted(self.model_fields_set & OF_PICTURES)
        if extra and (self.file is None or self.is_package):
            raise ValueError(f"{extra[0]} belongs to a picture: leave it out")
        if self.bottom_deg >= self.top_deg:
            raise ValueError(f"bottom_deg ({self.bottom_deg:g}) must be below top_deg ({self.top_deg:g})")
        if self.file is not None:
            landscape_panorama(self, 0)
        if self.dem is not None:
            elevation_of(self.dem)
        return self

    def place(self, latitude_deg: float, longitude_deg: float) -> tuple[float, float] | None:
        """The site if the landscape depends on it, else None."""
        return None if self.dem is None else (latitude_deg, longitude_deg)

    @property
    def is_package(self) -> bool:
        """Whether the file is a landscape package of Stellarium."""
        return self.file is not None and self.file.path.lower().endswith(".zip")


@functools.lru_cache(maxsize=2)
def landscape_panorama(spec: LandscapeSpec, seed: int, place: tuple[float, float] | None = None) -> Panorama:
    """Return the panorama of a landscape; drawn parts depend on the scenario's seed (stream ``landscape``).

    Parameters
    ----------
    spec : LandscapeSpec
    seed : int
    place : (latitude, longitude)
        Place of the camera, deg, for an elevation raster.

    Raises
    ------
    PictureError, PackageError, ElevationError
        A file cannot be used.
    """
    if spec.dem is not None:
        if place is None:
            raise ValueError("an elevation raster is seen from a place")
        rng = random_stream(seed, "landscape", spec.variant)
        panorama = terrain_panorama(
            elevation_of(spec.dem), place, spec.eye_height_m, spec.skyline, rng, spec.glow_cd_m2
        )
        return dataclasses.replace(panorama, white_reflectance=spec.reflectance)
    if spec.file is None:
        return stored_skyline(spec.skyline, seed, spec.variant, spec.glow_cd_m2)
    if spec.is_package:
        panorama = read_landscape(Path(spec.file.location), spec.file.path)
        return dataclasses.replace(panorama, glow_cd_m2=spec.glow_cd_m2, white_reflectance=spec.reflectance)
    # No surface reflects more light than it receives.
    picture, white = _picture(spec.file, 1 / max(spec.reflectance, LEAST_REFLECTANCE))
    glow, shine = (None, 1.0) if spec.glow_file is None else _picture(spec.glow_file, None)
    if glow is not None and spec.glow_file is not None and glow.shape != picture.shape:
        raise ValueError(
            f"'{spec.glow_file.path}' has {glow.shape[1]} x {glow.shape[0]} pixels, '{spec.file.path}' has "
            f"{picture.shape[1]} x {picture.shape[0]}: make them the same"
        )
    if spec.projection == "equirectangular":
        panorama = equirectangular(picture, spec.top_deg, spec.bottom_deg, spec.azimuth_deg, glow)
    else:
        panorama = fisheye(picture, spec.fov_deg, spec.azimuth_deg, spec.mirrored, glow)
    return dataclasses.replace(panorama, glow_cd_m2=spec.glow_cd_m2 * shine, white_reflectance=spec.reflectance * white)


def _picture(file: InputFile, most: float | None) -> tuple[Bytes, float]:
    """Return a picture encoded in sRGB, and the linear value of its white: 1 unless its format supports larger ones."""
    if file.path.lower().endswith(".exr"):
        linear = read_linear(Path(file.location), file.path, most)
        return linear.rgba, linear.white
    return read_picture(Path(file.location).read_bytes(), file.path), 1.0


@functools.lru_cache(maxsize=1)
def elevation_of(file: InputFile) -> Elevation:
    """Read an elevation raster.

    Raises
    ------
    ElevationError
    """
    return read_elevation(Path(file.location).read_bytes(), file.path)


def check_place(spec: LandscapeSpec, latitude_deg: float, longitude_deg: float) -> None:
    """Check that an elevation raster has a height at the site.

    Raises
    ------
    ElevationError
    """
    if spec.dem is not None and elevation_of(spec.dem).at_place(latitude_deg, longitude_deg) is None:
        raise ElevationError(
            f"foreground.landscape.dem: '{spec.dem.path}' has no height at the site, latitude {latitude_deg:g}, longitude "
            f"{longitude_deg:g} deg; take a raster that holds the site"
        )
