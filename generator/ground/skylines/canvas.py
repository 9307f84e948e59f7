"""The panorama on which skylines are drawn: patches in metres at a distance, each over the background."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from generator.ground.lamp import Lamp
from generator.ground.panorama import EYE_HEIGHT_M, Panorama, column_azimuths, encoded, row_altitudes

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]

COLUMNS = 3600
"""Number of columns, one per 0.1 deg."""
TOP_DEG = 75.0
FARTHEST_M = 50_000.0
GROUND: tuple[float, float, float] = (0.045, 0.055, 0.025)
"""Reflectance of grass in linear red, green and blue (dark green of the ColorChecker's foliage, halved for its shadows)."""


@dataclass
class Canvas:
    """Linear colours, alpha, glow and distance of a panorama that is being drawn.

    Attributes
    ----------
    rng : Generator
    lamps : list of Lamp
        Lamps that belong to the drawing.
    grass : bool
        Whether it starts with level grass up to the horizon.
    """

    rng: np.random.Generator
    lamps: list[Lamp] = field(default_factory=list)
    grass: bool = True

    def __post_init__(self) -> None:
        """Start empty, or with grass."""
        rows = round((TOP_DEG + 90) / 360 * COLUMNS)
        self.altitude_deg = row_altitudes(rows, TOP_DEG, -90.0)
        self.azimuth_deg = column_azimuths(COLUMNS)
        self.alpha: Singles = np.zeros((rows, COLUMNS), np.float32)
        self.colour: Singles = np.zeros((rows, COLUMNS, 3), np.float32)
        self.glow: Singles = np.zeros((rows, COLUMNS, 3), np.float32)
        self.distance: Singles = np.full((rows, COLUMNS), FARTHEST_M, np.float32)
        self.glows = False
        if self.grass:
            self._draw_grass()

    def _draw_grass(self) -> None:
        below = self.altitude_deg < 0
        depth = np.minimum(EYE_HEIGHT_M / np.sin(np.radians(np.maximum(-self.altitude_deg[below], 1e-3))), FARTHEST_M)
        self.distance[below] = depth[:, None]
        self.alpha[below] = 1
        speckle = 1 + 0.25 * smooth_noise(self.rng, (int(below.sum()), COLUMNS), 2.0)
        self.colour[below] = np.array(GROUND, np.float32) * speckle[..., None]

    @property
    def step_deg(self) -> float:
        """Step of rows and columns."""
        return 360 / COLUMNS

    def patch(self, azimuth_deg: float, half_width_deg: float, low_deg: float, high_deg: float) -> Patch:
        """The texels around an azimuth between two altitudes."""
        half = int(np.ceil(half_width_deg / self.step_deg)) + 1
        middle = int(np.floor(azimuth_deg / self.step_deg))
        columns = np.arange(middle - half, middle + half + 1)
        rows = np.flatnonzero(
            (self.altitude_deg > low_deg - self.step_deg) & (self.altitude_deg < high_deg + self.step_deg)
        )
        offset: Floats = (columns.astype(np.float64) + 0.5) * self.step_deg - azimuth_deg
        return Patch(slice(rows[0], rows[-1] + 1), columns % COLUMNS, offset, self.altitude_deg[rows])

    def whole(self, low_deg: float, high_deg: float) -> Patch:
        """All texels between two altitudes; azimuths count from south."""
        rows = np.flatnonzero(
            (self.altitude_deg > low_deg - self.step_deg) & (self.altitude_deg < high_deg + self.step_deg)
        )
        columns = np.arange(COLUMNS)
        return Patch(slice(rows[0], rows[-1] + 1), columns, self.azimuth_deg - 180.0, self.altitude_deg[rows])

    def draw(
        self, patch: Patch, alpha: Floats, colour: Floats, distance_m: Floats | float, glow: Floats | None = None
    ) -> None:
        """Draw over the content: alpha (rows, columns), 0-1, and linear colours that broadcast to (rows, columns, 3)."""
        covered_by = np.clip(alpha, 0, 1).astype(np.float32)
        for part, columns in patch.drawn(covered_by):
            place = (slice(patch.rows.start + part[0].start, patch.rows.start + part[0].stop), columns)
            cover, before = covered_by[part], self.alpha[place]
            whole = cover + before * (1 - cover)
            share = np.divide(cover, whole, out=np.zeros_like(cover), where=whole > 0)[..., None]
            rest = 1 - share
            self.colour[place] *= rest
            self.colour[place] += _part(colour, (*patch.shape, 3), part) * share
            if glow is not None or self.glows:
                self.glow[place] *= rest
            if glow is not None:
                self.glow[place] += _part(glow, (*patch.shape, 3), part) * share
            # A texel's distance is that of the larger part of its cover.
            np.copyto(self.distance[place], _part(distance_m, patch.shape, part), where=share[..., 0] > 0.5)
            self.alpha[place] = whole
        self.glows |= glow is not None

    def panorama(self, glow_cd_m2: float) -> Panorama:
        """Return the drawing as a panorama."""
        used = np.flatnonzero(self.alpha.any(axis=1))
        first = int(used[0])
        step = (TOP_DEG + 90) / len(self.altitude_deg)
        return Panorama(
            encoded(self.colour[first:]),
            np.rint(255 * self.alpha[first:]).astype(np.uint8),
            TOP_DEG - first * step,
            -90.0,
            encoded(self.glow[first:]) if self.glow.any() else None,
            glow_cd_m2,
            self.distance[first:],
            tuple(self.lamps),
        )


@dataclass(frozen=True, eq=False)
class Patch:
    """Texels of a canvas: rows, columns (possibly across north), azimuths from the patch's own, and altitudes, deg."""

    rows: slice
    columns: NDArray[np.intp]
    offset_deg: Floats
    altitude_deg: Floats

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return len(self.altitude_deg), len(self.columns)

    def drawn(self, cover: Singles) -> Iterator[tuple[tuple[slice, slice], slice]]:
        """The rectangle that contains a cover (rows, columns) above 0, split at north.

        Yields its rows and columns in the patch, and its columns on the canvas.
        """
        rows, columns = (np.flatnonzero(cover.any(axis=axis)) for axis in (1, 0))
        if not len(rows):
            return
        down = slice(int(rows[0]), int(rows[-1]) + 1)
        first, stop = int(columns[0]), int(columns[-1]) + 1
        while first < stop:
            start = int(self.columns[first])
            count = min(stop - first, COLUMNS - start)
            yield (down, slice(first, first + count)), slice(start, start + count)
            first += count

    def metres(self, distance_m: float) -> tuple[Floats, Floats]:
        """Places on an upright plane at a distance: x to the right (columns,), y above the ground (rows,)."""
        x = distance_m * np.tan(np.radians(np.clip(self.offset_deg, -80, 80)))
        return x, distance_m * np.tan(np.radians(self.altitude_deg)) + EYE_HEIGHT_M


def _part(values: Floats | float, shape: tuple[int, ...], part: tuple[slice, slice]) -> Singles:
    """A part of values that broadcast to a shape."""
    return np.broadcast_to(np.asarray(values), shape)[part].astype(np.float32)


def smooth_noise(rng: np.random.Generator, shape: tuple[int, int], sigma: float) -> Singles:
    """Gaussian noise of standard deviation 1, correlated over `sigma` texels."""
    noise = gaussian_filter(rng.standard_normal(shape, dtype=np.float32), sigma, mode="wrap", truncate=3.0)
    return np.asarray(noise / max(float(noise.std()), 1e-9), dtype=np.float32)


def covered(edge: Floats, place: Floats, step: Floats | float) -> Floats:
    """Fraction of cells of a given width around places that is below an edge."""
    return np.clip((edge - place) / step + 0.5, 0, 1)


def strip(place: Floats, middle: Floats | float, width: Floats | float, step: Floats | float) -> Floats:
    """Fraction of cells of width `step` around places that a strip covers, however thin it is."""
    low = np.maximum(place - np.divide(step, 2), middle - np.divide(width, 2))
    high = np.minimum(place + np.divide(step, 2), middle + np.divide(width, 2))
    return np.clip((high - low) / step, 0, 1)
