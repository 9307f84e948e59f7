"""FITS images, plain or compressed (gzip, bzip2, tiles), read within bounds; and what their header says.

Source: Pence et al. 2010, A&A 524, A42 (FITS 3.0); for time, `celnav.sky.fits_times`. Rows are taken in the order of
the file.
"""

from __future__ import annotations

import bz2
import io
import math
import warnings
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from celnav.errors import ImageError
from celnav.sky.fits_times import ExposureInHeader, exposure_in

MAX_PIXELS = 100_000_000
MAX_BYTES = 500_000_000
_CHUNK = 1 << 20
_STARTS = (b"SIMPLE", b"BZh", b"\x1f\x8b")
_MOST_WORDS = 2000
# The mean of a block of video frames, as the Global Meteor Network's stations write it.
_MEAN_OF_BLOCK = "AVEPIXEL"


@dataclass(frozen=True, eq=False)
class FitsImage:
    """An image of a FITS file.

    Attributes
    ----------
    pixels : ndarray, shape (height, width) or (height, width, 3)
        Values; NaN where it has none.
    exposure : ExposureInHeader
        When it was taken, where the header says it.
    header : mapping
        Words and their values (str, int, float): the image's, and of the file's first unit what the image's does not have.
    """

    pixels: NDArray[np.generic]
    exposure: ExposureInHeader
    header: Mapping[str, object]


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
        When the file cannot be read, holds no image of two axes or of three colours, or more than a hundred million pixels.
    """
    from astropy.io import fits

    data = unpacked_bytes(path)
    if not data.startswith(b"SIMPLE"):
        raise ImageError(f"image {path} is not a FITS file")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with fits.open(io.BytesIO(data), memmap=False, lazy_load_hdus=True) as units:
                unit, axes = _image_unit(units, path)
                size = math.prod(axes)
                if not 0 < size <= MAX_PIXELS * (1 if len(axes) == 2 else 3):
                    raise ImageError(f"image {path} has {size} pixels; the limit is 100 million")
                pixels = np.asarray(unit.data).reshape(axes)
                header, first = _words(unit.header), _words(units[0].header)
    except ImageError:
        raise
    except Exception as error:  # astropy raises OSError, TypeError, KeyError, VerifyError and others for damaged files
        text = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise ImageError(f"image {path} is a damaged FITS file: {text}") from None
    if pixels.ndim == 3 and pixels.shape[2] != 3:
        pixels = np.moveaxis(pixels, 0, 2)
    native = np.ascontiguousarray(pixels.astype(pixels.dtype.newbyteorder("="), copy=False))
    return FitsImage(native, exposure_in(header, first, Path(path).name), first | header)


def _image_unit(units: Any, path: str | Path) -> tuple[Any, tuple[int, ...]]:
    """Choose the unit that is read; with its axes as numpy counts them, those of one pixel left out."""
    chosen = None
    for number in range(64):
        try:
            unit = units[number]
        except IndexError:
            break
        axes = _axes(unit)
        if axes is None:
            continue
        if unit.name == _MEAN_OF_BLOCK:
            return unit, axes
        chosen = (unit, axes) if chosen is None else chosen
    if chosen is None:
        raise ImageError(
            f"image {path} holds no image of two axes, or of three with three colours (other cubes and tables are not read)"
        )
    return chosen


def _axes(unit: Any) -> tuple[int, ...] | None:
    """Sides of a unit's image, or of its image in three colours; None of what is neither."""
    if str(unit.header.get("XTENSION", "IMAGE")).strip() != "IMAGE":
        return None
    number = int(unit.header.get("NAXIS", 0))
    sides = [int(unit.header[f"NAXIS{axis}"]) for axis in range(number, 0, -1)]
    axes = tuple(sides) if number == 2 else tuple(side for side in sides if side != 1)
    if len(axes) == 2 or (len(axes) == 3 and 3 in (axes[0], axes[2])):
        return axes
    return None


def unpacked_bytes(path: str | Path) -> bytes:
    """Return a file's bytes, unpacked where it is compressed by gzip or bzip2.

    Raises
    ------
    ImageError
        When it cannot be read, is damaged, or holds more than `MAX_BYTES`.
    """
    path = Path(path)
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
    except ImageError:
        raise
    except (OSError, ValueError, zlib.error) as error:
        raise ImageError(f"image {path} is damaged: {error}") from None
    return _bounded(b"".join(parts), path)


def _bounded(data: bytes, path: Path) -> bytes:
    if len(data) > MAX_BYTES:
        raise ImageError(f"image {path} is larger than {MAX_BYTES // 1_000_000} MB unpacked")
    return data


def _words(header: Any) -> dict[str, object]:
    """Return the texts and numbers of a header; those that cannot be parsed count as absent."""
    from astropy.io.fits.verify import VerifyError

    words: dict[str, object] = {}
    for key in list(header)[:_MOST_WORDS]:
        try:
            value = header[key]
        except (VerifyError, ValueError, KeyError):
            continue
        if isinstance(value, (str, int, float)):
            words.setdefault(key, value)
    return words
