"""What happens to charge in the pixels: response, photon noise, dark current, cosmic rays, full well."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from generator.sensor.draws import poisson, standard_normal
from generator.sensor.effect import Exposure, Floats


@dataclass(frozen=True)
class PhotoResponse:
    """Fixed spread of the pixels' response (EMVA 1288's PRNU, normal) and dead pixels; acts on the expectation."""

    prnu: float
    dead_fraction: float

    def apply(self, signal: Floats, exposure: Exposure) -> Floats:
        """Scale each pixel's expected electrons."""
        if self.prnu:
            spread = standard_normal(signal.shape, exposure.unit("prnu"))
            signal = signal * np.maximum(1 + self.prnu * spread, 0)
        if self.dead_fraction:
            signal = np.where(exposure.unit("dead").random(signal.shape) < self.dead_fraction, 0, signal)
        return signal


@dataclass(frozen=True)
class PhotonNoise:
    """Poisson statistics of light (EMVA 1288 release 4.0, section 2.2)."""

    noise: bool

    def apply(self, signal: Floats, exposure: Exposure) -> Floats:
        """Draw electrons from their expectation."""
        return poisson(signal, signal.shape, exposure.frame("shot")) if self.noise else signal


@dataclass(frozen=True)
class DarkCurrent:
    """Thermal electrons: Poisson, a mean that doubles every few degrees, and hot pixels with an exponential excess.

    Poisson and the doubling temperature are EMVA 1288's (release 4.0); the exponential distribution of the hot pixels'
    excess is skybench's own choice.
    """

    mean_e_s: float
    hot_fraction: float
    hot_e_s: float
    noise: bool

    def apply(self, signal: Floats, exposure: Exposure) -> Floats:
        """Add dark electrons."""
        mean = self.mean_e_s * exposure.exposure_s
        if not self.hot_fraction:
            if not self.noise:
                return signal + np.float32(mean)
            return signal + poisson(mean, signal.shape, exposure.frame("dark"))
        random = exposure.unit("hot")
        hot = random.random(signal.shape) < self.hot_fraction
        excess = random.standard_exponential(signal.shape)
        expected = mean + hot * excess * self.hot_e_s * exposure.exposure_s
        electrons = poisson(expected, signal.shape, exposure.frame("dark")) if self.noise else expected
        return signal + electrons.astype(np.float32)


@dataclass(frozen=True)
class CosmicRays:
    """Straight tracks at random places and angles, with exponential lengths and charges per pixel.

    The mean charge is the user's: a minimum-ionising particle leaves about 80 electrons per micrometre of silicon (Particle
    Data Group, Review of Particle Physics, section Silicon detectors). Arrivals are Poisson.
    """

    rate_s: float
    charge_e_px: float
    length_px: float

    def apply(self, signal: Floats, exposure: Exposure) -> Floats:
        """Add the tracks' charge."""
        random = exposure.frame("cosmic_rays")
        height, width = signal.shape[-2:]
        count = random.poisson(self.rate_s * exposure.exposure_s)
        u, v = random.uniform(0, width, count), random.uniform(0, height, count)
        angle = random.uniform(0, 2 * np.pi, count)
        length, charge = random.exponential(self.length_px, count), random.exponential(self.charge_e_px, count)
        steps = np.maximum(1, np.ceil(4 * length)).astype(np.intp)
        track = np.repeat(np.arange(count), steps)
        step = np.arange(len(track)) - np.repeat(np.cumsum(steps) - steps, steps)
        along = (step + 0.5) / steps[track] * length[track]
        column = np.floor(u[track] + along * np.cos(angle[track])).astype(np.intp)
        row = np.floor(v[track] + along * np.sin(angle[track])).astype(np.intp)
        inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
        left = charge[track] * np.maximum(length, 1)[track] / steps[track]
        # Several steps may fall into one pixel, where they add up.
        place = row[inside] * width + column[inside]
        light = np.bincount(place, weights=left[inside], minlength=height * width).reshape(height, width)
        return (signal + light).astype(signal.dtype)


@dataclass(frozen=True)
class FullWell:
    """Saturation of the pixel; with blooming the excess runs to both neighbours in the column, and on from there."""

    full_well_e: float
    blooming: bool

    def apply(self, signal: Floats, exposure: Exposure) -> Floats:
        """Limit the charge."""
        del exposure
        if self.blooming:
            signal = signal.copy()
            _spill(signal, self.full_well_e)
        return np.minimum(signal, self.full_well_e)


def _spill(signal: Floats, full_well_e: float) -> None:
    """Pass half of each pixel's excess down and half up its column; charge leaves at the array's ends."""
    height = signal.shape[-2]
    excess = np.maximum(signal - full_well_e, 0) / 2
    signal -= 2 * excess
    for rows in (range(height), range(height - 1, -1, -1)):
        carried = np.zeros_like(signal[..., 0, :])
        for row in rows:
            room = np.maximum(full_well_e - signal[..., row, :], 0)
            taken = np.minimum(carried, room)
            signal[..., row, :] += taken
            carried = carried - taken + excess[..., row, :]
