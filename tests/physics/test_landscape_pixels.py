"""A pixel's part of a landscape: a few looks at its maps against many at the picture itself."""

import numpy as np
import pytest
import yaml
from small_scenes import BASE, FISHEYE_CAMERA

from generator import plugins
from generator.frame.landscape import landscape_maps
from generator.frame.plan import plan_frame
from generator.frame.scene import camera_dict, frame_layers, metameric, scene_dict
from generator.ground.lighting import ROWS, SkyLight, sky_directions
from generator.ground.panorama import Layers
from generator.ground.surface import (
    AZIMUTHS,
    CELL_DEG,
    CELLS,
    covered_cells,
    grown_cells,
    surface_maps,
    surface_terms,
)
from generator.light.photometry import GRID_NM
from generator.scenario.file import parse_scenario

PINHOLE = {"width": 240, "height": 160, "hfov_deg": 100, "aperture_mm": 4.0, "bloom": {"share": 0}, "veiling_glare": 0}
WIDE = FISHEYE_CAMERA | {"bloom": {"share": 0}, "veiling_glare": 0}
LOOKS = 8


def frame_scene(camera, attitude, **more):
    mi = plugins.start()
    from generator.plugins.film_response import film_response

    tree = BASE | {"camera": camera, "attitude": attitude, "stars": {"limiting_magnitude": 1.0}, "seed": 5} | more
    tree |= {"foreground": {"landscape": {"skyline": ["forest", "masts"]}}}
    plan = plan_frame(parse_scenario(yaml.safe_dump(tree), "scene"), 0)
    sensor = mi.load_dict(camera_dict(plan))
    sensor.film().prepare([])
    response = film_response(sensor).on_grid
    tables = list(frame_layers(plan).values())
    maps = landscape_maps(plan, tables, response)
    return plan, mi.load_dict(scene_dict(plan, metameric(tables, response), sensor, maps)), sensor


def many_looks(plan, camera):
    """Alpha of each pixel, mean over LOOKS x LOOKS places in it, each at the nearest texel of the picture."""
    mi = plugins.start()
    import drjit as dr

    from generator.frame.landscape import panorama_of
    from generator.plugins.camera import FLOAT64

    panorama = panorama_of(plan, plan.spec.foreground.landscape)
    ny, nx = panorama.shape
    width, height = camera.width, camera.height
    pixel = np.arange(width * height)
    total = np.zeros(width * height)
    places = (np.arange(LOOKS) + 0.5) / LOOKS
    for right in places:
        for down in places:
            position = mi.Point2f(mi.Float((pixel % width + right) / width), mi.Float((pixel // width + down) / height))
            ray, etendue = camera.pixel_ray(dr.opaque(FLOAT64, 0.5), position)
            east, north, up = (np.array(part, dtype=np.float64) for part in ray.d)
            altitude = np.degrees(np.arcsin(np.clip(up, -1, 1)))
            row = (panorama.top_deg - altitude) / (panorama.top_deg - panorama.bottom_deg) * ny
            column = (np.degrees(np.arctan2(east, north)) % 360 / 360 * nx).astype(int) % nx
            inside = (row >= 0) & (row < ny)
            alpha = panorama.alpha[np.clip(row.astype(int), 0, ny - 1), column] / 255
            total += np.where(inside, alpha, 0) / LOOKS**2
    valid = np.array(etendue) > 0
    return total.reshape(height, width), valid.reshape(height, width)


@pytest.mark.parametrize(
    ("camera", "attitude", "edge_rms"),
    [
        pytest.param(PINHOLE, {"azimuth_deg": 20, "altitude_deg": 25}, 0.055, marks=pytest.mark.journey),
        (PINHOLE, {"azimuth_deg": 20, "altitude_deg": 25, "roll_deg": 30}, 0.05),
        (WIDE, {"azimuth_deg": 180, "altitude_deg": 90}, 0.05),
    ],
)
def test_looks_at_the_maps_are_the_mean_over_the_pixel(camera, attitude, edge_rms) -> None:
    """Trees and wires against 64 looks at the picture's own texels in each pixel: cover in the mean within 0.1 %, of pixels
    that are covered in part (10 to 20 % of the frame) within 0.05 rms."""
    plan, scene, sensor = frame_scene(camera, attitude)
    cover = np.array(scene.integrator().diffuse_and_cover(scene, sensor)[1], dtype=np.float64)
    truth, valid = many_looks(plan, sensor)
    partly = valid & (truth > 0) & (truth < 1)
    assert 0.05 < partly.mean() < 0.3
    assert (cover - truth)[valid].mean() == pytest.approx(0, abs=1e-3)
    assert np.sqrt(np.mean((cover - truth)[partly] ** 2)) < edge_rms


def test_a_moving_camera_sees_the_mean_over_the_exposure() -> None:
    """The image of a still landscape turns by 5 px: a few looks, each at another moment, against 64 moments."""
    _, scene, sensor = frame_scene(PINHOLE, {"azimuth_deg": 20, "altitude_deg": 25}, motion={"rate_deg_s": [2, 3, -4]})
    integrator = scene.integrator()
    assert 3 < integrator.coverage_moments < 12
    few, cover = (np.array(part, dtype=np.float64) for part in integrator.diffuse_and_cover(scene, sensor))
    integrator.coverage_moments = 64
    many, true_cover = (np.array(part, dtype=np.float64) for part in integrator.diffuse_and_cover(scene, sensor))
    assert (cover - true_cover).mean() == pytest.approx(0, abs=5e-4)
    assert (cover - true_cover).std() < 0.02
    assert few.sum() == pytest.approx(many.sum(), rel=1e-3)
    assert np.std(few - many) < 0.02 * np.percentile(many, 95)


def test_pixels_far_from_the_landscape_are_left_out_without_loss() -> None:
    """Looked at everywhere, no pixel differs; more than a fifth of the sphere is left out."""
    import drjit

    _, scene, sensor = frame_scene(PINHOLE, {"azimuth_deg": 20, "altitude_deg": 45}, motion={"rate_deg_s": [2, 3, -4]})
    integrator = scene.integrator()
    some = [np.array(part) for part in integrator.diffuse_and_cover(scene, sensor)]
    near = np.array(integrator.landscape.around(sensor.swept_rad + sensor.pixel_rad)).reshape(CELLS)
    assert near.mean() < 0.8
    integrator.landscape.around = lambda reach_rad: drjit.full(
        type(integrator.landscape.values), 1, CELLS[0] * CELLS[1]
    )
    everywhere = [np.array(part) for part in integrator.diffuse_and_cover(scene, sensor)]
    for part, whole in zip(some, everywhere, strict=True):
        np.testing.assert_allclose(part, whole, rtol=1e-5, atol=1e-6)


def test_cells_near_those_with_a_landscape_are_all_found() -> None:
    """Against angles between random directions, towards the zenith and over north too: of 100,000 none is missed."""
    rng = np.random.default_rng(4)
    cells = rng.random(CELLS) < 3e-4
    cells[1, 30] = True
    reach = 3.0
    grown = grown_cells(cells, reach)
    assert grown.mean() < 0.5
    points = rng.standard_normal((100_000, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    rows, columns = np.nonzero(cells)
    inside = []
    for down in (0.05, 0.5, 0.95):
        for right in (0.05, 0.5, 0.95):
            altitude, azimuth = np.radians(90 - (rows + down) * CELL_DEG), np.radians((columns + right) * CELL_DEG)
            inside.append(
                np.stack([np.sin(azimuth) * np.cos(altitude), np.cos(azimuth) * np.cos(altitude), np.sin(altitude)], 1)
            )
    close = (points @ np.concatenate(inside).T).max(axis=1) > np.cos(np.radians(reach))
    row = np.clip((90 - np.degrees(np.arcsin(points[:, 2]))) / CELL_DEG, 0, CELLS[0] - 1).astype(int)
    column = (np.degrees(np.arctan2(points[:, 0], points[:, 1])) % 360 / CELL_DEG).astype(int) % CELLS[1]
    assert close.sum() > 1000
    assert grown[row, column][close].all()


def layers_of(rng, rows=40, columns=80, distance=True) -> Layers:
    alpha = (rng.random((rows, columns)) * (rng.random((rows, columns)) < 0.5)).astype(np.float32)
    reflectance = rng.random((rows, columns, 3)).astype(np.float32) * alpha[..., None]
    away = rng.uniform(2, 50_000, (rows, columns)).astype(np.float32) if distance else None
    return Layers(alpha, reflectance, None, away, 40.0, -20.0)


def test_light_by_surfaces_is_that_of_each_texel_on_its_own() -> None:
    """Every texel by the equations, one by one: walls between azimuths, ground, Koschmieder's air; 1e-5 of the light."""
    from generator.ground.lighting import WALLS
    from generator.ground.reflectance import primaries

    rng = np.random.default_rng(6)
    layers = layers_of(rng)
    lit, response = rng.random((WALLS + 1, len(GRID_NM))), rng.random((3, len(GRID_NM)))
    light = SkyLight(
        rng.random((2, len(sky_directions()[0]))), rng.random((2, len(GRID_NM))), np.array([0, 0, 1.0]), np.zeros(1)
    )
    maps, terms = surface_maps(layers, 0.05), surface_terms(lit, light, response)
    assert set(np.unique(layers.level)) == {False, True}
    for row, column in rng.integers(0, (40, 80), (60, 2)):
        azimuth = (column + 0.5) * 360 / 80
        share = azimuth / 360 * WALLS
        upright = (1 - share % 1) * lit[int(share)] + share % 1 * lit[(int(share) + 1) % WALLS]
        reflected = (lit[-1] if layers.level[row, column] else upright) / np.pi
        colour = layers.reflectance[row, column].astype(float) @ primaries()
        lowest = light.maps.reshape(2, -1, 2 * ROWS)[:, -1]
        sky = np.array([np.interp(azimuth, 1.25 + 2.5 * np.arange(2 * ROWS), each, period=360) for each in lowest])
        passed = np.exp(-0.05e-3 * layers.distance_m[row, column])
        radiance = passed * reflected * colour + (1 - passed) * layers.alpha[row, column] * (sky @ light.spectra)
        place = azimuth / 360 * AZIMUTHS
        term = (1 - place % 1) * terms[:, int(place)] + place % 1 * terms[:, (int(place) + 1) % AZIMUTHS]
        assert term @ maps[1:, row, column] == pytest.approx(response @ radiance, rel=1e-5)
        assert maps[0, row, column] == layers.alpha[row, column]


def test_covered_cells_are_those_of_the_texels() -> None:
    layers = layers_of(np.random.default_rng(2), 60, 360)
    alpha = np.zeros((60, 360), np.float32)
    alpha[12, 355] = 0.1
    cells = covered_cells(alpha, layers)
    assert np.argwhere(cells).tolist() == [[62, 355]]
