"""Light of stars in a sensor from 350 to 1000 nm, against published spectrophotometry."""

import numpy as np
import pytest

from generator.light.photometry import BESSELL_V, GRID_NM
from generator.light.star_colours import M_GIANTS_VI, moves_like_a_dwarf, usual_vi, vi_from_type
from generator.light.stellar_spectra import star_spectra
from generator.places.catalogue import load_catalogue, read_hipparcos, read_ybsc

QE_NM = [350, 400, 450, 500, 550, 600, 650, 700, 750, 800, 850, 900, 950, 1000]
QE = [0.20, 0.45, 0.65, 0.75, 0.78, 0.75, 0.70, 0.62, 0.53, 0.42, 0.32, 0.22, 0.12, 0.05]
"""A monochrome CMOS sensor."""

# Star, B-V, V-I, and its electrons in that sensor over its mean photon irradiance in V, nm. From the published spectra at
# their own 0.5 nm (Pickles) and 1 to 20 nm, so that neither the generator's grid nor its interpolation has a part in them.
PICKLES = [
    ("B3V", -0.19, -0.14, 290.7), ("B8V", -0.10, -0.03, 283.6), ("A2V", 0.04, 0.07, 275.5), ("F2V", 0.40, 0.49, 283.2),
    ("F6V", 0.47, 0.59, 288.9), ("G2V", 0.63, 0.75, 297.1), ("K3V", 0.93, 1.14, 338.4), ("M2V", 1.43, 2.08, 517.8),
    ("F8I", 0.60, 0.53, 278.5), ("G2I", 0.89, 0.76, 291.7), ("K2I", 1.48, 1.29, 349.9), ("K0IV", 0.94, 1.00, 316.7),
    ("G8III", 0.94, 0.96, 310.7), ("K0III", 0.95, 1.01, 316.9), ("K3III", 1.20, 1.21, 339.8), ("K5III", 1.41, 1.59, 400.6),
    ("M0III", 1.42, 1.70, 420.6), ("M2III", 1.44, 1.93, 472.2), ("M3II", 1.63, 2.37, 600.5), ("M4III", 1.38, 2.50, 647.4),
    ("M6III", 1.22, 3.40, 1266.6),
]  # fmt: skip
"""Pickles 1998, PASP 110, 863."""
GUNN_STRYKER = [
    ("102 Her", -0.26, -0.30, 294.9), ("HR 7899", -0.21, -0.23, 289.6), ("20 Aql", -0.17, -0.15, 287.9),
    ("iota Lyr", -0.15, -0.12, 286.7), ("HR 7346", -0.13, -0.09, 284.3), ("11 Sge", -0.04, -0.05, 278.4),
    ("HD 190849A", -0.01, 0.02, 276.6), ("60 Her", 0.07, 0.10, 276.5), ("HD 508", 0.29, 0.38, 281.1),
    ("HD 191177", 0.30, 0.43, 285.7), ("HD 7331", 0.42, 0.51, 285.9), ("HD 148816", 0.50, 0.69, 298.3),
    ("HD 192344", 0.64, 0.74, 296.7), ("HR 7670", 0.67, 0.73, 295.8), ("HD 128428", 0.71, 0.80, 300.1),
    ("HD 56176", 0.86, 0.97, 315.8), ("HD 199580", 0.88, 0.98, 317.8), ("BD+38 2457", 1.06, 1.21, 349.7),
]  # fmt: skip
"""Single stars, none of them in the generator's table: Gunn & Stryker 1983, ApJS 52, 121, as MAST's atlas BPGS has them."""


def electrons(bv_mag: float, vi_mag: float | None = None) -> float:
    fine = np.arange(350.0, 1000.01, 0.5)
    spectrum = np.interp(fine, GRID_NM, star_spectra([0.0], [bv_mag], None if vi_mag is None else [vi_mag])[0])
    return float(np.trapezoid(spectrum * np.interp(fine, QE_NM, QE), fine)) / BESSELL_V.zero_point


@pytest.mark.parametrize(("star", "bv_mag", "vi_mag", "published"), PICKLES + GUNN_STRYKER)
def test_electrons_of_a_star_of_known_colours(star, bv_mag, vi_mag, published) -> None:
    """Within 3 % from B to M6, for dwarfs, giants and supergiants."""
    assert electrons(bv_mag, vi_mag) == pytest.approx(published, rel=0.03), star


@pytest.mark.parametrize(
    "row", [row for row in PICKLES if row[1] < 1.22 and not row[0].endswith(("8I", "2I", "M6III"))]
)
def test_electrons_of_a_star_without_v_minus_i(row) -> None:
    """Dwarfs and giants to K3, whose V-I follows from B-V and luminosity: within 3 %; K3 V, bluer than usual, 8 %."""
    star, bv_mag, _, published = row
    usual = float(usual_vi(bv_mag, dwarf=star[2:] == "V"))
    assert electrons(bv_mag, usual) == pytest.approx(published, rel=0.08 if star == "K3V" else 0.03)


def test_colours_of_m_giants() -> None:
    """V-I of M0 to M8 III against the means of Th\u00e9, Steenman & Alcaino 1984 (A&A 132, 385), within 0.26 mag."""
    published = [1.60, 1.88, 2.05, 2.26, 2.55, 2.87, 3.30, 3.78, 4.34]
    assert np.abs(M_GIANTS_VI - published).max() < 0.27
    assert np.sqrt(np.mean((M_GIANTS_VI - published) ** 2)) < 0.12


def test_colour_of_the_sun() -> None:
    """B-V 0.653 and V-I 0.702 +- 0.010 belong together (Ramirez et al. 2012, ApJ 752, 5): within 0.06 mag."""
    assert float(usual_vi(0.653, dwarf=True)) == pytest.approx(0.702, abs=0.06)


def test_catalogue_has_hipparcos_v_minus_i() -> None:
    """Vega 0.00, Arcturus 1.22, Aldebaran 1.53, Betelgeuse 2.32, as ESA 1997 lists them; Mu Cephei, HIP 107259, is red."""
    stars = load_catalogue()
    listed = read_hipparcos().set_index("hip")["vi_mag"]
    for hip in (91262, 69673, 21421, 27989, 107259):
        assert stars.vi_mag[stars.hip == hip] == listed[hip]
    assert float(listed[91262]) == pytest.approx(0.0, abs=0.02)
    assert float(listed[69673]) == pytest.approx(1.22, abs=0.05)
    assert np.isfinite(stars.vi_mag).all()


def test_stars_that_only_ybsc_has_take_their_type_s_colour() -> None:
    """A giant M3 is redder in V-I than its B-V says; a dwarf of class K is redder than a giant of its B-V."""
    bv_mag = np.array([1.6, 1.6, 1.1, 1.1])
    found = vi_from_type(bv_mag, np.array(["M3III", "", "K3V", "K3III"]), np.array([False, False, True, False]))
    assert found[0] == M_GIANTS_VI[3]
    assert found[2] > found[3] + 0.05
    types = read_ybsc().set_index("hr")["spectral_type"]
    assert types[2061] == "M1-2Ia-Iab"
    assert types[5340] == "K1.5IIIFe-0.5"


def test_nearby_dwarfs_are_told_from_giants() -> None:
    """61 Cyg A and epsilon Eri are dwarfs; Arcturus, the fastest of the bright giants, and Aldebaran are giants."""
    v_mag, motion = np.array([5.21, 3.73, -0.04, 0.85]), np.array([5281.0, 976.0, 2279.0, 199.0])
    np.testing.assert_array_equal(moves_like_a_dwarf(v_mag, motion), [True, True, False, False])
