"""celnav's refraction: Bennett's against its published values, the integral against tables and the generator's."""

import numpy as np
import pytest

from celnav.position import usual_weather
from celnav.sky.ray_integral import Air, horizon_dip_rad, ray_bending_rad, standard_height_km
from celnav.sky.refraction import bennett_arcmin, refract, refraction_rad, unrefract
from generator.light.atmosphere import usual_pressure_hpa, usual_temperature_c
from generator.places.ray_bending import StandardAir
from generator.places.refraction import refraction_of_apparent_deg

# 1010 hPa, 10 deg C; the formula of Bennett 1982, evaluated elsewhere.
TABLE_ARCMIN = {
    0: 34.478, 0.5: 28.754, 1: 24.329, 2: 18.216, 5: 9.883, 10: 5.392,
    15: 3.636, 20: 2.703, 30: 1.717, 45: 0.995, 60: 0.575, 75: 0.266,
}  # fmt: skip


@pytest.mark.parametrize(("altitude_deg", "arcmin"), TABLE_ARCMIN.items())
def test_bennett_table(altitude_deg, arcmin):
    assert bennett_arcmin(altitude_deg) == pytest.approx(arcmin, abs=0.0006)


def test_pressure_and_temperature_scale():
    ratio = bennett_arcmin(20.0, 505.0, 10.0) / bennett_arcmin(20.0)
    assert ratio == pytest.approx(0.5)
    assert bennett_arcmin(20.0, 1010.0, -20.0) / bennett_arcmin(20.0) == pytest.approx(283 / 253)


def test_within_three_percent_of_saemundsson_above_ten_degrees():
    """The inverse formula of Saemundsson 1986, R = 1.02 cot(h + 10.3 / (h + 5.11)) from the true altitude h."""
    true_deg = np.arange(10.0, 80.0)
    saemundsson = 1.02 / np.tan(np.radians(true_deg + 10.3 / (true_deg + 5.11)))
    np.testing.assert_allclose(bennett_arcmin(true_deg + saemundsson / 60), saemundsson, rtol=0.03)


def test_refract_and_unrefract_are_inverse_and_lift():
    altitude = np.radians(np.concatenate((np.linspace(5, 89.9, 50), [90.0])))
    azimuth = np.linspace(0, 6, 51)
    dirs = np.column_stack((np.cos(altitude) * np.sin(azimuth), np.cos(altitude) * np.cos(azimuth), np.sin(altitude)))
    seen = refract(dirs, 1010.0, 10.0)
    assert (seen[:48, 2] > dirs[:48, 2]).all()
    np.testing.assert_allclose(np.linalg.norm(seen, axis=1), 1, atol=1e-12)
    back = unrefract(seen, 1010.0, 10.0)
    arcsec = np.degrees(np.linalg.norm(back - dirs, axis=1)) * 3600
    # Bennett's formula is -0.08 arcsec at the zenith itself, where lifting has no direction.
    assert arcsec.max() < 0.1


def arcsec(apparent_deg, *air):
    return 3600 * np.degrees(refraction_rad(np.radians(90 - np.atleast_1d(np.asarray(apparent_deg, float))), *air))


def test_low_altitudes_follow_the_pulkovo_tables():
    """15 deg C, 1013.25 hPa, dry, 590 nm: a fit to the tables of Pulkovo (Abalakin 1985), good to 0.29 arcsec; within 1."""
    h = np.array([0.5, 1.0, 1.5, 2.0, 5.0, 10.0, 14.0])
    pulkovo = 3600 / 62.8093 / np.tan(np.radians(h + 4.2206 / (h + 15.1115 / (h + 5.9431))))
    np.testing.assert_allclose(arcsec(h, 1013.25, 15.0, 0.0, 0.59), pulkovo, atol=1.0)


@pytest.mark.parametrize(
    ("height_m", "pressure_hpa"),
    [(0, 1013.25), (1000, 898.76), (4000, 616.60), (9000, 308.00), (12000, 193.99), (20000, 55.293)],
)
def test_heights_of_pressures_are_the_published_table_s(height_m, pressure_hpa):
    """U.S. Standard Atmosphere 1976, table I: within 5 m, or the rounding of the tabulated pressure."""
    assert 1000 * standard_height_km(pressure_hpa) == pytest.approx(height_m, abs=5)


@pytest.mark.parametrize("height_m", [2, 10, 100])
def test_the_navigators_dip(height_m):
    """The dip of the sea's horizon, 1.76 arcmin times the root of the height in metres (Nautical Almanac): within 1 %."""
    pressure = 1013.25 * (1 - 0.0065 * height_m / 288.15) ** 5.25588
    dip_arcmin = 60 * np.degrees(horizon_dip_rad(Air(pressure, 15.0, 0.0, 0.55)))
    assert dip_arcmin == pytest.approx(1.76 * np.sqrt(height_m), rel=0.01)


# Pressure, temperature, humidity, wavelength (um), height: the standard atmosphere's pressure at it, or weather's.
AIRS = [
    (1013.25, 15.0, 0.5, 0.55, 0.0),
    (980.0, 10.0, 0.5, 0.55, 0.0),
    (1040.0, -35.0, 0.8, 0.55, 0.0),
    (1005.0, 35.0, 0.95, 0.42, 70.0),
    (616.6, -11.0, 0.3, 0.55, 4000.0),
    (630.0, 15.0, 0.3, 0.55, 4000.0),
    (308.0, -43.5, 0.1, 0.8, 9000.0),
    (193.99, -56.5, 0.0, 0.55, 12000.0),
    (55.293, -56.5, 0.0, 0.55, 20000.0),
]


@pytest.mark.parametrize("values", AIRS)
def test_within_an_arcsecond_of_the_generator(values):
    """Two programs that share no code, from 0 to 90 deg."""
    *air, height_m = values
    pressure, temperature, humidity, wavelength_um = air
    of_generator = StandardAir(pressure, temperature, humidity, height_m, wavelength_nm=1000 * wavelength_um)
    altitude = np.concatenate([np.linspace(0, 20, 800), np.linspace(20, 90, 100)])
    difference = arcsec(altitude, *air) - 3600 * refraction_of_apparent_deg(altitude, of_generator)
    assert np.abs(difference).max() < 1.0
    assert np.abs(difference[altitude > 15.1]).max() < 1e-6


def test_dipping_rays_are_the_generator_s():
    """From 4,000 m down to 0.02 deg above the ground's horizon within 1 arcsec."""
    air = Air(616.6, -11.0, 0.3, 0.55)
    altitude = np.linspace(-np.degrees(horizon_dip_rad(air)) + 0.02, 0, 200)
    ours = 3600 * np.degrees(ray_bending_rad(np.radians(altitude), air))
    theirs = 3600 * refraction_of_apparent_deg(altitude, StandardAir(616.6, -11.0, 0.3, height_m=4000.0))
    assert np.abs(ours - theirs).max() < 1.0


@pytest.mark.parametrize("height_m", [-400.0, 0.0, 650.0, 4000.0, 9000.0, 12000.0, 20000.0])
def test_the_usual_weather_of_a_height_is_the_generator_s(height_m):
    """What both take where no pressure and temperature are told: 0.01 hPa and 0.01 deg C."""
    weather = usual_weather(height_m)
    assert weather.pressure_hpa == pytest.approx(float(usual_pressure_hpa(height_m)), abs=0.01)
    assert weather.temperature_c == pytest.approx(float(usual_temperature_c(height_m)), abs=0.01)
    assert standard_height_km(1013.25 / 1010 * weather.pressure_hpa) == pytest.approx(height_m / 1000, abs=0.002)
    assert usual_weather(height_m, 700.0).pressure_hpa == 700.0
    assert usual_weather(height_m, temperature_c=3.0).temperature_c == 3.0
