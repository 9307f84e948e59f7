"""The bake's radiative transfer by Mitsuba's ``volpath``: an independent check of the random walks.

It runs in a separate process: see :mod:`generator.bake.worker`. Lengths are in kilometres, for the sake of single
precision. The observer is 2 m above the ground at the origin.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from generator.bake.walk import phase_table
from generator.light.atmosphere import aerosol_optical_depth, rayleigh_optical_depth
from generator.light.bake_grids import DEFAULT_ALBEDO, BakedAir, CityGrid
from generator.light.single_scattering import aerosol_phase
from generator.light.view_directions import view_directions

Floats = NDArray[np.float64]
LAYERS = 512
HALF_WIDTH_KM = 2000.0
"""Half width of the layer; 4,000 km across approximate an infinite plane."""
OBSERVER_KM = 0.002
MAX_DEPTH = 24
PHASE_NODES = 40_001


def air_scene(air: BakedAir, wavelength_nm: float, aerosol_tau_550: float, light: dict[str, Any]) -> dict[str, Any]:
    """Scene of air over ground, lit by `light`. Ozone only absorbs; it is applied when the maps are used."""
    height = (np.arange(LAYERS) + 0.5) * air.top_km / LAYERS

    def profile(optical_depth: float, scale_km: float) -> Floats:
        shape = np.exp(-height / scale_km)
        return optical_depth * shape / (shape.sum() * air.top_km / LAYERS)

    rayleigh = profile(float(rayleigh_optical_depth(wavelength_nm, air.pressure_hpa)), air.rayleigh_height_km)
    tau_a = float(aerosol_optical_depth(wavelength_nm, aerosol_tau_550, air.angstrom_exponent))
    aerosol = profile(tau_a, air.aerosol_height_km)
    scattered_by_aerosol = air.aerosol_albedo * aerosol
    scattered = rayleigh + scattered_by_aerosol
    width = HALF_WIDTH_KM
    phase = aerosol_phase(np.linspace(-1, 1, PHASE_NODES))
    to_world = mi.ScalarTransform4f().translate([-width, -width, 0]).scale([2 * width, 2 * width, air.top_km])

    def volume(values: Floats) -> dict[str, Any]:
        data = np.tile(values.astype(np.float32)[:, None, None, None], (1, 2, 2, 1))
        return {"type": "gridvolume", "grid": mi.VolumeGrid(data), "to_world": to_world, "raw": True, "accel": False}

    box = mi.ScalarTransform4f().translate([0, 0, air.top_km / 2 - 0.5]).scale([width, width, air.top_km / 2 + 0.5])
    return {
        "type": "scene",
        "box": {
            "type": "cube",
            "to_world": box,
            "bsdf": {"type": "null"},
            "interior": {
                "type": "heterogeneous",
                "albedo": volume(scattered / (rayleigh + aerosol)),
                "sigma_t": volume(rayleigh + aerosol),
                "phase": {
                    "type": "blendphase",
                    "weight": volume(scattered_by_aerosol / scattered),
                    "first": {"type": "rayleigh"},
                    "second": {"type": "tabphase", "values": ", ".join(f"{value:.6g}" for value in phase)},
                },
            },
        },
        "ground": {
            "type": "rectangle",
            "to_world": mi.ScalarTransform4f().scale([0.99 * width, 0.99 * width, 1]),
            "bsdf": {"type": "diffuse", "reflectance": {"type": "uniform", "value": air.ground_albedo}},
        },
        "light": light,
    }


def _trace(scene: Any, start: Any, direction: Any, count: int, seed: int, hide: bool = False) -> Any:
    """Radiance (channels, count) at `start` from `direction`, one path each; `hide` excludes light straight from lamps."""
    integrator = mi.load_dict({"type": "volpath", "max_depth": MAX_DEPTH, "rr_depth": 8, "hide_emitters": hide})
    medium = next(shape.interior_medium() for shape in scene.shapes() if shape.interior_medium() is not None)
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, count)
    value, _, _ = integrator.sample(scene, sampler, mi.RayDifferential3f(mi.Ray3f(start, direction)), medium)
    return np.array(value, dtype=np.float64).reshape(-1, count)


def radiance(scene: Any, directions: Floats, paths: int, seed: int) -> tuple[Floats, Floats]:
    """Mean radiance towards the observer and its standard error.

    Parameters
    ----------
    scene : mi.Scene
    directions : (m, 3) array
        Directions in which the observer looks.
    paths : int
        Number of paths per direction.
    seed : int

    Returns
    -------
    mean, error : (m, channels) arrays
    """
    count = len(directions) * paths
    owner = dr.arange(mi.UInt32, count) // paths
    table = [mi.Float(directions[:, axis].astype(np.float32)) for axis in range(3)]
    direction = mi.Vector3f(*(dr.gather(mi.Float, axis, owner) for axis in table))
    samples = _trace(scene, mi.Point3f(0, 0, OBSERVER_KM), direction, count, seed)
    samples = samples.reshape(-1, len(directions), paths)
    return samples.mean(axis=-1).T, samples.std(axis=-1, ddof=1).T / math.sqrt(paths)


def multiply_scattered(
    scene: Any, air: BakedAir, wavelength_nm: float, aerosol_tau_550: float, directions: Floats, paths: int, seed: int
) -> tuple[Floats, Floats]:
    """Radiance of light scattered more than once, towards the observer, and its standard error.

    The last scattering before the observer is drawn here: its place in proportion to the transmitted light, and the
    direction from which the light comes from the phase function. Mitsuba traces the rest of each path, so that every path
    contributes; light straight from the lamps is left out.

    Returns
    -------
    mean, error : (m, channels) arrays
    """
    random = np.random.default_rng(seed)
    rayleigh = float(rayleigh_optical_depth(wavelength_nm, air.pressure_hpa))
    aerosol = float(aerosol_optical_depth(wavelength_nm, aerosol_tau_550, air.angstrom_exponent))
    height = np.concatenate([[0], np.geomspace(1e-4, air.top_km * 0.999, 2000)])
    depth = rayleigh * -np.expm1(-height / air.rayleigh_height_km)
    depth += aerosol * -np.expm1(-height / air.aerosol_height_km)
    rise = directions[:, 2:]
    scattered = -np.expm1(-depth[-1] / rise)
    uniform = (np.arange(paths) + random.random((len(directions), paths))) / paths
    h = np.interp(-np.log1p(-uniform * scattered) * rise, depth, height)
    per_km_r = rayleigh / air.rayleigh_height_km * np.exp(-h / air.rayleigh_height_km)
    per_km_a = aerosol / air.aerosol_height_km * np.exp(-h / air.aerosol_height_km)
    passed_on = (per_km_r + air.aerosol_albedo * per_km_a) / (per_km_r + per_km_a) * scattered
    by_aerosol = random.random(h.shape) * (per_km_r + air.aerosol_albedo * per_km_a) > per_km_r
    xi = random.random(h.shape)
    cosines, cumulative = phase_table()
    cosine_a = np.interp(xi, cumulative, cosines)
    root = np.cbrt(2 * (2 * xi - 1) + np.sqrt(4 * (2 * xi - 1) ** 2 + 1))
    cosine = np.clip(np.where(by_aerosol, cosine_a, root - 1 / root), -1, 1)
    turn = 2 * np.pi * random.random(h.shape)
    # Backwards along the line of sight: a photon that continues towards the observer came from about `directions`.
    first = np.cross(directions, np.where(np.abs(rise) < 0.9, [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]))
    first /= np.linalg.norm(first, axis=-1, keepdims=True)
    second = np.cross(directions, first)
    sine = np.sqrt(1 - cosine**2)
    came = (
        cosine[..., None] * directions[:, None]
        + (sine * np.cos(turn))[..., None] * first[:, None]
        + (sine * np.sin(turn))[..., None] * second[:, None]
    ).reshape(-1, 3)
    start = (directions[:, None] * (h / rise)[..., None]).reshape(-1, 3)
    samples = _trace(
        scene, mi.Point3f(start.T.astype(np.float32)), mi.Vector3f(came.T.astype(np.float32)), h.size, seed, hide=True
    )
    samples = samples.reshape(-1, *h.shape) * passed_on
    return samples.mean(axis=-1).T, samples.std(axis=-1, ddof=1).T / math.sqrt(paths)


VIEWS_DEG = ((8.0, 36.0, 90.0), (0.0, 75.0, 180.0))
"""Altitudes and azimuths at which the walks are compared."""
JUDGED_NM, JUDGED_TAU = 430.0, 0.3
SNOW_ALBEDO = 0.8
DISK_RINGS = 22
"""Rings of lamps of CityGrid, out to 29.5 km."""


BESIDE_KM = (8.0, 10.0)
"""Distance and radius of a city that contains the observer off its centre, km."""


def disk_of_lamps(paths: int = 200_000) -> tuple[Floats, Floats]:
    """Multiply scattered light of a disk of Lambert lamps around the observer, at the altitudes of VIEWS_DEG.

    The disk's edge is the edge of a ring of CityGrid.

    Returns
    -------
    mean, error : (3,) arrays
        Radiance per photon output of the disk, km^-2 sr^-1.
    """
    return _lamps_scattered_on(0.0, float(CityGrid().edges[0][DISK_RINGS]), VIEWS_DEG[1][:1], paths)


def disk_beside(paths: int = 100_000) -> tuple[Floats, Floats]:
    """Light of the disk of BESIDE_KM, in all directions of VIEWS_DEG, with azimuths relative to its centre: (9,) arrays."""
    return _lamps_scattered_on(*BESIDE_KM, VIEWS_DEG[1], paths)


def disk_on_snow(paths: int = 200_000) -> tuple[Floats, Floats]:
    """The light of :func:`disk_of_lamps` for ground of SNOW_ALBEDO: (3,) arrays."""
    return _lamps_scattered_on(0.0, float(CityGrid().edges[0][DISK_RINGS]), VIEWS_DEG[1][:1], paths, SNOW_ALBEDO)


def _lamps_scattered_on(
    distance_km: float,
    radius_km: float,
    azimuths_deg: tuple[float, ...],
    paths: int,
    ground_albedo: float = DEFAULT_ALBEDO,
) -> tuple[Floats, Floats]:
    air = dataclasses.replace(BakedAir(), ground_albedo=ground_albedo)
    light = {
        "type": "disk",
        "to_world": mi.ScalarTransform4f().translate([0, distance_km, 1e-4]).scale(radius_km),
        "bsdf": {"type": "diffuse", "reflectance": {"type": "uniform", "value": air.ground_albedo}},
        "emitter": {"type": "area", "radiance": {"type": "uniform", "value": 1 / (math.pi * radius_km) ** 2}},
    }
    scene = mi.load_dict(air_scene(air, JUDGED_NM, JUDGED_TAU, light))
    views = view_directions(VIEWS_DEG[0], azimuths_deg)
    mean, error = multiply_scattered(scene, air, JUDGED_NM, JUDGED_TAU, views, paths, 5)
    return mean[:, 0], error[:, 0]


def moonlit_snow() -> tuple[Floats, Floats]:
    """The light of :func:`moonlit` for ground of SNOW_ALBEDO: (9,) arrays."""
    return moonlit(ground_albedo=SNOW_ALBEDO)


def moonlit(
    moon_altitude_deg: float = 30.0, paths: int = 80_000, ground_albedo: float = DEFAULT_ALBEDO
) -> tuple[Floats, Floats]:
    """All scattered moonlight per unit irradiance above the air, sr^-1, at VIEWS_DEG: mean, error, (9,) arrays."""
    altitude = math.radians(moon_altitude_deg)
    light = {
        "type": "directional",
        "direction": [0, -math.cos(altitude), -math.sin(altitude)],
        "irradiance": {"type": "uniform", "value": 1.0},
    }
    air = dataclasses.replace(BakedAir(), ground_albedo=ground_albedo)
    scene = mi.load_dict(air_scene(air, JUDGED_NM, JUDGED_TAU, light))
    mean, error = radiance(scene, view_directions(*VIEWS_DEG), paths, 3)
    return mean[:, 0], error[:, 0]


def furnace(paths: int = 30_000, wavelength_nm: float = 400.0) -> tuple[Floats, Floats]:
    """Radiance in 8 directions in a white furnace: no absorption, isotropic light of radiance 1; the exact result is 1."""
    air = BakedAir(aerosol_albedo=1.0, ground_albedo=1.0)
    light = {"type": "constant", "radiance": {"type": "uniform", "value": 1.0}}
    scene = mi.load_dict(air_scene(air, wavelength_nm, 0.2, light))
    mean, error = radiance(scene, view_directions([5, 20, 45, 90], [0, 100]), paths, 3)
    return mean[:, 0], error[:, 0]
