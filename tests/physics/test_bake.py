"""The random walks of the bake: judged by Mitsuba's volpath and by quadrature, and the shipped maps made again."""

import math

import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator
from small_scenes import small_scenario

from generator.bake import make_maps
from generator.bake.make_maps import run_worker
from generator.frame.exposure.expected import render_expected
from generator.frame.plan import plan_frame
from generator.frame.scene import frame_layers
from generator.light.bake_grids import BakedAir, CityGrid, MoonGrid
from generator.light.baked_maps import CITY_FILE, MOON_FILE, city_map, city_multiple, moon_map
from generator.light.disk_scattering import disk_nodes
from generator.light.emission import pattern_weights
from generator.light.photometry import radiance_from_surface_brightness
from generator.light.single_scattering import column_from_ground, moon_single, moon_single_in_layers
from generator.sky.city_light import bortle_city, city_radiance
from generator.sky.component import total

VIEW_DEG = (8.0, 36.0, 90.0)
DISK_RINGS = 22
BESIDE_KM = (8.0, 10.0)


@pytest.mark.journey
def test_white_furnace() -> None:
    """Nothing absorbs and light comes from everywhere: radiance 1 everywhere, within 1 % on average and 3 sigma each."""
    mean, error = run_worker("furnace")
    assert abs(mean.mean() - 1) < 0.01
    assert (np.abs(mean - 1) < 0.01 + 3 * error).all()
    assert error.max() < 0.006


@pytest.mark.slow
def test_walks_are_mitsuba_s_moonlight() -> None:
    """All moonlight in nine directions at 430 nm under thick aerosol against ``volpath``: each within 4 sigma of its own
    errors (a false alarm in 1,800 runs), and within 0.5 % on average."""
    mean, error = run_worker("moonlit")
    grid = MoonGrid()
    tau, wavelength, moon = (
        grid.aerosol_tau_550.index(0.3), grid.wavelength_nm.index(430.0), grid.moon_altitude_deg.index(30.0),
    )  # fmt: skip
    azimuths = [grid.relative_azimuth_deg.index(a) for a in (0.0, 75.0, 180.0)]
    layers, _ = make_maps.moon_singles(BakedAir(), grid)
    walked = layers + moon_map("walked")
    ours = np.array(
        [walked[tau, wavelength, grid.view_altitude_deg.index(v), moon][azimuths] for v in VIEW_DEG]
    ).ravel()
    assert (np.abs(ours - mean) < 4 * error).all()
    assert abs(np.mean(ours / mean) - 1) < 0.005


@pytest.mark.slow  # random walks of two programs: some ten seconds
def test_walks_are_mitsuba_s_city_light() -> None:
    """Light scattered at least twice from a disk of Lambert lamps of 29.5 km around the observer, 430 nm, thick aerosol,
    against ``volpath``: within 4 sigma of its errors (a false alarm in 5,000 runs) and 1.5 %."""
    mean, error = run_worker("disk_of_lamps")
    grid = CityGrid()
    rings, parts = grid.edges
    area = np.diff(rings**2)[:, None] * np.diff(np.radians(parts))
    inside = np.arange(grid.distances) < DISK_RINGS
    pieces = city_map("walked")[0, grid.aerosol_tau_550.index(0.3), grid.wavelength_nm.index(430.0)]
    ours = np.array(
        [(pieces[grid.view_altitude_deg.index(v)] * area)[inside].sum() / area[inside].sum() for v in VIEW_DEG]
    )
    assert (np.abs(ours - mean) < 4 * error).all()
    np.testing.assert_allclose(ours, mean, rtol=0.015)


@pytest.mark.slow  # random walks of two programs: some ten seconds
def test_a_city_s_multiply_scattered_light_is_mitsuba_s() -> None:
    """Light scattered at least twice from a disk of 10 km whose middle is 8 km away, 430 nm, thick aerosol, in nine
    directions: the baked kernel integrated over the disk, against ``volpath``: within 4 sigma of its errors (a false alarm
    in 1,800 runs) and 4 %."""
    mean, error = run_worker("disk_beside")
    grid, (distance_km, radius_km) = CityGrid(), BESIDE_KM
    fitted = np.log(city_map()[0, grid.aerosol_tau_550.index(0.3), grid.wavelength_nm.index(430.0)])
    rows = [grid.view_altitude_deg.index(v) for v in VIEW_DEG]
    ours = []
    for azimuth in (0.0, 75.0, 180.0):
        distance, relative, weight = disk_nodes(distance_km, radius_km, azimuth, grid.core_km)
        light = city_multiple(np.broadcast_to(fitted[rows], (2, 1, *fitted[rows].shape)), distance, relative)
        ours.append((light[0, 0] * weight).sum(axis=-1))
    ours = np.array(ours).T.ravel()
    assert (np.abs(ours - mean) < 4 * error + 0.01 * mean).all()
    np.testing.assert_allclose(ours, mean, rtol=0.04)


# Makes parts of the shipped maps again.
@pytest.mark.journey
@pytest.mark.parametrize(("task", "index"), [("moon", (1, 3, 5)), ("city", (1, 6, 9))])
def test_shipped_maps_are_what_the_bake_makes(task, index) -> None:
    """One piece of the random walks again: bit for bit what the map was made from."""
    mean, _ = run_worker(task, *index)
    shipped = moon_map("walked")[index] if task == "moon" else city_map("walked")[(slice(None), *index)]
    np.testing.assert_array_equal(mean, shipped.astype(np.float32))


@pytest.mark.journey
def test_shipped_values_follow_from_the_walks() -> None:
    """The Moon's map, and the city's fit for one pattern and aerosol depth, from the stored walks."""
    again, _ = make_maps.moon_values(moon_map("walked"), np.zeros_like(moon_map("walked")))
    np.testing.assert_allclose(again, moon_map(), rtol=1e-5)
    again, _, scatter = make_maps.city_values(city_map("walked")[:1, 1:2], city_map("walked_error")[:1, 1:2])
    np.testing.assert_allclose(again, city_map()[:1, 1:2], rtol=1e-3)
    assert scatter < 1.3


def test_maps_are_small() -> None:
    assert CITY_FILE.stat().st_size + MOON_FILE.stat().st_size < 15e6


@pytest.mark.parametrize(("sine", "length", "height"), [(0.01, 50.0, 1.5), (0.2, 100.0, 8.0), (0.99, 3.0, 1.5)])
def test_column_over_a_curved_earth(sine, length, height) -> None:
    """Against an integral of the exact height above a sphere, within 1e-4."""
    from scipy.integrate import quad

    radius = 6371.0
    exact, _ = quad(
        lambda s: math.exp(-(math.sqrt(radius**2 + s * s + 2 * radius * s * sine) - radius) / height), 0, length
    )
    ours = column_from_ground(np.array([length]), np.array([sine]), height, radius)
    assert float(ours[0]) == pytest.approx(exact / height, rel=1e-4)


def test_single_scattering_in_layers_is_the_closed_form_for_one_layer() -> None:
    """Molecules alone: the quadrature over height against Chandrasekhar's formula, within 1e-4."""
    altitude, view = 35.0, 20.0
    cosine = np.array([[0.3, -0.5]])
    quadrature = moon_single_in_layers(BakedAir(), 0.2, 0.0, np.array([altitude]), view, cosine)
    sines = np.sin(np.radians([altitude, view]))
    closed = moon_single(0.2, 0.0, 1 / sines[0], 1 / sines[1], cosine, BakedAir())
    np.testing.assert_allclose(quadrature, closed, rtol=1e-4)


def shot_noise_margin(scenario, error_of) -> float:
    """Largest relative Monte Carlo error of a frame's sky over a fifth of its shot noise, in pixels that do not saturate.

    Over pixels above 2 deg, where the maps begin.

    Parameters
    ----------
    scenario : Scenario
    error_of : callable
        Monte Carlo error in V of the scenario's baked layer, photons s^-1 m^-2 nm^-1 sr^-1, by altitude and azimuth.
    """
    plan = plan_frame(scenario, 0)
    camera = plan.spec.camera
    electrons = render_expected(plan).sky_electrons
    v, u = np.mgrid[0 : camera.height : 8, 0 : camera.width : 8]
    rays = np.stack([u - camera.projection.cx_px, v - camera.projection.cy_px, np.full(u.shape, camera.f_px)], axis=-1)
    east, north, up = np.moveaxis(rays / np.linalg.norm(rays, axis=-1, keepdims=True) @ plan.spec.R_cam, -1, 0)
    altitude, azimuth = np.degrees(np.arcsin(up)).ravel(), np.degrees(np.arctan2(east, north)).ravel()
    seen = (altitude > 2) & (electrons[::8, ::8].ravel() < plan.spec.sensor.full_well_e)
    sky = total(list(frame_layers(plan).values())).v_mag_arcsec2(altitude[seen], azimuth[seen])
    relative = error_of(altitude[seen], azimuth[seen]) / radiance_from_surface_brightness(sky)
    fifth = 0.2 / np.sqrt(electrons[::8, ::8].ravel()[seen])
    return float((relative / fifth).max())


EXPOSURE_S = 0.5
THESIS = {
    "camera": {"preset": "thesis-720p"},
    "attitude": {"azimuth_deg": 225.0, "altitude_deg": 40.0},
    "stars": {"limiting_magnitude": -2.0, "planets": False},
    "time__exposure_s": EXPOSURE_S,
}


@pytest.mark.parametrize(
    "bortle", [1, 4, 9, *(pytest.param(bortle, marks=pytest.mark.journey) for bortle in (2, 3, 5, 6, 7, 8))]
)
def test_monte_carlo_error_is_below_a_fifth_of_the_shot_noise(bortle) -> None:
    """In all pixels that do not saturate (15,000 e) of a frame of the thesis' camera (120 deg, half a second) that looks
    towards the city of a class.

    The errors of the fit's values are taken as fully correlated over the city, which they are not: an upper limit."""
    grid, city = CityGrid(), bortle_city(bortle)
    scenario = small_scenario(**THESIS, sky={"bortle": bortle})
    layers = frame_layers(plan_frame(scenario, 0))
    at_530 = grid.wavelength_nm.index(530.0)
    tau = grid.aerosol_tau_550.index(0.1)
    kernel = np.log((city_map() * city_map("relative_error"))[:, tau])
    relative = np.linspace(0, 180, 25)
    nodes = [disk_nodes(city.distance_km, city.radius_km, azimuth, grid.core_km) for azimuth in relative]
    distance, turned, weight = (np.concatenate(each) for each in zip(*nodes, strict=True))
    error = city_multiple(kernel, distance, turned) * weight
    error = error.reshape(*kernel.shape[:3], len(relative), -1).sum(axis=-1)
    error = 1e-6 * np.tensordot(pattern_weights(city.horizon_share), error, axes=1)[at_530]
    # The lamps' output: skyglow at the zenith over the transfer there.
    transfer = city_radiance(city.distance_km, city.radius_km, city.horizon_share)
    scale = layers["skyglow"].zenith_v() / transfer[at_530, -1, 0]
    look_up = RegularGridInterpolator((np.log(grid.view_altitude_deg), relative), error * scale)

    def error_of(altitude, azimuth):
        apart = np.abs((azimuth - city.azimuth_deg + 180) % 360 - 180)
        return look_up(np.stack([np.log(altitude), apart], axis=-1))

    assert shot_noise_margin(scenario, error_of) < 1.0


@pytest.mark.parametrize(("utc", "least_altitude"), [("2020-01-10T19:30:00Z", 25.0), ("2020-01-10T23:30:00Z", 55.0)])
def test_monte_carlo_error_of_moonlight_is_below_a_fifth_of_the_shot_noise(utc, least_altitude) -> None:
    """The same under a full Moon at two altitudes, in a frame that looks 60 deg to its side."""
    grid = MoonGrid()
    plan = plan_frame(small_scenario(**THESIS, time__utc_start=utc, sky={"bortle": 2}), 0)
    assert plan.sky.moon_altitude_deg > least_altitude
    moon_azimuth = math.degrees(math.atan2(plan.sky.moon_enu[0], plan.sky.moon_enu[1]))
    attitude = {"azimuth_deg": moon_azimuth + 60.0, "altitude_deg": 40.0}
    scenario = small_scenario(**THESIS | {"attitude": attitude}, time__utc_start=utc, sky={"bortle": 2})
    light = frame_layers(plan_frame(scenario, 0))["moonlight"]
    nearest = int(np.argmin(np.abs(np.array(grid.moon_altitude_deg) - plan.sky.moon_altitude_deg)))
    error = moon_map("relative_error")[grid.aerosol_tau_550.index(0.1), grid.wavelength_nm.index(530.0), :, nearest]
    look_up = RegularGridInterpolator((np.log(grid.view_altitude_deg), np.array(grid.relative_azimuth_deg)), error)

    def error_of(altitude, azimuth):
        apart = np.abs((azimuth - moon_azimuth + 180) % 360 - 180)
        radiance = radiance_from_surface_brightness(light.v_mag_arcsec2(altitude, azimuth))
        return look_up(np.stack([np.log(altitude), apart], axis=-1)) * radiance

    assert shot_noise_margin(scenario, error_of) < 1.0
