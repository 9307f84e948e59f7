"""Stars packed into a few bytes each: the layout of ``data/tycho2/stars.xz``.

The file is the XZ compression of a header and planes of bytes, with one entry per star. Stars are in bands of
declination, 128 arcsec each, from the south, and sorted by right ascension within a band. A star is stored as the step
from the previous one, in half arcseconds on the sky, and its height in the band. Sorted this way, 1.4 million places to
half an arcsecond take 22 bits each, which is their information content (log2 of cells per star, plus 1.44). Steps of
magnitudes and colours are finer than Tycho-2's errors for most of its stars (0.1 mag); those of proper motions, 20
mas/yr, add up to a quarter of an arcsecond in 26 years.
"""

from __future__ import annotations

import lzma
import struct
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from generator.errors import DataFileError

Floats = NDArray[np.float64]

MAGIC = b"skybench-stars-1"
HEADER = struct.Struct("<16sI")
CELL_ARCSEC = 0.5
CELLS_IN_BAND = 256
BANDS = int(np.ceil(180 * 3600 / (CELL_ARCSEC * CELLS_IN_BAND)))
V_STEP_MAG = 0.05
BV_STEP_MAG, LEAST_BV_MAG, NO_BV = 0.05, -1.0, 255
MOTION_STEP_MAS_YR = 20.0
BYTES_PER_STAR = 3 + 1 + 1 + 1 + 2 + 2
MOST_STARS = 4_000_000
FILTERS = [{"id": lzma.FILTER_LZMA2, "preset": 6, "dict_size": 1 << 20, "lc": 0, "lp": 0, "pb": 0}]


@dataclass(frozen=True)
class Stars:
    """Places, magnitudes and motions of n stars.

    Attributes
    ----------
    ra_deg, dec_deg : (n,) arrays
        ICRS at J2000.0.
    pm_ra_mas_yr, pm_dec_mas_yr : (n,) arrays
        Proper motion, with cos(dec) in right ascension.
    v_mag, bv_mag : (n,) arrays
        Johnson magnitudes; B-V is NaN if unknown.
    """

    ra_deg: Floats
    dec_deg: Floats
    pm_ra_mas_yr: Floats
    pm_dec_mas_yr: Floats
    v_mag: Floats
    bv_mag: Floats


def _cells_per_deg(band: NDArray[np.intp]) -> Floats:
    """Number of cells along a degree of right ascension at the middle of bands; the last band is half as high."""
    height_deg = CELLS_IN_BAND * CELL_ARCSEC / 3600
    middle_deg = np.minimum((band + 0.5) * height_deg - 90, 90 - height_deg / 4)
    return np.cos(np.radians(middle_deg)) * 3600 / CELL_ARCSEC


def _planes(values: NDArray[np.integer], count: int) -> list[bytes]:
    return [((values >> (8 * number)) & 255).astype(np.uint8).tobytes() for number in range(count)]


def packed(stars: Stars) -> bytes:
    """Pack stars into bytes, which :func:`unpacked` reads; the stars are ordered by place."""
    row = np.floor((stars.dec_deg + 90) * 3600 / CELL_ARCSEC).astype(np.intp)
    band = row // CELLS_IN_BAND
    column = np.floor(stars.ra_deg % 360 * _cells_per_deg(band)).astype(np.intp)
    order = np.lexsort((row, column, band))
    band, column = band[order], column[order]
    first = np.diff(band, prepend=-1) > 0
    step = np.where(first, column, np.diff(column, prepend=0))
    colour = np.rint((stars.bv_mag - LEAST_BV_MAG) / BV_STEP_MAG)
    colour = np.where(np.isnan(colour), NO_BV, np.clip(colour, 0, NO_BV - 1))
    planes = _planes(np.bincount(band, minlength=BANDS), 2) + _planes(step, 3)
    planes += _planes((row % CELLS_IN_BAND)[order], 1)
    planes += _planes(np.clip(np.rint(stars.v_mag / V_STEP_MAG), 0, 255).astype(int)[order], 1)
    planes += _planes(colour.astype(int)[order], 1)
    for motion in (stars.pm_ra_mas_yr, stars.pm_dec_mas_yr):
        steps = np.rint(motion / MOTION_STEP_MAS_YR).astype(int)[order]
        # Zigzag: small numbers of either sign become small numbers.
        planes += _planes(np.where(steps < 0, -2 * steps - 1, 2 * steps), 2)
    plain = HEADER.pack(MAGIC, len(row)) + b"".join(planes)
    return lzma.compress(plain, format=lzma.FORMAT_XZ, check=lzma.CHECK_CRC32, filters=FILTERS)


def unpacked(data: bytes, name: str) -> Stars:
    """Unpack the bytes of :func:`packed`; places are the centres of their cells.

    Raises
    ------
    DataFileError
        The bytes are not packed stars; the message names the file `name`.
    """
    try:
        plain = lzma.LZMADecompressor(format=lzma.FORMAT_XZ).decompress(
            data, max_length=HEADER.size + 2 * BANDS + BYTES_PER_STAR * MOST_STARS
        )
        magic, count = HEADER.unpack_from(plain)
    except (lzma.LZMAError, struct.error) as error:
        raise DataFileError(f"{name}: not a table of packed stars ({error}); reinstall skybench") from error
    values = np.frombuffer(plain, np.uint8, offset=HEADER.size)
    if magic != MAGIC or len(values) != 2 * BANDS + BYTES_PER_STAR * count:
        raise DataFileError(f"{name}: not a table of packed stars of {MAGIC.decode()}; reinstall skybench")
    low, high = values[: 2 * BANDS].reshape(2, BANDS).astype(np.intp)
    in_band = low + 256 * high
    if in_band.sum() != count:
        raise DataFileError(f"{name}: holds {count} stars in bands of {in_band.sum()}; reinstall skybench")
    plane = values[2 * BANDS :].reshape(BYTES_PER_STAR, count).astype(np.int32)
    band = np.repeat(np.arange(BANDS), in_band)
    along = np.cumsum(plane[0] + 256 * plane[1] + 65536 * plane[2], dtype=np.int64)
    # The sum continues from band to band.
    before = np.concatenate([[0], along])[np.cumsum(in_band) - in_band]
    column = along - np.repeat(before, in_band)
    motions = []
    for low_byte, high_byte in (plane[6:8], plane[8:10]):
        folded = low_byte + 256 * high_byte
        motions.append(np.where(folded % 2, -(folded + 1) // 2, folded // 2) * MOTION_STEP_MAS_YR)
    return Stars(
        ra_deg=(column + 0.5) / _cells_per_deg(band) % 360,
        dec_deg=(band * CELLS_IN_BAND + plane[3] + 0.5) * (CELL_ARCSEC / 3600) - 90,
        pm_ra_mas_yr=motions[0],
        pm_dec_mas_yr=motions[1],
        v_mag=plane[4] * V_STEP_MAG,
        bv_mag=np.where(plane[5] == NO_BV, np.nan, plane[5] * BV_STEP_MAG + LEAST_BV_MAG),
    )
