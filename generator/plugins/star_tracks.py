"""Motion of stars on the film during the exposure.

A star's exposure is divided into so many moments that it moves by less than a fraction of the point spread function's
width between two of them: project all stars (:mod:`generator.plugins.star_paths`), probe their motion, divide the
exposure into moments, and weight these (:mod:`generator.plugins.star_moments`). Light that the air disperses along the
vertical has separate tracks in each band of wavelengths.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from generator.device_arrays import aligned
from generator.plugins.camera import FLOAT64, NightSkyCamera
from generator.plugins.landscape import LandscapeTexture
from generator.plugins.star_moments import (
    behind_geometry,
    behind_landscape,
    beside_moon,
    cut_exposure,
    moment_light,
)
from generator.plugins.star_paths import LitShares, find_paths, project, relative_light
from generator.plugins.stars import StarEmitter

Floats = NDArray[np.float64]

STEP_RAD = 1e-4
"""Step of the finite difference for the direction of the vertical on the film."""


@dataclass(frozen=True)
class StarTracks:
    """Places and times at which the light of n stars falls.

    Attributes
    ----------
    u_px, v_px : (n,) arrays
        Position when the star's row is half exposed, or half-way through the star's own time span within that exposure;
        NaN outside the lens' range.
    start, end : (n, 2) arrays
        Position (u, v) when that row's exposure, or the star's own time span within it, starts and ends; NaN outside the
        lens' range or far from the frame.
    centroid : (n, 2) array
        Mean position weighted by the arriving light; NaN if none arrives.
    light : (n,) array
        Arriving light relative to that of the same star on the axis during one exposure; far from the frame, from its
        place half-way.
    visible_share : (n,) array
        Fraction of the star's light that geometry, landscape and Moon let through, 0-1; 1 for stars far from the frame.
    star, u, v, weight : (m,) arrays
        The moments: index of the star, position, and light (as `light`, which is their sum per star).
    """

    u_px: Floats
    v_px: Floats
    start: Floats
    end: Floats
    centroid: Floats
    light: Floats
    visible_share: Floats
    star: NDArray[np.int64]
    u: Floats
    v: Floats
    weight: Floats


def follow_stars(
    scene: Any,
    camera: NightSkyCamera,
    emitter: StarEmitter,
    reach_px: float,
    largest_step_px: Floats,
    landscape: LandscapeTexture | None = None,
) -> StarTracks:
    """Follow all stars of an emitter over the exposure.

    Parameters
    ----------
    scene : Scene
        Scene whose shapes hide stars. The Moon also does, at times that the emitter knows.
    camera, emitter
    reach_px : float
        Largest distance of a star's centre from the frame at which its light still touches the frame.
    largest_step_px : (n,) array
        Longest step of each star between two moments.
    landscape : LandscapeTexture or None
        Landscape that hides parts of the light of stars.
    """
    count = emitter.count
    everyone, half = np.arange(count, dtype=np.int64), np.full(count, 0.5)
    lit = LitShares.of(camera, emitter)
    middle = project(camera, emitter, everyone, half if lit is None else lit.share(everyone, half))
    paths = find_paths(camera, emitter, middle, reach_px, lit)
    start, end, centroid = (np.full((count, 2), np.nan) for _ in range(3))
    start[paths.star], end[paths.star] = paths.start, paths.end
    light, visible_share = relative_light(camera, middle), np.ones(count)
    if lit is not None:
        light = light * lit.length * lit.times.mean_light
    star, u, v, weight = np.zeros(0, np.int64), np.zeros(0), np.zeros(0), np.zeros(0)
    if len(paths.star):
        moments = cut_exposure(paths, camera, largest_step_px, lit)
        placed = project(camera, emitter, moments.star, moments.share)
        star, u, v = moments.star, placed.u, placed.v
        weight = moment_light(camera, emitter, moments, placed, lit)
        foreground = emitter.behind_foreground and (scene.shapes() or landscape is not None)
        if foreground or emitter.hidden is not None:
            whole = np.bincount(star, weight, count)
            if emitter.hidden is not None:
                weight = weight * beside_moon(camera, emitter, moments, placed)
            if foreground and scene.shapes():
                weight = weight * ~behind_geometry(scene, placed)
            if foreground and landscape is not None:
                weight = weight * (1 - behind_landscape(landscape, camera, placed))
            np.divide(np.bincount(star, weight, count), whole, out=visible_share, where=whole > 0)
        light = np.where(paths.near, np.bincount(star, weight, count), light)
        seen = np.flatnonzero(paths.near & (light > 0))
        for axis, position in enumerate((u, v)):
            total = np.bincount(star, weight * np.where(weight > 0, position, 0), count)
            centroid[seen, axis] = total[seen] / light[seen]
        keep = np.flatnonzero(weight > 0)
        star, u, v, weight = star[keep], u[keep], v[keep], weight[keep]
    return StarTracks(middle.u, middle.v, start, end, centroid, light, visible_share, star, u, v, weight)


@dataclass(frozen=True)
class Dispersed:
    """Dispersed stars of an emitter.

    Attributes
    ----------
    rows : (k,) array
        Indices of the stars.
    shift_px : (k, bands, 2) array
        Shift from the place at the reference wavelength to that of each band, u and v; the vertical is that of mid-exposure.
    """

    rows: NDArray[np.intp]
    shift_px: Floats

    @property
    def bands(self) -> int:
        """Number of equal bands of the spectral range."""
        return self.shift_px.shape[1]

    def mean_shift(self, electrons: Floats, count: int) -> Floats:
        """Mean shift, px, of the light of all `count` stars, (count, 2) array, from electrons in each band (count, bands)."""
        result = np.zeros((count, 2))
        share = electrons[self.rows]
        total = np.maximum(share.sum(axis=1, keepdims=True), 1e-300)
        result[self.rows] = np.einsum("kb,kbx->kx", share / total, self.shift_px)
        return result


def dispersed(camera: NightSkyCamera, emitter: StarEmitter) -> Dispersed | None:
    """Return the dispersed stars of an emitter; None if there are none."""
    if emitter.dispersion_rad is None:
        return None
    rows = np.flatnonzero(np.abs(emitter.dispersion_rad).max(axis=1) > 0)
    middle = emitter.directions_at_middle[rows]
    level = np.hypot(middle[:, 0], middle[:, 1])
    upward = np.stack([-middle[:, 2] * middle[:, 0] / level, -middle[:, 2] * middle[:, 1] / level, level], axis=1)
    ends = []
    for sign in (-0.5, 0.5):
        vector = middle + sign * STEP_RAD * upward
        east, north, up = (FLOAT64(aligned(component)) for component in vector.T)
        u, v, _, valid = camera.project(east, north, up, FLOAT64(0.5))
        good = np.array(valid)
        ends.append(np.stack([np.where(good, np.array(place), np.nan) for place in (u, v)], axis=1))
    per_rad = np.nan_to_num((ends[1] - ends[0]) / STEP_RAD)
    return Dispersed(rows, emitter.dispersion_rad[rows][:, :, None] * per_rad[:, None, :])


def by_band(
    tracks: StarTracks, electrons: Floats, fine: Floats, spread: Dispersed
) -> Iterator[tuple[StarTracks, Floats]]:
    """Yield parts of the stars' light whose tracks differ: stars without dispersion, then each band of the dispersed ones.

    Parameters
    ----------
    tracks : StarTracks
    electrons : (n, channels, b) array
        Electrons in the bands of the point spread function.
    fine : (n, channels, bands) array
        Electrons in the bands of the dispersion, a multiple of b.
    spread : Dispersed
    """
    place = np.full(len(electrons), -1)
    place[spread.rows] = np.arange(len(spread.rows))
    of_moment = place[tracks.star]
    yield _moments(tracks, np.flatnonzero(of_moment < 0), 0.0), electrons
    low = np.flatnonzero(of_moment >= 0)
    for band in range(spread.bands):
        part = np.zeros_like(electrons)
        part[spread.rows, :, band * electrons.shape[2] // spread.bands] = fine[spread.rows, :, band]
        yield _moments(tracks, low, spread.shift_px[of_moment[low], band]), part


def _moments(tracks: StarTracks, chosen: NDArray[np.intp], shift_px: Any) -> StarTracks:
    """Select some moments of tracks, moved by (m, 2) px."""
    moved = np.stack([tracks.u[chosen], tracks.v[chosen]], axis=1) + shift_px
    return replace(tracks, star=tracks.star[chosen], u=moved[:, 0], v=moved[:, 1], weight=tracks.weight[chosen])
