"""What is measured on a photograph and its twin, on images whose answer is known."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import Rotation

from benchmark.errors import PhotographError
from benchmark.photographed.alignment import align, directions
from benchmark.photographed.star_light import isolated, star_light
from benchmark.photographed.view import dark_plane, view_of
from benchmark.twin.comparison import Stars, measure
from benchmark.twin.focus import FACTORS, fit_focus, focused_psf
from benchmark.twin.ground import PICTURE_PX, UNSEEN, ground_mask, ground_reflectance, landscape_picture
from benchmark.twin.render_twin import LEAST_LIGHT_DN, check_light, stars_are_seen
from benchmark.twin.scene import read_passing, with_passing
from benchmark.twin.weather import DECK, DRAWS, VEIL, Fit, Seen, Weather, fit_weather, sky_cells
from celnav.camera import Camera
from generator.scenario.camera_spec import CameraSpec

CAMERA = Camera("equidistant", 400, 400, f_px=120.0)
UP = np.array([[1.0, 0, 0], [0, 1, 0], [0, 0, 1]])
"""Columns and rows of the image towards east and north."""


def draw(uv: np.ndarray, flux: np.ndarray, sigma_px: float = 0.8, shape: tuple[int, int] = (400, 400)) -> np.ndarray:
    """Gaussian stars, sampled at the pixels' centres."""
    image = np.zeros(shape)
    v, u = np.mgrid[0 : shape[0], 0 : shape[1]]
    for (x, y), light in zip(uv, flux, strict=True):
        near = (slice(max(int(y) - 12, 0), int(y) + 13), slice(max(int(x) - 12, 0), int(x) + 13))
        r2 = (u[near] - x) ** 2 + (v[near] - y) ** 2
        image[near] += light * np.exp(-r2 / (2 * sigma_px**2)) / (2 * np.pi * sigma_px**2)
    return image


def sky_stars(rng: np.random.Generator, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Azimuths and altitudes over the upper sky, deg."""
    return rng.uniform(0, 360, n), np.degrees(np.arcsin(rng.uniform(0.35, 1, n)))


def test_light_of_a_star_is_that_of_its_aperture() -> None:
    image = draw(np.array([[100.3, 90.8]]), np.array([5000.0])) + 700
    found = star_light(image, np.array([[100.0, 90.0], [3.0, 200.0], [np.nan, np.nan]]), search_px=2.0)
    inside = 1 - np.exp(-(3.5**2) / (2 * 0.8**2))
    assert found.flux[0] == pytest.approx(5000 * inside, rel=2e-3)
    assert found.uv[0] == pytest.approx([100.3, 90.8], abs=0.02)
    assert found.sky[0] == pytest.approx(700, abs=0.1)
    assert found.nearest_share[0] == pytest.approx(
        np.exp(-(0.3**2 + 0.2**2) / (2 * 0.64)) / (2 * np.pi * 0.64), rel=0.01
    )
    assert np.isnan(found.flux[1:]).all()


def test_the_noise_of_a_star_is_that_of_the_ring_around_it() -> None:
    """300 rings of some 370 pixels: the mean of their deviations within 1.5 %, five standard errors."""
    rng = np.random.default_rng(1)
    image = rng.normal(1000, 20, (700, 700))
    uv = np.stack(np.meshgrid(np.arange(20, 680, 40.0), np.arange(20, 680, 40.0)), -1).reshape(-1, 2)
    assert np.mean(star_light(image, uv).noise) == pytest.approx(20, rel=0.015)


def test_stars_with_a_brighter_or_similar_neighbour_are_not_isolated() -> None:
    uv = np.array([[10, 10], [14, 10], [100, 100], [103, 100], [200, 200], [np.nan, 0]], dtype=float)
    v_mag = np.array([3.0, 4.0, 3.0, 6.0, 5.0, 1.0])
    assert isolated(uv, v_mag).tolist() == [False, False, True, False, True, False]


@pytest.mark.parametrize("turn_deg", [0.05, 1.0, 4.0])
def test_an_attitude_is_found_by_the_stars(turn_deg: float) -> None:
    rng = np.random.default_rng(2)
    azimuth, altitude = sky_stars(rng, 80)
    enu = directions(azimuth, altitude)
    true = Rotation.from_rotvec(np.radians(turn_deg) * np.array([0.6, -0.64, 0.48])).as_matrix() @ UP
    uv = CAMERA.project(enu @ true.T)
    image = draw(uv, rng.uniform(2000, 20000, len(uv))) + rng.normal(500, 10, (400, 400))
    sky = np.hypot(*(np.indices((400, 400)) - 199.5)) < 160
    found = align(image, sky, CAMERA, UP, enu)
    assert found.stars >= 60
    assert found.rms_px < 0.1
    missed = Rotation.from_matrix(found.R_cam @ true.T).magnitude()
    assert np.degrees(missed) < 0.01
    assert found.turned_deg == pytest.approx(turn_deg, abs=0.01)


def test_an_empty_frame_keeps_the_attitude() -> None:
    rng = np.random.default_rng(3)
    enu = directions(*sky_stars(rng, 50))
    image = rng.normal(500, 10, (400, 400))
    found = align(image, np.ones((400, 400), dtype=bool), CAMERA, UP, enu)
    assert (found.R_cam == UP).all()
    assert np.isnan(found.rms_px)


def test_trees_are_ground_and_the_picture_has_them_in_their_directions() -> None:
    view = view_of(CAMERA, UP)
    rng = np.random.default_rng(4)
    tree = (np.abs(view.azimuth_deg - 90) < 12) & (view.altitude_deg < 25)
    frames = []
    for level in (400.0, 900.0, 3000.0):
        light = np.where(view.altitude_deg > 0, level, 0.0)
        frames.append(np.where(tree, 0.3, 1.0) * light + rng.normal(0, 10, (400, 400)))
    found = ground_mask(frames, view)
    above = np.nan_to_num(view.altitude_deg, nan=-90) > 2
    assert (found & above & tree).sum() > 0.95 * (tree & above).sum()
    assert (found & above & ~tree).sum() < 0.05 * (tree & above).sum()
    reflectance = np.full((400, 400), 0.5, np.float32)
    picture = landscape_picture(found, reflectance, CAMERA, UP)
    middle = PICTURE_PX // 2
    at_15_deg = round(PICTURE_PX / 2 * 75 / 90)
    alpha = picture[..., 3]
    # East is on the left of a picture of the sky with north at its top.
    assert alpha[middle, middle - at_15_deg] == 255
    assert alpha[middle, middle + at_15_deg] == alpha[middle - at_15_deg, middle] == 0
    # Half of the light in sRGB (IEC 61966-2-1).
    assert (picture[middle, middle - at_15_deg, :3] == 188).all()


def test_sky_shows_under_a_crown_and_the_skirts_of_a_glow_are_no_ground() -> None:
    view = view_of(CAMERA, UP)
    azimuth, altitude = view.azimuth_deg, view.altitude_deg
    trunk = (np.abs(azimuth - 90) < 3) & (altitude < 15)
    tree = trunk | ((np.abs(azimuth - 90) < 12) & (altitude >= 15) & (altitude < 25))
    # A glow towards the west, whose sides are darker than what the level is taken from.
    glow = 1 + 1.2 * np.exp(-(((azimuth - 270) / 25) ** 2) - (altitude / 12) ** 2)
    frames = [np.where(tree, 0.3, glow) * np.where(altitude > 0, level, 0.0) for level in (400.0, 900.0, 3000.0)]
    found = ground_mask(frames, view)
    open_sky = (altitude > 9) & ~tree
    assert (found & tree & (altitude > 9)).sum() > 0.9 * (tree & (altitude > 9)).sum()
    assert (found & open_sky & (np.abs(azimuth - 90) < 12) & (altitude < 14)).sum() < 60
    assert not (found & (np.abs(azimuth - 270) < 60)).any()


def test_walls_reflect_what_they_send_back_of_the_sky() -> None:
    """Of an even sky a wall of reflectance r sends back r / 2 of its radiance, on top of what the lens scatters."""
    view = view_of(CAMERA, UP)
    above = view.altitude_deg > 0
    wall = above & (np.abs(view.azimuth_deg - 90) < 20) & (view.altitude_deg < 25)
    needles = above & (np.abs(view.azimuth_deg - 200) < 20) & (view.altitude_deg < 25)
    ground = wall | needles
    moonlit = np.where(wall, 2.0, 1.0)
    frames = [
        level * np.where(wall, 0.35 + 0.05, np.where(needles, 0.015 + 0.05, above)) * factor
        for level, factor in ((400.0, 1.0), (900.0, 1.0), (3000.0, moonlit), (5000.0, moonlit))
    ]
    found = ground_reflectance(frames, view, ground)
    inner = (np.abs(view.altitude_deg - 12) < 8) & (np.abs(view.azimuth_deg - 90) < 14)
    assert np.median(found[inner]) == pytest.approx(0.7, abs=0.02)
    assert np.median(found[needles]) == pytest.approx(0.03, abs=0.01)
    assert (found[~ground] == np.float32(UNSEEN)).all()


def test_the_dark_level_is_the_plane_of_the_dark_corners() -> None:
    v, u = np.mgrid[0:400, 0:400]
    plane = 1000 + 0.2 * u - 0.1 * v
    light = np.where(np.hypot(u - 199.5, v - 199.5) < 150, 5000.0, 0.0)
    found = dark_plane(plane + light, CAMERA, 150.0, 64.0)
    assert found == pytest.approx(plane, abs=0.1)
    assert (dark_plane(plane + light, CAMERA, 260.0, 64.0) == 64.0).all()
    assert (dark_plane(plane + light, CAMERA, None, 64.0) == 64.0).all()


def test_a_weather_is_found_from_sky_and_stars() -> None:
    """A sky of known law: airglow and city add, the air dims; 3 % of noise on cells, 10 % on stars."""
    rng = np.random.default_rng(5)
    airmass = np.linspace(1, 5, 8)[:, None] * np.ones(12)
    glow = 500 * airmass**0.5
    town = 100 * airmass**2 * (1 + np.cos(np.linspace(0, 2 * np.pi, 12)))
    star_airmass = rng.uniform(1, 4, 200)

    names = ("airglow_factor", "aerosol_tau_550", "city_factor")

    def twin(weather: Weather) -> Seen:
        airglow, tau, city = (getattr(weather, name) for name in names)
        cells = (airglow * glow + city * town) * np.exp(-tau * airmass)
        return Seen(cells, 1000 * np.exp(-tau * star_airmass))

    true = Weather(airglow_factor=0.6, aerosol_tau_550=0.12, city_factor=2.0)
    clean = twin(true)
    real = Seen(clean.cells * rng.lognormal(0, 0.03, (8, 12)), clean.stars * rng.lognormal(0, 0.1, 200))
    real.cells[0, :3] = np.nan
    found = fit_weather(real, names, twin)
    assert found.weather.airglow_factor == pytest.approx(0.6, rel=0.05)
    assert found.weather.aerosol_tau_550 == pytest.approx(0.12, abs=0.015)
    assert found.weather.city_factor == pytest.approx(2.0, rel=0.1)
    assert found.weather.cloud_tau is None
    assert found.typical_miss < 0.04
    # Means of normal misses without sign: 0.8 of their deviations, half of the stars'.
    assert found.misfit == pytest.approx(0.8 * (0.03 + 0.1 / 2), rel=0.2)
    assert not found.clouded


def test_thick_haze_and_misses_are_cloud() -> None:
    clear = Fit(Weather(aerosol_tau_550=0.1), 0.05, 0.1, 0.1)
    assert not clear.clouded
    assert dataclasses.replace(clear, weather=Weather(aerosol_tau_550=0.8)).clouded
    assert dataclasses.replace(clear, typical_miss=0.2).clouded
    assert dataclasses.replace(clear, star_miss=0.4).clouded


def test_a_cloud_is_found_wherever_its_gaps_lie() -> None:
    """Cover and depth of a cloud, from a sky with the same cloud's gaps at other places; limits by ten draws of the gaps."""
    rng = np.random.default_rng(12)
    cells_at, stars_at = rng.uniform(size=(2, 8, 12)), rng.uniform(size=(2, 300))

    def sky(weather: Weather, draw: int) -> Seen:
        """Depth even between 0 and twice its mean in the part that is cloud, which shines."""
        assert weather.cloud_tau is not None
        cover, tau = weather.cloud_cover, weather.cloud_tau
        cells, stars = (np.clip(1 - at[draw] / cover, 0, None) * 2 * tau / cover for at in (cells_at, stars_at))
        return Seen(500 * (weather.airglow_factor + 0.4 * cells), np.maximum(np.exp(-stars), 0.02))

    true = Weather(airglow_factor=0.9, cloud_tau=1.1, cloud_cover=0.6)
    found = fit_weather(sky(true, 0), ("airglow_factor", "cloud_tau", "cloud_cover"), lambda weather: sky(weather, 1))
    assert found.weather.cloud_cover == pytest.approx(0.6, rel=0.15)
    assert found.weather.cloud_tau == pytest.approx(1.1, rel=0.15)
    assert found.weather.airglow_factor == pytest.approx(0.9, rel=0.15)
    assert found.weather.cloudless == Weather(airglow_factor=found.weather.airglow_factor)


def test_texture_of_cloud_is_not_taken_for_stars() -> None:
    """Blobs at random places, and 300 places of which none, and then a tenth, has a star of an SNR of 20."""
    rng = np.random.default_rng(21)
    pixels = 1000 + rng.standard_normal((400, 400))
    for u, v in rng.integers(20, 380, (3000, 2)):
        pixels[v - 1 : v + 2, u - 1 : u + 2] += 3
    places = rng.integers(30, 370, (300, 2)).astype(float)
    assert not stars_are_seen(pixels, places)
    for u, v in places[:120].astype(int):
        pixels[v, u] += 100
    assert stars_are_seen(pixels, places)


def test_a_cloud_of_a_weather_is_a_veil_or_a_deck_with_its_cover() -> None:
    for kind, draw in ((VEIL, 5), (DECK, DRAWS + 5)):
        clouds = Weather(cloud_tau=1.2, cloud_cover=0.7, cloud_draw=draw).over({})["sky"]["clouds"]
        assert clouds == kind | {"mean_optical_depth": 1.2, "coverage": 0.7, "draw": 5}


@pytest.mark.parametrize(("factor", "light"), [(0.7, 2e4), (1.15, 2e4), (1.0, 1200.0)])
def test_the_focus_of_stars_is_found(factor: float, light: float) -> None:
    """Stars of another width, with noise, by stars at the same places without; the faint ones have an SNR of 12."""
    rng = np.random.default_rng(13)
    uv = np.stack(np.meshgrid(np.arange(20, 380, 40.0), np.arange(20, 380, 40.0)), -1).reshape(-1, 2)
    uv = uv + rng.uniform(-0.5, 0.5, uv.shape)
    flux = np.full(len(uv), light)
    photograph = rng.normal(1000 + draw(uv, flux, 0.9 * factor), 15)
    found = fit_focus(photograph, uv, 60000.0, lambda given: draw(uv, flux, 0.9 * given))
    assert found == pytest.approx(factor, abs=0.06)
    assert fit_focus(photograph, uv[:5], 60000.0, lambda given: draw(uv, flux, 0.9 * given)) is None
    assert min(FACTORS) < factor < max(FACTORS)


def test_a_focus_widens_gaussian_stars_and_no_others() -> None:
    plain = {"width": 64, "height": 64, "f_px": 60.0, "aperture_mm": 2.0, "psf_sigma_px": 0.8}
    field = {"radial_sigma_px": [[0, 0.5], [60, 0.6]], "tangential_sigma_px": [[0, 0.5], [60, 1.0]]}
    assert focused_psf(CameraSpec.model_validate(plain), 0.5) == {"psf_sigma_px": 0.4}
    wide = CameraSpec.model_validate(plain | {"psf": {"field_gaussian": field, "support_px": 8}})
    given = focused_psf(wide, 2.0)
    assert given["psf"]["field_gaussian"]["tangential_sigma_px"] == [[0, 1.0], [60, 2.0]]
    assert CameraSpec.model_validate(plain | given).psf is not None
    moffat = CameraSpec.model_validate(plain | {"psf": {"moffat": {"fwhm_px": 2.0, "beta": 3.0}}})
    assert focused_psf(moffat, 2.0) == {}


def test_a_weather_changes_its_keys_of_the_scenario_and_no_others() -> None:
    tree = {"sky": {"cities": [{"distance_km": 9, "upward_mlm": 5.0}]}, "atmosphere": {"ozone_du": 280}}
    found = Weather(airglow_factor=0.5, aerosol_tau_550=0.2, city_factor=2.0).over(tree)
    assert found["sky"] == {"airglow_factor": 0.5, "cities": [{"distance_km": 9, "upward_mlm": 10.0}]}
    assert found["atmosphere"] == {"ozone_du": 280, "aerosol_tau_550": 0.2}
    assert tree["sky"]["cities"][0]["upward_mlm"] == 5.0
    assert Weather().over(tree) == tree


def test_what_flew_through_a_photograph_is_in_its_twin_alone(tmp_path: Path) -> None:
    trail = {"kind": "aircraft", "start": {"azimuth_deg": 10, "altitude_deg": 20}, "v_mag": -1}
    trail["end"] = {"azimuth_deg": 60, "altitude_deg": 50}
    (tmp_path / "passing.yaml").write_text(json.dumps({"006": [trail]}), encoding="utf-8")
    passing = read_passing(tmp_path / "passing.yaml")
    tree = {"name": "twin-006", "foreground": {"landscape": "here"}}
    assert with_passing(tree, passing["006"]) == tree | {"foreground": {"landscape": "here", "trails": [trail]}}
    assert with_passing(tree, passing.get("008", ())) == tree
    (tmp_path / "passing.yaml").write_text(json.dumps({"006": [trail | {"kind": "bird"}]}), encoding="utf-8")
    with pytest.raises(PhotographError, match="expected trails of a scenario's foreground"):
        read_passing(tmp_path / "passing.yaml")


def test_cells_are_medians_of_their_sky() -> None:
    view = view_of(CAMERA, UP)
    light = np.where(np.nan_to_num(view.azimuth_deg) < 180, 100.0, 300.0)
    sky = np.nan_to_num(view.altitude_deg, nan=-90) > 30
    cells = sky_cells(light, view, sky)
    assert np.isnan(cells[:3]).all()
    assert (cells[4, :6] == 100).all()
    assert (cells[4, 6:] == 300).all()


@pytest.fixture(scope="module")
def night() -> tuple[np.ndarray, Stars]:
    rng = np.random.default_rng(6)
    azimuth, altitude = sky_stars(rng, 150)
    v_mag = rng.uniform(1, 5, 150)
    uv = CAMERA.project(directions(azimuth, altitude) @ UP.T)
    image = draw(uv, 2e5 * 10 ** (-0.4 * v_mag)) + 800
    return rng.normal(image, 15), Stars(uv, v_mag, altitude, 90 - altitude)


def test_measures_of_a_frame_of_known_stars_and_white_noise(night: tuple[np.ndarray, Stars]) -> None:
    """Lag-one correlations of some 30,000 pixels of white noise: within 0.03, five standard errors."""
    image, stars = night
    view = view_of(CAMERA, UP)
    sky = np.nan_to_num(view.altitude_deg, nan=-90) > 15
    found = measure(image, np.full(image.shape, 100.0), view, sky, stars, 65535.0)
    assert found.sep > 100
    assert found.celnav > 100
    assert found.celnav_spurious < 0.05
    assert found.noise == pytest.approx(15, rel=0.05)
    assert np.abs(found.autocorrelation).max() < 0.03
    assert found.spectrum == pytest.approx(np.ones(4), abs=0.12)
    assert np.isnan(found.sky[0])
    assert found.sky[1:] == pytest.approx(700, abs=3)


def test_smooth_noise_has_its_correlation_and_false_stars_are_spurious(night: tuple[np.ndarray, Stars]) -> None:
    """Gaussian smoothing by s correlates neighbours by exp(-1 / (4 s^2))."""
    image, stars = night
    rng = np.random.default_rng(7)
    view = view_of(CAMERA, UP)
    sky = np.nan_to_num(view.altitude_deg, nan=-90) > 15
    false = CAMERA.project(directions(*sky_stars(rng, 150)) @ UP.T)
    smooth = gaussian_filter(rng.normal(0, 60, image.shape), 0.8)
    found = measure(image + smooth + draw(false, np.full(150, 2e4)), np.zeros(image.shape), view, sky, stars, 65535.0)
    expected = np.exp(-1 / (4 * 0.8**2))
    part = smooth.var() / (smooth.var() + 15**2)
    assert found.autocorrelation == pytest.approx(np.full(2, expected * part), abs=0.06)
    assert found.spectrum[0] > 2 * found.spectrum[3]
    assert 0.35 < found.sep_spurious < 0.65


@pytest.mark.parametrize("cells", [np.full((8, 12), np.nan), np.zeros((8, 12)), np.full((8, 12), 0.9 * LEAST_LIGHT_DN)])
def test_a_photograph_without_light_of_the_sky_is_refused(cells: np.ndarray) -> None:
    with pytest.raises(PhotographError, match=r"night\.fits: no part of its sky is brighter than the dark level"):
        check_light("night.fits", cells)
    cells[2, 3] = 1.1 * LEAST_LIGHT_DN
    check_light("night.fits", cells)


@pytest.mark.parametrize("sigma", [0.4, 0.6, 0.8, 1.2, 1.8, 2.5])
def test_noise_of_a_few_grey_values_is_measured_though_pixels_are_whole_numbers(sigma: float) -> None:
    """Rounding adds a variance of 1/12 (Sheppard); a bright neighbour in the ring is no noise."""
    rng = np.random.default_rng(4)
    image = np.rint(rng.normal(50.3, sigma, (400, 400)))
    image[30::40, 30::40] = 255.0
    u, v = np.meshgrid(np.arange(20.0, 380.0, 40.0), np.arange(20.0, 380.0, 40.0))
    light = star_light(image, np.column_stack((u.ravel(), v.ravel())))
    # 81 rings of 370 pixels: 0.4 % at one sigma; small sigmas are not normal any more, by 2 %.
    assert np.mean(light.noise) == pytest.approx(np.hypot(sigma, 1 / np.sqrt(12)), rel=0.03)
