"""One baking task in a separate process (``python -m generator.bake.worker TASK OUT``).

Dr.Jit must find LLVM before it is first imported, and a process can have only one variant of Mitsuba; the check by
``volpath`` needs a different variant from the frames.
"""

from __future__ import annotations

import dataclasses
import os
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from generator import mitsuba_runtime
from generator.errors import GeneratorError
from generator.files import atomic_path
from generator.light.bake_grids import BakedAir, CityGrid, Grid, GroundGrid, MoonGrid, TwilightGrid

Floats = NDArray[np.float64]
VOLPATH_TASKS = ("furnace", "disk_of_lamps", "disk_beside", "disk_on_snow", "moonlit", "moonlit_snow")
"""Tasks of :mod:`generator.bake.volpath`."""
TWICE_TASK = "twice"
"""Twilight scattered twice: :func:`generator.bake.twilight_walk.scattered_twice`."""
GRIDS: dict[str, Grid] = {"moon": MoonGrid(), "city": CityGrid(), "ground": GroundGrid(), "twilight": TwilightGrid()}


def shape_of(grid: Grid) -> tuple[int, ...]:
    """Numbers of values along the axes that are computed in separate walks."""
    if isinstance(grid, TwilightGrid):
        axes = (grid.observer_km, grid.aerosol_tau, grid.rayleigh_tau, grid.view_altitude_deg)
        return tuple(len(axis) for axis in axes)
    return len(grid.aerosol_tau_550), len(grid.wavelength_nm), len(grid.view_altitude_deg)


def random_walks(grid: Grid) -> tuple[Floats, Floats]:
    """All pieces of a map: mean and relative error, arrays whose first axes are those of :func:`shape_of`."""
    shape = shape_of(grid)
    pieces = [piece(grid, *index) for index in np.ndindex(shape)]
    means, errors = (np.array([part[k] for part in pieces]).reshape(*shape, *pieces[0][k].shape) for k in range(2))
    return means, errors


def piece(grid: Grid, *index: int) -> tuple[Floats, Floats]:
    """One piece of a map, by its indices."""
    from generator.bake.tallies import city_piece, ground_piece, moon_piece
    from generator.bake.walk import Air

    if isinstance(grid, TwilightGrid):
        return shell_piece(grid, index)
    seed = grid.seed * 1_000_003 + int(np.ravel_multi_index(index, shape_of(grid))) * grid.batches
    aerosol, wavelength, view = index
    # For light reflected once, as for all light, the ground's albedo is a factor: the walks use a ground that absorbs
    # nothing.
    ground = BakedAir() if not isinstance(grid, GroundGrid) else dataclasses.replace(BakedAir(), ground_albedo=1.0)
    air = Air(ground, grid.wavelength_nm[wavelength], grid.aerosol_tau_550[aerosol])
    altitude = grid.view_altitude_deg[view]
    if isinstance(grid, MoonGrid):
        return moon_piece(air, grid, altitude, seed)
    if isinstance(grid, GroundGrid):
        return ground_piece(air, grid, altitude, seed)
    return city_piece(air, grid, altitude, seed)


def shell_piece(grid: TwilightGrid, index: tuple[int, ...]) -> tuple[Floats, Floats]:
    """One piece of the map of twilight."""
    from generator.bake.shell_air import shell_air
    from generator.bake.twilight_walk import twilight_piece

    seed = grid.seed * 1_000_003 + int(np.ravel_multi_index(index, shape_of(grid))) * grid.batches
    observer, aerosol, rayleigh, _ = index
    layer = grid.stratosphere_at(grid.rayleigh_tau[rayleigh])
    air = shell_air(
        BakedAir(), grid.rayleigh_tau[rayleigh], grid.aerosol_tau[aerosol], grid.observer_km[observer], layer
    )
    return twilight_piece(air, grid, grid.view_altitude_deg[index[3]], seed)


def main(task: str, out: Path, *index: str) -> None:
    """Compute a map, one piece of it by its indices, or another task; write mean and error to `out`."""
    os.environ[mitsuba_runtime.LLVM_VARIABLE] = mitsuba_runtime.find_llvm().path
    if task in VOLPATH_TASKS:
        import mitsuba

        mitsuba.set_variant("llvm_ad_mono")
        from generator.bake import volpath

        mean, error = getattr(volpath, task)()
    elif task == TWICE_TASK:
        from generator.bake.twilight_walk import scattered_twice

        mean, error = scattered_twice()
    elif task not in GRIDS:
        raise GeneratorError(f"found task {task!r}, expected one of {', '.join([*VOLPATH_TASKS, TWICE_TASK, *GRIDS])}")
    elif index:
        mean, error = piece(GRIDS[task], *(int(part) for part in index))
    else:
        mean, error = random_walks(GRIDS[task])
    with atomic_path(out) as temporary:
        np.savez_compressed(temporary, mean=mean.astype(np.float32), error=error.astype(np.float32))


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]), *sys.argv[3:])
