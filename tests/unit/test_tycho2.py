"""Stars of Tycho-2: the packed file, what is in it, and the catalogue that it is joined to."""

import lzma

import numpy as np
import pytest

from generator.errors import DataFileError
from generator.places.catalogue import load_catalogue, tangent_frame
from generator.places.packed_stars import HEADER, MAGIC, Stars, packed, unpacked
from generator.places.tycho2 import (
    FAINTEST_V_MAG,
    TYCHO2_PATH,
    TYCHO_ID_BASE,
    johnson_from_tycho,
    load_with_tycho2,
    read_tycho2,
)
from generator.sky.milky_way import GALACTIC_POLE

HOSTS = {
    "WASP-76": (26.632746, 2.700574, 9.52),
    "HAT-P-7": (292.247306, 47.969505, 10.48),
    "WASP-121": (107.600252, -39.097381, 10.51),
    "XO-1": (240.549355, 28.169561, 11.25),
}
"""Right ascension and declination, deg (Gaia), and V of stars with transiting planets that Hipparcos does not have."""
COUNTED = {7: 16_503, 8: 48_559, 9: 139_375, 10: 382_925, 11: 1_048_084}
"""Stars over the sky brighter than a magnitude in Tycho-2 and UCAC4 together. Source: "Counting stars", hnsky.org."""


def some_stars(count: int = 600) -> Stars:
    """Stars all over the sky, on both poles and beside the zero of right ascension."""
    random = np.random.default_rng(4)
    dec = np.degrees(np.arcsin(random.uniform(-1, 1, count)))
    ra = random.uniform(0, 360, count)
    dec[:4], ra[4:8] = [-90, 90, -89.99, 89.99], [0, 1e-6, 359.99999, 360]
    motion = random.standard_t(2, (2, count)) * 30
    bv = np.where(random.uniform(size=count) < 0.1, np.nan, random.uniform(-0.4, 5.0, count))
    return Stars(ra, dec, *motion, random.uniform(2, 11.5, count), bv)


def separation_arcsec(ra, dec, other_ra, other_dec):
    first, second = (tangent_frame(*map(np.atleast_1d, place))[0] for place in ((ra, dec), (other_ra, other_dec)))
    return np.degrees(np.linalg.norm(first[:, :, None] - second[:, None], axis=0)) * 3600


def test_packed_stars_come_back_within_their_steps() -> None:
    given = some_stars()
    found = unpacked(packed(given), "test")
    assert len(found.v_mag) == len(given.v_mag)
    distance = separation_arcsec(given.ra_deg, given.dec_deg, found.ra_deg, found.dec_deg)
    twin = distance.argmin(axis=1)
    assert sorted(twin) == list(range(len(twin)))
    # The diagonal of a cell; on the poles cells are twice as wide.
    assert distance.min(axis=1)[4:].max() < 0.36
    assert distance.min(axis=1)[:4].max() < 0.6
    np.testing.assert_allclose(found.v_mag[twin], given.v_mag, atol=0.0251)
    np.testing.assert_allclose(found.bv_mag[twin], given.bv_mag, atol=0.0251)
    for name in ("pm_ra_mas_yr", "pm_dec_mas_yr"):
        np.testing.assert_allclose(getattr(found, name)[twin], getattr(given, name), atol=10.01)


def test_the_same_stars_in_another_order_are_the_same_bytes() -> None:
    given = some_stars(500)
    turned = Stars(*(getattr(given, name)[::-1] for name in Stars.__dataclass_fields__))
    assert packed(turned) == packed(given)


def test_a_missing_or_damaged_file_is_named(tmp_path) -> None:
    with pytest.raises(DataFileError, match=r"nothing\.xz: cannot be read"):
        read_tycho2(tmp_path / "nothing.xz")
    whole = packed(some_stars(100))
    plain = lzma.decompress(whole)
    for damaged in (b"", whole[:200], b"x" + whole, lzma.compress(plain[:-3]), lzma.compress(plain + bytes(9)),
                    lzma.compress(HEADER.pack(MAGIC, 2**31) + plain[HEADER.size :]),
                    lzma.compress(plain[: HEADER.size] + b"\1" + plain[HEADER.size + 1 :])):  # fmt: skip
        path = tmp_path / "stars.xz"
        path.write_bytes(damaged)
        with pytest.raises(DataFileError, match=r"stars\.xz"):
            read_tycho2(path)


def test_conversion_of_colours() -> None:
    v, bv = johnson_from_tycho(np.array([5.0]), np.array([1.0]))
    assert (float(v[0]), float(bv[0])) == (4.91, 0.85)


def test_the_file_has_known_stars_where_others_have_them() -> None:
    """Within an arcsecond of Gaia's places (of another epoch), and within 0.2 mag."""
    stars = read_tycho2()
    assert len(stars) == 1_380_306
    assert TYCHO2_PATH.stat().st_size < 6_500_000
    assert stars.star_id[[0, -1]].tolist() == [TYCHO_ID_BASE, TYCHO_ID_BASE + len(stars) - 1]
    for name, (ra, dec, v_mag) in HOSTS.items():
        near = np.flatnonzero(np.abs(stars.dec_deg - dec) < 0.001)
        distance = separation_arcsec(stars.ra_deg[near], stars.dec_deg[near], ra, dec)
        distance = distance.ravel()
        assert distance.min() < 1.0, name
        assert stars.v_mag[near[distance.argmin()]] == pytest.approx(v_mag, abs=0.2), name


def test_joined_it_is_complete_to_v_11_and_has_no_star_twice() -> None:
    """Counts within 10 % of a combined catalogue's, whose magnitudes are of several bands; density on the galactic equator
    over that at 30 deg, and there over that at the pole, within 15 % of 150, 50 and 25 stars a square degree (all of Tycho-2:
    Hog et al. 2000, table 1). The naked-eye sky grows by less than 5."""
    base, joined = load_catalogue(), load_with_tycho2()
    assert (np.diff(joined.v_mag) >= 0).all()
    assert len(joined) == len(base) + 1_380_306
    assert joined.v_mag[joined.other_id > 0].max() <= FAINTEST_V_MAG
    assert (joined.v_mag <= 6.0).sum() - (base.v_mag <= 6.0).sum() < 5
    for magnitude, count in COUNTED.items():
        assert (joined.v_mag <= magnitude).sum() == pytest.approx(count, rel=0.1), magnitude
    sine = np.abs(joined.icrs @ GALACTIC_POLE)
    edges = np.sin(np.radians([0, 5, 25, 35, 80, 90]))
    equator, middle, pole = (np.histogram(sine, edges)[0] / np.diff(edges))[::2]
    assert equator / middle == pytest.approx(150 / 50, rel=0.15)
    assert middle / pole == pytest.approx(50 / 25, rel=0.15)


def test_no_star_of_the_yale_catalogue_alone_is_there_again() -> None:
    """Sigma CrB B has in the Yale catalogue its bright part's place, 5.6 arcsec from its own (V 6.66 there, 6.45 here)."""
    base, tycho = load_catalogue(), read_tycho2()
    yale = base[base.hip == 0]
    bright = tycho[tycho.v_mag < yale.v_mag.max() + 0.5]
    distance = np.linalg.norm(bright.icrs[:, None] - yale.icrs[None], axis=2)
    alike = np.abs(bright.v_mag[:, None] - yale.v_mag[None]) < 0.5
    assert not ((distance < np.radians(10 / 3600)) & alike).any()
