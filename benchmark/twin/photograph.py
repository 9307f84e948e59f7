"""Photographs of the night sky with known place and time: FITS files of fixed cameras."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmark.errors import PhotographError
from benchmark.photographed.alignment import Alignment
from benchmark.place import Place
from benchmark.twin.stacked_video import StackedVideo, read_stack, start_of
from celnav.errors import ImageError
from celnav.reading.fits_file import read_fits, unpacked_bytes
from celnav.sky.fits_times import ExposureInHeader
from generator.places.times import Instant
from generator.scenario.model import HIGHEST_SITE_M, LOWEST_SITE_M

LONGEST_S = 3600.0
"""Longest exposure of a scenario's frame."""
PLACE_WORDS = {
    "latitude_deg": (("OBSLAT", "SITELAT", "LATITUDE", "LAT-OBS", "OBS-LAT", "GEOLAT", "OBSGEO-B"), -90.0, 90.0),
    "longitude_deg": (("OBSLONG", "SITELONG", "LONGITUD", "LONG-OBS", "OBS-LONG", "GEOLON", "OBSGEO-L"), -180.0, 360.0),
    "height_m": (
        ("OBSALT", "SITEELEV", "ALTITUDE", "ALT-OBS", "OBS-ELEV", "GEOALT", "HEIGHT", "OBSGEO-H"),
        LOWEST_SITE_M,
        HIGHEST_SITE_M,
    ),
}
"""Header keywords that state the place, as written by common camera programs, and bounds of the values."""
_SEXAGESIMAL = re.compile(r"([+-]?)(\d+(?:\.\d+)?)(?:[ :]+(\d+(?:\.\d+)?))?(?:[ :]+(\d+(?:\.\d+)?))?")
_NAME = re.compile(r"[^a-z0-9_-]+")
_ENDINGS = re.compile(r"(\.(fits|fit|fts))?(\.(gz|bz2|fz))?$", re.IGNORECASE)


@dataclass(frozen=True, eq=False)
class Photograph:
    """A raw photograph with its place and time.

    Attributes
    ----------
    name : str
        Name of the file, without its endings.
    pixels : (height, width) float32 array
        DN.
    utc_start : str
        Start of the exposure, ISO 8601 with Z.
    exposure_s : float
    latitude_deg, longitude_deg, height_m : float
        WGS84, longitude east positive.
    stack : StackedVideo or None
        For a meteor camera, the stack of which the pixels are the mean.
    mean_of_video : bool
        Whether the pixels are the mean of a video's frames, with or without its stack.
    alignment : Alignment or None
        Attitude that is known already; None where the twin's is to be found from the stars.
    told : dict or None
        What solvers receive for the photograph (``told`` of a frame record); None for the truth.
    """

    name: str
    pixels: NDArray[np.float32]
    utc_start: str
    exposure_s: float
    latitude_deg: float
    longitude_deg: float
    height_m: float
    stack: StackedVideo | None = None
    mean_of_video: bool = False
    alignment: Alignment | None = None
    told: dict[str, Any] | None = None


def read_photograph(path: Path, place: Place | None = None) -> Photograph:
    """Read a FITS file with one image, or a meteor camera's stack (FF), optionally compressed by gzip or bzip2.

    A stack has its time in the file's name and no place; `place` is that of the camera.

    Raises
    ------
    PhotographError
        It cannot be read, is too large, or its header lacks the time, the exposure or the place; the message names the
        keyword.
    """
    try:
        return _stack(path, place) if start_of(path.name) is not None else _image(path)
    except ImageError as error:
        raise PhotographError(str(error).removeprefix("image ")) from error


def _stack(path: Path, place: Place | None) -> Photograph:
    start = start_of(path.name)
    if place is None or start is None:
        raise PhotographError(f"{path}: a stack of video says no place; give that of its camera")
    stack = read_stack(unpacked_bytes(path), str(path))
    where = place.latitude_deg, place.longitude_deg, place.height_m
    return Photograph(name_of(path), stack.mean, start, stack.exposure_s, *where, stack, mean_of_video=True)


def _image(path: Path) -> Photograph:
    read = read_fits(path)
    if read.pixels.ndim != 2:
        raise PhotographError(f"{path}: has three colours, and a scene's camera has one; give one of its planes")
    pixels = read.pixels.astype(np.float32)
    if not np.isfinite(pixels).all():
        raise PhotographError(f"{path}: has pixels that are no numbers; replace them by the sky around them")
    start, length_s = _start(read.exposure, path)
    latitude_deg, longitude_deg, height_m = (_stated(read.header, *words, path) for words in PLACE_WORDS.values())
    return Photograph(name_of(path), pixels, start, length_s, latitude_deg, longitude_deg, height_m)


def _start(told: ExposureInHeader, path: Path) -> tuple[str, float]:
    """Start of the exposure, ISO 8601 with Z, and its length, s."""
    if told.middle is None:
        raise PhotographError(f"{path}: {told.lacks}; mend the header")
    if told.length_s is None:
        raise PhotographError(f"{path}: its header has no EXPTIME; add it")
    if not 0 < told.length_s <= LONGEST_S:
        raise PhotographError(f"{path}: its EXPTIME is {told.length_s:g}; a scene has 0 to {LONGEST_S:g} s")
    begun = told.middle - timedelta(seconds=told.length_s / 2)
    start = f"{begun.strftime('%Y-%m-%dT%H:%M:%S.%f').rstrip('0').rstrip('.')}Z"
    try:
        Instant.parse(start)
    except ValueError as error:
        raise PhotographError(f"{path}: its start of the exposure, {error}; mend the header") from error
    return start, told.length_s


def name_of(path: Path) -> str:
    """Name of a photograph: that of its file without the endings, in small letters, digits, dashes and underscores."""
    return _NAME.sub("-", _ENDINGS.sub("", path.name, count=1).lower()).strip("-") or "photograph"


def _stated(header: Mapping[str, object], words: tuple[str, ...], lowest: float, highest: float, path: Path) -> float:
    """Return the value of the first keyword present, which may be a text such as -30 14 26.7."""
    for word in words:
        if (value := header.get(word)) is None or value == "":
            continue
        number = _number(value)
        if number is None or not lowest <= number <= highest:
            raise PhotographError(
                f"{path}: its {word} is {value!r}, expected a number from {lowest:g} to {highest:g}; mend it"
            )
        return number
    raise PhotographError(f"{path}: its header has none of the words {', '.join(words)}; add one")


def _number(value: object) -> float | None:
    """Return a number, also where it is written as degrees, minutes and seconds; None for anything else."""
    if isinstance(value, str) and (match := _SEXAGESIMAL.fullmatch(value.strip())):
        degrees, minutes, seconds = (float(part or 0.0) for part in match.groups()[1:])
        return (-1 if match[1] == "-" else 1) * (degrees + minutes / 60 + seconds / 3600)
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else None
