"""Reader of photographs: images of DN with the middle and the length of their exposure.

Times in a FITS header are UTC (DATE-AVG; DATE-BEG or DATE-OBS as the start, with the exposure; Rots et al. 2015, A&A 574,
A36). Times in EXIF tags are those of a clock whose zone is stated by the tags or the caller. A block of a meteor station is
dated by its name. Sizes are checked before anything is decoded.
"""

from __future__ import annotations

import csv
import hashlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import timedelta
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import celnav
from benchmark.errors import PhotographError
from celnav.command.exif import read_raw_tags, read_tags
from celnav.command.exposure_time import Stamp, exposure_time
from celnav.detecting.colour_mosaic import level_mosaic
from celnav.errors import TimeError
from celnav.reading.fits_file import FitsImage, is_fits, read_fits
from celnav.reading.image_file import RAW_SUFFIXES
from generator.files import read_at_most
from generator.places.times import Instant
from generator.reading.record import LARGEST_SIDE_PX

PLAIN_SUFFIXES = (".fits", ".fit", ".fts", ".png", ".jpg", ".jpeg", ".tif", ".tiff", ".heic", ".heif")
PACKED_SUFFIXES = (".bz2", ".gz", ".fz")
MOST_PHOTOGRAPHS = 20_000
LARGEST_FILE_BYTES = 500_000_000
LARGEST_TABLE_BYTES = 10_000_000
LARGEST_DN = 65535
LONGEST_EXPOSURE_S = 86_400.0
_SMALLEST_SCALE = 1 / 16
_FEW_LEVELS = 256
_TILE_PX = 32
_TIMES = "list it in a table: --times TABLE.csv with the columns file, utc_mid, exposure_s"


@dataclass(frozen=True)
class Clock:
    """What the caller knows about the times of photographs.

    Attributes
    ----------
    time_zone : str or None
        Zone of the camera's clock, ``+02:00`` or ``Europe/Berlin``; None takes it from the tags.
    stamp : str
        What the EXIF time marks: ``start``, ``middle`` or ``end`` of the exposure.
    exposure_s : float or None
        For files that do not state it.
    table : mapping
        Middle (UTC) and exposure (s) by the file's name; these take precedence over everything else.
    """

    time_zone: str | None = None
    stamp: Stamp = "start"
    exposure_s: float | None = None
    table: Mapping[str, tuple[str, float]] = field(default_factory=dict)


def read_times(path: Path) -> dict[str, tuple[str, float]]:
    """Read a table of times, CSV with the columns ``file``, ``utc_mid`` and ``exposure_s``.

    Raises
    ------
    PhotographError
        The message names the line.
    """
    try:
        if path.stat().st_size > LARGEST_TABLE_BYTES:
            raise PhotographError(f"{path}: larger than {LARGEST_TABLE_BYTES} bytes")
        rows = list(csv.DictReader(path.read_text(encoding="utf-8-sig").splitlines()))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise PhotographError(f"{path}: cannot be read ({error})") from error
    found = {}
    for line, row in enumerate(rows, 2):
        try:
            exposure_s = float(row["exposure_s"])
            Instant.parse(row["utc_mid"])
            if not 0 < exposure_s <= LONGEST_EXPOSURE_S:
                raise ValueError(f"exposure_s {exposure_s:g} is not within a day")
            if row["file"] in found:
                raise ValueError(f"{row['file']} is listed twice")
            found[row["file"]] = (row["utc_mid"], exposure_s)
        except (KeyError, TypeError, ValueError) as error:
            raise PhotographError(
                f"{path}, line {line}: {error}; expected the columns file, utc_mid, exposure_s"
            ) from error
    return found


def check_names(table: Mapping[str, tuple[str, float]], files: Sequence[Path], where: Path) -> None:
    """Refuse a table of times for other photographs: one that names none of the files, or one in other letters.

    Raises
    ------
    PhotographError
        The message names the table, `where`, and a name in it.
    """
    names = {path.name for path in files}
    by_letters = {name.casefold(): name for name in names}
    for name in table:
        if name not in names and (meant := by_letters.get(name.casefold())) is not None:
            raise PhotographError(f"{where}: names {name}, but the photograph is {meant}; write it so")
    if files and not names & table.keys():
        listed = next(iter(table), "nothing")
        raise PhotographError(f"{where}: names none of the photographs, such as {files[0].name}, but {listed}; mend it")


@dataclass(frozen=True, eq=False)
class Photograph:
    """A photograph with its time.

    Attributes
    ----------
    pixels : (height, width) uint16 array
        DN.
    bits : int
        Number of bits of the DN.
    scale, offset : float
        The file's values are (DN - offset) / scale.
    bayer_pattern : str or None
        Colours of a mosaic.
    utc_mid : str
        ISO 8601 with Z.
    exposure_s : float
    assumed : tuple of str
        How the time follows from the file, one sentence each.
    full : (height, width) bool array
        Pixels that are full in some colour.
    """

    pixels: NDArray[np.uint16]
    bits: int
    scale: float
    offset: float
    bayer_pattern: str | None
    utc_mid: str
    exposure_s: float
    full: NDArray[np.bool_]
    assumed: tuple[str, ...] = ()

    @property
    def light(self) -> NDArray[np.float32]:
        """Pixels, DN, for measurements of stars: those of a mosaic without the pattern of the sky's colour."""
        pixels = self.pixels.astype(np.float32)
        if self.bayer_pattern is None:
            return pixels
        # Whole numbers of DN: nothing within one step is an outlier.
        return level_mosaic(pixels, np.ones(pixels.shape, dtype=bool), _TILE_PX, 1.01)


def photographs_in(folder: Path) -> list[Path]:
    """Files of photographs in a folder, by name.

    Raises
    ------
    PhotographError
        There is no such folder, or it contains no photograph or too many.
    """
    if not folder.is_dir():
        raise PhotographError(f"{folder}: no such folder")
    found = sorted(path for path in folder.iterdir() if path.is_file() and _is_photograph(path))
    if not found:
        known = " ".join((*PLAIN_SUFFIXES, "and raw files"))
        raise PhotographError(f"{folder}: no photograph in it ({known}; FITS also packed, .bz2, .gz or .fz)")
    if len(found) > MOST_PHOTOGRAPHS:
        raise PhotographError(f"{folder}: {len(found)} photographs; at most {MOST_PHOTOGRAPHS} make one dataset")
    return found


def file_sha256(path: Path) -> str:
    """SHA-256 of a file. Raises PhotographError where it is not a regular file or is larger than any photograph."""
    try:
        return hashlib.sha256(read_at_most(path, LARGEST_FILE_BYTES)).hexdigest()
    except OSError as error:
        raise PhotographError(f"{path}: cannot be read ({error.strerror})") from error


def read_photograph(path: Path, clock: Clock) -> Photograph:
    """Read a photograph and its time.

    Raises
    ------
    PhotographError
        It cannot be read, is too large, or its time, zone or exposure is unknown; the message names file, key and remedy.
    """
    try:
        if path.suffix.lower() in RAW_SUFFIXES:
            from benchmark.importing.raw_file import read_raw

            mosaic = read_raw(path)
            utc_mid, exposure_s, assumed = _tagged_time(path, clock)
            full = mosaic.pixels >= mosaic.white
            return Photograph(mosaic.pixels, mosaic.bits, 1.0, 0.0, mosaic.pattern, utc_mid, exposure_s, full, assumed)
        if is_fits(path):
            found = read_fits(path)
            utc_mid, exposure_s = _header_time(path, found, clock)
            pixels, bits, scale, offset = as_dn(found.pixels, path)
            return Photograph(pixels, bits, scale, offset, None, utc_mid, exposure_s, full_pixels(found.pixels))
        utc_mid, exposure_s, assumed = _tagged_time(path, clock)
        values = celnav.read_image(path)
        pixels, bits, scale, offset = as_dn(values, path)
        return Photograph(pixels, bits, scale, offset, None, utc_mid, exposure_s, full_pixels(values), assumed)
    except celnav.CelnavError as error:
        raise PhotographError(str(error).removeprefix("image ")) from error


def check_tagged_times(files: Sequence[Path], clock: Clock) -> None:
    """Refuse files whose tags and the caller do not tell their time, before any file is decoded.

    Headers of FITS files, which may be packed, are checked when the files are read.

    Raises
    ------
    PhotographError
        As for `read_photograph`.
    """
    for path in files:
        try:
            if not is_fits(path):
                _tagged_time(path, clock)
        except celnav.CelnavError as error:
            raise PhotographError(str(error).removeprefix("image ")) from error


def as_dn(values: NDArray[np.generic], path: Path) -> tuple[NDArray[np.uint16], int, float, float]:
    """Convert an image's values to DN of at most 16 bits: pixels, bits, scale and offset; ``DN = offset + scale * value``.

    Colours are added, which causes no rounding. Numbers between 0 and 1 become 0 to 65535. An offset raises negative numbers,
    which occur in calibrated images. Values above 16 bits are halved until they fit, at most four times. Fractions that span
    fewer than 256 whole numbers, which rounding would change, are doubled as long as they fit.

    Raises
    ------
    PhotographError
        Values are not finite, or need more than 20 bits.
    """
    if max(values.shape) > LARGEST_SIDE_PX:
        raise PhotographError(
            f"{path}: {values.shape[1]} x {values.shape[0]} px; a frame has at most {LARGEST_SIDE_PX} a side"
        )
    grey = values
    if values.ndim == 3:
        grey = values.astype(np.uint32 if values.dtype in (np.uint8, np.uint16) else np.float64).sum(axis=2)
    low, high = float(grey.min()), float(grey.max())
    if not (math.isfinite(low) and math.isfinite(high)):
        raise PhotographError(f"{path}: has pixels that are no numbers; replace them by the sky around them")
    scale = _scale_up(grey, low, high) if np.issubdtype(grey.dtype, np.floating) else 1.0
    while scale > _SMALLEST_SCALE and scale * high + math.ceil(max(-scale * low, 0.0)) > LARGEST_DN:
        scale /= 2
    offset = float(math.ceil(max(-scale * low, 0.0)))
    if offset + scale * high > LARGEST_DN:
        raise PhotographError(
            f"{path}: values from {low:g} to {high:g}; at most {LARGEST_DN / _SMALLEST_SCALE:g} are read: divide them, and "
            "save anew"
        )
    dn = np.rint(offset + scale * grey.astype(np.float64)).astype(np.uint16)
    return dn, max(8, int(dn.max()).bit_length()), scale, offset


def full_pixels(values: NDArray[np.generic]) -> NDArray[np.bool_]:
    """Pixels, (height, width), that are full: in some colour they have the largest number of the picture's bits, or 1.0."""
    numbers: NDArray[Any] = values
    high = float(numbers.max())
    fractions = np.issubdtype(values.dtype, np.floating) and high <= 1.0
    full = numbers >= (1.0 if fractions else 2 ** max(8, int(high).bit_length()) - 1)
    return np.asarray(full if full.ndim == 2 else full.any(axis=2))


def _scale_up(grey: NDArray[np.generic], low: float, high: float) -> float:
    """Factor by which numbers with fractions are multiplied, so that rounding loses little."""
    if low >= 0.0 and high <= 1.0:
        return float(LARGEST_DN)
    if not 0 < high - low < _FEW_LEVELS or not np.any(grey != np.rint(grey.astype(np.float64))):
        return 1.0
    # Whole numbers of the offset take up to one DN.
    span = max(high, high - low)
    return 2.0 ** max(0, math.floor(math.log2((LARGEST_DN - 1) / span)))


def _header_time(path: Path, found: FitsImage, clock: Clock) -> tuple[str, float]:
    if path.name in clock.table:
        return clock.table[path.name]
    told = found.exposure
    if told.begun is None and told.middle is None:
        raise PhotographError(f"{path}: {told.lacks}; mend the header, or {_TIMES}")
    exposure_s = told.length_s if told.length_s is not None else clock.exposure_s
    if exposure_s is None:
        raise PhotographError(f"{path}: its header has no EXPTIME; give --exposure-s, or {_TIMES}")
    if not 0 <= exposure_s <= LONGEST_EXPOSURE_S:
        raise PhotographError(f"{path}: an exposure of {exposure_s:g} s; {_TIMES}")
    middle = told.middle
    if middle is None and told.begun is not None:
        middle = told.begun + timedelta(seconds=exposure_s / 2)
    assert middle is not None
    return middle.strftime("%Y-%m-%dT%H:%M:%S.%fZ"), exposure_s


def _tagged_time(path: Path, clock: Clock) -> tuple[str, float, tuple[str, ...]]:
    if path.name in clock.table:
        return *clock.table[path.name], ()
    tags = (read_raw_tags if path.suffix.lower() in RAW_SUFFIXES else read_tags)(path)
    if tags.taken is None and tags.gps_utc is None:
        raise PhotographError(f"{path}: has no tag DateTimeOriginal, so its time is not known; {_TIMES}")
    exposure_s = tags.exposure_s if tags.exposure_s is not None else clock.exposure_s
    if exposure_s is None:
        raise PhotographError(f"{path}: has no tag ExposureTime; give --exposure-s, or {_TIMES}")
    try:
        found = exposure_time(replace(tags, exposure_s=exposure_s), None, clock.time_zone, clock.stamp)
    except TimeError as error:
        raise PhotographError(f"{path}: {error}".replace("or --utc", f"or {_TIMES}")) from error
    return found.utc, exposure_s, found.assumed


def _is_photograph(path: Path) -> bool:
    name = path.name.lower()
    if name.startswith("."):
        return False
    for packed in PACKED_SUFFIXES:
        if name.endswith(packed):
            return name.removesuffix(packed).endswith(PLAIN_SUFFIXES[:3])
    return name.endswith((*PLAIN_SUFFIXES, *RAW_SUFFIXES))
