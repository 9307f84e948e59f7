"""Landscapes as pictures: where they are, what they hide, and the light that they send back."""

import dataclasses

import numpy as np
import pytest
import yaml
from PIL import Image
from small_scenes import BASE, FISHEYE_CAMERA

from generator.errors import ScenarioError
from generator.frame.exposure.expected import render_expected
from generator.frame.landscape import sky_light
from generator.frame.plan import plan_frame
from generator.frame.scene import frame_layers
from generator.ground.lighting import ROWS, SkyLight, irradiance, sky_directions, surface_normals
from generator.ground.panorama import Panorama, encoded, linear, on_sphere, opacity, reduced
from generator.ground.picture import fisheye
from generator.ground.reflectance import primaries
from generator.light.photometry import GRID_NM
from generator.scenario.file import parse_scenario


def write_picture(folder, rgba, name="ground.png") -> None:
    Image.fromarray(rgba).save(folder / name)


def scenario_in(folder, landscape, **overrides):
    tree = BASE | {"camera": FISHEYE_CAMERA, "stars": {"limiting_magnitude": 5.0}} | overrides
    tree = tree | {"foreground": {"landscape": landscape} if landscape else {}}
    return parse_scenario(yaml.safe_dump(tree), str(folder / "scene.yaml"))


def rendered(folder, landscape, **overrides):
    plan = plan_frame(scenario_in(folder, landscape, **overrides), 0)
    return plan, render_expected(plan)


def skyline(rows=900, columns=1800, edge_deg=10.0) -> np.ndarray:
    rgba = np.zeros((rows, columns, 4), np.uint8)
    altitude = 90 - (np.arange(rows) + 0.5) * 180 / rows
    rgba[altitude < edge_deg] = (128, 128, 128, 255)
    return rgba


def fisheye_pixel(azimuth_deg, altitude_deg, f_px=120.0, centre=199.5):
    """Where a direction falls on an equidistant camera that looks up with north at the top, so that east is on the left."""
    radius, turn = f_px * np.radians(90 - altitude_deg), np.radians(azimuth_deg)
    return centre - radius * np.sin(turn), centre - radius * np.cos(turn)


def centroid(image):
    rows, columns = np.indices(image.shape)
    return (image * columns).sum() / image.sum(), (image * rows).sum() / image.sum()


@pytest.mark.parametrize(("azimuth", "altitude"), [(30.0, 40.0), (359.9, 25.0), (200.0, 70.0)])
def test_a_spot_of_a_picture_is_where_it_belongs(tmp_path, azimuth, altitude) -> None:
    """A round spot of 3 deg, drawn independently on an equirectangular picture, within 0.05 px of its own projection."""
    rows, columns = 1800, 3600
    h = np.radians(90 - (np.arange(rows) + 0.5) * 180 / rows)[:, None]
    a = np.radians((np.arange(columns) + 0.5) * 360 / columns)[None, :]
    h0, a0 = np.radians([altitude, azimuth])
    distance = np.degrees(np.arccos(np.clip(np.sin(h) * np.sin(h0) + np.cos(h) * np.cos(h0) * np.cos(a - a0), -1, 1)))
    rgba = np.zeros((rows, columns, 4), np.uint8)
    rgba[..., 3] = np.clip((3 - distance) / 0.1 + 0.5, 0, 1) * 255
    write_picture(tmp_path, rgba)
    _, frame = rendered(tmp_path, {"file": "ground.png"})
    cover = np.where(np.hypot(*(np.indices((400, 400)) - 199.5)) < 185, frame.cover, 0)
    u, v = centroid(cover)
    # An equidistant image draws a circle of 3 deg tangentially larger off the zenith; its own centroid by fine sampling.
    radius, turn = np.meshgrid((np.arange(300) + 0.5) / 100, np.arange(720) * np.pi / 360, indexing="ij")
    axis = np.array([np.sin(a0) * np.cos(h0), np.cos(a0) * np.cos(h0), np.sin(h0)])
    east = np.array([np.cos(a0), -np.sin(a0), 0])
    north = np.cross(axis, east)
    sine, cosine = np.sin(np.radians(radius)), np.cos(np.radians(radius))
    points = cosine[..., None] * axis + sine[..., None] * (
        np.cos(turn)[..., None] * east + np.sin(turn)[..., None] * north
    )
    theta, phi = np.arccos(points[..., 2]), np.arctan2(points[..., 0], points[..., 1])
    area = sine * theta / np.sin(theta)
    expected = [199.5 - 120 * (theta * f(phi) * area).sum() / area.sum() for f in (np.sin, np.cos)]
    assert (u, v) == pytest.approx(expected, abs=0.05)
    assert cover.sum() == pytest.approx(2 * np.pi * 120**2 * area.mean() * np.radians(3), rel=0.01)


def test_a_fisheye_picture_is_the_same_as_its_panorama(tmp_path) -> None:
    """A wedge between two azimuths below 30 deg, drawn in both projections by their own formulas."""
    side = 1200
    v, u = np.mgrid[0:side, 0:side] - (side - 1) / 2
    altitude = 90 - np.hypot(u, v) / (side / 2) * 90
    azimuth = np.degrees(np.arctan2(-u, -v)) % 360
    rgba = np.zeros((side, side, 4), np.uint8)
    rgba[(altitude < 30) & (azimuth > 40) & (azimuth < 100)] = 255
    panorama = reduced(fisheye(rgba, 180.0), 0.2)
    inside = opacity(panorama, np.array([42.0, 70, 98]), np.array([28.0, 10, 1]))
    outside = opacity(panorama, np.array([38.0, 102, 70]), np.array([20.0, 20, 32]))
    assert inside.min() > 0.99
    assert outside.max() < 0.01
    assert opacity(panorama, np.array([40.0, 70.0]), np.array([15.0, 30.0])) == pytest.approx([0.5, 0.5], abs=0.15)
    mirrored = reduced(fisheye(rgba, 180.0, mirrored=True), 0.2)
    assert opacity(mirrored, np.array([290.0, 70.0]), np.array([10.0, 10.0])) == pytest.approx([1, 0], abs=0.01)


def uniform_light(radiance=2.0, moon=None) -> SkyLight:
    maps = np.ones((1, len(sky_directions()[0])))
    moon_enu, flux = (np.array([0.0, 0, 1]), 0.0) if moon is None else moon
    return SkyLight(maps, np.full((1, len(GRID_NM)), radiance), np.asarray(moon_enu), np.full(len(GRID_NM), flux))


def closed_below(edge_deg: float, level: int) -> Panorama:
    rgba = skyline(180, 360, edge_deg)
    rgba[..., :3] = level
    return Panorama(rgba[..., :3], rgba[..., 3])


@pytest.mark.parametrize("edge_deg", [0.0, 20.0, 45.0])
def test_a_white_landscape_is_as_bright_as_an_even_sky(edge_deg) -> None:
    """Energy: white surfaces that see only sky and each other send back the sky's radiance, whatever their shape (1 %)."""
    lit = irradiance(closed_below(edge_deg, 255), uniform_light(2.0))
    np.testing.assert_allclose(lit / np.pi, 2.0, rtol=0.01)


def test_grey_ground_has_the_series_of_its_reflections() -> None:
    """Level ground to the horizon: E = pi L; upright surfaces: half from the sky, half from ground of radiance rho L."""
    level = 120
    rho = float(linear(np.uint8(level)))
    lit = irradiance(closed_below(0.0, level), uniform_light(1.0))
    np.testing.assert_allclose(lit[-1], np.pi, rtol=0.002)
    np.testing.assert_allclose(lit[:-1], np.pi * (0.5 + 0.5 * rho), rtol=0.005)


def test_moonlight_on_upright_and_level_surfaces_follows_lambert() -> None:
    """Black landscape, Moon alone at 30 deg in the south-east: E = F cos(angle to the normal), none on the far side."""
    moon = np.array([np.sin(np.radians(135)), np.cos(np.radians(135)), np.tan(np.radians(30))])
    moon /= np.linalg.norm(moon)
    lit = irradiance(closed_below(0.0, 0), uniform_light(0.0, (moon, 3.0)))[:, 0]
    assert lit[-1] == pytest.approx(3 * np.sin(np.radians(30)), rel=1e-6)
    # The wall in the north-west faces the Moon.
    np.testing.assert_allclose(lit[72 * 315 // 360], 3 * np.cos(np.radians(30)), rtol=1e-6)
    assert lit[72 * 135 // 360] == 0
    walls = np.maximum(surface_normals() @ moon, 0) * 3
    np.testing.assert_allclose(lit, walls, atol=1e-9)


def test_a_hill_in_front_of_the_moon_takes_its_light() -> None:
    moon = np.array([0.0, np.cos(np.radians(15)), np.sin(np.radians(15))])
    assert irradiance(closed_below(20.0, 0), uniform_light(0.0, (moon, 3.0))).max() < 1e-6
    assert irradiance(closed_below(5.0, 0), uniform_light(0.0, (moon, 3.0)))[-1, 0] > 0.7


def test_colours_come_back_under_white_light() -> None:
    """Mallett & Yuksel's curves give an sRGB colour back under D65, through CIE 1931 and sRGB's matrix, within 0.005."""
    from generator.colour_science import colour

    module = colour()
    shape = module.SpectralShape(380, 780, 5)
    observer = module.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"].copy().align(shape).values
    d65 = module.SDS_ILLUMINANTS["D65"].copy().align(shape).values
    grid = np.arange(380, 781, 5)
    curves = np.array([np.interp(grid, GRID_NM, curve) for curve in primaries()])
    rgb = np.array([[0.8, 0.2, 0.1], [0.1, 0.5, 0.15], [0.18, 0.18, 0.18], [0.05, 0.1, 0.6]])
    xyz = (rgb @ curves * d65) @ observer / (d65 @ observer[:, 1])
    matrix = np.array([[3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570]])
    np.testing.assert_allclose(xyz @ matrix.T, rgb, atol=0.005)
    np.testing.assert_allclose(primaries().sum(axis=0), 1)


def test_white_ground_of_a_frame_has_its_sky_s_irradiance(tmp_path) -> None:
    """Looking down on white ground: electrons per sr are those of the sky, integrated with the cosine, over pi (2 %)."""
    rgba = np.full((90, 360, 4), 255, np.uint8)
    write_picture(tmp_path, rgba)
    down = {"azimuth_deg": 0.0, "altitude_deg": -90.0}
    camera = {"width": 32, "height": 32, "f_px": 200.0, "aperture_mm": 4.0, "bloom": {"share": 0}, "veiling_glare": 0}
    _, floor = rendered(
        tmp_path,
        {"file": "ground.png", "top_deg": 0.0},
        attitude=down,
        camera=camera,
        stars={"limiting_magnitude": -2.0},
    )
    _, sky = rendered(tmp_path, None, stars={"limiting_magnitude": -2.0})
    v, u = np.mgrid[0:400, 0:400]
    theta = np.hypot(u - 199.5, v - 199.5) / 120.0
    light = float((sky.sky_electrons * np.cos(theta))[theta < np.pi / 2].sum())
    assert floor.electrons[16, 16] == pytest.approx(light / np.pi / 200.0**2, rel=0.02)
    assert floor.cover.min() == 1


def test_stars_are_hidden_as_far_as_the_picture_covers_them(tmp_path) -> None:
    """A veil of alpha 0.4 in the east, a wall in the west: fractions, electrons, flags and sky follow from them."""
    rgba = np.zeros((180, 360, 4), np.uint8)
    rgba[:, :180, 3] = 102
    rgba[:, 200:340, 3] = 255
    write_picture(tmp_path, rgba)
    plan, frame = rendered(tmp_path, {"file": "ground.png", "reflectance": 0.0})
    _, free = rendered(tmp_path, None)
    azimuth, altitude = plan.middle.azimuth_deg, plan.middle.altitude_deg
    up = altitude < 80
    veiled, walled = up & (azimuth > 5) & (azimuth < 175), up & (azimuth > 206) & (azimuth < 334)
    clear = up & (azimuth > 343) & (azimuth < 357)
    assert veiled.sum() > 20
    assert walled.sum() > 20
    assert clear.sum() > 0
    np.testing.assert_allclose(frame.hidden_fraction[veiled], 0.4, atol=1e-5)
    np.testing.assert_allclose(frame.hidden_fraction[walled], 1)
    np.testing.assert_allclose(frame.hidden_fraction[clear], 0)
    np.testing.assert_allclose(frame.star_electrons[veiled], 0.6 * free.star_electrons[veiled], rtol=1e-5)
    np.testing.assert_array_equal(frame.occluded[up], (frame.hidden_fraction > 0.5)[up])
    east, west = fisheye_pixel(90.0, 45.0), fisheye_pixel(270.0, 45.0)
    ratio = frame.sky_electrons / np.maximum(free.sky_electrons, 1e-9)
    assert ratio[round(east[1]), round(east[0])] == pytest.approx(0.6, abs=1e-4)
    assert ratio[round(west[1]), round(west[0])] == pytest.approx(0, abs=1e-5)
    assert frame.cover[round(east[1]), round(east[0])] == pytest.approx(0.4, abs=1e-4)


def test_an_edge_within_a_pixel_covers_its_exact_part(tmp_path) -> None:
    """Level edge at many places within a pixel: cover of the pixel it crosses is the part below, within 0.06."""
    camera = {"width": 24, "height": 120, "f_px": 400.0, "aperture_mm": 4.0, "bloom": {"share": 0}, "veiling_glare": 0}
    north = {"azimuth_deg": 0.0, "altitude_deg": 0.0}
    # Rows of a fine picture are 0.01 deg; a pixel is 0.143 deg.
    for shift in range(0, 14, 3):
        edge = 2.0 + shift * 0.01
        rgba = np.zeros((1000, 8, 4), np.uint8)
        altitude = 10 - (np.arange(1000) + 0.5) * 0.01
        rgba[altitude < edge, :, 3] = 255
        write_picture(tmp_path, rgba)
        where = {"file": "ground.png", "top_deg": 10.0, "bottom_deg": 0.0}
        _, frame = rendered(tmp_path, where, camera=camera, attitude=north)
        row = 59.5 - 400 * np.tan(np.radians(edge))
        column = frame.cover[:, 12]
        # Rows below the edge are covered: by area the sum of the open parts is the edge's own row.
        assert (1 - column[40:59]).sum() == pytest.approx(row + 0.5 - 40, abs=0.06)


def test_alpha_is_the_mean_over_coarse_texels() -> None:
    """`reduced` and `on_sphere` keep the covered solid angle, whatever the ratio of the resolutions."""
    rng = np.random.default_rng(3)
    rgba = rng.integers(0, 256, (101, 233, 4), dtype=np.uint8)
    panorama = Panorama(rgba[..., :3], rgba[..., 3], 40.0, -20.0)
    coarse = reduced(panorama, 1.7)
    assert coarse.alpha.mean() == pytest.approx(rgba[..., 3].mean() / 255, rel=1e-5)
    sphere = on_sphere(panorama, ROWS)
    assert sphere.alpha.sum() * 2.5**2 == pytest.approx(rgba[..., 3].mean() / 255 * 60 * 360, rel=1e-5)
    np.testing.assert_array_equal(encoded(linear(np.arange(256, dtype=np.uint8))), np.arange(256))


def test_layers_of_a_frame_with_a_landscape_add_up(tmp_path) -> None:
    write_picture(tmp_path, skyline())
    glow = np.zeros((900, 1800, 3), np.uint8)
    glow[440:450, 300:320] = 255
    write_picture(tmp_path, glow, "glow.png")
    plan = plan_frame(scenario_in(tmp_path, {"file": "ground.png", "glow_file": "glow.png"}), 0)
    frame = render_expected(plan, layers=True)
    assert frame.layers["landscape"].max() > 0
    total = sum(part.astype(np.float64) for part in frame.layers.values())
    np.testing.assert_allclose(total, frame.electrons, rtol=2e-4, atol=1e-3)


def test_a_glowing_window_has_its_luminance(tmp_path) -> None:
    """10 cd/m^2 through a V-band camera: a lamp's photons by lumen, against the electrons per solid angle (1 %)."""
    from small_scenes import V_BAND_QE

    from generator.light.lamps import lamp_spectra, luminous
    from generator.light.photometry import BESSELL_V

    rgba = np.full((90, 180, 4), 255, np.uint8)
    write_picture(tmp_path, rgba)
    write_picture(tmp_path, rgba[..., :3], "glow.png")
    camera = {"width": 16, "height": 16, "f_px": 300.0, "aperture_mm": 5.0, "bloom": {"share": 0}, "veiling_glare": 0}
    _, frame = rendered(
        tmp_path, {"file": "ground.png", "glow_file": "glow.png", "reflectance": 0.0}, camera=camera,
        sensor={"quantum_efficiency": V_BAND_QE}, stars={"limiting_magnitude": -2.0},
    )  # fmt: skip
    width = np.trapezoid(BESSELL_V.response, BESSELL_V.wavelength_nm)
    assert BESSELL_V.mean(GRID_NM, lamp_spectra()["LED"]) == pytest.approx(1)
    photons = 10 / luminous(lamp_spectra()["LED"]) * width
    transmission = plan_frame(scenario_in(tmp_path, None), 0).spec.camera.transmission
    expected = photons * np.pi / 4 * 0.005**2 * 0.5 / 300.0**2 * transmission
    assert frame.electrons[8, 8] == pytest.approx(expected, rel=0.01)


def test_a_turning_camera_takes_its_landscape_along(tmp_path) -> None:
    """Rolled by 90 deg, the mask turns by 90 deg."""
    rgba = skyline()
    rgba[300:400, 200:400] = 255
    write_picture(tmp_path, rgba)
    covers = []
    for roll in (0.0, 90.0):
        attitude = {"azimuth_deg": 180.0, "altitude_deg": 90.0, "roll_deg": roll}
        covers.append(rendered(tmp_path, {"file": "ground.png"}, attitude=attitude)[1].cover)
    np.testing.assert_allclose(np.rot90(covers[0]), covers[1], atol=0.02)


def test_bad_landscapes_are_refused(tmp_path) -> None:
    write_picture(tmp_path, skyline(90, 180))
    write_picture(tmp_path, skyline(45, 90)[..., :3], "glow.png")
    (tmp_path / "noise.png").write_bytes(b"\x89PNG\r\n\x1a\n" + b"x" * 200)
    Image.new("1", (12000, 9000)).save(tmp_path / "huge.png")
    cases = [
        ({"file": "none.png"}, ["foreground.landscape.file", "cannot be read"]),
        ({"file": "noise.png"}, ["foreground.landscape", "'noise.png' cannot be read as a picture"]),
        ({"file": "huge.png"}, ["foreground.landscape", "12000 x 9000 pixels", "make it smaller"]),
        ({"file": "ground.png", "glow_file": "glow.png"}, ["'glow.png' has 90 x 45 pixels", "make them the same"]),
        ({"file": "ground.png", "top_deg": 5, "bottom_deg": 10}, ["bottom_deg (10) must be below top_deg (5)"]),
        ({"file": "../ground.png"}, ["leaves the scenario's folder"]),
    ]
    for landscape, fragments in cases:
        with pytest.raises(ScenarioError) as caught:
            scenario_in(tmp_path, landscape)
        for fragment in fragments:
            assert fragment in str(caught.value)


def test_a_frame_s_sky_lights_its_landscape(tmp_path) -> None:
    """The sampled sky is that of the tables: irradiance of level ground by a fine quadrature of radiance, within 1 %."""
    write_picture(tmp_path, skyline(180, 360, 0.0))
    plan = plan_frame(scenario_in(tmp_path, {"file": "ground.png", "reflectance": 0.0}), 0)
    tables = list(frame_layers(plan).values())
    light = dataclasses.replace(sky_light(plan, tables), moon_irradiance=np.zeros(len(GRID_NM)))
    black = skyline(180, 360, 0.0)
    black[..., :3] = 0
    lit = irradiance(Panorama(black[..., :3], black[..., 3]), light)[-1]
    altitude, azimuth = np.meshgrid(np.arange(0.25, 90, 0.5), np.arange(0, 360, 2.0), indexing="ij")
    cell = (
        np.radians(0.5) * np.radians(2.0) * np.cos(np.radians(altitude)).ravel() * np.sin(np.radians(altitude)).ravel()
    )
    fine = sum(cell @ table.radiance(altitude.ravel(), azimuth.ravel()) for table in tables)
    middle = np.searchsorted(GRID_NM, 550.0)
    np.testing.assert_allclose(lit[middle], fine[middle], rtol=0.01)
