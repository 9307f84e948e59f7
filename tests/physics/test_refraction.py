"""The generator's refraction against ERFA, published integrals and tables, and the path of a ray."""

import erfa
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from generator.places.ray_bending import Layers, StandardAir, bending_deg
from generator.places.refraction import refraction_deg, refraction_of_apparent_deg, refraction_of_vectors_rad


def lift_arcmin(true_altitude_deg, pressure_hpa=1010.0, temperature_c=10.0, relative_humidity=0.0):
    altitude = np.atleast_1d(np.asarray(true_altitude_deg, float))
    return 60 * refraction_deg(altitude, StandardAir(pressure_hpa, temperature_c, relative_humidity))


@pytest.mark.parametrize(("apparent_deg", "arcmin"), [(15, 3.556), (20, 2.637), (30, 1.671), (45, 0.967), (60, 0.559)])
def test_high_altitudes_are_erfa_s_refco(apparent_deg, arcmin) -> None:
    """ERFA refco A = 58.070", B = -0.0650" at 1010 hPa, 10 deg C, 550 nm, dry; within 0.003'."""
    assert lift_arcmin(apparent_deg - arcmin / 60)[0] == pytest.approx(arcmin, abs=0.003)


def test_a_published_ray_integral() -> None:
    """The value of SLALIB's and PAL's tests of their integral (``refro``): 0.00106715763018568 rad, to 1e-12 rad."""
    air = StandardAir(678.9, 280 - 273.15, 0.9, 3456.7, float(np.degrees(-0.3)), 550.0, lapse_k_m=0.006)
    bending = bending_deg(Layers(air), np.array([90 - np.degrees(1.4)]))
    assert np.radians(bending[0]) == pytest.approx(0.00106715763018568, abs=5e-12)


@pytest.mark.parametrize("apparent_deg", [0.5, 1.0, 1.5, 2.0, 5.0, 10.0, 14.0])
def test_low_altitudes_follow_the_pulkovo_tables(apparent_deg) -> None:
    """15 deg C, 1013.25 hPa, dry, 590 nm: a fit to the tables of Pulkovo (Abalakin 1985), good to 0.29 arcsec; within 1."""
    h = apparent_deg
    pulkovo_deg = 1 / 62.8093 / np.tan(np.radians(h + 4.2206 / (h + 15.1115 / (h + 5.9431))))
    air = StandardAir(1013.25, 15.0, 0.0, wavelength_nm=590.0)
    assert 3600 * refraction_deg(np.array([h - pulkovo_deg]), air)[0] == pytest.approx(3600 * pulkovo_deg, abs=1.0)


GAS_CONSTANT, DRY_KG_KMOL, WATER_KG_KMOL = 8314.32, 28.9644, 18.0152


def traced_deg(apparent_deg, observed):
    """Refraction by the path of a ray: d(n dx/ds)/ds = grad n, in the plane of the vertical, together with hydrostatics."""
    pressure_hpa, height_m = observed.pressure_hpa, observed.height_m
    radius, kelvin = 6378120.0, observed.temperature_c + 273.15
    tropopause = max(11000.0, height_m)
    coldest = kelvin - 0.0065 * (tropopause - height_m)
    gravity = 9.784 * (1 - 0.0026 * np.cos(np.radians(2 * observed.latitude_deg)) - 2.8e-7 * height_m)
    saturated = 10 ** ((0.7859 + 0.03477 * observed.temperature_c) / (1 + 0.00412 * observed.temperature_c))
    saturated *= 1 + pressure_hpa * (4.5e-6 + 6e-10 * observed.temperature_c**2)
    vapour = observed.relative_humidity * saturated / (1 - (1 - observed.relative_humidity) * saturated / pressure_hpa)
    um = observed.wavelength_nm / 1000
    refractivity = (287.6155 + 1.62887 / um**2 + 0.01360 / um**4) * 1e-6 * 273.15 / 1013.25

    def air(height):
        """Temperature, its derivative, and the pressure of water vapour."""
        if height_m >= 11000:
            # Below an observer in the stratosphere the troposphere begins at 11 km, with dry air.
            below = max(0.0, 11000 - height)
            return kelvin + 0.0065 * below, -0.0065 * (below > 0), 0.0
        if height > tropopause:
            return coldest, 0.0, 0.0
        t = kelvin - 0.0065 * (height - height_m)
        return t, -0.0065, vapour * (t / kelvin) ** 18.36

    def change(_, state):
        x, y, dx, dy, log_pressure = state
        r = np.hypot(x, y)
        t, slope, water = air(r - radius)
        pressure = np.exp(log_pressure)
        density = (DRY_KG_KMOL * (pressure - water) + WATER_KG_KMOL * water) / (GAS_CONSTANT * t)
        falls = -gravity * density  # hPa per m
        n = 1 + (refractivity * pressure - 11.2684e-6 * water) / t
        gradient = refractivity * falls / t - (n - 1) / t * slope - 11.2684e-6 * 18.36 * water / t * slope / t
        outward = (x * dx + y * dy) / r
        bend = gradient / n
        return [dx, dy, bend * (x / r - outward * dx), bend * (y / r - outward * dy), falls / pressure * outward]

    altitude = np.radians(apparent_deg)
    start = [0.0, radius + height_m, np.cos(altitude), np.sin(altitude), np.log(pressure_hpa)]

    def leaves(_, state):
        return np.hypot(state[0], state[1]) - radius - 80000.0

    leaves.terminal = True
    path = solve_ivp(change, (0, 3e6), start, "DOP853", events=leaves, rtol=1e-10, atol=1e-9, max_step=5000.0)
    _, _, dx, dy, _ = path.y[:, -1]
    return float(apparent_deg - np.degrees(np.arctan2(dy, dx)))


AIRS = {
    "sea level": StandardAir(1010.0, 10.0, 0.5, 0.0, 45.0, 550.0),
    "hot, humid, blue, equator": StandardAir(1005.0, 35.0, 0.95, 0.0, 0.0, 420.0),
    "arctic": StandardAir(1040.0, -35.0, 0.8, 200.0, 80.0, 550.0),
    "4,000 m": StandardAir(616.6, -11.0, 0.3, 4000.0, -25.0, 550.0),
    "9,000 m, red": StandardAir(307.4, -43.5, 0.1, 9000.0, 28.0, 800.0),
    "12 km": StandardAir(194.0, -56.5, 0.0, 12000.0, 50.0, 550.0),
    "20 km": StandardAir(55.3, -56.5, 0.0, 20000.0, 50.0, 550.0),
}


@pytest.mark.parametrize("name", AIRS)
def test_the_path_of_a_ray(name) -> None:
    """From 14 deg to 0.5 deg within 0.1 arcsec of a ray that is followed through the same air in another formulation."""
    air = AIRS[name]
    for apparent in (0.5, 2.0, 5.0, 10.0, 14.0):
        traced = traced_deg(apparent, air)
        assert 3600 * refraction_deg(np.array([apparent - traced]), air)[0] == pytest.approx(3600 * traced, abs=0.1)


@pytest.mark.parametrize(
    ("name", "apparent_deg"), [("4,000 m", -1.5), ("9,000 m, red", -2.8), ("12 km", -3.2), ("20 km", -4.3)]
)
def test_rays_from_below_the_horizontal(name, apparent_deg) -> None:
    """Down to near the ground, within 1 arcsec of the path of the ray; away from it, below the table, it is constant."""
    air = AIRS[name]
    traced = traced_deg(apparent_deg, air)
    true = np.array([apparent_deg - traced])
    assert 3600 * refraction_deg(true, air)[0] == pytest.approx(3600 * traced, abs=1.0)
    deep = refraction_deg(np.array([-20.0, -60.0]), air)
    assert deep[0] == deep[1] > traced


@pytest.mark.parametrize("name", AIRS)
def test_apparent_altitudes_go_back_to_true_ones(name) -> None:
    """The inverse within 1e-6 arcsec at every altitude; the apparent altitude increases with the true one."""
    air = AIRS[name]
    true = np.linspace(-8, 90, 30000)
    lift = refraction_deg(true, air)
    assert np.all(np.diff(true + lift) > 0)
    assert 3600 * np.abs(refraction_of_apparent_deg(true + lift, air) - lift).max() < 1e-6


def test_the_table_is_its_integral() -> None:
    """Within 0.001 arcsec where they are not faded into the series; 0.06 where they are."""
    for air in (AIRS["sea level"], AIRS["4,000 m"], AIRS["arctic"]):
        apparent = np.linspace(-0.3, 14.9, 3000)
        bending = bending_deg(Layers(air), apparent)
        error = 3600 * np.abs(refraction_deg(apparent - bending, air) - bending)
        assert error[apparent < 11.9].max() < 0.001
        assert error.max() < 0.06


def test_is_continuous_and_falls_with_altitude() -> None:
    altitude = np.linspace(-2, 90, 4000)
    lift = lift_arcmin(altitude)
    assert np.abs(np.diff(lift)).max() < 0.5
    assert np.all(np.diff(lift[altitude > -1]) <= 1e-12)
    assert lift[-1] == pytest.approx(0, abs=1e-9)


def test_agrees_with_erfa_s_own_observed_places() -> None:
    """Against erfa.atco13 with air: 0.001 arcsec above 30 deg."""
    utc = (2458849.5, 0.25)
    _, zenith_air, *_ = erfa.atco13(
        np.radians(np.linspace(0, 359, 400)), np.full(400, 0.5), 0.0, 0.0, 0.0, 0.0, *utc, -0.177, 0.1, 0.9, 0.0, 0.0, 0.0,
        850.0, -5.0, 0.3, 0.55,
    )  # fmt: skip
    _, zenith_none, *_ = erfa.atco13(
        np.radians(np.linspace(0, 359, 400)), np.full(400, 0.5), 0.0, 0.0, 0.0, 0.0, *utc, -0.177, 0.1, 0.9, 0.0, 0.0, 0.0,
        0.0, 0.0, 0.0, 0.55,
    )  # fmt: skip
    high = zenith_air < np.radians(60)
    assert high.sum() > 100
    lift = lift_arcmin(90 - np.degrees(zenith_none[high]), 850.0, -5.0, 0.3)
    difference_arcsec = 60 * lift - np.degrees(zenith_none - zenith_air)[high] * 3600
    assert np.abs(difference_arcsec).max() < 0.001


def test_refraction_of_vectors_is_that_of_their_altitudes() -> None:
    """Without trigonometric functions as with them, to 1e-8 arcsec, above and below the series' end and the horizontal."""
    altitude = np.concatenate([np.linspace(-8, 90, 1999), [14.999999, 15.0, 15.000001]])
    air = StandardAir(1013.25, -5.0, 0.5, 3000.0)
    wanted = refraction_deg(altitude, air)
    level, up = 0.7 * np.cos(np.radians(altitude)), 0.7 * np.sin(np.radians(altitude))
    found = np.degrees(refraction_of_vectors_rad(level, up, air))
    np.testing.assert_allclose(3600 * found, 3600 * wanted, rtol=0, atol=1e-8)


def test_no_air_does_not_bend() -> None:
    assert lift_arcmin([0.0, 45.0], pressure_hpa=0.0).tolist() == [0.0, 0.0]


def test_the_series_is_solved() -> None:
    """True zenith distance = observed + A tan + B tan^3 of the observed one, from the zenith to 15 deg: 1e-8 arcsec."""
    altitude = np.linspace(15.0, 90.0, 2000)
    refa, refb = erfa.refco(1040.0, -30.0, 0.0, 0.55)
    observed = np.radians(90 - altitude - lift_arcmin(altitude, 1040.0, -30.0, 0.0) / 60)
    true = observed + refa * np.tan(observed) + refb * np.tan(observed) ** 3
    assert np.degrees(np.abs(true - np.radians(90 - altitude))).max() * 3600 < 1e-8
