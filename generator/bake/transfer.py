"""Monte Carlo radiative transfer with Mitsuba's ``volpath``. Runs in a process of its own: see :mod:`generator.bake.worker`.

Lengths are kilometres (float32 needs it). The observer stands 2 m above the ground at the origin.
"""

from __future__ import annotations

import math
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from generator.atmosphere import aerosol_optical_depth, rayleigh_optical_depth
from generator.bake.directions import view_directions
from generator.bake.grids import BakedAir, CityGrid, MoonGrid

Floats = NDArray[np.float64]
LAYERS = 512
OBSERVER_KM = 0.002
MAX_DEPTH = 24
GARSTANG_NORMALISATION = 0.554


class LampDisk(mi.Emitter):
    """A disk of lamps on the ground, of unit photon output above the horizon, in two patterns at once.

    Red is Lambert, cos(psi)/pi; green is Garstang's light near the horizon, 0.554 psi^4/(2 pi); blue is nothing.
    Source: Garstang 1986, PASP 98, 364, eq. 1. A point of the disk is drawn for every shadow ray, so that the disk behaves
    like a point light whose place is blurred.
    """

    def __init__(self, props: Any) -> None:
        super().__init__(props)
        self.m_flags = int(mi.EmitterFlags.DeltaPosition)
        self.distance = mi.Float(float(props["distance"]))
        self.radius = float(props["radius"])

    def sample_direction(self, it: Any, sample: Any, active: Any = True) -> tuple[Any, Any]:
        """Mitsuba's interface."""
        spot = mi.warp.square_to_uniform_disk_concentric(sample) * self.radius
        ds = dr.zeros(mi.DirectionSample3f, dr.width(sample))
        ds.p = mi.Point3f(spot.x, spot.y + self.distance, 0.0005)
        ds.n = mi.Normal3f(0, 0, 1)
        ds.d = ds.p - it.p
        ds.dist = dr.norm(ds.d)
        ds.d = ds.d / ds.dist
        ds.pdf = mi.Float(1)  # type: ignore[assignment]
        ds.delta = mi.Bool(True)  # type: ignore[assignment]
        ds.time = it.time
        ds.emitter = mi.EmitterPtr(self)
        cosine = dr.maximum(-ds.d.z, 0)
        angle = dr.safe_acos(cosine)
        inverse_square = dr.select(active & (cosine > 0), dr.rcp(dr.square(ds.dist)), 0)
        lambert = cosine / math.pi
        horizon = GARSTANG_NORMALISATION * dr.square(dr.square(angle)) / (2 * math.pi)
        return ds, mi.Color3f(lambert, horizon, 0) * inverse_square

    def eval(self, si: Any, active: Any = True) -> Any:
        """Mitsuba's interface: a point light is never hit."""
        del si, active
        return mi.Spectrum(0)

    def pdf_direction(self, it: Any, ds: Any, active: Any = True) -> Any:
        """Mitsuba's interface."""
        del it, ds, active
        return mi.Float(0)

    def eval_direction(self, it: Any, ds: Any, active: Any = True) -> Any:
        """Mitsuba's interface."""
        del it, ds, active
        return mi.Spectrum(0)

    def traverse(self, callback: Any) -> None:
        """Mitsuba's interface: the distance may be changed."""
        callback.put("distance", self.distance, mi.ParamFlags.NonDifferentiable)

    def to_string(self) -> str:
        """Return a short description."""
        return "LampDisk"


def air_scene(air: BakedAir, wavelength_nm: float, aerosol_tau_550: float, light: dict[str, Any]) -> dict[str, Any]:
    """Scene of air over ground, lit by `light`. Ozone, which scatters nothing, is left to the maps' users."""
    height = (np.arange(LAYERS) + 0.5) * air.top_km / LAYERS

    def profile(optical_depth: float, scale_km: float) -> Floats:
        shape = np.exp(-height / scale_km)
        return optical_depth * shape / (shape.sum() * air.top_km / LAYERS)

    rayleigh = profile(float(rayleigh_optical_depth(wavelength_nm, air.pressure_hpa)), air.rayleigh_height_km)
    tau_a = float(aerosol_optical_depth(wavelength_nm, aerosol_tau_550, air.angstrom_exponent))
    aerosol = profile(tau_a, air.aerosol_height_km)
    scattered_by_aerosol = air.aerosol_albedo * aerosol
    scattered = rayleigh + scattered_by_aerosol
    width = air.half_width_km
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
                    "second": {"type": "hg", "g": air.aerosol_asymmetry},
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


def _trace(scene: Any, start: Any, direction: Any, count: int, seed: int) -> Any:
    """Radiance (channels, count) that arrives at `start` from `direction`, one path each."""
    integrator = mi.load_dict({"type": "volpath", "max_depth": MAX_DEPTH, "rr_depth": 8})
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
        Where the observer looks.
    paths : int
        Per direction.
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
    """Radiance towards the observer without the light that was scattered only once, and its standard error.

    The last scattering before the observer is drawn here: its place in proportion to the light it passes on, the direction
    from which the light comes by the phase function. Mitsuba traces the rest, so that every path counts, and light straight
    from the lamps is left out.

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
    g = air.aerosol_asymmetry
    cosine_a = (1 + g * g - ((1 - g * g) / (1 - g + 2 * g * xi)) ** 2) / (2 * g)
    root = np.cbrt(2 * (2 * xi - 1) + np.sqrt(4 * (2 * xi - 1) ** 2 + 1))
    cosine = np.clip(np.where(by_aerosol, cosine_a, root - 1 / root), -1, 1)
    turn = 2 * np.pi * random.random(h.shape)
    # Backwards along the line of sight: a photon that goes on towards the observer came from about `directions`.
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
        scene, mi.Point3f(start.T.astype(np.float32)), mi.Vector3f(came.T.astype(np.float32)), h.size, seed
    )
    samples = samples.reshape(-1, *h.shape) * passed_on
    return samples.mean(axis=-1).T, samples.std(axis=-1, ddof=1).T / math.sqrt(paths)


def bake_moon(air: BakedAir, grid: MoonGrid) -> tuple[Floats, Floats]:
    """Scattered moonlight per unit irradiance above the air, sr^-1.

    Returns
    -------
    mean, error : (aerosol, wavelength, moon altitude, view altitude, azimuth) arrays
    """
    views = view_directions(grid.view_altitude_deg, grid.relative_azimuth_deg)
    shape: tuple[int, ...] = (len(grid.aerosol_tau_550), len(grid.wavelength_nm), len(grid.moon_altitude_deg))
    shape += (len(grid.view_altitude_deg), len(grid.relative_azimuth_deg))
    mean, error = np.zeros(shape), np.zeros(shape)
    for index in np.ndindex(shape[:3]):
        altitude = math.radians(min(grid.moon_altitude_deg[index[2]], 89.9))
        light = {
            "type": "directional",
            "direction": [0, -math.cos(altitude), -math.sin(altitude)],
            "irradiance": {"type": "uniform", "value": 1.0},
        }
        scene = mi.load_dict(air_scene(air, grid.wavelength_nm[index[1]], grid.aerosol_tau_550[index[0]], light))
        seed = grid.seed * 100_003 + int(np.ravel_multi_index(index, shape[:3]))
        cell = radiance(scene, views, grid.paths, seed)
        mean[index], error[index] = (part[:, 0].reshape(shape[3:]) for part in cell)
        if index[2] == 0:
            print(f"moon {index[:2]}", flush=True)
    return mean, error


def bake_city(air: BakedAir, grid: CityGrid) -> tuple[Floats, Floats]:
    """Radiance per photon output above the horizon of a small disk of lamps, km^-2 sr^-1, without single scattering.

    Returns
    -------
    mean, error : (pattern, wavelength, distance, view altitude, azimuth) arrays
        Patterns: Lambert, near the horizon.
    """
    views = view_directions(grid.view_altitude_deg, grid.relative_azimuth_deg)
    shape: tuple[int, ...] = (2, len(grid.wavelength_nm), len(grid.distance_km), len(grid.view_altitude_deg))
    shape += (len(grid.relative_azimuth_deg),)
    mean, error = np.zeros(shape), np.zeros(shape)
    for w, wavelength in enumerate(grid.wavelength_nm):
        for d, distance in enumerate(grid.distance_km):
            light = {"type": "lamp_disk", "distance": float(distance), "radius": grid.disk_radius_km}
            scene = mi.load_dict(air_scene(air, wavelength, grid.aerosol_tau_550, light))
            seed = grid.seed * 100_003 + w * len(grid.distance_km) + d
            cell = multiply_scattered(scene, air, wavelength, grid.aerosol_tau_550, views, grid.paths, seed)
            for store, values in zip((mean, error), cell, strict=True):
                store[:, w, d] = values[:, :2].T.reshape(2, *shape[3:])
        print(f"city {wavelength:.0f} nm", flush=True)
    return mean, error


def furnace(paths: int = 20_000, wavelength_nm: float = 400.0) -> tuple[Floats, Floats]:
    """Radiance seen in 8 directions in a white furnace: nothing absorbs, and light of radiance 1 comes from everywhere."""
    air = BakedAir(aerosol_albedo=1.0, ground_albedo=1.0)
    light = {"type": "constant", "radiance": {"type": "uniform", "value": 1.0}}
    scene = mi.load_dict(air_scene(air, wavelength_nm, 0.2, light))
    mean, error = radiance(scene, view_directions([5, 20, 45, 90], [0, 100]), paths, 3)
    return mean[:, 0], error[:, 0]
