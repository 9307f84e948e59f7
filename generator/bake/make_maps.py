"""``skybench bake``: run the workers, smooth what they computed, and store the maps."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from generator.atmosphere import aerosol_optical_depth, rayleigh_optical_depth
from generator.bake.grids import BakedAir, CityGrid, MoonGrid, content_hash
from generator.bake.single_scattering import city_single, disk_points, moon_single
from generator.bake.smoothing import smooth
from generator.errors import GeneratorError
from generator.files import atomic_path
from generator.sky.baked_maps import CITY_FILE, FOLDER, MOON_FILE

Floats = NDArray[np.float64]


def run_worker(task: str) -> tuple[Floats, Floats]:
    """Run a task of :mod:`generator.bake.worker` in a process of its own; return its mean and error.

    Raises
    ------
    GeneratorError
        With the worker's last words.
    """
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / f"{task}.npz"
        command = [sys.executable, "-m", "generator.bake.worker", task, str(out)]
        run = subprocess.run(command, capture_output=True, text=True, check=False)
        if run.returncode != 0:
            last = (run.stderr.strip().splitlines() or ["no message"])[-1]
            raise GeneratorError(f"baking '{task}' failed (exit status {run.returncode}): {last}")
        return read_raw(out)


def read_raw(path: Path) -> tuple[Floats, Floats]:
    """Mean and error that a worker stored."""
    with np.load(path, allow_pickle=False) as stored:
        return stored["mean"].astype(np.float64), stored["error"].astype(np.float64)


def moon_single_on_grid(air: BakedAir, grid: MoonGrid) -> Floats:
    """Closed-form single scattering on the axes of the moonlight map, with the bake's plane-parallel air."""
    tau, wavelength = np.array(grid.aerosol_tau_550), np.array(grid.wavelength_nm)
    moon, view = np.radians(grid.moon_altitude_deg), np.radians(grid.view_altitude_deg)
    azimuth = np.radians(grid.relative_azimuth_deg)
    moon_, view_, azimuth_ = moon[:, None, None], view[None, :, None], azimuth[None, None, :]
    cosine = np.sin(moon_) * np.sin(view_) + np.cos(moon_) * np.cos(view_) * np.cos(azimuth_)
    rayleigh = rayleigh_optical_depth(wavelength, air.pressure_hpa)
    aerosol = np.array([aerosol_optical_depth(wavelength, t, air.angstrom_exponent) for t in tau])
    return moon_single(
        rayleigh[None, :, None, None, None],
        aerosol[:, :, None, None, None],
        1 / np.sin(moon_),
        1 / np.sin(view_),
        cosine,
        air,
    )


def moon_values(mean: Floats, error: Floats) -> tuple[Floats, Floats, float]:
    """Ratio of all moonlight to single scattering, smoothed; its relative error; and the fit's scatter."""
    air, grid = BakedAir(), MoonGrid()
    ratio = mean / moon_single_on_grid(air, grid)
    coordinates = [
        np.log(grid.aerosol_tau_550),
        np.log(grid.wavelength_nm),
        np.log(grid.moon_altitude_deg),
        np.log(grid.view_altitude_deg),
        np.cos(np.radians(grid.relative_azimuth_deg)),
    ]
    return smooth(ratio, error / mean, coordinates, [2, 3, 5, 5, 3], 6)


def city_values(mean: Floats, error: Floats) -> tuple[Floats, Floats, float]:
    """Multiply scattered city light, smoothed; its error relative to the total; and the fits' worst scatter."""
    air, grid = BakedAir(), CityGrid()
    from generator.bake.directions import view_directions

    views = view_directions(grid.view_altitude_deg, grid.relative_azimuth_deg)
    single = np.stack(
        [
            city_single(
                air,
                np.array(grid.wavelength_nm),
                grid.aerosol_tau_550,
                disk_points(grid.disk_radius_km) + np.array([0.0, distance]),
                views,
            )
            for distance in grid.distance_km
        ],
        axis=2,
    ).reshape(mean.shape)
    coordinates = [
        np.log(grid.wavelength_nm),
        np.log1p(grid.distance_km),
        np.log(grid.view_altitude_deg),
        np.sqrt(np.radians(grid.relative_azimuth_deg)),
    ]
    fits = [smooth(mean[p], error[p] / mean[p], coordinates, [3, 6, 4, 4], 7) for p in range(2)]
    values = np.stack([fit[0] for fit in fits])
    relative = np.stack([fit[1] for fit in fits]) * values / (values + single)
    return values, relative, max(fit[2] for fit in fits)


def store(path: Path, values: Floats, relative_error: Floats, scatter: float, key: str) -> None:
    """Write a map."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    with atomic_path(path) as temporary:
        np.savez_compressed(
            temporary,
            values=values.astype(np.float32),
            relative_error=relative_error.astype(np.float32),
            scatter=np.array(scatter),
            key=np.array(key),
        )


def bake_moon() -> float:
    """Make the moonlight map; return the median relative error."""
    values, error, scatter = moon_values(*run_worker("moon"))
    store(MOON_FILE, values, error, scatter, content_hash(BakedAir(), MoonGrid()))
    return float(np.median(error))


def bake_city() -> float:
    """Make the kernel of city light; return the median relative error."""
    values, error, scatter = city_values(*run_worker("city"))
    store(CITY_FILE, values, error, scatter, content_hash(BakedAir(), CityGrid()))
    return float(np.median(error))
