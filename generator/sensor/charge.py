"""Effects on charge in the pixels: response, photon noise, cosmic rays, full well."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from generator.sensor.draws import MOST_KEPT, normal_numbers, poisson, stream_key
from generator.sensor.effect import Exposure, Floats
from generator.sensor.sparse import rare_pixels


@dataclass(frozen=True)
class PhotoResponse:
    """Fixed variation of the pixels' response (EMVA 1288's PRNU, normal) and dead pixels; acts on the expected signal."""

    prnu: float
    dead_fraction: float

    def apply(self, signal: Floats, exposure: Exposure) -> Floats:
        """Scale each pixel's expected electrons."""
        if self.prnu:
            signal = signal * response(self.prnu, signal.shape, stream_key(exposure.unit("prnu")))
        if self.dead_fraction:
            signal = signal.copy()
            signal.reshape(-1)[rare_pixels(exposure.unit("dead"), signal.size, self.dead_fraction)] = 0
        return signal


def response(prnu: float, shape: tuple[int, ...], key: int) -> Floats:
    """Response factors of pixels, the same for all frames of a sensor; cached if they are few."""
    return (_kept_response if math.prod(shape) <= MOST_KEPT else _drawn_response)(prnu, shape, key)


def _drawn_response(prnu: float, shape: tuple[int, ...], key: int) -> Floats:
    return np.maximum(1 + prnu * normal_numbers(key, shape), 0)


_kept_response = functools.lru_cache(maxsize=1)(_drawn_response)


@dataclass(frozen=True)
class PhotonNoise:
    """Poisson statistics of light (EMVA 1288 release 4.0, section 2.2)."""

    noise: bool

    def apply(self, signal: Floats, exposure: Exposure) -> Floats:
        """Draw electrons from their expectation."""
        return poisson(signal, signal.shape, exposure.frame("shot")) if self.noise else signal


@dataclass(frozen=True)
class ParticleTracks:
    """Straight tracks of n charged particles.

    Attributes
    ----------
    corner_u_px, corner_v_px : (n,) arrays
        Starting points, px from the corner of the first pixel (half a pixel more than from its centre).
    angle_rad : (n,) array
        Direction, from u towards v.
    length_px : (n,) array
    charge_e_px : (n,) array
        Electrons per pixel of track; a track shorter than a pixel deposits those of one pixel.
    """

    corner_u_px: NDArray[np.float64]
    corner_v_px: NDArray[np.float64]
    angle_rad: NDArray[np.float64]
    length_px: NDArray[np.float64]
    charge_e_px: NDArray[np.float64]

    @classmethod
    def together(cls, parts: Sequence[ParticleTracks]) -> ParticleTracks:
        """Return the tracks of several exposures."""
        return cls(*(np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(cls)))

    @property
    def start_px(self) -> NDArray[np.float64]:
        """First end, with pixel centres at integers, (n, 2) array."""
        return np.stack([self.corner_u_px, self.corner_v_px], axis=1) - 0.5

    @property
    def end_px(self) -> NDArray[np.float64]:
        """Other end, (n, 2) array."""
        way = np.stack([np.cos(self.angle_rad), np.sin(self.angle_rad)], axis=1)
        return self.start_px + self.length_px[:, None] * way

    @property
    def electrons_e(self) -> NDArray[np.float64]:
        """Total electrons of each track, (n,) array."""
        return self.charge_e_px * np.maximum(self.length_px, 1)


@dataclass(frozen=True)
class CosmicRays:
    """Straight tracks at random places and angles, with exponential lengths and charges per pixel.

    The user states the mean charge: a minimum-ionising particle deposits about 80 electrons per micrometre of silicon
    (Particle Data Group, Review of Particle Physics, section Silicon detectors). Arrivals are Poisson.
    """

    rate_s: float
    charge_e_px: float
    length_px: float

    def tracks(self, width: int, height: int, exposure: Exposure) -> ParticleTracks:
        """Draw the tracks of an exposure on a sensor of `width` x `height` pixels."""
        random = exposure.frame("cosmic_rays")
        count = random.poisson(self.rate_s * exposure.exposure_s)
        u, v = random.uniform(0, width, count), random.uniform(0, height, count)
        angle = random.uniform(0, 2 * np.pi, count)
        length, charge = random.exponential(self.length_px, count), random.exponential(self.charge_e_px, count)
        return ParticleTracks(u, v, angle, length, charge)

    def apply(self, signal: Floats, exposure: Exposure) -> Floats:
        """Add the tracks' charge."""
        height, width = signal.shape[-2:]
        tracks = self.tracks(width, height, exposure)
        length, angle, charge = tracks.length_px, tracks.angle_rad, tracks.charge_e_px
        steps = np.maximum(1, np.ceil(4 * length)).astype(np.intp)
        track = np.repeat(np.arange(len(length)), steps)
        step = np.arange(len(track)) - np.repeat(np.cumsum(steps) - steps, steps)
        along = (step + 0.5) / steps[track] * length[track]
        column = np.floor(tracks.corner_u_px[track] + along * np.cos(angle[track])).astype(np.intp)
        row = np.floor(tracks.corner_v_px[track] + along * np.sin(angle[track])).astype(np.intp)
        inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
        left = charge[track] * np.maximum(length, 1)[track] / steps[track]
        # Several steps may fall into one pixel, where they add up.
        place, of_step = np.unique(row[inside] * width + column[inside], return_inverse=True)
        light = np.bincount(of_step, weights=left[inside], minlength=len(place))
        result = signal.copy()
        pixels = result.reshape(*signal.shape[:-2], height * width)
        pixels[..., place] = pixels[..., place] + light
        return result


@dataclass(frozen=True)
class FullWell:
    """Saturation of the pixel; with blooming the excess flows to both neighbours in the column, and onward from there."""

    full_well_e: float
    blooming: bool

    def apply(self, signal: Floats, exposure: Exposure) -> Floats:
        """Limit the charge."""
        del exposure
        if self.blooming:
            # Charge stays in its column.
            columns = np.flatnonzero((signal > self.full_well_e).any(axis=tuple(range(signal.ndim - 1))))
            if len(columns):
                signal = signal.copy()
                full = signal[..., columns]
                _spill(full, self.full_well_e)
                signal[..., columns] = full
        return np.minimum(signal, self.full_well_e)


def _spill(signal: Floats, full_well_e: float) -> None:
    """Pass half of each pixel's excess down and half up its column; charge leaves at the array's ends."""
    height = signal.shape[-2]
    excess = np.maximum(signal - full_well_e, 0) / 2
    signal -= 2 * excess
    overflows = (excess > 0).any(axis=(*range(signal.ndim - 2), -1)).tolist()
    for rows in (range(height), range(height - 1, -1, -1)):
        carried, carries = np.zeros_like(signal[..., 0, :]), False
        for row in rows:
            # Most rows neither receive nor pass on any charge.
            if not (overflows[row] or carries):
                continue
            room = np.maximum(full_well_e - signal[..., row, :], 0)
            taken = np.minimum(carried, room)
            signal[..., row, :] += taken
            carried = carried - taken + excess[..., row, :]
            carries = bool(carried.any())
