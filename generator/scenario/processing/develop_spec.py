"""The scenario's ``sensor.develop`` section: development of the raw frame in the camera."""

from __future__ import annotations

import re
from typing import Annotated, Literal

from pydantic import AfterValidator, BeforeValidator, Discriminator, Field, Tag

from generator.scenario.processing.video_spec import DenoiseSpec, SharpenSpec
from generator.scenario.strict import Strict, listed

LARGEST_FACTOR = 1e4
"""Largest exposure factor of a developed picture."""

Exposure = Annotated[
    Annotated[float, Field(gt=0, le=LARGEST_FACTOR), Tag("#factor")] | Annotated[Literal["auto"], Tag("#auto")],
    Discriminator(lambda value: "#auto" if isinstance(value, str) else "#factor"),
]
Gamma = Annotated[
    Annotated[float, Field(ge=1, le=4), Tag("#power")] | Annotated[Literal["srgb", "linear"], Tag("#named")],
    Discriminator(lambda value: "#named" if isinstance(value, str) else "#power"),
]


def _offset(text: str) -> str:
    if not re.fullmatch(r"[+-](0\d|1[0-4]):(00|15|30|45)", text):
        raise ValueError(f"found {text!r}, expected an offset from UTC such as +02:00")
    return text


def _name(text: str) -> str:
    if not re.fullmatch(r"[ -~]{1,60}", text):
        raise ValueError(f"found {text!r}, expected 1 to 60 characters of ASCII")
    return text


Name = Annotated[str, AfterValidator(_name)]


class GravitySpec(Strict):
    """A telephone's accelerometer, whose reading the manufacturer writes among the tags."""

    form: Literal["apple"] = "apple"
    """Form of the maker note: Apple's, tag 0x0008 (AccelerationVector)."""
    # Ten milli-g is the rms by which the length of the vector differs from 1 in eight photographs whose tags are
    # public.
    offset_mg: Annotated[float, Field(ge=0, le=200)] = 10.0
    """Rms of each axis' offset, the same in all frames, thousandths of g."""
    noise_mg: Annotated[float, Field(ge=0, le=200)] = 1.0
    """Rms of each axis' noise, different in every frame, thousandths of g."""


class PhotoSpec(Strict):
    """A file as a camera writes it, with its tags."""

    format: Literal["jpeg", "heif"] = "jpeg"
    """File format; ``heif`` needs the package pillow-heif (``skybench[heif]``)."""
    quality: Annotated[int, Field(ge=1, le=100)] = 90
    """Quality of the coding, 1 to 100."""
    subsampling: Literal["4:4:4", "4:2:2", "4:2:0"] = "4:2:0"
    """Chroma subsampling."""
    utc_offset: Annotated[str, AfterValidator(_offset)] = "+00:00"
    """Offset of the camera's clock from UTC."""
    clock_error_s: Annotated[float, Field(ge=-86400, le=86400)] = 0.0
    """Error of the camera's clock: displayed time minus true time, s."""
    orientation: Annotated[int, Field(ge=1, le=8)] = 1
    """Orientation tag, which states how to turn the stored picture; pixels and truth are as stored."""
    gps: bool = False
    """Whether the position is among the tags."""
    pointing: bool = False
    """Whether the boresight's altitude and azimuth are among the tags, as whole hundredths of a degree."""
    gravity: GravitySpec | None = Field(default=None, exclude_if=lambda gravity: gravity is None)
    """Write the accelerometer's reading in a maker note."""
    make: Name = "skybench"
    camera: Name = "skybench"
    lens: Name | None = None


class DevelopSpec(Strict):
    """An 8-bit picture besides the raw one: demosaicing, white balance, noise reduction, transfer curve, sharpening."""

    white_balance: Annotated[tuple[float, float, float], BeforeValidator(listed)] | None = None
    """Factors on red, green, blue; grey-world factors unless given."""
    exposure: Exposure = 1.0
    """Factor before the transfer curve; 1 maps the largest DN to white; ``auto`` derives it from the frame's own light."""
    gamma: Gamma = "srgb"
    """Transfer curve: ``srgb``, ``linear``, or g for the light to the power of 1 / g."""
    # These keys are left out of the scenario's hash unless given, as if they did not exist.
    denoise: DenoiseSpec | None = Field(default=None, exclude_if=lambda denoise: denoise is None)
    """Noise reduction after white balance and exposure, on linear light."""
    sharpen: SharpenSpec | None = Field(default=None, exclude_if=lambda sharpen: sharpen is None)
    """Unsharp mask after the transfer curve."""
    photo: PhotoSpec | None = Field(default=None, exclude_if=lambda photo: photo is None)
    """Also write a photograph file with tags."""
