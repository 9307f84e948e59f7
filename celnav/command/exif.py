"""EXIF tags of photographs: time, lens and the vertical.

Tags are untrusted input: numbers are checked, and text is truncated and stripped of anything that a terminal would act upon.
The position that a photograph may contain is not read.

Source: CIPA DC-008-2019, "Exchangeable image file format for digital still cameras: Exif Version 2.32".
"""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, SupportsFloat

from celnav.command.maker_note import Vector, acceleration_g, up_in_picture
from celnav.errors import ImageError

if TYPE_CHECKING:
    from PIL import Image

    from celnav.reading.fits_file import FitsImage

_Tags = Mapping[int, object]
_EXIF_IFD, _GPS_IFD = 0x8769, 0x8825
_LONGEST_TEXT = 60
# Years of a clock that may be right: one whose battery is dead can show the year 1 or 9999.
_YEARS = (1900, 2200)
_LONGEST_EXPOSURE_S = 86400.0
# Units of FocalPlaneResolutionUnit in millimetres; 4 and 5 are widely used although they are not in the standard.
_UNIT_MM = {2: 25.4, 3: 10.0, 4: 1.0, 5: 0.001}


@dataclass(frozen=True)
class PhotoTags:
    """Tags of a photograph; missing ones are None or empty.

    Attributes
    ----------
    width, height : int
        Size of the stored picture, pixels.
    taken : datetime or None
        Time of the camera's clock, without a time zone.
    whole_seconds : bool
        Whether that time lacks fractions of a second.
    offset : timedelta or None
        Offset of the camera's clock from UTC.
    gps_utc : datetime or None
        Time of the last position fix; UTC.
    exposure_s : float or None
        Exposure time.
    focal_length_mm, focal_length_35mm : float or None
        Focal length of the lens, and of a lens with the same diagonal field of view on 35 mm film.
    focal_plane_px_mm : float or None
        Pixels per millimetre of the sensor.
    tagged_width_px : int or None
        Width of the picture that the camera wrote.
    orientation : int
        1: stored as it is to be shown; 2 to 8: rotated or mirrored.
    camera, lens : str
        Names of camera and lens.
    up : tuple of float or None
        Direction of the zenith, from the accelerometer of a telephone, in the camera frame of the pixels as they are read.
    source : str
        Where time and exposure were found.
    lacks : str
        Reason why the time of a FITS image is not known; empty if it is known.
    """

    width: int
    height: int
    taken: datetime | None = None
    whole_seconds: bool = True
    offset: timedelta | None = None
    gps_utc: datetime | None = None
    exposure_s: float | None = None
    focal_length_mm: float | None = None
    focal_length_35mm: float | None = None
    focal_plane_px_mm: float | None = None
    tagged_width_px: int | None = None
    orientation: int = 1
    camera: str = ""
    lens: str = ""
    up: Vector | None = None
    source: str = "EXIF"
    lacks: str = ""


def tags_of_fits(image: FitsImage) -> PhotoTags:
    """Return size, and start and duration of the exposure, of a FITS image."""
    height, width = image.pixels.shape[:2]
    exposure = image.exposure
    begun = exposure.begun or exposure.middle
    return PhotoTags(
        width,
        height,
        None if begun is None else begun.replace(tzinfo=None),
        False,
        None if begun is None else timedelta(0),
        exposure_s=exposure.length_s,
        source="FITS header",
        lacks=exposure.lacks,
    )


def read_tags(path: str | Path) -> PhotoTags:
    """Read the tags of a PNG, JPEG, TIFF or HEIF; for a FITS image, its size and the start and duration of its exposure.

    Raises
    ------
    ImageError
        When the file is not such an image, or is a TIFF that must be rotated. Damaged tags count as absent.
    """
    from PIL import Image

    from celnav.reading.fits_file import is_fits, read_fits
    from celnav.reading.heif_file import is_heif, open_heif

    if is_fits(path):
        return tags_of_fits(read_fits(path))
    if is_heif(path):
        picture = open_heif(path)
        return _tags((picture.width, picture.height), *_directories(lambda: _loaded(picture.tags)), turned=True)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with Image.open(path, formats=("PNG", "JPEG", "TIFF")) as image:
                size, form = image.size, image.format
                base, photo, gps = _directories(image.getexif)
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        raise ImageError(f"image {path} cannot be read: {error}".replace("\n", " ")) from None
    tags = _tags(size, base, photo, gps)
    if form == "TIFF" and tags.orientation != 1:
        raise ImageError(
            f"image {path} is a TIFF with the orientation {tags.orientation}, by which programs turn it or do not: save it "
            "upright, or as PNG"
        )
    return tags


def read_raw_tags(path: str | Path) -> PhotoTags:
    """Read the tags of a raw file with the structure of a TIFF (DNG, NEF, CR2, ARW, PEF); another program reads its pixels.

    Tags of other raw files, and damaged ones, count as absent. The size is given as 0 x 0, because that of the first
    directory may be a preview's, and the orientation as 1, because the sensor's pixels are never turned.

    Raises
    ------
    ImageError
        When the file cannot be read.
    """
    from PIL import Image

    def read() -> Image.Exif:
        exif = Image.Exif()
        exif.load_from_fp(stream)
        return exif

    try:
        with Path(path).open("rb") as stream:
            base, photo, gps = _directories(read)
    except OSError as error:
        raise ImageError(f"image {path} cannot be read: {error.strerror}") from None
    # Files after TIFF/EP (ISO 12234-2) have the photograph's tags among those of the picture.
    return replace(_tags((0, 0), base, {**base, **photo}, gps), orientation=1)


def _loaded(content: bytes) -> Image.Exif:
    from PIL import Image

    exif = Image.Exif()
    exif.load(content)
    return exif


def _directories(read: Callable[[], Image.Exif]) -> tuple[_Tags, _Tags, _Tags]:
    """Return the tags of the picture, of the photograph and of the position; empty if they are damaged."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            exif = read()
            return dict(exif), dict(exif.get_ifd(_EXIF_IFD)), dict(exif.get_ifd(_GPS_IFD))
    except Exception:  # Pillow raises struct.error, KeyError, OverflowError and others for damaged tags
        return {}, {}, {}


def _tags(size: tuple[int, int], base: _Tags, photo: _Tags, gps: _Tags, turned: bool = False) -> PhotoTags:
    """Check the tags of a picture; `turned` states that its pixels are already rotated by its orientation."""
    fraction = re.match(r"\d+", _text(photo.get(0x9291)))
    taken = _time(photo.get(0x9003))
    if taken is not None and fraction:
        taken += timedelta(seconds=float(f"0.{fraction[0]}"))
    per_unit, unit_mm = _positive(photo.get(0xA20E)), _UNIT_MM.get(int(_positive(photo.get(0xA210)) or 2))
    tagged_width, exposure_s = _positive(photo.get(0xA002)), _positive(photo.get(0x829A))
    stated = int(_positive(base.get(0x0112)) or 1)
    orientation = stated if 1 <= stated <= 8 else 1
    lens = _text(photo.get(0xA434))
    return PhotoTags(
        width=size[0],
        height=size[1],
        taken=taken,
        whole_seconds=fraction is None,
        offset=_offset(photo.get(0x9011)),
        gps_utc=_gps_time(gps.get(29), gps.get(7)),
        exposure_s=None if exposure_s is None or exposure_s > _LONGEST_EXPOSURE_S else exposure_s,
        focal_length_mm=_positive(photo.get(0x920A)),
        focal_length_35mm=_positive(photo.get(0xA405)),
        focal_plane_px_mm=None if per_unit is None or unit_mm is None else per_unit / unit_mm,
        tagged_width_px=None if tagged_width is None else round(tagged_width),
        orientation=1 if turned else orientation,
        camera=_text(base.get(0x0110)),
        lens=lens,
        up=_up(photo.get(0x927C), size, lens, orientation, turned),
    )


def _up(note: object, size: tuple[int, int], lens: str, orientation: int, turned: bool) -> Vector | None:
    """Read the vertical from the maker note, if the picture is from a rear camera and its pixels are as written by it."""
    acceleration = acceleration_g(note)
    # Cameras store rows along the telephone's long side; a program that has rotated the picture has left them upright.
    rows, columns = size if not (turned and orientation >= 5) else size[::-1]
    if acceleration is None or rows < columns or "front" in lens.lower():
        return None
    return up_in_picture(acceleration, orientation, turned)


def _text(value: object) -> str:
    if isinstance(value, bytes):
        value = value.decode("ascii", "replace")
    if not isinstance(value, str):
        return ""
    return "".join(letter for letter in value if letter.isprintable()).strip()[:_LONGEST_TEXT]


def _positive(value: object) -> float | None:
    """Return a number above zero and below one billion, or None."""
    if isinstance(value, (tuple, list)) and len(value) == 1:
        value = value[0]
    if not isinstance(value, (SupportsFloat, str)):
        return None
    try:
        number = float(value)
    except (TypeError, ValueError, ArithmeticError):
        return None
    return number if math.isfinite(number) and 0 < number < 1e9 else None


def _time(value: object) -> datetime | None:
    try:
        shown = datetime.strptime(_text(value), "%Y:%m:%d %H:%M:%S")
    except ValueError:
        return None
    return shown if _YEARS[0] <= shown.year <= _YEARS[1] else None


def _offset(value: object) -> timedelta | None:
    found = re.fullmatch(r"([+-])(\d\d):?(\d\d)|Z", _text(value))
    if found is None:
        return None
    if found[0] == "Z":
        return timedelta(0)
    offset = timedelta(hours=int(found[2]), minutes=int(found[3]))
    if offset > timedelta(hours=14) or int(found[3]) > 59:
        return None
    return offset if found[1] == "+" else -offset


def _gps_time(day: object, clock: object) -> datetime | None:
    """Read GPSDateStamp and GPSTimeStamp, which are UTC."""
    if not isinstance(clock, (tuple, list)) or len(clock) != 3:
        return None
    try:
        hours, minutes, seconds = (float(part) for part in clock)
        midnight = datetime.strptime(_text(day), "%Y:%m:%d").replace(tzinfo=UTC)
        if not (_YEARS[0] <= midnight.year <= _YEARS[1] and 0 <= 3600 * hours + 60 * minutes + seconds < 86400):
            return None
        return midnight + timedelta(hours=hours, minutes=minutes, seconds=seconds)
    except (TypeError, ValueError, ArithmeticError):
        return None
