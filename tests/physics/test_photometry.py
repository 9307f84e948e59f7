"""Photons of magnitudes: zero points, bands and surface brightness against published numbers."""

import math

import numpy as np
import pytest
import speclite.filters
from colour.plotting.datasets.astm_g_173 import SD_ASTMG173_ETR
from scipy import constants
from small_scenes import V_BAND_QE, small_scenario

from generator.frame.exposure.expected import render_expected
from generator.frame.plan import plan_frame
from generator.light.photometry import (
    BESSELL_B,
    BESSELL_I,
    BESSELL_V,
    GRID_NM,
    radiance_from_surface_brightness,
    surface_brightness_from_radiance,
)
from generator.light.stellar_spectra import star_spectra
from generator.places.catalogue import load_catalogue

PER_CM2_ANGSTROM = 1e-5


@pytest.mark.parametrize(
    ("band", "name"), [(BESSELL_B, "bessell-B"), (BESSELL_V, "bessell-V"), (BESSELL_I, "bessell-I")]
)
def test_band_is_bessell_1990_as_speclite_has_it(band, name) -> None:
    """Speclite has the published table, which is a response to energy; the band's is one to photons."""
    published = speclite.filters.load_filter(name)
    np.testing.assert_allclose(band.wavelength_nm * 10, published.wavelength)
    energy = band.response * band.wavelength_nm
    scale = published.response.max() / energy.max()
    np.testing.assert_allclose(energy * scale, published.response, atol=5e-4)


def test_v_counts_photons_as_bessell_and_murphy_do() -> None:
    """Their photonic passband (2012, PASP 124, 140) from 480 to 560 nm, where it follows the table of 1990."""
    published = [0.033, 0.176, 0.485, 0.811, 0.986, 1.000, 0.955, 0.865, 0.750]
    at = np.arange(480.0, 561.0, 10.0)
    np.testing.assert_allclose(np.interp(at, BESSELL_V.wavelength_nm, BESSELL_V.response), published, atol=6e-4)


def test_magnitudes_of_the_sun() -> None:
    """The spectrum of ASTM G173 outside the air: V -26.76 +- 0.02 (Willmer 2018, ApJS 236, 47), B-V 0.653 +- 0.003 and V-I
    0.702 +- 0.010 (Ramirez et al. 2012, ApJ 752, 5)."""
    wavelength, power = SD_ASTMG173_ETR.wavelengths, SD_ASTMG173_ETR.values
    photons = power * wavelength * 1e-9 / (constants.h * constants.c)
    b, v, i = (float(band.magnitude(wavelength, photons)) for band in (BESSELL_B, BESSELL_V, BESSELL_I))
    assert v == pytest.approx(-26.76, abs=0.02)
    assert b - v == pytest.approx(0.653, abs=0.004)
    assert v - i == pytest.approx(0.702, abs=0.015)


def test_v_zero_gives_1000_photons() -> None:
    """V = 0, B-V = 0: 1000 photons s^-1 cm^-2 A^-1 within 2 % (Bessell, Castelli & Plez 1998)."""
    photons = float(BESSELL_V.mean(GRID_NM, star_spectra([0.0], [0.0]))[0]) * PER_CM2_ANGSTROM
    assert photons == pytest.approx(1000, rel=0.02)


def test_v_six_gives_3445_photons_in_the_band() -> None:
    """Integral over the V band of a V = 6 star, 1003.3 x 862 A x 10^-2.4: 3445 photons s^-1 cm^-2 within 1 %."""
    mean = float(BESSELL_V.mean(GRID_NM, star_spectra([6.0], [0.0]))[0]) * PER_CM2_ANGSTROM
    width_angstrom = np.trapezoid(BESSELL_V.response, BESSELL_V.wavelength_nm * 10)
    assert width_angstrom == pytest.approx(862.4, rel=0.005)
    assert mean * width_angstrom == pytest.approx(3445, rel=0.01)


def test_spectra_close_on_catalogue_v_and_colour() -> None:
    """Synthetic V within 0.01, B-V within 0.03 and V-I within 0.01 mag for catalogue stars, through speclite's own bands.

    V-I is that of the catalogue to the reddest template, 4.4.
    """
    catalogue = load_catalogue()
    rows = np.arange(0, 9000, 7)
    stars = catalogue[rows]
    photons = star_spectra(stars.v_mag, stars.bv_mag, stars.vi_mag)

    def synthetic(name: str, zero_point: float) -> np.ndarray:
        band = speclite.filters.load_filter(name)
        fine_nm = np.arange(350, 1000.5, 0.5)
        response = np.interp(fine_nm * 10, band.wavelength, band.response / band.wavelength)
        spectra = np.array([np.interp(fine_nm, GRID_NM, spectrum) for spectrum in photons])
        mean = (spectra * response).sum(axis=1) / response.sum()
        return -2.5 * np.log10(mean * PER_CM2_ANGSTROM / zero_point)

    v, b, i = synthetic("bessell-V", 1003.3), synthetic("bessell-B", 1395.0), synthetic("bessell-I", 465.5)
    assert np.abs(v - stars.v_mag).max() < 0.01
    assert np.abs(b - v - stars.bv_mag).max() < 0.03
    assert np.abs(v - i - np.minimum(stars.vi_mag, 4.4)).max() < 0.01


@pytest.mark.parametrize(
    ("mag", "radiance"),
    [(17, 6.763e11), (18, 2.692e11), (20, 4.267e10), (21, 1.699e10), (21.5, 1.072e10), (22, 6.763e9)],
)
def test_surface_brightness_in_photons(mag, radiance) -> None:
    """Photons s^-1 m^-2 nm^-1 sr^-1 of V mag/arcsec^2, from the V zero point (0.1 %)."""
    assert float(radiance_from_surface_brightness(mag)) == pytest.approx(radiance, rel=1e-3)
    assert float(surface_brightness_from_radiance(radiance)) == pytest.approx(mag, abs=1e-3)


def test_electrons_of_a_star_at_the_zenith_without_atmosphere() -> None:
    """Electrons = zero point x aperture x integral of the quantum efficiency, within 1 %.

    The camera's quantum efficiency is the V band itself, so that the expectation needs no spectrum: 1003.3 photons
    s^-1 cm^-2 A^-1 x 862 A x area x exposure x 10^(-0.4 V). The star nearest the zenith among the bright ones is taken.
    """
    scenario = small_scenario(
        camera__hfov_deg=40,
        camera__transmission=1.0,
        sensor={"quantum_efficiency": V_BAND_QE},
        atmosphere={"extinction": False, "refraction": False},
        sky=None,
        stars={"limiting_magnitude": 6.0},
    )
    plan = plan_frame(scenario, 0)
    expected = render_expected(plan)
    cosine = np.sin(np.radians(plan.middle.altitude_deg))
    nearest = int(np.argmax(cosine))
    area_cm2 = math.pi / 4 * 0.4**2
    zero_point_electrons = 1003.3 * np.trapezoid(
        [point[1] for point in V_BAND_QE], [10 * point[0] for point in V_BAND_QE]
    )
    wanted = zero_point_electrons * area_cm2 * 0.5 * 10 ** (-0.4 * plan.stars.v_mag[nearest]) * cosine[nearest]
    assert cosine[nearest] > 0.99
    assert expected.star_electrons[nearest] == pytest.approx(wanted, rel=0.01)
