"""The maps of ``skybench bake``, read, checked and interpolated."""

from __future__ import annotations

import functools
import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RegularGridInterpolator

from generator.bake.grids import BakedAir, CityGrid, MoonGrid, content_hash
from generator.errors import DataFileError

Floats = NDArray[np.float64]
FOLDER = Path(__file__).parents[1] / "data" / "baked"
MOON_FILE, CITY_FILE = FOLDER / "moonlight.npz", FOLDER / "city_kernel.npz"


@dataclass(frozen=True)
class BakedMap:
    """A smoothed map and what is known of its error.

    Attributes
    ----------
    values : array
        Moonlight: over single scattering (see :mod:`generator.sky.moonlight`), axes of MoonGrid. City: multiply scattered
        light of a disk of lamps, km^-2 sr^-1, axes (pattern, CityGrid).
    relative_error : array
        Monte Carlo standard error of `values` after smoothing, relative to the total light.
    """

    values: Floats
    relative_error: Floats


def read(path: Path, key: str) -> BakedMap:
    """Read a map, and refuse one that was made of something else.

    Raises
    ------
    DataFileError
    """
    try:
        with np.load(path, allow_pickle=False) as stored:
            found, values, error = str(stored["key"]), stored["values"], stored["relative_error"]
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as problem:
        raise DataFileError(f"{path}: not a baked map ({problem}); run `skybench bake`") from problem
    if found != key:
        raise DataFileError(f"{path}: baked from other inputs (key {found[:12]}, not {key[:12]}); run `skybench bake`")
    return BakedMap(values.astype(np.float64), error.astype(np.float64))


@functools.cache
def moon_map() -> BakedMap:
    """Moonlight over single scattering."""
    return read(MOON_FILE, content_hash(BakedAir(), MoonGrid()))


@functools.cache
def city_map() -> BakedMap:
    """Multiply scattered light of a small disk of lamps."""
    return read(CITY_FILE, content_hash(BakedAir(), CityGrid()))


def moon_ratio(aerosol_tau_550: float, moon_altitude_deg: float, altitude_deg: Floats, azimuth_deg: Floats) -> Floats:
    """All moonlight over light scattered once, (w, m, k) array for wavelengths x view altitudes x azimuths from the Moon.

    Linear in the logarithm between the grid's points; outside them the nearest value holds (aerosol depths beyond 0.03 to
    0.3, altitudes below 2 deg).
    """
    grid = MoonGrid()
    table = np.log(moon_map().values)
    tau = np.clip(aerosol_tau_550, grid.aerosol_tau_550[0], grid.aerosol_tau_550[-1])
    moon = np.clip(moon_altitude_deg, grid.moon_altitude_deg[0], grid.moon_altitude_deg[-1])
    outer = RegularGridInterpolator(
        (np.log(grid.aerosol_tau_550), np.log(grid.moon_altitude_deg)), np.moveaxis(table, 1, 2)
    )([np.log(tau), np.log(moon)])[0]
    inner = RegularGridInterpolator(
        (np.log(grid.view_altitude_deg), np.array(grid.relative_azimuth_deg)), np.moveaxis(outer, 0, -1)
    )
    view = np.log(np.clip(altitude_deg, grid.view_altitude_deg[0], 90.0))
    relative = np.abs((azimuth_deg + 180) % 360 - 180)
    points = np.stack(np.meshgrid(view, relative, indexing="ij"), axis=-1)
    return np.exp(np.moveaxis(inner(points), -1, 0))


def city_multiple(distance_km: Floats, altitude_deg: Floats, relative_azimuth_deg: Floats) -> Floats:
    """Multiply scattered light of a small disk of lamps, km^-2 sr^-1 per unit output, (2, w, m) array for m cases."""
    grid = CityGrid()
    table = np.moveaxis(np.log(city_map().values), (0, 1), (-2, -1))
    axes = (
        np.log1p(np.array(grid.distance_km)), np.log(grid.view_altitude_deg), np.array(grid.relative_azimuth_deg),
    )  # fmt: skip
    points = np.stack(
        [
            np.log1p(np.clip(distance_km, 0, grid.distance_km[-1])),
            np.log(np.clip(altitude_deg, grid.view_altitude_deg[0], 90.0)),
            np.abs((relative_azimuth_deg + 180) % 360 - 180),
        ],
        axis=-1,
    )
    return np.exp(np.moveaxis(RegularGridInterpolator(axes, table)(points), 0, -1))
