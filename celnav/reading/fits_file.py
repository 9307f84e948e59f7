"""Reading of FITS images, plain or compressed (gzip, bzip2, tiles), within size limits, with the metadata of the header.

Sources: Pence et al. 2010, A&A 524, A42 (FITS 3.0); for times, `celnav.sky.fits_times`; for the keyword ROWORDER, which
camera programs write, https://free-astro.org/index.php?title=Siril:FITS_orientation. Without that keyword, rows are taken in
the order of the file, which most programs write from the top down.
"""

from __future__ import annotations

import bz2
import gzip
import io
import math
import warnings
import zlib
from collections.abc import Callable, Iterator, Mapping
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
_BZIP2, _GZIP = b"BZh", b"\x1f\x8b"
_STARTS = (b"SIMPLE", _BZIP2, _GZIP)
# Programs with several threads write a stream per 64 kB or more, so a file of the largest size has some 8000.
_MOST_STREAMS = 20_000
_MOST_WORDS = 2000
_MOST_UNITS = 64
# A camera of 100 million pixels has some ten thousand rows in three colours, each of which may be a tile.
_MOST_TILES = 200_000
_LARGEST_PIXEL_BYTES = 8
_GZIP_BESIDE = "GZIP_COMPRESSED_DATA"
_BYTES_OF = {"B": 1, "I": 2, "J": 4}
# Name of the mean of a block of video frames in files of the Global Meteor Network's stations.
_MEAN_OF_BLOCK = "AVEPIXEL"
_ROWS_UPWARDS = "BOTTOM-UP"


@dataclass(frozen=True, eq=False)
class FitsImage:
    """An image of a FITS file.

    Attributes
    ----------
    pixels : ndarray, shape (height, width) or (height, width, 3)
        Values; NaN for pixels without one. The first row is the top one if the header says which row is on top.
    exposure : ExposureInHeader
        Time and duration of the exposure, as far as the header gives them.
    header : mapping
        Keywords and their values (str, int, float): those of the image, and those that only the file's first unit has.
    """

    pixels: NDArray[np.generic]
    exposure: ExposureInHeader
    header: Mapping[str, object]


def is_fits(path: str | Path) -> bool:
    """Return whether a file may hold a FITS image, judging from its first bytes and its name."""
    try:
        with Path(path).open("rb") as file:
            start = file.read(6)
    except OSError:
        return False
    return start.startswith(_STARTS)


def read_fits(path: str | Path) -> FitsImage:
    """Read the first image of a FITS file; for the block of a meteor station, read its mean image.

    Raises
    ------
    ImageError
        When the file cannot be read, holds no image with two axes or in three colours, or has more than a hundred million
        pixels.
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
                _check_tiles(data, path)
                pixels = np.asarray(unit.data).reshape(axes)
                header, first = _words(unit.header), _words(units[0].header)
    except ImageError:
        raise
    except Exception as error:  # astropy raises OSError, TypeError, KeyError, VerifyError and others for damaged files
        text = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise ImageError(f"image {path} is a damaged FITS file: {text}") from None
    if pixels.ndim == 3 and pixels.shape[2] != 3:
        pixels = np.moveaxis(pixels, 0, 2)
    words = first | header
    if str(words.get("ROWORDER", "")).strip().upper() == _ROWS_UPWARDS:
        pixels = pixels[::-1]
    native = np.ascontiguousarray(pixels.astype(pixels.dtype.newbyteorder("="), copy=False))
    return FitsImage(native, exposure_in(header, first, Path(path).name), words)


def _image_unit(units: Any, path: str | Path) -> tuple[Any, tuple[int, ...]]:
    """Choose the unit to read; also return its axes in numpy's order, without those of length one."""
    chosen = None
    for number in range(_MOST_UNITS):
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
    """Return the sides of a unit's image, in one or three colours; None if it has no such image."""
    if str(unit.header.get("XTENSION", "IMAGE")).strip() != "IMAGE":
        return None
    number = int(unit.header.get("NAXIS", 0))
    sides = [int(unit.header[f"NAXIS{axis}"]) for axis in range(number, 0, -1)]
    axes = tuple(sides) if number == 2 else tuple(side for side in sides if side != 1)
    if len(axes) == 2 or (len(axes) == 3 and 3 in (axes[0], axes[2])):
        return axes
    return None


def unpacked_bytes(path: str | Path) -> bytes:
    """Return a file's bytes, unpacked if it is compressed by gzip or bzip2.

    Raises
    ------
    ImageError
        When the file cannot be read, is damaged, or holds more than `MAX_BYTES` or too many compressed streams.
    """
    path = Path(path)
    try:
        with path.open("rb") as file:
            start = file.read(3)
            file.seek(0)
            for mark, unpacker in ((_BZIP2, bz2.BZ2Decompressor), (_GZIP, _Gzip)):
                if start.startswith(mark):
                    return _unpacked(file, mark, unpacker, path)
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

    @property
    def unused_data(self) -> bytes:
        return self._inner.unused_data


def _unpacked(file: io.BufferedReader, mark: bytes, new_unpacker: Callable[[], Any], path: Path) -> bytes:
    """Unpack all streams of a file, of which programs with several threads write one after another."""
    parts, total, streams = [], 0, 1
    unpacker, further = new_unpacker(), b""
    try:
        while True:
            if unpacker.eof:
                further = unpacker.unused_data
                while len(further) < len(mark) and (more := file.read(_CHUNK)):
                    further += more
                if not further.startswith(mark):
                    break
                # Empty streams never reach the limit of size, however many there are.
                if streams == _MOST_STREAMS:
                    raise ImageError(
                        f"image {path} has more than {_MOST_STREAMS} compressed streams: compress it as one"
                    )
                unpacker, streams = new_unpacker(), streams + 1
            asked = unpacker.needs_input
            piece, further = (further or file.read(_CHUNK), b"") if asked else (b"", further)
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
    """Return the texts and numbers of a header; those that cannot be parsed are left out."""
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


def _check_tiles(data: bytes, name: object) -> None:
    """Refuse a file with a compressed image whose tiles do not have the size that its header states.

    Of the compression algorithms (FITS 4.0, 10.4), only GZIP writes as much as its stream demands, so a tile of a kilobyte
    can unpack to gigabytes. With the other algorithms, tiles may be stored as GZIP if their values cannot be quantised.
    """
    from astropy.io import fits

    with fits.open(io.BytesIO(data), memmap=False, lazy_load_hdus=True, disable_image_compression=True) as units:
        for number in range(_MOST_UNITS):
            try:
                unit = units[number]
            except IndexError:
                return
            if isinstance(unit, fits.BinTableHDU) and unit.header.get("ZIMAGE"):
                _check_table(data, unit, name)


def _check_table(data: bytes, unit: Any, name: object) -> None:
    """Check a table of tiles."""
    header = unit.header
    sides = [int(header[f"ZNAXIS{axis}"]) for axis in range(1, int(header["ZNAXIS"]) + 1)]
    # By default, the tiles are rows of the image.
    tile = [int(header.get(f"ZTILE{axis + 1}", side if axis == 0 else 1)) for axis, side in enumerate(sides)]
    if min((*sides, *tile), default=0) < 1:
        raise ImageError(f"image {name} has compressed tiles without a size")
    count = math.prod(-(-side // part) for side, part in zip(sides, tile, strict=True))
    if count > _MOST_TILES:
        raise ImageError(f"image {name} has {count} compressed tiles; the limit is {_MOST_TILES}")
    most = _LARGEST_PIXEL_BYTES * math.prod(map(min, sides, tile))
    names = [column.name.upper() for column in unit.columns]
    if len(set(names)) != len(names):
        raise ImageError(f"image {name} has two columns of one name among its compressed tiles")
    total = 0
    for column in unit.columns:
        is_gzip = str(header["ZCMPTYPE"]).startswith("GZIP") and column.name.upper() == "COMPRESSED_DATA"
        if not is_gzip and column.name.upper() != _GZIP_BESIDE:
            continue
        for stream in _cells(data, unit, column, count, name):
            total += len(stream)
            if total > len(data):
                raise ImageError(f"image {name} has compressed tiles that lie over each other")
            if stream and _unpacks_to_more(stream, most):
                raise ImageError(f"image {name} has a compressed tile of more than the {most} bytes that a tile takes")


def _cells(data: bytes, unit: Any, column: Any, count: int, name: object) -> Iterator[memoryview]:
    """Yield the streams of a column for the first `count` tiles, as views of the file."""
    header: Mapping[str, Any] = unit.header
    start, rows = unit.fileinfo()["datLoc"], int(header["NAXIS2"])
    kind = unit.columns.dtype.newbyteorder(">")
    form = column.format.removeprefix("1")
    if form[:1] not in "PQ" or form[1:2] not in _BYTES_OF or kind.itemsize != int(header["NAXIS1"]):
        raise ImageError(f"image {name} has compressed tiles in a column of the form {column.format}")
    heap = start + int(header.get("THEAP", kind.itemsize * rows))
    places = np.frombuffer(data, kind, min(rows, count), start)[column.name]
    whole = memoryview(data)
    for size, offset in places.reshape(len(places), 2).tolist():
        end = heap + offset + size * _BYTES_OF[form[1]]
        if size < 0 or offset < 0 or (size and end > len(data)):
            raise ImageError(f"image {name} has a compressed tile that lies outside the file")
        yield whole[heap + offset : end] if size else whole[:0]


def _unpacks_to_more(stream: memoryview, most: int) -> bool:
    left = most
    with gzip.GzipFile(fileobj=io.BytesIO(stream)) as unpacked:
        while piece := unpacked.read(_CHUNK):
            left -= len(piece)
            if left < 0:
                return True
    return False
