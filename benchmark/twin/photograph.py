"""Photographs of the night sky whose place and time are known: FITS files of fixed cameras."""

from __future__ import annotations

import bz2
import gzip
import io
import re
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from benchmark.errors import PhotographError
from benchmark.twin.stacked_video import StackedVideo, read_stack, start_of

LARGEST_BYTES = 450_000_000
"""Of a file, unpacked: a hundred million pixels of 32 bits."""
LARGEST_PX = 100_000_000
KEYS = {
    "exposure_s": ("EXPTIME", "EXPOSURE"),
    "latitude_deg": ("OBSLAT", "SITELAT", "LATITUDE"),
    "longitude_deg": ("OBSLONG", "SITELONG", "LONGITUD"),
    "height_m": ("OBSALT", "SITEELEV", "ALTITUDE"),
}
"""Words of the header that state a quantity: those of the cameras' programs that are in use."""
_UTC = re.compile(r"\d{4}-\d{2}-\d{2}T\d{2}:\d{2}:\d{2}(\.\d+)?")
_NAME = re.compile(r"[^a-z0-9_-]+")


@dataclass(frozen=True, eq=False)
class Photograph:
    """A raw photograph with its place and time.

    Attributes
    ----------
    name : str
        The file's, without its endings.
    pixels : (height, width) float32 array
        DN.
    utc_start : str
        Start of the exposure, ISO 8601 with Z.
    exposure_s : float
    latitude_deg, longitude_deg, height_m : float
        WGS84, longitude east positive.
    stack : StackedVideo or None
        Of a meteor camera, whose mean the pixels are.
    """

    name: str
    pixels: NDArray[np.float32]
    utc_start: str
    exposure_s: float
    latitude_deg: float
    longitude_deg: float
    height_m: float
    stack: StackedVideo | None = None


@dataclass(frozen=True)
class Place:
    """Where a camera stands: WGS84, longitude east positive."""

    latitude_deg: float
    longitude_deg: float
    height_m: float


def read_photograph(path: Path, place: Place | None = None) -> Photograph:
    """Read a FITS file with one image, or a meteor camera's stack (FF), also packed by gzip or bzip2.

    A stack has its time in the file's name and no place: `place` is the camera's.

    Raises
    ------
    PhotographError
        It cannot be read, is larger than `LARGEST_BYTES`, or its header lacks the time, the exposure or the place.
    """
    from astropy.io import fits

    try:
        with _opened(path) as stream:
            data = _bounded(stream, path)
    except (OSError, EOFError, ValueError) as error:
        raise PhotographError(f"{path}: cannot be read as FITS ({str(error).splitlines()[0]})") from None
    start = start_of(path.name)
    if start is not None:
        if place is None:
            raise PhotographError(f"{path}: a stack of video says no place; give that of its camera")
        stack = read_stack(data, str(path))
        where = place.latitude_deg, place.longitude_deg, place.height_m
        return Photograph(_name_of(path), stack.mean, start, stack.exposure_s, *where, stack)
    try:
        with warnings.catch_warnings(), fits.open(io.BytesIO(data), memmap=False) as hdus:
            warnings.simplefilter("error")
            header = hdus[0].header
            sides = [header.get(f"NAXIS{axis}", 0) for axis in (1, 2)]
            if header.get("NAXIS") != 2 or not all(sides) or sides[0] * sides[1] > LARGEST_PX:
                raise PhotographError(f"{path}: expected one image of two axes and at most {LARGEST_PX} pixels")
            pixels = np.asarray(hdus[0].data, dtype=np.float32)
    except (OSError, EOFError, ValueError, TypeError, KeyError, Warning, fits.VerifyError) as error:
        raise PhotographError(f"{path}: cannot be read as FITS ({str(error).splitlines()[0]})") from None
    if not np.isfinite(pixels).all():
        raise PhotographError(f"{path}: has pixels that are no numbers")
    began = str(header.get("DATE-OBS", ""))
    if not _UTC.fullmatch(began):
        raise PhotographError(f"{path}: DATE-OBS is {began!r}, expected the start in UTC such as 2018-09-14T11:53:22")
    exposure_s, latitude_deg, longitude_deg, height_m = (_number(header, words, path) for words in KEYS.values())
    return Photograph(_name_of(path), pixels, f"{began}Z", exposure_s, latitude_deg, longitude_deg, height_m)


def _name_of(path: Path) -> str:
    return _NAME.sub("-", path.name.split(".")[0].lower()).strip("-") or "photograph"


def _opened(path: Path) -> BinaryIO | bz2.BZ2File | gzip.GzipFile:
    """A file's bytes, unpacked by its ending."""
    if path.suffix == ".bz2":
        return bz2.BZ2File(path)
    if path.suffix == ".gz":
        return gzip.GzipFile(path)
    return path.open("rb")


def _bounded(stream: BinaryIO | bz2.BZ2File | gzip.GzipFile, path: Path) -> bytes:
    data = stream.read(LARGEST_BYTES + 1)
    if len(data) > LARGEST_BYTES:
        raise PhotographError(f"{path}: is larger than {LARGEST_BYTES} bytes when unpacked")
    return data


def _number(header: Mapping[str, object], words: tuple[str, ...], path: Path) -> float:
    """Return the first of some words that the header states as a number."""
    for word in words:
        value = header.get(word)
        if isinstance(value, int | float) and not isinstance(value, bool) and np.isfinite(value):
            return float(value)
    raise PhotographError(f"{path}: its header has none of the numbers {', '.join(words)}; add one")
