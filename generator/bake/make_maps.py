"""``skybench bake``: run the workers, fit their results, and store the maps."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from generator.bake.fit_twilight import fitted
from generator.bake.smoothing import chosen_terms, design, smooth, within_cells
from generator.errors import GeneratorError
from generator.files import atomic_path
from generator.light.atmosphere import aerosol_optical_depth, rayleigh_optical_depth
from generator.light.bake_grids import BakedAir, CityGrid, GroundGrid, MoonGrid, TwilightGrid, content_hash
from generator.light.baked_maps import CITY_FILE, FOLDER, GROUND_FILE, MOON_FILE
from generator.light.chebyshev import Axis, evaluated
from generator.light.emission import PATTERNS
from generator.light.single_scattering import moon_single, moon_single_in_layers
from generator.twilight.twilight_map import TWILIGHT_FILE

Floats = NDArray[np.float64]

TOTAL_DEGREE = 10


def run_worker(task: str, *index: int) -> tuple[Floats, Floats]:
    """Run a task of :mod:`generator.bake.worker` in a separate process; return its mean and relative error.

    Raises
    ------
    GeneratorError
        The worker failed; the message ends with the worker's.
    """
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / f"{task}.npz"
        command = [sys.executable, "-m", "generator.bake.worker", task, str(out), *map(str, index)]
        run = subprocess.run(command, capture_output=True, text=True, check=False)
        if run.returncode != 0:
            last = (run.stderr.strip().splitlines() or ["no message"])[-1]
            raise GeneratorError(f"baking '{task}' failed (exit status {run.returncode}): {last}")
        with np.load(out, allow_pickle=False) as stored:
            return stored["mean"], stored["error"]


def moon_singles(air: BakedAir, grid: MoonGrid) -> tuple[Floats, Floats]:
    """Single scattering of moonlight on the map's axes: by quadrature in two layers, and in closed form."""
    moon, azimuth = np.radians(grid.moon_altitude_deg)[:, None], np.radians(grid.relative_azimuth_deg)
    rayleigh = rayleigh_optical_depth(np.array(grid.wavelength_nm), air.pressure_hpa)
    layers, closed = [], []
    for tau in grid.aerosol_tau_550:
        aerosol = aerosol_optical_depth(np.array(grid.wavelength_nm), tau, air.angstrom_exponent)
        for r, a in zip(rayleigh, aerosol, strict=True):
            for altitude in grid.view_altitude_deg:
                view = np.radians(altitude)
                cosine = np.sin(moon) * np.sin(view) + np.cos(moon) * np.cos(view) * np.cos(azimuth)
                altitudes = np.array(grid.moon_altitude_deg)
                layers.append(moon_single_in_layers(air, float(r), float(a), altitudes, altitude, cosine))
                closed.append(moon_single(r, a, 1 / np.sin(moon), 1 / np.sin(view), cosine, air))
    shape = (len(grid.aerosol_tau_550), len(grid.wavelength_nm), len(grid.view_altitude_deg), *np.shape(layers[0]))
    return np.reshape(layers, shape), np.reshape(closed, shape)


def moon_values(mean: Floats, error: Floats) -> tuple[Floats, Floats]:
    """Ratio of all moonlight to closed-form single scattering, and its relative error, with the walks' axes."""
    layers, closed = moon_singles(BakedAir(), MoonGrid())
    return (layers + mean) / closed, error * mean / (layers + mean)


def city_values(mean: Floats, error: Floats) -> tuple[Floats, Floats, float]:
    """Multiply scattered city light, fitted, at the nodes of the map; its relative error; and the fits' worst scatter."""
    grid = CityGrid()
    rings, parts = grid.edges
    scale, root = grid.scale(rings), np.sqrt(parts / 180)
    axes = (
        Axis(np.log(grid.wavelength_nm[0]), np.log(grid.wavelength_nm[-1]), 4),
        Axis(np.log(grid.view_altitude_deg[0]), np.log(90.0), 8),
        Axis(0.0, float(scale[-1]), 9),
        Axis(0.0, 1.0, 8),
    )
    points = (np.log(grid.wavelength_nm), np.log(grid.view_altitude_deg))
    radius = grid.core_km * np.expm1(within_cells(scale)[0])
    # The area of a cell is proportional to the distance and, because of the scales, to the derivatives of distance and
    # azimuth.
    by_area = within_cells(scale)[1] * radius * (radius + grid.core_km), within_cells(root)[1] * within_cells(root)[0]
    cells = ((scale, by_area[0]), (root, by_area[1]))
    bases = [axis.basis(at) for axis, at in zip(axes, (*points, scale, root), strict=True)]
    terms = design(bases, chosen_terms(axes, TOTAL_DEGREE))
    shape = (*mean.shape[:4], len(scale), len(root))
    values, relative, scatters = np.empty(shape), np.empty(shape), []
    for index in np.ndindex(mean.shape[:2]):
        fit, spread, scatter = smooth(mean[index], error[index], axes, points, cells, TOTAL_DEGREE)
        values[index] = np.exp(evaluated(fit, bases))
        relative[index] = np.sqrt(np.sum((terms @ spread.T) ** 2, axis=1)).reshape(shape[2:])
        scatters.append(scatter)
    return values, relative, max(scatters)


def ground_values(mean: Floats, error: Floats) -> tuple[Floats, Floats, float]:
    """Light reflected by the ground at the nodes of the map, and the fits' worst scatter.

    Returns
    -------
    glow : (aerosol, wavelength, view) array
    lamps : (pattern, aerosol, wavelength, view, edges of the rings) array
    scatter : float
    """
    grid = GroundGrid()
    rings, _ = grid.city.edges
    scale = grid.city.scale(rings)
    axes = (
        Axis(np.log(grid.wavelength_nm[0]), np.log(grid.wavelength_nm[-1]), 4),
        Axis(np.log(grid.view_altitude_deg[0]), np.log(90.0), 6),
        Axis(0.0, float(scale[-1]), 7),
    )
    points = (np.log(grid.wavelength_nm), np.log(grid.view_altitude_deg))
    radius = grid.city.core_km * np.expm1(within_cells(scale)[0])
    cells = ((scale, within_cells(scale)[1] * radius * (radius + grid.city.core_km)),)
    bases = [axis.basis(at) for axis, at in zip(axes, (*points, scale), strict=True)]
    shape = (*mean.shape[:3], len(PATTERNS), grid.city.distances)
    of_lamps, errors = (np.moveaxis(part[..., 1:].reshape(shape), 3, 0) for part in (mean, error))
    values, scatters = np.empty((*of_lamps.shape[:-1], len(scale))), []
    for index in np.ndindex(of_lamps.shape[:2]):
        fit, _, scatter = smooth(of_lamps[index], errors[index], axes, points, cells, TOTAL_DEGREE)
        values[index] = np.exp(evaluated(fit, bases))
        scatters.append(scatter)
    return mean[..., 0], values, max(scatters)


def store(path: Path, key: str, **arrays: Floats) -> None:
    """Write a map: values in single precision, and relative errors, which need few digits, in half precision."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    single: dict[str, Any] = {
        name: values.astype(np.float16 if name.endswith("error") else np.float32) for name, values in arrays.items()
    }
    with atomic_path(path) as temporary:
        np.savez_compressed(temporary, key=np.array(key), **single)


def bake_moon() -> float:
    """Compute the moonlight map; return the median relative error."""
    walked = run_worker("moon")
    values, error = moon_values(*walked)
    store(MOON_FILE, content_hash(BakedAir(), MoonGrid()), values=values, relative_error=error, walked=walked[0])
    return float(np.median(error))


def bake_ground() -> float:
    """Compute the map of light that the ground reflects; return the median relative error of the walks."""
    mean, error = run_worker("ground")
    glow, lamps, _ = ground_values(mean, error)
    key = content_hash(BakedAir(), GroundGrid())
    store(GROUND_FILE, key, values=lamps, glow=glow, walked=mean, walked_error=error)
    return float(np.median(error))


def bake_city() -> float:
    """Compute the kernel of city light; return the median relative error."""
    mean, walked_error = (np.moveaxis(part, 3, 0) for part in run_worker("city"))
    values, error, _ = city_values(mean, walked_error)
    key = content_hash(BakedAir(), CityGrid())
    store(CITY_FILE, key, values=values, relative_error=error, walked=mean, walked_error=walked_error)
    return float(np.median(error))


def bake_twilight() -> float:
    """Compute the map of multiply scattered twilight; return the median relative error."""
    walked, walked_error = run_worker("twilight")
    return store_twilight(walked, walked_error)


def store_twilight(walked: Floats, walked_error: Floats) -> float:
    """Fit and store the walks of twilight; return the median relative error of the fit."""
    # In the map's precision, so that the fit can be reproduced from the map.
    walked_error = walked_error.astype(np.float16).astype(np.float64)
    coefficients, error, _ = fitted(TwilightGrid(), walked, walked_error)
    key = content_hash(BakedAir(), TwilightGrid())
    arrays = {"relative_error": error, "walked": walked, "walked_error": walked_error}
    store(TWILIGHT_FILE, key, coefficients=coefficients, **arrays)
    return float(np.median(error))
