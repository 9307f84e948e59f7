"""Cloud and scintillation: what they do to stars and sky, and by how much."""

import itertools

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.ndimage import gaussian_filter
from scipy.special import j1
from small_scenes import small_scenario

from generator import plugins
from generator.frame.exposure.expected import render_expected
from generator.frame.plan import plan_frame
from generator.frame.scene import frame_layers
from generator.gallery.vision import naked_eye_limit
from generator.light.disk_scattering import disk_irradiance
from generator.light.scintillation import scintillation_factors, scintillation_sigma
from generator.places.ephemeris import PLANET_ID_BASE
from generator.seeds import random_stream
from generator.sky.assembly import whole_sky
from generator.sky.cloud_light import coarse_axes, light_from_city
from generator.sky.clouds import COARSE_CELL_KM, Texture, cloud_pattern, diffuse_transmission
from generator.sky.directions import sky_grid, unit_vectors
from generator.sky.zenith import BORTLE_ZENITH_MAG

CLOUD = {"mean_optical_depth": 0.8, "coverage": 0.6}


def sampled(pattern, cell_km, cells):
    """Depths of a pattern on a square grid."""
    at = np.arange(cells) * cell_km
    return pattern.depth(*np.meshgrid(at, at, indexing="ij"))


def spectral_slope(field, cell_km, band):
    """Slope of a periodic or windowed field's power by wave number, between two wave numbers per km."""
    cells = len(field)
    power = np.abs(np.fft.rfft2(field)) ** 2
    k = np.hypot(np.fft.fftfreq(cells, cell_km)[:, None], np.fft.rfftfreq(cells, cell_km)[None, :])
    edges = np.geomspace(*band, 12)
    mean = [power[(k >= low) & (k < high)].mean() for low, high in itertools.pairwise(edges)]
    return np.polyfit(np.log((edges[1:] * edges[:-1]) ** 0.5), np.log(mean), 1)[0]


def test_field_has_its_mean_coverage_and_spectrum() -> None:
    """The power law holds within 0.15 from 15 km to 40 m: over the large tile's waves and over the small tile's."""
    thin = sampled(cloud_pattern(0.8, 0.6, -8 / 3, 20.0, np.random.default_rng(3)), 0.125, 1024)
    assert thin.mean() == pytest.approx(0.8, rel=0.01)
    assert (thin > 0).mean() == pytest.approx(0.6, abs=0.08)
    whole = cloud_pattern(0.8, 1.0, -8 / 3, 20.0, np.random.default_rng(3))
    assert sampled(whole, 0.125, 1024).mean() == pytest.approx(0.8, rel=0.01)
    assert spectral_slope(whole.coarse, 0.125, (0.15, 3.0)) == pytest.approx(-8 / 3, abs=0.15)
    assert spectral_slope(whole.fine, 0.0125, (4.0, 25.0)) == pytest.approx(-8 / 3, abs=0.15)
    # One law for both: the power per wave next to the split, on either side.
    power = [np.abs(np.fft.fft2(tile)) ** 2 * cell**2 / tile.size for tile, cell in
             ((whole.coarse, 0.125), (whole.fine, 0.0125))]  # fmt: skip
    waves = [np.hypot(*np.meshgrid(np.fft.fftfreq(len(tile), cell), np.fft.fftfreq(len(tile), cell))) for tile, cell in
             ((whole.coarse, 0.125), (whole.fine, 0.0125))]  # fmt: skip
    below, above = power[0][(waves[0] > 2.8) & (waves[0] < 3.2)], power[1][(waves[1] > 3.2) & (waves[1] < 3.6)]
    assert above.mean() / below.mean() == pytest.approx((3.4 / 3.0) ** (-8 / 3), rel=0.2)


def test_light_of_a_thick_layer_has_no_waves_shorter_than_that() -> None:
    """The field is that without thickness, spread by spots whose root mean square radius is the thickness."""
    thick = Texture(thickness_km=0.5)
    kept = cloud_pattern(0.8, 1.0, -8 / 3, 5.0, np.random.default_rng(7), thick).coarse
    sharp = cloud_pattern(0.8, 1.0, -8 / 3, 5.0, np.random.default_rng(7)).coarse
    spread = gaussian_filter(sharp.astype(float), 0.5 / np.sqrt(2) / COARSE_CELL_KM, mode="wrap")
    assert (kept - spread).std() < 0.01 * spread.std()


def test_stars_are_dimmed_by_the_depth_in_their_truth_row() -> None:
    scenario = small_scenario(sky={"bortle": 4, "clouds": CLOUD}, stars={"limiting_magnitude": 4.0})
    clear = small_scenario(sky={"bortle": 4}, stars={"limiting_magnitude": 4.0})
    plan = plan_frame(scenario, 0)
    behind, free = render_expected(plan), render_expected(plan_frame(clear, 0))
    assert plan.cloud_optical_depth.max() > 0.5
    ratio = behind.star_electrons / free.star_electrons
    np.testing.assert_allclose(ratio, plan.cloud_transmission, rtol=2e-4)
    assert (plan.cloud_transmission > np.exp(-plan.cloud_optical_depth) - 1e-12).all()


def test_without_particles_a_cloud_takes_all_it_extinguishes() -> None:
    cloud = CLOUD | {"particle_um": 0.0}
    plan = plan_frame(small_scenario(sky={"bortle": 4, "clouds": cloud}, stars={"limiting_magnitude": 4.0}), 0)
    np.testing.assert_allclose(plan.cloud_transmission, np.exp(-plan.cloud_optical_depth), rtol=1e-12)


def test_cloud_brightens_a_city_and_darkens_the_wild() -> None:
    """The mean sky above 30 deg under overcast cloud: brighter in class 8, darker in class 1."""
    altitude, azimuth = np.repeat([35.0, 60.0, 85.0], 12), np.tile(np.arange(0, 360, 30.0), 3)
    change = {}
    for bortle in (1, 8):
        light = []
        for clouds in (None, {"mean_optical_depth": 6.0, "coverage": 1.0, "altitude_km": 2.0}):
            table = whole_sky(frame_layers(plan_frame(small_scenario(sky={"bortle": bortle, "clouds": clouds}), 0)))
            light.append(float(np.mean(10 ** (-0.4 * table.v_mag_arcsec2(altitude, azimuth)))))
        change[bortle] = light[1] / light[0]
    assert change[8] > 1.3
    assert change[1] < 0.8


def test_emitter_s_cloud_is_the_stars_cloud() -> None:
    """Optical depth ray by ray on the device against the function that dims the stars, carried by a wind: 20,000 directions
    above 10 deg, each within 1 % of the mean depth, 0.02 % on average. Lower, a direction in single precision is metres wide
    on the layer."""
    plugins.start()
    import mitsuba as mi

    from generator.plugins.clouds import CloudTexture, cloud_numbers

    windy = {"bortle": 4, "clouds": CLOUD | {"wind_m_s": 17.0, "wind_azimuth_deg": 70.0}}
    clouds = plan_frame(small_scenario(sky=windy), 0).sky.clouds
    random = np.random.default_rng(1)
    enu = unit_vectors(random.uniform(10, 90, 20_000), random.uniform(0, 360, 20_000))
    tiles = [mi.TensorXf(tile) for tile in (clouds.pattern.coarse, clouds.pattern.fine)]
    texture = CloudTexture(*tiles, mi.TensorXf(np.array(cloud_numbers(clouds), np.float32)))
    (depth,) = texture.slant_depths(mi.Vector3f(*enu.T.astype(np.float32)))
    ours = np.array(depth)
    wanted = clouds.slant_depth(enu)
    error = np.abs(ours - wanted) / wanted.mean()
    assert error.mean() < 2e-4
    assert error.max() < 0.01


def test_cloud_has_structure_from_pixel_to_pixel() -> None:
    """In a frame of 120 deg with 1,080 pixels (0.1 deg each), the sky's power falls as a power law to the pixel: on a line of
    128 pixels there is more in the finest octave than bilinear interpolation over half a degree leaves (a tenth)."""
    scenario = small_scenario(
        camera={"preset": "thesis-720p"},
        attitude={"azimuth_deg": 0, "altitude_deg": 90},
        sky={"bortle": 8, "clouds": CLOUD | {"coverage": 1.0}},
        stars={"limiting_magnitude": -2.0, "planets": False},
    )
    sky = render_expected(plan_frame(scenario, 0)).sky_electrons[296:424, 476:604].astype(float)
    window = np.hanning(128)[:, None] * np.hanning(128)
    power = np.abs(np.fft.rfft2((sky / sky.mean() - 1) * window)) ** 2
    k = np.hypot(np.fft.fftfreq(128)[:, None], np.fft.rfftfreq(128)[None, :])
    octaves = [power[(k >= low) & (k < 2 * low)].mean() for low in (0.0625, 0.125, 0.25)]
    assert octaves[1] / octaves[0] > 0.05
    assert octaves[2] / octaves[1] > 0.05


def test_wind_carries_the_cloud() -> None:
    """12.5 s at 20 m/s are 250 m: the field of the later frame is the earlier one's, moved to the east."""
    moved = {"bortle": 4, "clouds": CLOUD | {"wind_m_s": 20.0, "wind_azimuth_deg": 90.0}}
    first = plan_frame(small_scenario(sky=moved), 0).sky.clouds
    later = plan_frame(small_scenario(sky=moved, time__utc_start="2020-01-15T20:00:12.5Z"), 0).sky.clouds
    np.testing.assert_array_equal(first.pattern.coarse, later.pattern.coarse)
    assert later.east_km - first.east_km == pytest.approx(0.25, abs=1e-6)
    assert later.north_km == pytest.approx(first.north_km, abs=1e-6)


def test_diffuse_transmission_is_bohren_s() -> None:
    """Optical depth 10 with g 0.85 passes about half (Meador & Weaver 1980, Eddington: 0.47 for 3/4 (1 - g) tau = 1.125)."""
    assert float(diffuse_transmission(10.0)) == pytest.approx(0.47, abs=0.01)
    assert float(diffuse_transmission(0.0)) == 1.0


@pytest.mark.parametrize("aperture_mm", [500, 1000, 4000])
@pytest.mark.parametrize(("height_m", "exposure_s"), [(0, 0.1), (2500, 10)])
def test_scintillation_of_large_apertures_is_young_s(aperture_mm, height_m, exposure_s) -> None:
    """Young 1967: 0.09 D^(-2/3) exp(-h / 8 km) (2 t)^(-1/2), D in cm."""
    young = 0.09 * (aperture_mm / 10) ** (-2 / 3) * np.exp(-height_m / 8000) / np.sqrt(2 * exposure_s)
    assert float(scintillation_sigma(aperture_mm, 1.0, exposure_s, height_m)) == pytest.approx(young, rel=0.02)


def layer_variance(diameter_m, distance_m):
    """Integral of f^(-11/3) sin^2(pi lambda h f^2) (2 J1(pi D f) / (pi D f))^2 over frequencies f across the wind."""

    def density(x):
        # x = sqrt(lambda h) f. The aperture's factor of a small lens is 1 until the power is spent.
        argument = np.pi * diameter_m / fresnel * x
        return x ** (-11 / 3) * np.sin(np.pi * x**2) ** 2 * (2 * j1(argument) / argument) ** 2

    fresnel = np.sqrt(550e-9 * distance_m)
    pieces = np.sqrt(np.arange(0, 61) / 2)
    return fresnel ** (8 / 3) * sum(quad(density, *ends, limit=200)[0] for ends in itertools.pairwise(pieces))


@pytest.mark.parametrize("airmass", [1.0, 4.0])
@pytest.mark.parametrize("aperture_mm", [3, 4.5, 6, 20, 70, 300])
def test_scintillation_of_small_apertures_is_that_of_a_layer(aperture_mm, airmass) -> None:
    """Tatarskii's spectrum for a layer 10 km above the site, relative to an aperture of 1 m, for which Young's law holds; in
    exposures so long that no limit matters."""
    ours = [float(scintillation_sigma(mm, airmass, 1e6, 0.0)) for mm in (aperture_mm, 1000 * np.sqrt(airmass))]
    theory = [layer_variance(mm / 1000, 10_000 * airmass) for mm in (aperture_mm, 1000 * np.sqrt(airmass))]
    assert ours[0] / ours[1] == pytest.approx(np.sqrt(theory[0] / theory[1]), rel=0.07)


def test_scintillation_of_small_apertures_by_airmass() -> None:
    """X^(1.75 - 1/3): the Fresnel scale grows with the distance of the layer."""
    one, four = (float(scintillation_sigma(4.0, airmass, 1e6, 0.0)) for airmass in (1.0, 4.0))
    assert four / one == pytest.approx(4 ** (1.75 - 1 / 3), rel=0.01)


def test_planets_do_not_scintillate_and_leave_the_stars_factors_alone() -> None:
    """Jupiter and Mars are up on 2022 December 8; each star keeps its own draw."""
    sky = {"time__utc_start": "2022-12-08T20:00:00Z", "camera__hfov_deg": 150}
    plans = [
        plan_frame(small_scenario(**sky, stars={"limiting_magnitude": 4, "scintillation": True, "planets": planets}), 0)
        for planets in (True, False)
    ]
    planet = plans[0].stars.star_id >= PLANET_ID_BASE
    assert planet.sum() >= 2
    assert (plans[0].scintillation[planet] == 1).all()
    np.testing.assert_array_equal(plans[0].scintillation[~planet], plans[1].scintillation)
    assert (plans[1].scintillation != 1).all()


def test_scintillation_saturates_and_keeps_the_mean() -> None:
    assert 0.2 < float(scintillation_sigma(4.0, 10.0, 0.01, 0.0)) < 0.4
    factors = scintillation_factors(np.full(200_000, 0.3), random_stream(1, "scintillation", 0))
    assert factors.mean() == pytest.approx(1.0, abs=4 * 0.3 / np.sqrt(200_000))
    assert factors.std() == pytest.approx(0.3, rel=0.02)


def test_scintillation_is_off_unless_asked_for_and_in_the_truth() -> None:
    still = plan_frame(small_scenario(stars={"limiting_magnitude": 4.0}), 0)
    assert (still.scintillation == 1).all()
    scenario = small_scenario(stars={"limiting_magnitude": 4.0, "scintillation": True})
    lively = plan_frame(scenario, 0)
    assert lively.scintillation.std() > 0.03
    np.testing.assert_array_equal(lively.scintillation, plan_frame(scenario, 0).scintillation)
    ratio = render_expected(lively).star_electrons / render_expected(still).star_electrons
    np.testing.assert_allclose(ratio, lively.scintillation, rtol=2e-4)


def test_crumey_naked_eye_limit_of_the_bortle_table() -> None:
    """Crumey 2014, F = 2: V 6.18 at 21.83 mag/arcsec^2; the classes' limits within 0.02 mag."""
    published = {1: 6.25, 2: 6.17, 3: 6.05, 4: 5.87, 5: 5.63, 6: 5.33, 7: 5.04, 8: 4.83, 9: 4.78}
    assert naked_eye_limit(21.83) == pytest.approx(6.18, abs=0.02)
    for bortle, limit in published.items():
        assert naked_eye_limit(BORTLE_ZENITH_MAG[bortle]) == pytest.approx(limit, abs=0.02), bortle


@pytest.mark.parametrize("altitude_km", [0.5, 2.0, 8.0])
def test_a_city_lights_cloud_as_a_lambert_disk_does(altitude_km) -> None:
    """The view factor from a plane element to a disk parallel to it, at any distance from its axis, is known in closed form:
    (1 + (r^2 - a^2 - h^2) / sqrt((r^2 + a^2 + h^2)^2 - 4 r^2 a^2)) / 2 (Howell, "A Catalog of Radiation Heat Transfer
    Configuration Factors", B-13)."""
    radius = 10.0
    away = np.array([0.0, 1.0, 5.0, 9.0, 11.0, 15.0, 30.0, 60.0])
    place = away[:, None] * [np.sin(0.7), np.cos(0.7)]
    square = radius**2 + away**2 + altitude_km**2
    factor = 0.5 * (1 + (square - 2 * away**2 - 2 * altitude_km**2) / np.sqrt(square**2 - 4 * radius**2 * away**2))
    light = disk_irradiance(place, altitude_km, radius)[0, 0]
    np.testing.assert_allclose(light * np.pi * radius**2, factor, rtol=2e-3)


def test_low_cloud_over_a_city_is_lit_evenly() -> None:
    """A kilometre above the middle of a disk of 10 km, light falls off smoothly to its rim."""
    light = light_from_city(0.0, 0.0, 10.0, 0.5, 1.0)[0][0]
    altitude = sky_grid().altitude_deg[coarse_axes()[0]]
    high = light[(altitude > 15)]
    assert (np.ptp(high, axis=1) < 1e-3 * high.mean(axis=1)).all()
    assert (np.diff(high.mean(axis=1)) > 0).all()


def in_the_air(height_m, **clouds):
    """The sky's state over a camera in the air above a ground at sea level."""
    site = {"latitude_deg": 47.0, "longitude_deg": 11.0, "height_m": height_m, "ground_height_m": 0.0}
    return plan_frame(small_scenario(site=site, sky={"clouds": CLOUD | clouds}), 0).sky


def test_layers_stand_over_the_ground_and_cameras_in_the_air_come_nearer() -> None:
    """A place on the layer, 0.3 km north and 0.2 km east, has one vertical depth, seen from the ground or from beneath it."""
    depth = []
    for height_m in (0.0, 1500.0):
        field = in_the_air(height_m, altitude_km=2.0).clouds
        assert field.altitude_km == 2.0 - height_m / 1000
        sight = np.array([0.2, 0.3, field.altitude_km])
        enu = sight / np.linalg.norm(sight)
        depth.append(float(field.slant_depth(enu[None])[0]) * enu[2])
    assert depth[0] > 0
    assert depth[1] == pytest.approx(depth[0], rel=2e-3)


def test_a_camera_at_the_height_of_a_layer_or_above_sees_a_clear_sky() -> None:
    assert in_the_air(1999.0, altitude_km=2.0).clouds is not None
    for height_m in (2000.0, 3000.0):
        assert in_the_air(height_m, altitude_km=2.0).clouds is None


def test_light_of_a_city_on_a_layer_does_not_depend_on_who_looks() -> None:
    """The zenith of a camera over the middle of a city, on the ground and 1.5 km up, is the same place on a layer at 2 km."""
    ground, air = (light_from_city(0.0, 0.0, 10.0, 0.5, 2.0 - up, up)[0][0] for up in (0.0, 1.5))
    np.testing.assert_allclose(air[-1], ground[-1], rtol=1e-6)
