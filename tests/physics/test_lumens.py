"""Photons, energy and lumens: the effective wavelengths of the bands, and the light of lamps as the eye weighs it."""

import colour
import numpy as np
import pytest
import speclite.filters
from colour.colorimetry import SDS_LEFS_PHOTOPIC
from scipy import constants

from generator.ground.lamp import KINDS, RED_NM, RED_WIDTH_NM, Lamp, apparent_v_mag
from generator.light.emission import REFLECTED_SHARE
from generator.light.lamps import City, luminous
from generator.light.photometry import BESSELL_B, BESSELL_I, BESSELL_V, GRID_NM
from generator.light.stellar_spectra import star_spectra
from generator.sky.city_light import upward_spectrum

FINE_NM = np.arange(380.0, 780.1, 0.5)
COLOUR_NAMES = {
    "HPS": "HPS",
    "LED": "Phosphor LED YAG",
    "LED3000": "PHOS-1",
    "MH": "Metal Halide",
    "mercury": "Mercury",
}
V_ZERO_W_M2_NM = 3.631e-11
"""Bessell, Castelli & Plez 1998, A&A 333, 231: 363.1e-11 erg s^-1 cm^-2 A^-1."""


def photopic(wavelength_nm: np.ndarray) -> np.ndarray:
    published = SDS_LEFS_PHOTOPIC["CIE 1924 Photopic Standard Observer"]
    return np.interp(wavelength_nm, published.wavelengths, published.values, left=0, right=0)


def power(kind: str) -> np.ndarray:
    """Relative spectral power of a lamp at FINE_NM, not by way of photons."""
    if kind == "red":
        return np.exp(-0.5 * ((FINE_NM - RED_NM) / RED_WIDTH_NM) ** 2) / FINE_NM
    published = colour.SDS_LIGHT_SOURCES[COLOUR_NAMES[kind]]
    return np.interp(FINE_NM, published.wavelengths, published.values)


def lux_of_v_zero(kind: str) -> float:
    """Illuminance by a lamp of V = 0: its mean irradiance, weighted by the energy response of Bessell 1990, is known."""
    band = speclite.filters.load_filter("bessell-V")
    response = np.interp(FINE_NM, band.wavelength / 10, band.response, left=0, right=0)
    irradiance = power(kind) * V_ZERO_W_M2_NM * response.sum() / (power(kind) * response).sum()
    return float(683 * np.trapezoid(irradiance * photopic(FINE_NM), FINE_NM))


@pytest.mark.parametrize(("band", "nm"), [(BESSELL_B, 436.1), (BESSELL_V, 544.8), (BESSELL_I, 798.0)])
def test_effective_wavelengths_of_a_white_star(band, nm) -> None:
    """Bessell 2005, ARA&A 43, 293, table 1: photons of a star of type A0."""
    at = np.arange(band.wavelength_nm[0], band.wavelength_nm[-1], 0.1)
    photons = np.interp(at, band.wavelength_nm, band.response) * np.interp(at, GRID_NM, star_spectra([0.0], [0.0])[0])
    assert float((at * photons).sum() / photons.sum()) == pytest.approx(nm, abs=0.5)


def test_a_star_of_v_zero_is_as_bright_as_published() -> None:
    """2.54e-6 lx (Crumey 2014, MNRAS 442, 2600), for a white star."""
    assert float(luminous(star_spectra([0.0], [0.0]))[0]) == pytest.approx(2.54e-6, rel=0.02)


@pytest.mark.parametrize("kind", KINDS)
def test_v_of_a_lamp_is_that_of_its_lux(kind) -> None:
    """1 cd at 1 km is 1e-6 lx: of the same V, sodium gives 30 % more lux than a white star, red light 70 %."""
    (v_mag,) = apparent_v_mag((Lamp(0.0, 0.0, 1000.0, 1.0, 0.0, kind),), None)
    assert float(v_mag) == pytest.approx(-2.5 * np.log10(1e-6 / lux_of_v_zero(kind)), abs=0.015)


@pytest.mark.parametrize("lamps", [(("HPS", 1.0),), (("LED", 1.0),), (("HPS", 0.5), ("LED3000", 0.5))])
def test_upward_light_of_a_town_has_its_lumens(lamps) -> None:
    """Photons weighed by their energy and CIE 1924's efficiency."""
    town = City(10.0, 0.0, 3.0, upward_mlm=25.0, horizon_share=0.2, lamps=lamps)
    photons = upward_spectrum(town, REFLECTED_SHARE)
    joule = constants.h * constants.c / (GRID_NM * 1e-9)
    assert 683 * np.trapezoid(photons * joule * photopic(GRID_NM), GRID_NM) == pytest.approx(25e6, rel=2e-3)
