"""Stars whose light the air spreads along the vertical by more than a fraction of a pixel, in bands of wavelengths."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from generator.plugins.camera import FLOAT64, NightSkyCamera
from generator.plugins.star_tracks import StarTracks
from generator.plugins.stars import StarEmitter

Floats = NDArray[np.float64]

STEP_RAD = 1e-4
"""Over which the direction of the vertical on the film is differenced."""


@dataclass(frozen=True)
class Dispersed:
    """Some stars of an emitter.

    Attributes
    ----------
    rows : (k,) array
        Which of its stars.
    shift_px : (k, bands, 2) array
        From the place at the reference wavelength to that of each band, u and v; the vertical is that of mid-exposure.
    """

    rows: NDArray[np.intp]
    shift_px: Floats

    @property
    def bands(self) -> int:
        """Equal bands of the spectral range."""
        return self.shift_px.shape[1]

    def mean_shift(self, electrons: Floats, count: int) -> Floats:
        """Mean shift, px, of the light of all `count` stars, (count, 2) array, by electrons in each band (count, bands)."""
        result = np.zeros((count, 2))
        share = electrons[self.rows]
        total = np.maximum(share.sum(axis=1, keepdims=True), 1e-300)
        result[self.rows] = np.einsum("kb,kbx->kx", share / total, self.shift_px)
        return result


def dispersed(camera: NightSkyCamera, emitter: StarEmitter) -> Dispersed | None:
    """The dispersed stars of an emitter; None where there are none."""
    if emitter.dispersion_rad is None:
        return None
    rows = np.flatnonzero(np.abs(emitter.dispersion_rad).max(axis=1) > 0)
    middle = emitter.directions_at_middle[rows]
    level = np.hypot(middle[:, 0], middle[:, 1])
    upward = np.stack([-middle[:, 2] * middle[:, 0] / level, -middle[:, 2] * middle[:, 1] / level, level], axis=1)
    ends = []
    for sign in (-0.5, 0.5):
        vector = middle + sign * STEP_RAD * upward
        east, north, up = (FLOAT64(np.ascontiguousarray(component)) for component in vector.T)
        u, v, _, valid = camera.project(east, north, up, FLOAT64(0.5))
        good = np.array(valid)
        ends.append(np.stack([np.where(good, np.array(place), np.nan) for place in (u, v)], axis=1))
    per_rad = np.nan_to_num((ends[1] - ends[0]) / STEP_RAD)
    return Dispersed(rows, emitter.dispersion_rad[rows][:, :, None] * per_rad[:, None, :])


def by_band(
    tracks: StarTracks, electrons: Floats, fine: Floats, spread: Dispersed
) -> Iterator[tuple[StarTracks, Floats]]:
    """Parts of the stars' light whose tracks differ: the stars that are not dispersed, then each band of those that are.

    Parameters
    ----------
    tracks : StarTracks
    electrons : (n, channels, b) array
        In the bands of the point spread function.
    fine : (n, channels, bands) array
        In those of the dispersion, a multiple of b.
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
    """Some moments of tracks, moved by (m, 2) px."""
    moved = np.stack([tracks.u[chosen], tracks.v[chosen]], axis=1) + shift_px
    return dataclasses.replace(
        tracks, star=tracks.star[chosen], u=moved[:, 0], v=moved[:, 1], weight=tracks.weight[chosen]
    )
