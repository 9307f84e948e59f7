"""Light of stars in a sensor from 350 to 1000 nm, against published spectrophotometry."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from generator.light.photometry import BESSELL_V, GRID_NM
from generator.light.star_colours import M_GIANTS_VI, moves_like_a_dwarf, usual_vi, vi_from_type
from generator.light.stellar_spectra import star_spectra
from generator.places.catalogue import load_catalogue, read_hipparcos, read_ybsc

QE_NM = [350, 400, 450, 500, 550, 600, 650, 700, 750, 800, 850, 900, 950, 1000]
QE = [0.20, 0.45, 0.65, 0.75, 0.78, 0.75, 0.70, 0.62, 0.53, 0.42, 0.32, 0.22, 0.12, 0.05]
"""A monochrome CMOS sensor."""

PHOTOMETRY = pd.read_csv(Path(__file__).with_name("stellar_photometry.csv"), comment="#")
"""Colours and electrons of published spectra, on their own wavelengths: tools/build_stellar_photometry.py."""
WORST = {"M6V": 0.06, "M9III": 0.09, "GL83.1": 0.04}
"""Deviations of stars to which the templates are not a good likeness: late dwarfs, and an M9 giant bluer than the M8."""


def electrons(bv_mag: np.ndarray, vi_mag: np.ndarray) -> np.ndarray:
    fine = np.arange(350.0, 1000.01, 0.5)
    spectra = star_spectra(np.zeros(len(bv_mag)), bv_mag, vi_mag)
    collected = [np.trapezoid(np.interp(fine, GRID_NM, row) * np.interp(fine, QE_NM, QE), fine) for row in spectra]
    return np.array(collected) / BESSELL_V.zero_point


@pytest.mark.parametrize(("source", "stars"), [("pickles", 106), ("gunn_stryker", 20)])
def test_electrons_of_stars_of_known_colours(source, stars) -> None:
    """Within 3 % from O5 to M8, for dwarfs, giants and supergiants; in the median within 0.4 %."""
    table = PHOTOMETRY[PHOTOMETRY["source"] == source]
    assert len(table) == stars
    off = np.abs(electrons(table["bv_mag"].to_numpy(), table["vi_mag"].to_numpy()) / table["electrons_nm"] - 1)
    bounds = table["star"].map(WORST).fillna(0.03)
    assert not list(table["star"][off > bounds])
    assert np.median(off) < 0.004


def test_electrons_of_stars_without_v_minus_i() -> None:
    """Dwarfs to giants, up to K3, whose V-I follows from B-V and luminosity: within 3 %; K3 V, bluer than usual, 8 %."""
    luminosity = PHOTOMETRY["star"].str.extract(r"^[OBAFGK][\d.-]+(V|IV|III)$")[0]
    table = PHOTOMETRY[luminosity.notna() & (PHOTOMETRY["source"] == "pickles") & (PHOTOMETRY["bv_mag"] < 1.23)]
    dwarf = luminosity[table.index].to_numpy() == "V"
    bv_mag = table["bv_mag"].to_numpy()
    usual = np.where(dwarf, usual_vi(bv_mag, dwarf=True), usual_vi(bv_mag, dwarf=False))
    off = np.abs(electrons(bv_mag, usual) / table["electrons_nm"] - 1)
    assert not list(table["star"][off > np.where(table["star"] == "K3V", 0.08, 0.03)])


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
