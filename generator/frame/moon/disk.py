"""The Moon's disk as points of light, so that a resolved Moon is drawn like the stars and its light is conserved."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from generator.frame.dispersion import LEAST_PX
from generator.frame.moon.path import MoonPath, moon_path, seen_through_air
from generator.frame.plan import (
    SKY_RATE_DEG_S,
    FramePlan,
    airmass_to,
    field_radius_deg,
)
from generator.light.points import PointLights
from generator.optics.motion import turned_rad
from generator.optics.psf import equivalent_sigma_px
from generator.sky.clouds import LEAST_TRANSMISSION, level_or_up
from generator.sky.moon_irradiance import earthshine_over_moonlight, moon_colours

Floats = NDArray[np.float64]
Whole = NDArray[np.intp]

FEWEST_ACROSS = 3
"""Fewest points across the disk: enough for a centroid if it is unresolved."""
LARGE_PX = 60.0
"""Diameter from which a disk counts as large: its points are spaced as widely as the point spread function allows, and those
outside the frame are gathered."""
CLOSEST_PX, FARTHEST_PX = 0.5, 2.0
"""Limits of the distance between points."""
SIGMAS_APART = 1.25
"""Distance between points of a large disk, in standard deviations. A lattice of Gaussians with this spacing ripples by 4
exp(-2 pi^2 / 1.25^2), 1.3e-5."""
LARGEST_DISPERSED_PX = 600.0
"""Diameter up to which a disk is dispersed by the air: dispersion takes a dozen times as long, and shows only at the limb."""
STEPS_PER_DIAMETER = 64.0
"""Steps per diameter of a large disk that moves: the ends of its trail are ramps of this many steps."""
CELL = 16
"""Points across the cells in which points outside the frame are gathered."""
MOMENTS_AT_ONCE, FEWEST_AT_ONCE, MOST_AT_ONCE = 4_000_000, 4_096, 250_000
"""Limits of one block of points: number of moments, which limits memory if the Moon moves, and number of points."""


@dataclass(frozen=True, eq=False)
class DiskGrid:
    """A square lattice over the disk, row by row; x points to the Sun, and the disk's radius is 1.

    The lit part has uniform brightness, nearly as the full Moon has (Lommel-Seeliger's law at small phase angles), and
    the terminator is where the Sun sets.

    Attributes
    ----------
    across : int
        Number of rows, and of points in the longest of them.
    first, lit, after : (across,) arrays
        Columns of each row's first point on the disk, of its first lit point, and of the point after its last.
    earthshine : float
        Light of the whole disk lit by the Earth, relative to that of its part lit by the Sun.
    """

    across: int
    first: Whole
    lit: Whole
    after: Whole
    earthshine: float

    @property
    def in_row(self) -> Whole:
        """Number of shining points in each row, (across,) array."""
        return self.after - (self.first if self.earthshine else self.lit)

    def rows(self, start: int, stop: int) -> tuple[Floats, Floats, Floats]:
        """Points of rows `start` to `stop` - 1 that shine.

        Returns
        -------
        x, y : (n,) arrays
        share : (n,) array
            Fraction of the Moon's light; those of all rows add up to 1 plus earthshine.
        """
        count = self.in_row[start:stop]
        row = np.repeat(np.arange(start, stop), count)
        within = np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count)
        column = self.after[row] - self.in_row[row] + within
        share = (column >= self.lit[row]) / (self.after - self.lit).sum()
        share += self.earthshine / (self.after - self.first).sum()
        return (column + 0.5) / self.across * 2 - 1, (row + 0.5) / self.across * 2 - 1, share


def disk_grid(across: int, phase_angle_deg: float, earthshine: float = 0.0) -> DiskGrid:
    """Lattice of a disk for a number of points across and the phase angle, deg; at least one point is lit."""
    y = (np.arange(across) + 0.5) / across * 2 - 1
    half = np.sqrt(1 - y**2)

    def column_beyond(x: Floats) -> Whole:
        return np.asarray(np.floor((x + 1) / 2 * across - 0.5) + 1, dtype=np.intp)

    first, after = column_beyond(-half), across - column_beyond(-half)
    lit = np.clip(column_beyond(-math.cos(math.radians(phase_angle_deg)) * half), first, after)
    if not (after - lit).any():
        lit = np.where(after == after.max(), after - 1, after)
    return DiskGrid(across, first, lit, after, earthshine)


def is_drawn(plan: FramePlan) -> bool:
    """Whether a frame has a Moon, above the horizon or not."""
    return "moonlight" in plan.spec.sky.active_components


@dataclass(frozen=True)
class Drawing:
    """Parameters for drawing the points of a disk.

    Attributes
    ----------
    step_px : float
        Longest step between two moments of a large moving disk; 0 for a small one.
    dispersed_px : float
        Dispersion from which the points are spread.
    """

    step_px: float
    dispersed_px: float


def drawing_of(plan: FramePlan) -> Drawing:
    """Return how a frame's Moon is drawn."""
    diameter = _diameter_px(plan, moon_path(plan))
    if diameter <= LARGE_PX:
        return Drawing(0.0, LEAST_PX)
    return Drawing(diameter / STEPS_PER_DIAMETER, LEAST_PX if diameter <= LARGEST_DISPERSED_PX else math.inf)


def moon_lights(plan: FramePlan) -> Iterator[PointLights]:
    """Points of the Moon's disk that are above the horizon at some time of the exposure, in blocks that fit into memory.

    They move with the Moon, and each is refracted individually, so that the disk is flattened near the horizon and sets
    gradually. Brightness and colour are those of mid-exposure; air and cloud dim each point as at its place at
    mid-exposure.
    """
    if not is_drawn(plan):
        return
    path = moon_path(plan)
    state, f_px = plan.sky, plan.spec.camera.f_px
    highest = seen_through_air(plan, path.centre)[:, 2].max() + 2 * path.radius_rad.max()
    if highest < plan.horizon.sine:
        return
    diameter = _diameter_px(plan, path)
    apart = CLOSEST_PX
    if diameter > LARGE_PX:
        apart = float(np.clip(SIGMAS_APART * equivalent_sigma_px(plan.spec.camera), CLOSEST_PX, FARTHEST_PX))
    phase = state.moon.phase_angle_deg
    across = max(math.ceil(diameter / apart), FEWEST_ACROSS)
    grid = disk_grid(across, phase, earthshine_over_moonlight(phase))
    travel_rad = turned_rad(plan.motion.R_cam) + math.radians(SKY_RATE_DEG_S) * plan.spec.shutter_s
    moments = max(travel_rad * f_px / max(drawing_of(plan).step_px, CLOSEST_PX), len(path.centre))
    block = int(np.clip(MOMENTS_AT_ONCE / moments, FEWEST_AT_ONCE, MOST_AT_ONCE))
    so_far = np.cumsum(grid.in_row)
    edges = np.unique(np.searchsorted(so_far, np.append(np.arange(0, so_far[-1], block), so_far[-1]), side="right"))
    edges[0], edges[-1] = 0, across
    outside: list[tuple[Floats, Floats, Floats]] = []
    for start, stop in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        x, y, share = grid.rows(start, stop)
        if diameter > LARGE_PX:
            near = _near_the_frame(plan, path, x, y, travel_rad)
            outside.append(_gathered(x[~near], y[~near], share[~near], across))
            x, y, share = x[near], y[near], share[near]
        yield from _above_horizon(plan, path, x, y, share)
    if outside:
        x, y, share = (np.concatenate(parts) for parts in zip(*outside, strict=True))
        yield from _above_horizon(plan, path, x, y, share)


def _diameter_px(plan: FramePlan, path: MoonPath) -> float:
    return 2 * float(path.radius_rad.max()) * plan.spec.camera.f_px


def _middle(directions: Floats) -> Floats:
    """Return unit vectors (n, 3) at the middle of paths (n, k, 3)."""
    moments = directions.shape[1]
    middle = directions[:, (moments - 1) // 2] + directions[:, moments // 2]
    return np.asarray(middle / np.linalg.norm(middle, axis=-1, keepdims=True))


def _near_the_frame(plan: FramePlan, path: MoonPath, x: Floats, y: Floats, travel_rad: float) -> NDArray[np.bool_]:
    """Return which places on the disk may touch the frame at some time of the exposure, (n,) array."""
    at_middle = [(len(path.centre) - 1) // 2, len(path.centre) // 2]
    both = MoonPath(*(part[at_middle] for part in (path.centre, path.towards_sun, path.across, path.radius_rad)))
    towards = _middle(seen_through_air(plan, both.points(x, y)))
    reach = math.radians(field_radius_deg(plan.spec.camera)) + travel_rad
    return np.asarray(towards @ plan.motion.R_mid[2] > math.cos(min(reach, math.pi)))


def _gathered(x: Floats, y: Floats, share: Floats, across: int) -> tuple[Floats, Floats, Floats]:
    """Merge the points of each cell of the lattice into one with their light, at their mean position."""
    column, row = (np.floor((place + 1) / 2 * across / CELL) for place in (x, y))
    _, cell = np.unique(row * across + column, return_inverse=True)
    light: Floats = np.bincount(cell, share).astype(np.float64)
    return np.bincount(cell, share * x) / light, np.bincount(cell, share * y) / light, light


def _above_horizon(plan: FramePlan, path: MoonPath, x: Floats, y: Floats, share: Floats) -> Iterator[PointLights]:
    """Yield places on the disk that are above the horizon at some time, as points of light; nothing if all are below."""
    directions = seen_through_air(plan, path.points(x, y))
    up = np.flatnonzero(directions[:, :, 2].max(axis=1, initial=-1.0) >= plan.horizon.sine)
    if not len(up):
        return
    directions, share = directions[up], share[up]
    middle, state = _middle(directions), plan.sky
    passed = np.ones(len(up)) if state.clouds is None else state.clouds.point_transmission(level_or_up(middle))
    phase = state.moon.phase_angle_deg
    bv_mag, vi_mag = moon_colours(phase)
    path_air = np.zeros(len(up))
    if plan.spec.atmosphere.extinction:
        sine = np.clip(middle[:, 2], plan.horizon.sine, 1.0)
        path_air = airmass_to(plan.horizon, np.degrees(np.arcsin(sine)))
    yield PointLights.in_the_open(
        directions,
        state.moon_v_mag - 2.5 * np.log10(share * np.maximum(passed, LEAST_TRANSMISSION)),
        np.full(len(up), bv_mag),
        np.full(len(up), vi_mag),
        path_air,
    )
