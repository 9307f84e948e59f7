"""The reader of KStars' deepstars.dat, on a file of the same bytes with made-up stars."""

import struct

import numpy as np
import pytest

from generator.catalogue import load_catalogue
from generator.errors import DataFileError
from generator.tycho2 import TYCHO_ID_BASE, add_missing, johnson_from_tycho, read_tycho2


def deepstars(stars) -> bytes:
    """A file in KStars' format: preamble, 11 field descriptors, index of 512 trixels, records."""
    head = b"KStars Star Data v1.0. To be read using the 32-bit StarData structure only".ljust(124, b" ")
    head += struct.pack("<hBH", 0x4B53, 1, 11)
    head += b"".join(struct.pack("<10sBBi", f"field{k}".encode(), 4, 4, 1) for k in range(11))
    head += struct.pack("<I", 512) + b"".join(struct.pack("<III", k, 0, 0) for k in range(512)) + bytes(5)
    records = b"".join(
        struct.pack("<iiiiiihh2sBB", round(ra / 15 * 1e6), round(dec * 1e5), 50, -30, 0, 0, round(vt * 100),
                    9999 if colour is None else round(colour * 100), b"G2", 0, 0)
        for ra, dec, vt, colour in stars
    )  # fmt: skip
    return head + records


STARS = [(10.0, 20.0, 9.0, 0.8), (10.0, 20.0, 9.0, 0.8), (200.0, -45.5, 10.5, None), (200.01, -45.5, 8.2, 0.1)]


def test_reads_places_and_johnson_magnitudes_without_duplicates(tmp_path) -> None:
    path = tmp_path / "deepstars.dat"
    path.write_bytes(deepstars(STARS))
    stars = read_tycho2(path)
    assert len(stars) == 3
    np.testing.assert_allclose(stars.ra_deg, [10.0, 200.0, 200.01], atol=1e-5)
    np.testing.assert_allclose(stars.dec_deg, [20.0, -45.5, -45.5], atol=1e-6)
    np.testing.assert_allclose(stars.v_mag[[0, 2]], [9.0 - 0.072, 8.2 - 0.009], atol=1e-9)
    np.testing.assert_allclose(stars.bv_mag, [0.68, 0.6, 0.085], atol=1e-9)
    assert stars.bv_assumed.tolist() == [False, True, False]
    assert stars.star_id.tolist() == [TYCHO_ID_BASE, TYCHO_ID_BASE + 2, TYCHO_ID_BASE + 3]
    np.testing.assert_allclose(stars.pm_ra_mas_yr, 5.0)


def test_adds_only_stars_that_the_catalogue_lacks(tmp_path) -> None:
    """Stars of Hipparcos again, as Tycho has them, add nothing; others are added and sorted in."""
    base = load_catalogue()[np.arange(1000, 1100)]
    again = [(ra, dec, v + 0.09 * bv / 0.85, bv / 0.85) for ra, dec, v, bv in
             zip(base.ra_deg, base.dec_deg, base.v_mag, base.bv_mag, strict=True)]  # fmt: skip
    path = tmp_path / "deepstars.dat"
    path.write_bytes(deepstars([*again, (123.0, 45.0, 3.0, 0.0)]))
    joined = add_missing(base, read_tycho2(path))
    assert len(joined) == 101
    assert (np.diff(joined.v_mag) >= 0).all()
    assert joined.star_id[0] == TYCHO_ID_BASE + 100


def test_conversion_of_colours() -> None:
    v, bv = johnson_from_tycho(np.array([5.0]), np.array([1.0]))
    assert (float(v[0]), float(bv[0])) == (4.91, 0.85)


def test_a_missing_or_damaged_file_is_named(tmp_path) -> None:
    with pytest.raises(DataFileError, match="kstars-data-extra-tycho2"):
        read_tycho2(tmp_path / "nothing.dat")
    path = tmp_path / "deepstars.dat"
    path.write_bytes(deepstars(STARS)[:-5])
    with pytest.raises(DataFileError, match="multiple of 32"):
        read_tycho2(path)
