"""Moonlight in cloud: phase functions, transfer through a layer, the light that arrives; published numbers and walks."""

import dataclasses

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from small_scenes import small_scenario

from generator import plugins
from generator.frame.plan import plan_frame
from generator.frame.scene import frame_layers
from generator.light.cloud_phase import ICE_ASYMMETRY, aureole, ray_phase
from generator.light.photometry import GRID_NM
from generator.scenario.sky.cloud_spec import CloudSpec
from generator.sky.assembly import whole_sky
from generator.sky.cloud_layer import LayerTransfer, cloud_transfer, layer_transfer, scattered_once
from generator.sky.directions import unit_vectors
from generator.sky.moonlit_cloud import DIFFRACTED, MoonVeil, layer_cosine, moon_veil
from generator.sky.state import ThroughClouds, UnderClouds, drifted_clouds

NO_AIR = {"atmosphere": {"extinction": False}}
MOON_COSINE = 0.7
LOOKS = np.array([(0.95, 0.3), (0.7, np.pi / 2), (0.7, np.pi), (0.4, 0.0), (0.4, np.pi / 2), (0.4, np.pi)])
"""Cosine of the zenith angle, and azimuth from the Moon's."""


def cloud(kind: str = "cirrus", depth: float = 0.8, coverage: float = 1.0):
    spec = CloudSpec.model_validate({"kind": kind, "optical_depth": depth, "coverage": coverage})
    return drifted_clouds(spec, UnderClouds(0.5), 3, ThroughClouds(60.0, 0.002))


def over_the_sphere(values: np.ndarray, angle: np.ndarray) -> float:
    return float(np.trapezoid(2 * np.pi * values * np.sin(angle), angle))


def test_droplets_scatter_as_far_forward_as_large_spheres_do() -> None:
    """With diffraction straight on, rays make the mean cosine 0.884 of spheres without end (Kokhanovsky & Zege 1995, Appl.
    Opt. 34, 5513)."""
    angle = np.linspace(0, np.pi, 20_001)
    phase = ray_phase(angle, ice=False)
    whole = over_the_sphere(phase, angle)
    assert whole == pytest.approx(1, abs=2e-3)
    rays = over_the_sphere(phase * np.cos(angle), angle) / whole
    assert (1 + rays) / 2 == pytest.approx(0.884, abs=2e-3)


def test_droplets_have_a_cloudbow_and_crystals_none() -> None:
    """Rainbow rays of water turn by 138 deg (Descartes)."""
    angle = np.radians(np.arange(100, 175, 1.0))
    water, ice = ray_phase(angle, ice=False), ray_phase(angle, ice=True)
    assert np.degrees(angle[np.argmax(water)]) == pytest.approx(139, abs=2)
    assert (np.diff(ice) < 0).all()


def test_crystals_have_the_measured_asymmetry() -> None:
    angle = np.linspace(0, np.pi, 20_001)
    phase = ray_phase(angle, ice=True)
    assert over_the_sphere(phase, angle) == pytest.approx(1, abs=1e-6)
    assert (1 + over_the_sphere(phase * np.cos(angle), angle)) / 2 == pytest.approx(ICE_ASYMMETRY, abs=1e-5)


def test_aureole_is_all_that_is_diffracted() -> None:
    """Nearly all lies within 11 deg; its core is as wide as wavelength over diameter and the Moon."""
    angle = np.linspace(0, 0.2, 8001)
    for particle_um in (20.0, 60.0):
        light = aureole(angle, particle_um)
        assert 0.95 < over_the_sphere(light, angle) <= 1.001
        half = angle[np.argmax(light < light[0] / 2)]
        # The first dark ring of a disk lies at 1.22 wavelength / diameter, half the light of its middle at 0.51.
        assert 0.45 * 0.55 / particle_um < half < 0.51 * 0.55 / particle_um + np.radians(0.26)


def test_a_layer_passes_diffuse_light_as_published() -> None:
    """Isotropic scattering without loss: 0.9157, 0.7040, 0.5532, 0.3900 of even light pass depths of 0.1, 0.5, 1 and 2
    (Heaslet & Warming 1965, Int. J. Heat Mass Transfer 8, 979)."""
    layer = layer_transfer(lambda angle: np.full_like(angle, 1 / (4 * np.pi)))
    _, weights = np.polynomial.legendre.leggauss(len(layer.cosines))
    sent_back = (layer.albedo * layer.cosines * weights).sum(axis=1)
    passed = 1 - CubicSpline(np.log(layer.depths), sent_back)(np.log([0.1, 0.5, 1.0, 2.0]))
    np.testing.assert_allclose(passed, [0.9157, 0.7040, 0.5532, 0.3900], atol=3e-4)


def walks(ice: bool, depth: float, photons: int, seed: int) -> tuple[np.ndarray, float]:
    """Radiance below a layer over irradiance in LOOKS, and the part of the light that passes, by random walks."""
    random = np.random.default_rng(seed)
    angle = np.linspace(0, np.pi, 4001)
    density = ray_phase(angle, ice) * np.sin(angle)
    below = np.concatenate([[0], np.cumsum((density[1:] + density[:-1]) / 2)])
    way = np.tile([np.sqrt(1 - MOON_COSINE**2), 0, -MOON_COSINE], (photons, 1))
    place = np.zeros(photons)
    sines = np.sqrt(1 - LOOKS[:, 0] ** 2)
    looks = np.column_stack((-sines * np.cos(LOOKS[:, 1]), sines * np.sin(LOOKS[:, 1]), LOOKS[:, 0]))
    light, passed = np.zeros(len(looks)), 0
    while len(place):
        place = place - random.exponential(size=len(place)) * way[:, 2]
        passed += int((place >= depth).sum())
        inside = (place >= 0) & (place < depth)
        place, way = place[inside], way[inside]
        seen = ray_phase(np.arccos(np.clip(-way @ looks.T, -1, 1)), ice)
        light += (seen * np.exp(-(depth - place)[:, None] / looks[:, 2]) / looks[:, 2]).sum(axis=0)
        turned = np.interp(random.random(len(place)), below / below[-1], angle)[:, None]
        around = random.random(len(place))[:, None] * 2 * np.pi
        across = np.cross(way, np.where(np.abs(way[:, 2:]) < 0.9, [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]))
        across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-12)
        way = way * np.cos(turned) + np.sin(turned) * (across * np.cos(around) + np.cross(way, across) * np.sin(around))
    return light * MOON_COSINE / photons, passed / photons


@pytest.mark.parametrize("ice", [True, False])
@pytest.mark.parametrize("depth", [0.25, 1.0, 4.0])
def test_layers_shine_as_random_walks_do(ice, depth) -> None:
    """In six directions, light scattered once and more often, and what passes: within five standard errors of the means of
    twenty walks (at most 9 %), a false alarm of 3e-3 for all 42 comparisons."""
    layer: LayerTransfer = cloud_transfer(ice)
    each = [walks(ice, depth, 2000, seed) for seed in range(20)]
    walked, passed = (np.mean(part, axis=0) for part in zip(*each, strict=True))
    error, passed_error = (np.std(part, axis=0, ddof=1) / np.sqrt(20) for part in zip(*each, strict=True))
    sines = np.sqrt(1 - LOOKS[:, 0] ** 2) * np.sqrt(1 - MOON_COSINE**2)
    angle = np.arccos(LOOKS[:, 0] * MOON_COSINE + sines * np.cos(LOOKS[:, 1]))
    once = ray_phase(angle, ice) * scattered_once(depth / LOOKS[:, 0], depth / MOON_COSINE)
    more = [layer.radiance(MOON_COSINE, np.array([depth]), *look[:, None])[0, 0, 0] for look in LOOKS]
    assert (np.abs(once + more - walked) < 5 * error).all()
    assert (error < 0.09 * walked).all()
    albedo = CubicSpline(np.log(layer.depths), CubicSpline(layer.cosines, layer.albedo, axis=1)(MOON_COSINE))
    assert 1 - float(albedo(np.log(depth))) == pytest.approx(passed, abs=5 * passed_error)


def even_cloud(veil: MoonVeil, depth: float) -> MoonVeil:
    """The veil of a layer of one depth."""
    pattern = veil.clouds.pattern
    flat = dataclasses.replace(
        pattern, coarse=np.zeros_like(pattern.coarse), fine=np.zeros_like(pattern.fine), threshold=-1.0, scale=depth
    )
    return dataclasses.replace(veil, clouds=dataclasses.replace(veil.clouds, pattern=flat))


@pytest.mark.parametrize("kind", ["cirrus", "stratocumulus"])
@pytest.mark.parametrize("depth", [0.1, 1.0, 6.0])
def test_what_cloud_scatters_down_and_what_it_passes_is_what_it_does_not_send_back(kind, depth) -> None:
    """Over the hemisphere, aureole and the Moon's image included, the light on the ground is 1 less the layer's albedo."""
    moon = unit_vectors(45.0, 100.0)
    veil = even_cloud(moon_veil(cloud(kind), moon), depth)
    # Directions around the Moon, fine near it, and the weights of their solid angles.
    edges = np.concatenate([np.linspace(0, 0.04, 101), np.linspace(0.04, np.pi, 401)[1:]])
    angle, ring = (edges[1:] + edges[:-1]) / 2, -np.diff(np.cos(edges))
    turn = (np.arange(360) + 0.5) * 2 * np.pi / 360
    side = np.cross(moon, [0.0, 0.0, 1.0])
    side /= np.linalg.norm(side)
    around = np.cos(turn)[:, None] * side + np.sin(turn)[:, None] * np.cross(moon, side)
    enu = np.cos(angle)[:, None, None] * moon + np.sin(angle)[:, None, None] * around
    up = enu[..., 2] > 0
    weight = np.broadcast_to((ring * 2 * np.pi / 360)[:, None], up.shape)[up]
    enu = enu[up]
    slope = layer_cosine(enu, veil.clouds.altitude_km)
    # Of the layer above the site: the Earth's curvature moves the directions near the horizon up the layer.
    lowest = float(layer_cosine(np.array([1.0, 0.0, 0.0]), veil.clouds.altitude_km))
    flat = np.sqrt(np.clip((slope**2 - lowest**2) / (1 - lowest**2), 0, 1))
    scattered = float(np.sum(veil.at(enu) * flat * weight)) / veil.moon_cosine
    image = np.exp(-veil.clouds.point_share * depth / veil.moon_cosine)
    layer = cloud_transfer(veil.clouds.ice)
    by_cosine = CubicSpline(layer.cosines, layer.albedo, axis=1)(veil.moon_cosine)
    albedo = float(CubicSpline(np.log(layer.depths), by_cosine)(np.log(DIFFRACTED * depth)))
    assert scattered + image == pytest.approx(1 - albedo, abs=0.012)


def test_emitter_s_moonlit_cloud_is_the_table_s() -> None:
    """Ray by ray on the device, in all directions and within a degree of the Moon: 1 % of the brightest of each."""
    plugins.start()
    import mitsuba as mi

    from generator.plugins.clouds import CloudTexture, MoonTexture, cloud_numbers, moon_numbers

    random = np.random.default_rng(1)
    moon = unit_vectors(40.0, 120.0)
    far = unit_vectors(random.uniform(10, 90, 5000), random.uniform(0, 360, 5000))
    near = moon + random.normal(size=(500, 3)) * 0.01
    near /= np.linalg.norm(near, axis=1, keepdims=True)
    for kind in ("cirrus", "altocumulus"):
        veil = moon_veil(cloud(kind, coverage=0.7), moon)
        tensors = (
            veil.clouds.pattern.coarse, veil.clouds.pattern.fine, cloud_numbers(veil.clouds), moon_numbers(veil),
            np.stack((veil.phase, veil.halo)), veil.more,
        )  # fmt: skip
        coarse, fine, numbers, *rest = (mi.TensorXf(np.asarray(each, np.float32)) for each in tensors)
        clouds, texture = CloudTexture(coarse, fine, numbers), MoonTexture(*rest)
        for enu in (far[far @ moon < 0.99], near):
            rays = mi.Vector3f(*enu.T.astype(np.float32))
            ours, wanted = np.array(texture.radiance(clouds, clouds.slant_depths(rays), rays)), veil.at(enu)
            assert np.abs(ours - wanted).max() < 0.01 * wanted.max()


def moonlit(clouds: dict | None, altitude: np.ndarray, azimuth: np.ndarray) -> np.ndarray:
    """Radiance at 550 nm of a sky of moonlight alone over a black ground, without air, Moon high in the south-west."""
    sky = {"components": ["moonlight"], "clouds": clouds, "ground_albedo": 0.0}
    plan = plan_frame(small_scenario(time__utc_start="2020-01-09T02:30:00Z", sky=sky, **NO_AIR), 0)
    return whole_sky(frame_layers(plan)).radiance(altitude, azimuth)[:, int(np.argmin(np.abs(GRID_NM - 550)))]


def test_thin_cirrus_shines_by_the_angle_to_the_moon() -> None:
    """Without air and ground a frame's thin cirrus adds (g = 0.5) half its depth along the line of sight times Henyey and
    Greenstein's function times the Moon's light, written out here; more by what is scattered twice (under 6 %)."""
    clouds = {"altitude_km": 9.0, "coverage": 1.0, "mean_optical_depth": 0.02}
    plan = plan_frame(small_scenario(time__utc_start="2020-01-09T02:30:00Z", sky__clouds=clouds, **NO_AIR), 0)
    state = plan.sky
    assert state.moon_altitude_deg > 30
    altitude, azimuth = np.repeat([25.0, 50.0, 75.0], 4), np.tile([10.0, 100.0, 190.0, 280.0], 3)
    added = moonlit(clouds, altitude, azimuth) - moonlit(None, altitude, azimuth)
    enu = unit_vectors(altitude, azimuth)
    cosine = enu @ state.moon_enu
    phase = (1 - 0.5**2) / (4 * np.pi * (1 + 0.5**2 - cosine) ** 1.5)
    moon = state.moon_spectrum[int(np.argmin(np.abs(GRID_NM - 550)))]
    depths = np.mean([still.slant_depth(enu) for still in state.clouds.moments], axis=0)
    assert depths.min() > 0
    ratio = added / (0.5 * depths * phase * moon)
    assert (ratio > 0.98).all()
    assert (ratio < 1.06).all()
