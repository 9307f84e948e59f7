"""City light and moonlight by radiative transfer, against formulas and measurements of others."""

import dataclasses
import math

import numpy as np
import pytest
from scipy.integrate import quad, simpson

from generator.gallery.light_plots import krisciunas_schaefer
from generator.light.atmosphere import Atmosphere, aerosol_optical_depth, airmass, optical_depth, rayleigh_optical_depth
from generator.light.bake_grids import VIEW_ALTITUDES_DEG, WAVELENGTHS_NM, BakedAir
from generator.light.baked_maps import moon_multiple
from generator.light.disk_scattering import disk_nodes, disk_single
from generator.light.emission import (
    DIRECT_SHARE,
    GARSTANG_HORIZON_SHARE,
    REFLECTED_SHARE,
    WORLD_ATLAS_HORIZON_SHARE,
    built_up,
    built_up_output,
    lamp_patterns,
)
from generator.light.lamps import City, lamp_spectra, mixed_lamps
from generator.light.photometry import ARCSEC2_PER_SR, BESSELL_B, BESSELL_V, GRID_NM
from generator.light.single_scattering import (
    aerosol_phase,
    city_single,
    moon_single,
    moon_single_by_layer,
    moon_single_in_layers,
    rayleigh_phase,
)
from generator.light.stellar_spectra import colours, star_spectra
from generator.light.view_directions import view_directions
from generator.sky.city_light import STANDARD_AIR, bortle_city, city_radiance, city_table
from generator.sky.component import SkyTable
from generator.sky.directions import sky_grid
from generator.sky.moon_irradiance import krisciunas_schaefer_v_mag, moon_v_mag
from generator.sky.moonlight import moonlight

NEAR_550 = WAVELENGTHS_NM.index(530.0)


def v_light(table: SkyTable, altitude, azimuth):
    return 10 ** (
        -0.4 * table.v_mag_arcsec2(np.atleast_1d(altitude).astype(float), np.atleast_1d(azimuth).astype(float))
    )


def colour(spectrum) -> float:
    """B-V of a photon spectrum."""
    return float(BESSELL_B.magnitude(GRID_NM, spectrum) - BESSELL_V.magnitude(GRID_NM, spectrum))


@pytest.mark.parametrize("distance_km", [15.0, 30.0, 60.0])
def test_city_light_rises_from_the_zenith_towards_the_city(distance_km) -> None:
    """Monotonic from the zenith to 80 deg from it in the city's azimuth (Garstang 1986)."""
    table = city_table(City(distance_km, 120.0, 5.0))
    light = v_light(table, [90, 80, 70, 60, 50, 40, 30, 20, 10], [120] * 9)
    assert (np.diff(light) > 0).all()


@pytest.mark.parametrize(
    ("horizon_share", "lowest_deg"),
    [(GARSTANG_HORIZON_SHARE, 17.0), (WORLD_ATLAS_HORIZON_SHARE, 11.0), (0.0, 4.0), (None, 4.0)],
)
def test_inside_a_city_the_sky_low_down_is_two_to_six_times_the_zenith(horizon_share, lowest_deg) -> None:
    """In the middle of a disk of 10 km radius, up to 20 deg of altitude, at all azimuths.

    How far down depends on the light that leaves along the ground, where houses stand in its way: 54 % by Garstang, 21 % by
    the world atlas, none by Lambert, and less of all near the horizon by the default. Below, light goes on rising.
    """
    table = city_table(dataclasses.replace(bortle_city(9), horizon_share=horizon_share))
    altitude, azimuth = np.meshgrid([20.0, 18.0, lowest_deg], np.arange(0.0, 360.0, 45.0), indexing="ij")
    over_zenith = (v_light(table, altitude.ravel(), azimuth.ravel()) / v_light(table, 90, 0)).reshape(altitude.shape)
    assert (over_zenith > 2).all()
    assert (over_zenith < 6).all()
    assert (np.diff(over_zenith.mean(axis=1)) > 0).all()
    assert (np.ptp(over_zenith, axis=1) < 0.02 * over_zenith.mean(axis=1)).all()


def test_a_built_up_area_lets_out_a_tenth_of_its_light() -> None:
    """Flagstaff: 17.9 of 173 Mlm leave upwards, 8.3 % of it straight from luminaires (Luginbuhl et al. 2009, PASP 121, 185);
    without obstacles 22 % would."""
    assert built_up_output() == pytest.approx(17.9 / 173, rel=0.02)
    whole, _ = quad(lambda psi: 2 * math.pi * math.sin(psi) * float(built_up(psi)), 0, math.pi / 2)
    assert whole == pytest.approx(built_up_output(), rel=1e-6)
    assert pytest.approx(0.22, abs=0.005) == DIRECT_SHARE + REFLECTED_SHARE * (1 - DIRECT_SHARE)


def test_patterns_send_all_light_upwards() -> None:
    """Each integrates to 1 over the upper hemisphere, within the 0.1 % of Garstang's rounded constant."""
    psi = np.linspace(0, np.pi / 2, 200_001)
    light = np.trapezoid(2 * np.pi * np.sin(psi) * lamp_patterns(np.cos(psi)), psi)
    np.testing.assert_allclose(light, 1, rtol=1.5e-3)


def test_walker_s_law() -> None:
    """Zenith brightness goes as distance to the power -2.5 +- 0.4 from 15 to 60 km (Walker 1977, PASP 89, 405)."""
    distance = np.array([15.0, 22.0, 32.0, 45.0, 60.0])
    zenith = [city_radiance(d, 3.0, None)[NEAR_550, -1, 0] for d in distance]
    slope, _ = np.polyfit(np.log(distance), np.log(zenith), 1)
    assert slope == pytest.approx(-2.5, abs=0.4)


def test_skyglow_is_bluer_than_its_lamps_near_the_city_and_redder_far_away() -> None:
    """White light (its own B-V 0.9): over the city the zenith is bluer; 60 km away the glow on the horizon is redder."""
    lamps = (("LED", 1.0),)
    own = colour(mixed_lamps(lamps))
    near = city_table(City(0.0, 0.0, 3.0, lamps=lamps)).radiance(np.array([90.0]), np.array([0.0]))[0]
    far = city_table(City(60.0, 0.0, 3.0, lamps=lamps)).radiance(np.array([3.0]), np.array([0.0]))[0]
    assert colour(near) < own - 0.1
    assert colour(far) > colour(near) + 0.1
    assert colour(far) > own


def garstang_single(
    wavelength_nm: float, distance_km: float, zenith_deg: float, azimuth_deg: float, share: float
) -> float:
    """Single scattering of a point city by adaptive quadrature, written from Garstang 1986, eqs. 4 to 9, for two layers."""
    air = BakedAir()
    rayleigh = float(rayleigh_optical_depth(wavelength_nm, air.pressure_hpa))
    aerosol = float(aerosol_optical_depth(wavelength_nm, 0.1, air.angstrom_exponent))
    z, a = math.radians(zenith_deg), math.radians(azimuth_deg)

    def integrand(s: float) -> float:
        x, y, h = s * math.sin(z) * math.sin(a), s * math.sin(z) * math.cos(a), s * math.cos(z)
        leg = math.sqrt(x * x + (y - distance_km) ** 2 + h * h)
        psi = math.acos(h / leg)
        column = rayleigh * (1 - math.exp(-h / 8.0)) + aerosol * (1 - math.exp(-h / 1.5))
        transmitted = math.exp(-column * (leg + s) / h)
        cosine = -(x * x + y * (y - distance_km) + h * h) / (leg * s)
        molecules = rayleigh / 8.0 * math.exp(-h / 8.0) * 3 / (16 * math.pi) * (1 + cosine**2)
        droplets = aerosol / 1.5 * math.exp(-h / 1.5) * air.aerosol_albedo * float(aerosol_phase(cosine))
        emitted = (1 - share) * math.cos(psi) / math.pi + share * 0.554 * psi**4 / (2 * math.pi)
        return emitted / leg**2 * transmitted * (molecules + droplets)

    value, _ = quad(integrand, 1e-4, 40 / math.cos(z), limit=400, points=[0.1, 1.0, 10.0])
    return value


@pytest.mark.parametrize("zenith_deg", [0.0, 30.0, 60.0])
@pytest.mark.parametrize("azimuth_deg", [0.0, 180.0])
def test_quadrature_is_garstang_s_kernel(zenith_deg, azimuth_deg) -> None:
    """The map's single scattering against an adaptive quadrature written apart: within 3 %."""
    wavelength, share = 530.0, 0.5
    views = view_directions([90 - zenith_deg], [azimuth_deg])
    ours = city_single(BakedAir(), np.array([wavelength]), 0.1, np.array([[0.0, 20.0]]), views)
    mixed = (1 - share) * ours[0, 0, 0] + share * ours[1, 0, 0]
    assert mixed == pytest.approx(garstang_single(wavelength, 20.0, zenith_deg, azimuth_deg, share), rel=0.03)


@pytest.mark.parametrize("distance_km", [0.0, 2.0])
@pytest.mark.parametrize("altitude_deg", [90.0, 62.0, 36.0, 27.0])
def test_radiative_transfer_against_garstang_with_double_scattering(altitude_deg, distance_km) -> None:
    """Inside a small city (radius 3 km), where single scattering rules: all orders over Garstang's kernel lie between 1 and
    1.3 (Garstang's own correction for double scattering is 1.1 to 1.3)."""
    share = GARSTANG_HORIZON_SHARE
    row = VIEW_ALTITUDES_DEG.index(altitude_deg)
    views = view_directions([altitude_deg], [0.0])
    tau = STANDARD_AIR.aerosol_tau_550
    single = 1e-6 * disk_single(BakedAir(), np.array([530.0]), tau, distance_km, 3.0, views)
    kernel = (1 - share) * single[0, 0, 0] + share * single[1, 0, 0]
    assert 1.0 < city_radiance(distance_km, 3.0, share)[NEAR_550, row, 0] / kernel < 1.3


@pytest.mark.parametrize("zenith_deg", [0.0, 60.0, 80.0])
def test_inside_a_disk_its_light_is_garstang_s_kernel_over_the_disk(zenith_deg) -> None:
    """In the middle of a disk of 3 km: adaptive quadrature along the line of sight, Gauss and Simpson over the disk."""
    radius, share, wavelength = 3.0, 0.5, 530.0
    ours = disk_single(BakedAir(), np.array([wavelength]), 0.1, 0.0, radius, view_directions([90 - zenith_deg], [0.0]))
    node, weight = np.polynomial.legendre.leggauss(10)
    spread = 12.0
    distance = radius * np.exp(spread * (node - 1) / 2)
    azimuth = np.array([0.0]) if zenith_deg == 0 else 180 * np.linspace(0, 1, 17) ** 3
    light = np.array(
        [[d * d * garstang_single(wavelength, d, zenith_deg, a, share) for a in azimuth] for d in distance]
    )
    around = light[:, 0] if zenith_deg == 0 else simpson(light, x=azimuth, axis=1) / 180
    published = 2 * np.sum(weight * around) * spread / 2 / radius**2
    assert (1 - share) * ours[0, 0, 0] + share * ours[1, 0, 0] == pytest.approx(published, rel=0.02)


@pytest.mark.parametrize("distance_km", [0.0, 4.0, 9.0, 14.0])
def test_nodes_integrate_over_a_disk(distance_km) -> None:
    """The mean of (north / distance + 1) exp(-distance / 5 km) against a million places on a grid."""
    distance, relative, weight = disk_nodes(distance_km, 10.0, 70.0, 2.0)
    ours = np.sum(weight * (np.cos(np.radians(relative + 70.0)) + 1) * np.exp(-distance / 5))
    x, y = np.meshgrid(*[np.linspace(-10, 10, 1000, endpoint=False) + 0.01] * 2)
    inside = x * x + y * y < 100
    away = np.hypot(x, y + distance_km)[inside]
    assert ours == pytest.approx(np.mean(((y[inside] + distance_km) / away + 1) * np.exp(-away / 5)), rel=3e-3)


def test_lamps_are_normalised_in_v() -> None:
    for name, spectrum in lamp_spectra().items():
        assert float(BESSELL_V.mean(GRID_NM, spectrum)) == pytest.approx(1.0), name


def nanolambert(mu) -> float:
    """Garstang's conversion of V mag/arcsec^2."""
    return 34.08 * math.exp(20.7233 - 0.92104 * mu)


KRISCIUNAS_SCHAEFER = [
    (50, 70, 20, 45, 0.15, 389.5),
    (60, 60, 0, 0, 0.172, 1089.9),
    (60, 60, 0, 60, 0.172, 247.0),
    (60, 60, 0, 90, 0.172, 99.2),
    (30, 30, 0, 0, 0.172, 2367.6),
    (90, 60, 45, 0, 0.172, 1067.2),
    (10, 40, 30, 0, 0.172, 4967.1),
    (5, 40, 35, 0, 0.172, 12206.0),
]


def moonlight_nanolambert(rho, moon_zenith, zenith, phase, k) -> float:
    """Our moonlight for a geometry of Krisciunas & Schaefer, who observed at 2,800 m (725 hPa); aerosol brings V extinction
    to their k."""
    pressure = 725.0
    ozone = 0.031 / 1.0857
    rayleigh = float(rayleigh_optical_depth(550.0, pressure))
    tau = max(k / 1.0857 - rayleigh - ozone, 0.01)
    air = Atmosphere(pressure, tau, 1.3, 300.0)
    zm, z = math.radians(moon_zenith), math.radians(zenith)
    denominator = math.sin(zm) * math.sin(z)
    turn = 0.0
    if denominator > 1e-9:
        cosine = (math.cos(math.radians(rho)) - math.cos(zm) * math.cos(z)) / denominator
        turn = math.degrees(math.acos(np.clip(cosine, -1, 1)))
    moon = np.array([0.0, math.sin(zm), math.cos(zm)])
    table = moonlight(moon, krisciunas_schaefer_v_mag(phase), air)
    return nanolambert(float(table.v_mag_arcsec2(np.array([90.0 - zenith]), np.array([turn]))[0]))


@pytest.mark.parametrize(("rho", "moon_zenith", "zenith", "phase", "k", "published"), KRISCIUNAS_SCHAEFER)
def test_moonlight_of_krisciunas_and_schaefer(rho, moon_zenith, zenith, phase, k, published) -> None:
    """Krisciunas & Schaefer 1991, PASP 103, 1033: within 30 % (their own accuracy is 8 to 23 %)."""
    assert moonlight_nanolambert(rho, moon_zenith, zenith, phase, k) == pytest.approx(published, rel=0.30)


@pytest.mark.parametrize(
    ("rho", "least", "most"), [(3, 0.6, 1.0), (5, 0.8, 1.2), (10, 0.8, 1.3), (20, 0.8, 1.3), (45, 0.7, 1.2)]
)
def test_aureole_of_the_moon(rho, least, most) -> None:
    """Full Moon at 45 deg of altitude, the same altitude beside it, over the law of Krisciunas & Schaefer 1991, which has no
    limit towards the Moon: the haze's forward peak holds it to 3 deg. Henyey and Greenstein's function has two fifths
    of the haze's value at 3 deg."""
    published = krisciunas_schaefer(rho, 45.0, 45.0, 0.172)
    assert least < moonlight_nanolambert(rho, 45, 45, 0, 0.172) / published < most
    g, cosine = 0.69, math.cos(math.radians(3))
    henyey_greenstein = (1 - g * g) / (4 * math.pi * (1 + g * g - 2 * g * cosine) ** 1.5)
    assert henyey_greenstein < 0.5 * float(aerosol_phase(cosine))


@pytest.mark.parametrize(
    ("view_deg", "moon_deg", "azimuth_deg", "walked"),
    [
        (6.633, 24.5, 7.5, (0.20811, 0.25219)),
        (23.238, 24.5, 7.5, (0.21930, 0.21537)),
        (9.381, 45.0, 90.0, (0.07196, 0.04158)),
        (54.553, 52.0, 160.0, (0.03298, 0.01246)),
    ],
)
def test_moonlight_between_the_map_s_nodes_is_what_walks_give_there(view_deg, moon_deg, azimuth_deg, walked) -> None:
    """Light at 430 and 580 nm, sr^-1 per unit irradiance, within 0.7 % of random walks to these very directions (262,144
    paths of :func:`generator.bake.tallies.moon_piece`, within 0.3 %, and :func:`moon_single_in_layers`)."""
    air = BakedAir()
    rayleigh = rayleigh_optical_depth(np.array(WAVELENGTHS_NM), air.pressure_hpa)
    aerosol = aerosol_optical_depth(np.array(WAVELENGTHS_NM), 0.1, air.angstrom_exponent)
    moon, view = np.radians(moon_deg), np.radians(view_deg)
    cosine = np.sin(moon) * np.sin(view) + np.cos(moon) * np.cos(view) * np.cos(np.radians(azimuth_deg))
    path = 1 / np.sin(moon), 1 / np.sin(view)
    molecules, particles = moon_single_by_layer(air, rayleigh, aerosol, path[0], np.array([path[1]]))
    light = molecules[:, 0] * rayleigh_phase(cosine) + particles[:, 0] * aerosol_phase(cosine)
    more = moon_multiple(
        Atmosphere(air.pressure_hpa, 0.1, air.angstrom_exponent, 0.0),
        moon_deg,
        np.array([view_deg]),
        np.array([azimuth_deg]),
    )
    light += more[:, 0, 0] * moon_single(rayleigh, aerosol, *path, 0.0, air)
    judged = [WAVELENGTHS_NM.index(nm) for nm in (430.0, 580.0)]
    assert light[judged] == pytest.approx(walked, rel=0.007)


@pytest.mark.parametrize("view_deg", [0.3, 5.0, 60.0])
def test_moonlight_scattered_once_by_layers_is_the_fine_quadrature(view_deg) -> None:
    air, depth = BakedAir(), np.array([0.7])
    molecules, particles = moon_single_by_layer(air, depth, depth / 2, 2.0, 1 / np.sin(np.radians([view_deg])))
    cosine = np.array([[0.3]])
    fine = moon_single_in_layers(air, 0.7, 0.35, np.array([30.0]), view_deg, cosine, steps=100_000)
    light = molecules * rayleigh_phase(cosine) + particles * aerosol_phase(cosine)
    assert light == pytest.approx(fine, rel=1e-3)


def test_full_moon_lights_the_ground_with_a_quarter_lux() -> None:
    """Direct and scattered light of a full Moon 60 deg up: 0.25 lx +- 10 % (Kyba et al. 2017, A&G 58, 1.31).

    A full Moon is 3.3 deg from opposition in the mean, and there a tenth fainter than at its brightest.
    """
    air = Atmosphere(1013.25, 0.1, 1.3, 300.0)
    moon = np.array([0.0, math.cos(math.radians(60)), math.sin(math.radians(60))])
    magnitude = float(moon_v_mag(3.3))
    direct = star_spectra([magnitude], [0.92])[0] * np.exp(-optical_depth(GRID_NM, air) * float(airmass(60.0)))
    direct_v = float(BESSELL_V.mean(GRID_NM, direct)) * moon[2]
    table = moonlight(moon, magnitude, air)
    altitude = np.radians(sky_grid().altitude_deg)
    per_row = BESSELL_V.mean(GRID_NM, table.spectra) @ table.maps.mean(axis=2)
    diffuse_v = 2 * np.pi * np.trapezoid(per_row * np.sin(altitude) * np.cos(altitude), altitude)
    lux = (direct_v + diffuse_v) / BESSELL_V.zero_point * 2.54e-6
    assert lux == pytest.approx(0.25, rel=0.1)


def test_high_pressure_sodium_in_the_near_infrared() -> None:
    """Against another lamp than the table's: Osram Super Vialox, LI-1800 spectroradiometer (Aphalo, photobiologyLamps).

    In that spectrum sodium's doublet at 818 and 819 nm holds 55 nm times the mean over V, and V-I is 0.47; three lamps'
    continua between 700 and 760 nm differ by a factor 1.5, which is 0.4 mag in V-I without the doublet.
    """
    sodium = lamp_spectra()["HPS"]
    doublet = (GRID_NM > 810) & (GRID_NM < 830)
    continuum = np.interp(GRID_NM[doublet], [805, 835], sodium[np.isin(GRID_NM, [805, 835])])
    assert float(np.sum(sodium[doublet] - continuum)) * 5 == pytest.approx(55, rel=0.2)
    assert float(colours(sodium)[1]) == pytest.approx(0.47, abs=0.4)


def test_light_emitting_diodes_are_dark_in_the_near_infrared() -> None:
    """Phosphor's band ends: less than 1 % of the photons beyond 780 nm; metal halide has sodium's doublet too."""
    lamps = lamp_spectra()
    beyond = {name: float(lamp[GRID_NM > 780].sum() / lamp.sum()) for name, lamp in lamps.items()}
    assert beyond["LED"] < 0.01
    assert beyond["LED3000"] < 0.01
    assert lamps["MH"][GRID_NM == 820] > 10 * lamps["MH"][GRID_NM == 800]


def test_a_city_s_glow_shines_in_the_near_infrared() -> None:
    """Half HPS, half LED, class 6: V-I between the lamps' own -0.6 and 1.7 mag less, as molecules scatter V and I."""
    glow = city_table(City(14.0, 225.0, 10.0)).radiance(np.array([90.0]), np.array([0.0]))[0]
    assert -0.6 - 1.7 < float(colours(glow)[1]) < -0.6


def test_full_moon_of_the_eso_sky_model() -> None:
    """Zenith of Paranal, full Moon 45 deg up: V 18.01 with the night's 21.83, B 18.20 with 22.78 (public SkyCalc tool).

    Ours is 0.40 and 0.40 mag fainter in Paranal's air (aerosol depth 0.05), and within 0.1 and 0.2 mag at twice its aerosol;
    Krisciunas & Schaefer's formula, extinction 0.12, gives 18.6 without the opposition surge.
    """
    moon = np.array([0.0, 1.0, 1.0]) / np.sqrt(2)
    night = {"V": (BESSELL_V, 21.83, 18.01), "B": (BESSELL_B, 22.78, 18.20)}
    for aerosol, least, most in ((0.05, 0.3, 0.5), (0.1, -0.1, 0.25)):
        air = Atmosphere(740.0, aerosol, 1.3, 260.0)
        spectrum = moonlight(moon, moon_v_mag(0.0), air).radiance(np.array([90.0]), np.array([0.0]))[0]
        for band, dark, published in night.values():
            light = float(band.mean(GRID_NM, spectrum)) / band.zero_point / ARCSEC2_PER_SR + 10 ** (-0.4 * dark)
            assert least < -2.5 * np.log10(light) - published < most
