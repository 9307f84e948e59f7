"""A developed frame as a photograph's file: JPEG or HEIF with the tags that a camera writes.

Source of the tags: CIPA DC-008-2019, "Exchangeable image file format for digital still cameras: Exif Version 2.32"; for
the equivalent focal length, CIPA DCG-001 (equal diagonals).
"""

from __future__ import annotations

import io
import math
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from PIL.TiffImagePlugin import IFDRational

from generator.reading.heif_file import heif_library
from generator.scenario.model import FrameSpec, Pointing
from generator.scenario.processing.develop_spec import PhotoSpec
from generator.scenario.sensor_spec import SensorSpec
from generator.sensor.maker_note import apple_note

PHOTO_SUFFIXES = {"jpeg": "photo.jpg", "heif": "photo.heic"}
"""Suffix of the file by its format."""
SUBSAMPLINGS = {"4:4:4": 0, "4:2:2": 1, "4:2:0": 2}
EXIF_IFD, GPS_IFD = 0x8769, 0x8825
MAKER_NOTE = 0x927C
BYTE, UNDEFINED = 1, 7
"""TIFF's numbers of data types."""
DIAGONAL_35MM = math.hypot(36.0, 24.0)
CENTIMETRE = 3
"""Unit of the focal plane's resolution."""


@dataclass(frozen=True)
class Taken:
    """How a photograph was taken.

    Attributes
    ----------
    spec : FrameSpec
        Specification of the frame; its camera is the true one.
    utc_start : str
        Start of the exposure, ISO 8601 with microseconds and Z.
    pointing : Pointing
        Pointing at mid-exposure.
    acceleration_g : tuple of float or None
        The accelerometer's reading, if the camera writes one.
    """

    spec: FrameSpec
    utc_start: str
    pointing: Pointing
    acceleration_g: tuple[float, float, float] | None = None


def check_photo(sensor: SensorSpec) -> None:
    """Refuse a photograph format that cannot be written here, before frames are rendered.

    Raises
    ------
    GeneratorError
        HEIF is requested, but the package pillow-heif is missing.
    """
    photo = None if sensor.develop is None else sensor.develop.photo
    if photo is not None and photo.format == "heif":
        heif_library()


def photo_bytes(picture: NDArray[np.uint8], taken: Taken, spec: PhotoSpec) -> bytes:
    """Encode a developed picture, (height, width) or (height, width, 3), as a file; the bytes depend on the coder's version.

    The coders are Pillow's libjpeg-turbo and pillow-heif's x265. A HEIF file's orientation is also in its container, so
    programs decode the picture rotated.

    Raises
    ------
    GeneratorError
        The format is HEIF and pillow-heif is missing.
    """
    stored = io.BytesIO()
    image = Image.fromarray(picture)
    if spec.format == "heif":
        options = {} if picture.ndim == 2 else {"chroma": int(spec.subsampling.replace(":", ""))}
        file = heif_library().from_pillow(image)
        file.save(stored, quality=spec.quality, exif=tag_bytes(taken, spec), **options)
        return stored.getvalue()
    chosen = {} if picture.ndim == 2 else {"subsampling": SUBSAMPLINGS[spec.subsampling]}
    image.save(stored, format="JPEG", quality=spec.quality, optimize=True, exif=tag_bytes(taken, spec), **chosen)
    return stored.getvalue()


def tag_bytes(taken: Taken, spec: PhotoSpec) -> bytes:
    """Return the tags in the form in which a file contains them."""
    stored = tags(taken, spec).tobytes()
    # Pillow gives bytes of unknown tags the type BYTE; the standard requires UNDEFINED for a maker note, of the same
    # length.
    return stored.replace(MAKER_NOTE.to_bytes(2) + BYTE.to_bytes(2), MAKER_NOTE.to_bytes(2) + UNDEFINED.to_bytes(2), 1)


def tags(taken: Taken, spec: PhotoSpec) -> Image.Exif:
    """The tags of a frame's photograph: their time is the start of the exposure on the camera's clock."""
    camera, site = taken.spec.camera, taken.spec.site
    exif = Image.Exif()
    exif[0x010F], exif[0x0110], exif[0x0112] = spec.make, spec.camera, spec.orientation
    true = _clock(taken.utc_start.removesuffix("Z"))
    hours, minutes = int(spec.utc_offset[1:3]), int(spec.utc_offset[4:])
    offset = timedelta(hours=hours, minutes=minutes) * (-1 if spec.utc_offset[0] == "-" else 1)
    shown = true + offset + timedelta(seconds=spec.clock_error_s)
    photo: dict[int, Any] = exif.get_ifd(EXIF_IFD)
    exif[0x0132] = photo[0x9003] = shown.strftime("%Y:%m:%d %H:%M:%S")
    photo[0x9291] = f"{shown.microsecond:06d}"
    photo[0x9010] = photo[0x9011] = spec.utc_offset
    photo[0x829A] = _rational(taken.spec.time.exposure_s, 1_000_000)
    photo[0xA002], photo[0xA003] = camera.width, camera.height
    photo[0xA405] = round(camera.f_px * DIAGONAL_35MM / math.hypot(camera.width, camera.height))
    if camera.pixel_pitch_um is not None:
        focal_mm = camera.f_px * camera.pixel_pitch_um / 1000
        photo[0x920A] = _rational(focal_mm, 10_000)
        photo[0x829D] = _rational(focal_mm / camera.aperture_mm, 100)
        photo[0xA20E] = _rational(10_000 / camera.pixel_pitch_um, 1000)
        photo[0xA20F] = _rational(10_000 * camera.pixel_aspect / camera.pixel_pitch_um, 1000)
        photo[0xA210] = CENTIMETRE
    if taken.acceleration_g is not None:
        photo[MAKER_NOTE] = apple_note(taken.acceleration_g)
    if spec.lens is not None:
        photo[0xA434] = spec.lens
    where: dict[int, Any] = exif.get_ifd(GPS_IFD)
    if spec.gps:
        where[1], where[2] = "NS"[site.latitude_deg < 0], _sexagesimal(site.latitude_deg)
        # The tag's range is 180 degrees to either side, the site's reaches once around from Greenwich.
        east_deg = site.longitude_deg - 360 if site.longitude_deg > 180 else site.longitude_deg
        where[3], where[4] = "EW"[east_deg < 0], _sexagesimal(east_deg)
        where[5], where[6] = bytes([site.height_m < 0]), _rational(abs(site.height_m), 100)
        seconds = true.second + true.microsecond / 1e6
        where[7] = (IFDRational(true.hour), IFDRational(true.minute), _rational(seconds, 1_000_000))
        where[29] = true.strftime("%Y:%m:%d")
    if spec.pointing:
        photo[0x9405] = _rational(taken.pointing.altitude_deg, 100)
        where[16], where[17] = "T", _rational(taken.pointing.azimuth_deg % 360, 100)
    return exif


def _clock(text: str) -> datetime:
    """Parse a time as a clock shows it; during a leap second it shows the next second."""
    if text[17:19] != "60":
        return datetime.fromisoformat(text)
    return datetime.fromisoformat(f"{text[:17]}59{text[19:]}") + timedelta(seconds=1)


def _rational(value: float, denominator: int) -> IFDRational:
    """Round a number to a multiple of one over the denominator."""
    return IFDRational(round(value * denominator), denominator)


def _sexagesimal(angle_deg: float) -> tuple[IFDRational, IFDRational, IFDRational]:
    """Degrees, minutes and seconds of an angle's size, to 1e-4 arcsec."""
    whole = round(abs(angle_deg) * 36_000_000)
    degrees, rest = divmod(whole, 36_000_000)
    minutes, left = divmod(rest, 600_000)
    return IFDRational(degrees), IFDRational(minutes), IFDRational(left, 10_000)
