"""The reader of KStars' star files: on a file of the same bytes with made-up stars, and on the real ones."""

import os
import struct
from pathlib import Path

import numpy as np
import pytest

from generator.errors import DataFileError
from generator.places.catalogue import StarCatalogue, load_catalogue
from generator.places.tycho2 import (
    BRIGHTER_FILES,
    DEFAULT_PATH,
    PATH_VARIABLE,
    TYCHO_ID_BASE,
    add_missing,
    johnson_from_tycho,
    read_tycho2,
)  # fmt: skip


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


def test_knows_stars_where_they_were_at_hipparcos_epoch(tmp_path) -> None:
    """KStars has some stars at J1991.25: a star of the catalogue moved back 8.75 years is not a new one."""
    catalogue = load_catalogue()
    fast = catalogue[(np.hypot(catalogue.pm_ra_mas_yr, catalogue.pm_dec_mas_yr) > 1200) & (catalogue.v_mag < 7)]
    assert len(fast) > 20
    cosine = np.cos(np.radians(fast.dec_deg))
    more = StarCatalogue(
        hip=np.zeros(len(fast), np.int32),
        hr=np.zeros(len(fast), np.int32),
        ra_deg=fast.ra_deg - fast.pm_ra_mas_yr * 8.75 / 3.6e6 / cosine,
        dec_deg=fast.dec_deg - fast.pm_dec_mas_yr * 8.75 / 3.6e6,
        pm_ra_mas_yr=fast.pm_ra_mas_yr,
        pm_dec_mas_yr=fast.pm_dec_mas_yr,
        parallax_mas=fast.parallax_mas,
        v_mag=fast.v_mag,
        bv_mag=fast.bv_mag,
        vi_mag=fast.vi_mag,
        bv_assumed=fast.bv_assumed,
        other_id=(TYCHO_ID_BASE + np.arange(len(fast))).astype(np.int32),
    )
    assert len(add_missing(fast, more)) == len(fast)


INSTALLED = Path(os.environ.get(PATH_VARIABLE, DEFAULT_PATH))


@pytest.mark.slow
@pytest.mark.skipif(
    not (INSTALLED.parent / BRIGHTER_FILES[0]).exists() or not INSTALLED.exists(),
    reason=f"{INSTALLED} of Debian's non-free kstars-data-extra-tycho2 and kstars-data's files beside it are not installed",
)
def test_the_real_files() -> None:
    """Counts of the three files, Johnson V, duplicates removed, by an independent reading: 45,636 stars to V 8 and 77,673 to
    V 8.5 (within 3, by what counts as a duplicate). Joined, no bright star comes twice: the naked-eye sky grows by less
    than 5, by companions that the default catalogue has as one star."""
    tycho, base = read_tycho2(INSTALLED), load_catalogue()
    assert (tycho.v_mag <= 8.0).sum() == pytest.approx(45_636, abs=3)
    assert (tycho.v_mag <= 8.5).sum() == pytest.approx(77_673, abs=3)
    joined = add_missing(base, tycho)
    assert (joined.v_mag <= 6.0).sum() - (base.v_mag <= 6.0).sum() < 5
    assert 77_673 < (joined.v_mag <= 8.5).sum() < 1.01 * 77_673
    assert (np.diff(joined.v_mag) >= 0).all()
