"""Tycho-2 stars from the files of Debian's packages kstars-data-extra-tycho2 and kstars-data, which the user installs.

``deepstars.dat`` of the first holds stars fainter than V_T 8; ``unnamedstars.dat`` and ``namedstars.dat`` of the second, read
where they stand beside it, the brighter ones. Each is a header with field descriptors, an index of trixels, and records of 32
bytes. Magnitudes are Tycho's V_T and B_T - V_T. Source of the stars: Hog et al. 2000, A&A 355, L27.
"""

from __future__ import annotations

import functools
import os
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from generator.errors import DataFileError
from generator.light.star_colours import moves_like_a_dwarf, vi_from_type
from generator.places.catalogue import ASSUMED_BV_MAG, StarCatalogue, load_catalogue

Floats = NDArray[np.float64]

PATH_VARIABLE = "SKYBENCH_TYCHO2"
DEFAULT_PATH = Path("/usr/share/kstars/deepstars.dat")
BRIGHTER_FILES = ("unnamedstars.dat", "namedstars.dat")
PREAMBLE_BYTES = 124
DESCRIPTOR_BYTES, INDEX_BYTES, EXPANSION_BYTES, RECORD_BYTES = 16, 12, 5, 32
TYCHO_ID_BASE = 100_000_000
SAME_STAR_ARCSEC, SAME_STAR_MAG = 5.0, 1.5
DUPLICATE_ARCSEC = 0.2
YEARS_FROM_HIPPARCOS = 8.75
NO_COLOUR = 9999
RECORD = np.dtype(
    [("ra", "<i4"), ("dec", "<i4"), ("pm_ra", "<i4"), ("pm_dec", "<i4"), ("parallax", "<i4"), ("hd", "<i4"),
     ("mag", "<i2"), ("colour", "<i2"), ("spectral_type", "S2"), ("flags", "u1"), ("spare", "u1")]
)  # fmt: skip


def johnson_from_tycho(vt_mag: Floats, bt_vt_mag: Floats) -> tuple[Floats, Floats]:
    """Johnson V and B-V from Tycho V_T and B_T - V_T. Source: ESA 1997, SP-1200, volume 1, eq. 1.3.20."""
    return vt_mag - 0.090 * bt_vt_mag, 0.850 * bt_vt_mag


def read_records(path: Path) -> NDArray[np.void]:
    """Records of a ``deepstars.dat``.

    Raises
    ------
    DataFileError
        The file cannot be read or has another layout.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise DataFileError(
            f"{path}: cannot be read ({error.strerror}); install kstars-data-extra-tycho2 (Debian, non-free) and "
            f"kstars-data, or point {PATH_VARIABLE} at the former's deepstars.dat"
        ) from error
    # Preamble: 124 bytes of text, i2 byte order, u1 version, u2 count of field descriptors; descriptors from byte 129.
    header = PREAMBLE_BYTES + 5
    if len(data) < header + 4:
        raise DataFileError(f"{path}: too short for a KStars binary catalogue")
    fields = int(np.frombuffer(data, "<u2", 1, PREAMBLE_BYTES + 3)[0])
    start = header + fields * DESCRIPTOR_BYTES
    if len(data) < start + 4:
        raise DataFileError(f"{path}: ends inside its field descriptors")
    trixels = int(np.frombuffer(data, "<u4", 1, start)[0])
    start += 4 + trixels * INDEX_BYTES + EXPANSION_BYTES
    size = len(data) - start
    if size < 0 or size % RECORD_BYTES:
        raise DataFileError(
            f"{path}: {size} bytes of records, not a multiple of {RECORD_BYTES}; install the package again"
        )
    return np.frombuffer(data, RECORD, offset=start)


def without_duplicates(ra_deg: Floats, dec_deg: Floats, v_mag: Floats) -> NDArray[np.bool_]:
    """Which stars to keep: of those within DUPLICATE_ARCSEC of each other and alike to 0.05 mag, the first."""
    a, d = np.radians(ra_deg), np.radians(dec_deg)
    xyz = np.stack([np.cos(d) * np.cos(a), np.cos(d) * np.sin(a), np.sin(d)], axis=-1)
    pairs = cKDTree(xyz).query_pairs(float(np.radians(DUPLICATE_ARCSEC / 3600)), output_type="ndarray")
    keep = np.ones(len(ra_deg), bool)
    alike = np.abs(v_mag[pairs[:, 0]] - v_mag[pairs[:, 1]]) < 0.05
    keep[pairs[alike].max(axis=1)] = False
    return keep


def read_tycho2(path: Path) -> StarCatalogue:
    """Tycho-2 as a catalogue: ICRS at J2000.0, Johnson V and B-V, duplicates removed. Ids: TYCHO_ID_BASE plus record.

    Parameters
    ----------
    path : Path
        Of ``deepstars.dat``; BRIGHTER_FILES beside it are read too.
    """
    beside = [path.parent / name for name in BRIGHTER_FILES]
    record = np.concatenate([read_records(file) for file in (path, *(file for file in beside if file.exists()))])
    colour = record["colour"].astype(float) / 100
    assumed = (record["colour"] == NO_COLOUR) | (np.abs(colour) > 5)
    bt_vt = np.where(assumed, ASSUMED_BV_MAG / 0.85, colour)
    v_mag, bv_mag = johnson_from_tycho(record["mag"].astype(float) / 100, bt_vt)
    ra, dec = record["ra"].astype(float) / 1e6 * 15, record["dec"].astype(float) / 1e5
    none = np.zeros(len(record), np.int32)
    motion_mas_yr = np.hypot(record["pm_ra"].astype(float), record["pm_dec"].astype(float)) / 10
    vi_mag = vi_from_type(bv_mag, record["spectral_type"].astype(str), moves_like_a_dwarf(v_mag, motion_mas_yr))
    stars = StarCatalogue(
        hip=none,
        hr=none,
        ra_deg=ra,
        dec_deg=dec,
        pm_ra_mas_yr=record["pm_ra"].astype(float) / 10,
        pm_dec_mas_yr=record["pm_dec"].astype(float) / 10,
        parallax_mas=record["parallax"].astype(float) / 10,
        v_mag=v_mag,
        bv_mag=bv_mag,
        vi_mag=vi_mag,
        bv_assumed=assumed,
        other_id=(TYCHO_ID_BASE + np.arange(len(record))).astype(np.int32),
    )
    return stars[without_duplicates(ra, dec, v_mag)]


def unit_vectors(stars: StarCatalogue, years: float = 0.0) -> Floats:
    """Directions of stars after some years of proper motion, (n, 3) array."""
    d = np.radians(stars.dec_deg + stars.pm_dec_mas_yr * years / 3.6e6)
    a = np.radians(stars.ra_deg + stars.pm_ra_mas_yr * years / 3.6e6 / np.cos(np.radians(stars.dec_deg)))
    return np.stack([np.cos(d) * np.cos(a), np.cos(d) * np.sin(a), np.sin(d)], axis=-1)


def add_missing(base: StarCatalogue, more: StarCatalogue) -> StarCatalogue:
    """`base`, and those stars of `more` that it lacks: none within SAME_STAR_ARCSEC and SAME_STAR_MAG; sorted by V.

    KStars' files give most stars at J2000 and some, unmarked, at J1991.25, the epoch of Hipparcos: a star counts as known
    if the base has it at either place.
    """
    reach = float(np.radians(SAME_STAR_ARCSEC / 3600))
    tree, v_mag = cKDTree(unit_vectors(base)), np.append(base.v_mag, np.inf)
    known = np.zeros(len(more), bool)
    for years in (0.0, YEARS_FROM_HIPPARCOS):
        distance, row = tree.query(unit_vectors(more, years), k=2, distance_upper_bound=reach)
        alike = np.abs(v_mag[row] - more.v_mag[:, None]) < SAME_STAR_MAG
        known |= (np.isfinite(distance) & alike).any(axis=1)
    joined = base.joined(more[~known])
    return joined[np.argsort(joined.v_mag, kind="stable")]


@functools.cache
def load_with_tycho2() -> StarCatalogue:
    """The default catalogue and all Tycho-2 stars it lacks, from the installed file (see PATH_VARIABLE)."""
    return add_missing(load_catalogue(), read_tycho2(Path(os.environ.get(PATH_VARIABLE, DEFAULT_PATH))))
