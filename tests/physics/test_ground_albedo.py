"""The ground's albedo: what comes back from it, against published formulas and Mitsuba."""

import numpy as np
import pytest
from scipy.special import expn
from small_scenes import small_scenario

from generator.bake import make_maps
from generator.bake.make_maps import run_worker
from generator.errors import GeneratorError
from generator.frame.plan import plan_frame
from generator.frame.scene import frame_layers
from generator.light.atmosphere import Atmosphere, rayleigh_optical_depth
from generator.light.bake_grids import WAVELENGTHS_NM, BakedAir, CityGrid, MoonGrid
from generator.light.baked_maps import city_kernel, ground_map, moon_map
from generator.light.ground import albedo_at, ground_light, spherical_albedo, with_ground
from generator.sky.city_light import STANDARD_AIR, bortle_city, city_table
from generator.sky.moonlight import moonlight

SNOW = 0.8
JUDGED_NM, JUDGED_TAU = 430.0, 0.3
VIEW_DEG = (8.0, 36.0, 90.0)
DISK_RINGS = 22
BAKED_PRESSURE_HPA = BakedAir().pressure_hpa
THICK = Atmosphere(BAKED_PRESSURE_HPA, JUDGED_TAU, BakedAir().angstrom_exponent, 300.0)


def test_light_that_molecules_return_to_the_ground() -> None:
    """The spherical albedo of a Rayleigh atmosphere, (3 tau - E3 (4 + 2 tau) + 2 exp(-tau)) / (4 + 3 tau) (Vermote et al.
    1997, IEEE Trans. Geosci. Remote Sens. 35, 675, 6S), within 2.5 %: the bake's, carried on to no aerosol."""
    little, more = (spherical_albedo(Atmosphere(BAKED_PRESSURE_HPA, tau, 1.3, 300.0)) for tau in (0.03, 0.1))
    ours = (little - (more - little) * 0.03 / 0.07)[:4]
    tau = rayleigh_optical_depth(np.array(WAVELENGTHS_NM[:4]), BAKED_PRESSURE_HPA)
    published = (3 * tau - expn(3, tau) * (4 + 2 * tau) + 2 * np.exp(-tau)) / (4 + 3 * tau)
    np.testing.assert_allclose(ours, published, rtol=0.025)


def test_light_goes_to_and_fro_as_a_geometric_series() -> None:
    albedo, returned = 0.8, 0.3
    series = sum(albedo * (albedo * returned) ** k for k in range(200))
    assert ground_light(np.array([albedo]), np.array([1.0]), returned)[0] == pytest.approx(series, rel=1e-12)


@pytest.mark.slow  # random walks of two programs: some ten seconds
def test_city_light_over_snow_is_mitsuba_s() -> None:
    """Light scattered at least twice from a disk of lamps around the observer over ground of 0.8, 430 nm, thick aerosol, by
    ``volpath``: within 4 sigma of its errors (a false alarm in 5,000 runs) and 3 %. Snow adds a third to a half."""
    mean, error = run_worker("disk_on_snow")
    grid = CityGrid()
    rings, parts = grid.edges
    w = WAVELENGTHS_NM.index(JUDGED_NM)
    rows = [grid.view_altitude_deg.index(v) for v in VIEW_DEG]
    light = []
    for albedo in (SNOW, 0.15):
        kernel = np.exp(with_ground(city_kernel(THICK), albedo, THICK))[0, w][rows]
        around = np.trapezoid(kernel, parts, axis=-1) / 180
        fine = np.geomspace(1e-3, rings[DISK_RINGS], 4000)
        at = np.array([np.interp(grid.scale(fine), grid.scale(rings), row) for row in around])
        light.append(np.trapezoid(at * fine, fine, axis=1) * 2 / rings[DISK_RINGS] ** 2)
    assert (np.abs(light[0] - mean) < 4 * error + 0.02 * mean).all()
    np.testing.assert_allclose(light[0], mean, rtol=0.03)
    assert (light[0] > 1.2 * light[1]).all()


@pytest.mark.slow
def test_moonlight_over_snow_is_mitsuba_s() -> None:
    """All moonlight at 430 nm under thick aerosol over ground of 0.8 by ``volpath`` (80,000 paths a direction, a minute):
    within 1 % on average and 4 sigma of its errors (a false alarm in 1,800 runs)."""
    mean, error = run_worker("moonlit_snow")
    grid, altitude = MoonGrid(), 30.0
    index = grid.aerosol_tau_550.index(JUDGED_TAU), grid.wavelength_nm.index(JUDGED_NM)
    row = grid.moon_altitude_deg.index(altitude)
    layers, _ = make_maps.moon_singles(BakedAir(), grid)
    azimuths = [grid.relative_azimuth_deg.index(a) for a in (0.0, 75.0, 180.0)]
    land = np.array(
        [(layers + moon_map("walked"))[*index, grid.view_altitude_deg.index(v), row][azimuths] for v in VIEW_DEG]
    ).ravel()
    snow, bare = (moon_in(albedo, altitude) for albedo in (SNOW, 0.15))
    ours = land * snow / bare
    assert (np.abs(ours - mean) < 4 * error + 0.01 * mean).all()
    assert abs(np.mean(ours / mean) - 1) < 0.01


def moon_in(albedo: float, altitude: float) -> np.ndarray:
    """Moonlight at JUDGED_NM in the directions of the comparison."""
    from generator.light.photometry import GRID_NM

    moon = np.array([0.0, np.cos(np.radians(altitude)), np.sin(np.radians(altitude))])
    table = moonlight(moon, -12.0, THICK, albedo)
    view, azimuth = np.repeat(VIEW_DEG, 3), np.tile([0.0, 75.0, 180.0], 3)
    return table.radiance(view, azimuth)[:, int(np.argmin(np.abs(GRID_NM - JUDGED_NM)))]


@pytest.mark.journey
def test_snow_brightens_a_town() -> None:
    """The same lamps, clear sky, zenith in V. With 13 % of the upward light straight from the lamps, reflected light in
    proportion to the albedo: 2 to 3 times for a town in snow with cleared streets (0.35 to 0.5), as observers report;
    4 to 5.5 where all ground has the albedo of fresh snow."""
    city = bortle_city(9)
    land = city_table(city, STANDARD_AIR).zenith_v()
    gain = {albedo: city_table(city, STANDARD_AIR, albedo).zenith_v() / land for albedo in (0.0, 0.35, 0.5, SNOW)}
    assert 2.0 < gain[0.35] < gain[0.5] < 3.2
    assert 4.0 < gain[SNOW] < 5.5
    assert 0.1 < gain[0.0] < 0.2


def test_albedo_by_wavelength() -> None:
    """Grass reflects green and infrared more than blue: under it the same Moon's sky is redder than over grey ground."""
    grass = ((400.0, 0.04), (550.0, 0.10), (680.0, 0.05), (750.0, 0.45), (900.0, 0.50))
    np.testing.assert_allclose(albedo_at(grass, np.array([300.0, 550.0, 1000.0])), [0.04, 0.10, 0.50])
    zenith = np.array([90.0]), np.array([0.0])
    moon = np.array([0.0, 0.6, 0.8])
    grey, green = (moonlight(moon, -12.0, STANDARD_AIR, albedo).radiance(*zenith)[0] for albedo in (0.15, grass))
    change = green / grey - 1
    assert change[20] < 0 < change[-30]


def test_ground_of_a_scenario_by_name_number_and_curve() -> None:
    def zenith(ground) -> float:
        sky = {"cities": [{"distance_km": 0.0, "azimuth_deg": 0.0, "radius_km": 5.0}], "ground_albedo": ground}
        return frame_layers(plan_frame(small_scenario(sky=sky), 0))["skyglow"].zenith_v()

    assert zenith("snow") == zenith(0.8) == pytest.approx(zenith([[350, 0.8], [1000, 0.8]]), rel=1e-6)
    assert zenith("land") == zenith(0.15) < zenith("snow")
    with pytest.raises(GeneratorError, match=r"sky\.ground_albedo"):
        small_scenario(sky={"bortle": 3, "ground_albedo": "moss"})
    with pytest.raises(GeneratorError, match="increase"):
        small_scenario(sky={"bortle": 3, "ground_albedo": [[700, 0.2], [500, 0.1]]})


@pytest.mark.journey
def test_shipped_ground_follows_from_the_walks() -> None:
    """One piece of the walks again, to the bit, and the fit from all of them."""
    mean, _ = run_worker("ground", 1, 3, 12)
    np.testing.assert_array_equal(mean, ground_map("walked")[1, 3, 12].astype(np.float32))
    glow, lamps, _ = make_maps.ground_values(ground_map("walked"), ground_map("walked_error"))
    np.testing.assert_allclose(glow, ground_map("glow"), rtol=1e-6)
    np.testing.assert_allclose(lamps, ground_map(), rtol=5e-3)
