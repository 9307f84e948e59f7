"""Stars to V 11.5 from Tycho-2 that the default catalogue lacks, in ``data/tycho2``.

Source: Hog et al. 2000, A&A 355, L27 (CDS I/259), with its first supplement; 99 % complete to V 11.0, 90 % to 11.5.
``tools/build_tycho2.py`` writes the file. Places are within 0.4 arcsec of the catalogue's, and proper motions within 10
mas/yr along each axis (:mod:`generator.places.packed_stars`).
"""

from __future__ import annotations

import functools
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from generator.errors import DataFileError
from generator.light.star_colours import moves_like_a_dwarf, usual_vi
from generator.places.catalogue import ASSUMED_BV_MAG, StarCatalogue, load_catalogue
from generator.places.packed_stars import unpacked

Floats = NDArray[np.float64]

TYCHO2_PATH = Path(__file__).parents[1] / "data" / "tycho2" / "stars.xz"
TYCHO_ID_BASE = 100_000_000
FAINTEST_V_MAG = 11.5
"""V of the faintest star in the file."""


def johnson_from_tycho(vt_mag: Floats, bt_vt_mag: Floats) -> tuple[Floats, Floats]:
    """Johnson V and B-V from Tycho V_T and B_T - V_T. Source: ESA 1997, SP-1200, volume 1, eq. 1.3.20."""
    return vt_mag - 0.090 * bt_vt_mag, 0.850 * bt_vt_mag


def read_tycho2(path: Path = TYCHO2_PATH) -> StarCatalogue:
    """Read the file's stars, in its order. Ids are TYCHO_ID_BASE plus the row.

    Raises
    ------
    DataFileError
        The file cannot be read or is a different one.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise DataFileError(f"{path}: cannot be read ({error.strerror}); reinstall skybench") from error
    stars = unpacked(data, str(path))
    assumed = np.isnan(stars.bv_mag)
    bv_mag = np.where(assumed, ASSUMED_BV_MAG, stars.bv_mag)
    motion_mas_yr = np.hypot(stars.pm_ra_mas_yr, stars.pm_dec_mas_yr)
    none = np.zeros(len(bv_mag), np.int32)
    return StarCatalogue(
        hip=none,
        hr=none,
        ra_deg=stars.ra_deg,
        dec_deg=stars.dec_deg,
        pm_ra_mas_yr=stars.pm_ra_mas_yr,
        pm_dec_mas_yr=stars.pm_dec_mas_yr,
        parallax_mas=np.zeros(len(bv_mag)),
        v_mag=stars.v_mag,
        bv_mag=bv_mag,
        vi_mag=usual_vi(bv_mag, moves_like_a_dwarf(stars.v_mag, motion_mas_yr) | (bv_mag < 0.8)),
        bv_assumed=assumed,
        other_id=(TYCHO_ID_BASE + np.arange(len(bv_mag))).astype(np.int32),
    )


@functools.cache
def load_with_tycho2() -> StarCatalogue:
    """Return the default catalogue and the stars of Tycho-2 that it lacks, sorted by V."""
    joined = load_catalogue().joined(read_tycho2())
    return joined[np.argsort(joined.v_mag, kind="stable")]
