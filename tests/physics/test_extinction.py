"""The atmosphere against published extinction, optical depth and airmass."""

import dataclasses

import numpy as np
import pytest
from small_scenes import small_scenario

from generator.frame.exposure.expected import render_expected
from generator.frame.plan import plan_frame
from generator.frame.scene import quantum_efficiency
from generator.light.atmosphere import (
    MAG_PER_OPTICAL_DEPTH,
    Atmosphere,
    aerosol_optical_depth,
    airmass,
    optical_depth,
    ozone_optical_depth,
    rayleigh_optical_depth,
    standard_pressure_hpa,
)
from generator.light.molecular_bands import band_depth, ozone_airmass, precipitable_water_cm, slant_depth
from generator.light.photometry import GRID_NM
from generator.light.stellar_spectra import star_spectra
from generator.sky.component import DIFFUSE_EXTINCTION_FACTOR, extinction_factors
from generator.sky.directions import sky_grid
from generator.sky.moonlight import moonlight

# Patat et al. 2011, A&A 527, A91, table: Paranal, 2640 m, mag/airmass at A.
PATAT_2011 = {
    4025: 0.330, 4125: 0.298, 4225: 0.274, 4325: 0.253, 4425: 0.229, 4525: 0.212, 4625: 0.198, 4725: 0.185, 4825: 0.176,
    4925: 0.162, 5025: 0.156, 5125: 0.146, 5225: 0.141, 5325: 0.139, 5425: 0.133, 5525: 0.129, 5625: 0.128, 5725: 0.134,
    5825: 0.124, 5925: 0.125, 6025: 0.117, 6125: 0.108, 6225: 0.102, 6325: 0.095, 6425: 0.085, 6525: 0.083, 6625: 0.076,
    6725: 0.068, 6775: 0.064,
}  # fmt: skip
PARANAL = Atmosphere(pressure_hpa=743.0, aerosol_tau_550=0.025, angstrom_exponent=1.3, ozone_du=257.0)


def test_paranal_extinction() -> None:
    """Within 0.03 mag/airmass of Patat 2011 from 400 to 680 nm, at 2640 m's pressure and low aerosol."""
    wavelength_nm = np.array(list(PATAT_2011)) / 10
    difference = MAG_PER_OPTICAL_DEPTH * optical_depth(wavelength_nm, PARANAL) - np.array(list(PATAT_2011.values()))
    assert np.abs(difference).max() < 0.03


@pytest.mark.parametrize(
    ("nm", "tau"),
    [(350, 0.63085), (400, 0.36052), (450, 0.22130), (500, 0.14348), (550, 0.09715), (600, 0.06815), (700, 0.03646),
     (800, 0.02125), (1000, 0.00864)],
)  # fmt: skip
def test_rayleigh_against_bodhaine(nm, tau) -> None:
    """Within 0.5 % of Bodhaine et al. 1999 at sea level."""
    assert float(rayleigh_optical_depth(nm, 1013.25)) == pytest.approx(tau, rel=0.005)


@pytest.mark.parametrize(
    ("zenith_deg", "value"),
    [(30, 1.1540), (45, 1.4126), (60, 1.9943), (70, 2.9031), (80, 5.5860), (85, 10.3058), (89, 26.3106), (90, 37.9196)],
)
def test_airmass_is_kasten_and_young(zenith_deg, value) -> None:
    assert float(airmass(90 - zenith_deg)) == pytest.approx(value, abs=6e-5)


def test_rendered_stars_are_dimmed_by_their_own_path() -> None:
    """Electrons with atmosphere over electrons without = band-integrated transmission, within 0.2 %."""
    clear = small_scenario(atmosphere={"extinction": False}, sky=None, stars={"limiting_magnitude": 4.0})
    hazy = small_scenario(
        atmosphere={"aerosol_tau_550": 0.3, "ozone_du": 400}, sky=None, stars={"limiting_magnitude": 4.0}
    )
    plan = plan_frame(hazy, 0)
    ratio = render_expected(plan).star_electrons / render_expected(plan_frame(clear, 0)).star_electrons
    response = quantum_efficiency(plan.spec)
    spectra = star_spectra(plan.stars.v_mag, plan.stars.bv_mag, plan.stars.vi_mag)
    air = Atmosphere(1010.0, 0.3, 1.3, 400.0, precipitable_water_cm(10.0, 0.5))
    dimmed = spectra * np.exp(-slant_depth(GRID_NM, air, plan.airmass))
    wanted = np.trapezoid(dimmed * response, GRID_NM) / np.trapezoid(spectra * response, GRID_NM)
    in_front = np.isfinite(ratio)
    assert in_front.sum() > 100
    np.testing.assert_allclose(ratio[in_front], wanted[in_front], rtol=2e-3)


@pytest.mark.parametrize(
    ("height_m", "pressure_hpa"),
    [(-1000, 1139.3), (0, 1013.25), (1000, 898.76), (5000, 540.48), (11000, 226.99), (15000, 121.11), (20000, 55.293)],
)
def test_standard_pressure_is_the_published_table_s(height_m, pressure_hpa) -> None:
    """U.S. Standard Atmosphere 1976, table I, geometric heights."""
    assert standard_pressure_hpa(height_m) == pytest.approx(pressure_hpa, rel=2e-4)


def planck(kelvin):
    """Photons of a black body at GRID_NM, relative."""
    return GRID_NM**-4.0 / np.expm1(1.438776877e7 / (GRID_NM * kelvin))


SILICON = np.interp(GRID_NM, [350, 400, 500, 600, 700, 800, 900, 1000], [0.3, 0.5, 0.6, 0.6, 0.5, 0.35, 0.2, 0.05])


@pytest.mark.parametrize(
    ("kelvin", "water_cm", "path", "lost"), [(10000, 1.4, 2, 0.02), (3200, 1.4, 2, 0.07), (3200, 4, 5, 0.15)]
)
def test_bands_of_water_and_oxygen_dim_stars_as_measured(kelvin, water_cm, path, lost) -> None:
    """2 % of a blue star and 7 % of a red one at airmass 2, 15 % low and humid, in a silicon sensor: within 3 %."""
    air = Atmosphere(1010.0, 0.1, 1.3, 300.0, water_cm)
    passed = np.exp(-band_depth(GRID_NM, air, [path]))[0]
    electrons = planck(kelvin) * SILICON
    assert 1 - np.sum(electrons * passed) / np.sum(electrons) == pytest.approx(lost, abs=0.03)


def test_bands_grow_more_slowly_than_the_path() -> None:
    air = Atmosphere(1013.25, 0.1, 1.3, 300.0, 1.4)
    one, four = band_depth([762.5, 937.0], air, [1.0, 4.0])
    assert np.all((four > 1.5 * one) & (four < 2.5 * one))
    assert np.all(band_depth([762.5, 937.0], air, [0.0]) == 0)


@pytest.mark.parametrize(("temperature_c", "humidity"), [(30, 0.7), (15, 0.5), (10, 0.5), (0, 0.8), (-10, 0.6)])
def test_precipitable_water(temperature_c, humidity) -> None:
    """Against the fit of Keogh & Blakers 2004 to Gueymard 1994 (Solar Energy 53, 57): within 30 %."""
    kelvin = temperature_c + 273.15
    theta = kelvin / 273.15
    scale_km = 0.4976 + 1.5265 * theta + np.exp(13.6897 * theta - 14.9188 * theta**3)
    hundreds = kelvin / 100
    saturated = np.exp(22.330 - 49.140 / hundreds - 10.922 / hundreds**2 - 0.39015 * hundreds)
    gueymard_cm = 0.1 * scale_km * 216.7 * humidity / kelvin * saturated
    assert precipitable_water_cm(temperature_c, humidity) == pytest.approx(gueymard_cm, rel=0.3)


def through_ozone(altitude_deg) -> np.ndarray:
    """Path through a thin layer at 22 km over a sphere of 6370 km, by geometry, relative to the vertical one."""
    return 1 / np.sqrt(1 - (np.cos(np.radians(altitude_deg)) / (1 + 22 / 6370)) ** 2)


@pytest.mark.parametrize("altitude_deg", [90, 30, 10, 3, 0])
def test_ozone_airmass(altitude_deg) -> None:
    assert float(ozone_airmass(altitude_deg)) == pytest.approx(through_ozone(altitude_deg), rel=0.01)


def test_slant_depth_is_the_sum_of_its_parts() -> None:
    air = Atmosphere(800.0, 0.2, 1.3, 300.0, 1.0)
    path = np.array([1.0, float(airmass(10.0))])
    along = slant_depth(GRID_NM, air, path)
    no_ozone = slant_depth(GRID_NM, dataclasses.replace(air, ozone_du=0.0), path)
    ozone = ozone_optical_depth(GRID_NM, 300.0)
    np.testing.assert_allclose(along[1] - no_ozone[1], float(ozone_airmass(10.0)) * ozone, rtol=2e-3, atol=1e-9)
    dry = dataclasses.replace(air, ozone_du=0.0, water_cm=0.0)
    scattered = rayleigh_optical_depth(GRID_NM, 800.0) + aerosol_optical_depth(GRID_NM, 0.2, 1.3)
    away = (GRID_NM < 660) | (GRID_NM > 790)
    np.testing.assert_allclose(slant_depth(GRID_NM, dry, path)[1, away], (path[1] * scattered)[away], rtol=1e-6)


def test_ozone_takes_all_that_it_absorbs_of_diffuse_light() -> None:
    """No scattered light replaces it, as it does for air and aerosol, and its path is that of its own layer."""
    air = Atmosphere(1013.25, 0.1, 1.3, 300.0)
    with_it, without = (
        np.einsum("ka,kn->an", *extinction_factors(each, DIFFUSE_EXTINCTION_FACTOR))
        for each in (air, dataclasses.replace(air, ozone_du=0.0))
    )
    altitude = sky_grid().altitude_deg
    chappuis = np.flatnonzero((GRID_NM >= 550) & (GRID_NM <= 650))
    depth = ozone_optical_depth(GRID_NM[chappuis], 300.0)
    for degrees in (90, 30, 10):
        row = int(np.abs(altitude - degrees).argmin())
        lost = -np.log(with_it[row, chappuis] / without[row, chappuis])
        np.testing.assert_allclose(lost, depth * through_ozone(altitude[row]), rtol=0.02)


@pytest.mark.parametrize("altitude_deg", [60.0, 10.0, 2.0])
def test_moonlight_passes_ozone_along_its_own_path(altitude_deg) -> None:
    """Near the horizon that is half the airmass of the air: the layer lies high."""
    moon = np.array([0.0, np.cos(np.radians(altitude_deg)), np.sin(np.radians(altitude_deg))])
    air = Atmosphere(1013.25, 0.1, 1.3, 300.0)
    with_it, without = (
        moonlight(moon, -12.7, each).radiance(np.array([60.0]), np.array([90.0]))[0]
        for each in (air, dataclasses.replace(air, ozone_du=0.0))
    )
    at = np.flatnonzero((GRID_NM >= 550) & (GRID_NM <= 650))
    wanted = ozone_optical_depth(GRID_NM[at], 300.0) * through_ozone(altitude_deg)
    np.testing.assert_allclose(-np.log(with_it[at] / without[at]), wanted, rtol=0.02)
