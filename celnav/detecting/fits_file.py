"""FITS images, plain or compressed (gzip, bzip2), read within bounds; and the time that their header gives.

Source: Pence et al. 2010, A&A 524, A42 (FITS 3.0); for time, Rots et al. 2015, A&A 574, A36: DATE-OBS is the start unless the
header has DATE-BEG, DATE-AVG or DATE-END. Rows are taken in the order of the file.
"""

from __future__ import annotations

import bz2
import io
import math
import re
import warnings
import zlib
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from celnav.errors import ImageError

MAX_PIXELS = 100_000_000
MAX_BYTES = 500_000_000
_CHUNK = 1 << 20
_STARTS = (b"SIMPLE", b"BZh", b"\x1f\x8b")
_YEARS = (1900, 2200)
_DATES = ("DATE-AVG", "DATE-BEG", "DATE-OBS", "DATE-END")
_EXPOSURES = ("EXPTIME", "EXPOSURE", "XPOSURE", "EXP_TIME")
# The mean of a block of video frames, as the Global Meteor Network's stations write it.
_MEAN_OF_BLOCK = "AVEPIXEL"
_BLOCK_NAME = re.compile(r"FF_?\w*?_(\d{8})_(\d{6})_(\d{3})_")


@dataclass(frozen=True, eq=False)
class FitsImage:
    """An image of a FITS file.

    Attributes
    ----------
    pixels : ndarray, shape (height, width)
        Values.
    middle : datetime or None
        Middle of the exposure, UTC, where the header says it.
    exposure_s : float or None
        Its length.
    """

    pixels: NDArray[np.generic]
    middle: datetime | None
    exposure_s: float | None


def is_fits(path: str | Path) -> bool:
    """Tell from a file's first bytes and its name whether it may hold a FITS image."""
    try:
        with Path(path).open("rb") as file:
            start = file.read(6)
    except OSError:
        return False
    return start.startswith(_STARTS)


def read_fits(path: str | Path) -> FitsImage:
    """Read the first image of a FITS file; of a meteor station's block, its mean.

    Raises
    ------
    ImageError
        When the file cannot be read, holds no image of two axes, or more than a hundred million pixels.
    """
    from astropy.io import fits

    data = _bytes(Path(path))
    if not data.startswith(b"SIMPLE"):
        raise ImageError(f"image {path} is not a FITS file")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with fits.open(io.BytesIO(data), memmap=False, lazy_load_hdus=True) as units:
                unit = _image_unit(units, path)
                size = int(unit.header["NAXIS1"]) * int(unit.header["NAXIS2"])
                if not 0 < size <= MAX_PIXELS:
                    raise ImageError(f"image {path} has {size} pixels; the limit is 100 million")
                pixels = np.ascontiguousarray(unit.data)
                header, first = _values(unit.header), _values(units[0].header)
    except ImageError:
        raise
    except Exception as error:  # astropy raises OSError, TypeError, KeyError, VerifyError and others for damaged files
        text = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise ImageError(f"image {path} is a damaged FITS file: {text}") from None
    if pixels.ndim != 2:
        raise ImageError(f"image {path} holds no image of two axes")
    native = pixels.astype(pixels.dtype.newbyteorder("="), copy=False)
    exposure_s = _exposure(header, first)
    if exposure_s is None:
        exposure_s = _block_length(first)
    return FitsImage(native, _middle(header, first, exposure_s, Path(path).name), exposure_s)


def _image_unit(units: Any, path: str | Path) -> Any:
    chosen = None
    for number in range(64):
        try:
            unit = units[number]
        except IndexError:
            break
        if unit.header.get("NAXIS") != 2 or unit.header.get("XTENSION", "IMAGE").strip() != "IMAGE":
            continue
        if unit.name == _MEAN_OF_BLOCK:
            return unit
        chosen = unit if chosen is None else chosen
    if chosen is None:
        raise ImageError(f"image {path} holds no image of two axes (cubes and tables are not read)")
    return chosen


def _bytes(path: Path) -> bytes:
    """Return the file's bytes, unpacked where it is compressed, and no more than `MAX_BYTES` of them."""
    try:
        with path.open("rb") as file:
            start = file.read(3)
            file.seek(0)
            if start == b"BZh":
                return _unpacked(file, bz2.BZ2Decompressor(), path)
            if start[:2] == b"\x1f\x8b":
                return _unpacked(file, _Gzip(), path)
            data = file.read(MAX_BYTES + 1)
    except OSError as error:
        raise ImageError(f"image {path} cannot be read: {error.strerror or error}") from None
    return _bounded(data, path)


class _Gzip:
    """`zlib` with the interface of `bz2.BZ2Decompressor`."""

    def __init__(self) -> None:
        self._inner = zlib.decompressobj(wbits=31)

    def decompress(self, data: bytes, max_length: int) -> bytes:
        return self._inner.decompress(self._inner.unconsumed_tail + data, max_length)

    @property
    def eof(self) -> bool:
        return self._inner.eof

    @property
    def needs_input(self) -> bool:
        return not self._inner.unconsumed_tail


def _unpacked(file: io.BufferedReader, unpacker: Any, path: Path) -> bytes:
    parts, total = [], 0
    try:
        while not unpacker.eof:
            piece = file.read(_CHUNK) if unpacker.needs_input else b""
            asked = unpacker.needs_input
            parts.append(unpacker.decompress(piece, _CHUNK))
            if asked and not piece and not parts[-1]:
                raise ImageError(f"image {path} is cut short")
            total += len(parts[-1])
            if total > MAX_BYTES:
                break
    except (OSError, ValueError, zlib.error) as error:
        raise ImageError(f"image {path} is damaged: {error}") from None
    return _bounded(b"".join(parts), path)


def _bounded(data: bytes, path: Path) -> bytes:
    if len(data) > MAX_BYTES:
        raise ImageError(f"image {path} is larger than {MAX_BYTES // 1_000_000} MB unpacked")
    return data


def _values(header: Any) -> dict[str, object]:
    """Return the values of a header that are used here; those that cannot be parsed count as absent."""
    from astropy.io.fits.verify import VerifyError

    values = {}
    for key in (*_EXPOSURES, *_DATES, "NFRAMES", "FPS"):
        try:
            values[key] = header.get(key)
        except (VerifyError, ValueError):
            continue
    return values


def _exposure(header: dict[str, object], first: dict[str, object]) -> float | None:
    for part in (header, first):
        for key in _EXPOSURES:
            value = part.get(key)
            if isinstance(value, (int, float)) and math.isfinite(value) and 0 <= value <= 86400:
                return float(value)
    return None


def _middle(
    header: dict[str, object], first: dict[str, object], exposure_s: float | None, name: str
) -> datetime | None:
    """Middle of the exposure: DATE-AVG; the start and half the exposure; the name of a meteor station's block."""
    for part in (header, first):
        if (average := _moment(part.get("DATE-AVG"))) is not None:
            return average
        begun, ended = _moment(part.get("DATE-BEG")) or _moment(part.get("DATE-OBS")), _moment(part.get("DATE-END"))
        if begun is not None and exposure_s is not None:
            return begun + timedelta(seconds=exposure_s / 2)
        if begun is not None and ended is not None:
            return begun + (ended - begun) / 2
    length_s = _block_length(first)
    return None if length_s is None else block_middle(name, length_s)


def _block_length(first: dict[str, object]) -> float | None:
    """Length of a meteor station's block of video frames, s."""
    count, rate = first.get("NFRAMES"), first.get("FPS")
    if not (isinstance(count, (int, float)) and isinstance(rate, (int, float)) and 0 < count < 1e6 and 0 < rate < 1e6):
        return None
    return count / rate if count / rate < 86400 else None


def block_middle(name: str, length_s: float) -> datetime | None:
    """Middle of a block of video frames by its file name, ``FF_<station>_<date>_<time>_<ms>_…``; None for other names."""
    found = _BLOCK_NAME.match(name)
    if found is None:
        return None
    try:
        begun = datetime.strptime(found[1] + found[2], "%Y%m%d%H%M%S").replace(tzinfo=UTC)
    except ValueError:
        return None
    if not _YEARS[0] <= begun.year <= _YEARS[1]:
        return None
    return begun + timedelta(milliseconds=int(found[3])) + timedelta(seconds=length_s / 2)


def _moment(value: object) -> datetime | None:
    """Read a date with a time of day; without a zone it is UTC."""
    if not isinstance(value, str) or "T" not in value:
        return None
    try:
        moment = datetime.fromisoformat(value.strip())
        if not _YEARS[0] <= moment.year <= _YEARS[1]:
            return None
        return moment.replace(tzinfo=UTC) if moment.tzinfo is None else moment.astimezone(UTC)
    except (ValueError, OverflowError):
        return None
