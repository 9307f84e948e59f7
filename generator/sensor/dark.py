"""Thermal electrons: dark current, hot pixels, and pixels whose dark current jumps between two levels."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from generator.sensor.draws import poisson, stream_key, uniform_at
from generator.sensor.effect import Exposure, Floats, NoiseStream
from generator.sensor.sparse import rare_pixels

MOMENTS = 16
"""Number of moments in an exposure at which the state of a blinking pixel is evaluated."""
MOST_CELLS = 24
"""Number of cells before a moment that are searched; the probability that none of them contains a renewal is exp(-24),
4e-11."""
MOST_RENEWALS = 8
"""Largest number of renewals in a cell; more occur with a probability of 1e-6."""


@dataclass(frozen=True)
class HotPixels:
    """Pixels of a sensor whose dark current exceeds the others' by a log-normally distributed amount.

    Dark currents of pixels are log-normal (Baer 2006, Proc. SPIE 6068; Konnik & Welsh 2014, arXiv:1412.4031, section 3.3).

    Attributes
    ----------
    fraction : float
        Fraction of the pixels.
    mean_e_s : float
        Mean of the excess at the sensor's temperature.
    log_sigma : float
        Standard deviation of its natural logarithm; 0 makes all equal.
    """

    fraction: float
    mean_e_s: float
    log_sigma: float

    def excess_e_s(self, shape: tuple[int, ...], exposure: Exposure) -> tuple[NDArray[np.intp], Floats]:
        """Flat indices of the hot pixels, (n,), and their excess, e/s, (n,); the same for all frames of a sensor."""
        random = exposure.unit("hot")
        places = rare_pixels(random, math.prod(shape), self.fraction)
        logarithm = self.log_sigma * random.standard_normal(len(places)) - 0.5 * self.log_sigma**2
        return places, (self.mean_e_s * np.exp(logarithm)).astype(np.float32)


@dataclass(frozen=True)
class BlinkingPixels:
    """Pixels whose dark current jumps between two levels: the random telegraph signal of dark current.

    The signal has two levels, exponentially distributed amplitudes, and dwell times from fractions of a second to hours
    (Hopkins & Hopkinson 1993, IEEE Trans. Nucl. Sci. 40, 1567; 1995, ibid. 42, 2074; Goiffon et al. 2011, IEEE Electron
    Device Lett. 32, 773). Both levels are equally likely. At renewals, a Poisson process of rate 1 / time constant, the
    level is drawn anew: the signal is the random telegraph process, with correlation exp(-|t| / time constant). It is a
    function of only the sensor and the time: renewals are drawn in numbered cells of one time constant, and the last one
    before a moment determines the level.

    Attributes
    ----------
    fraction : float
        Fraction of the pixels.
    amplitude_e_s : float
        Mean of the exponentially distributed upper level's excess, at the sensor's temperature.
    shortest_s, longest_s : float
        Limits of the time constants, distributed evenly in their logarithm (McWhorter 1957).
    """

    fraction: float
    amplitude_e_s: float
    shortest_s: float
    longest_s: float

    def excess_e_s(self, shape: tuple[int, ...], exposure: Exposure) -> tuple[NDArray[np.intp], Floats]:
        """Flat indices of these pixels, (n,), and the mean excess of each over the exposure, e/s, (n,)."""
        sensor = _Sensor(stream_key(exposure.unit("blinking.renewals")), exposure.unit)
        return _blinking(self, math.prod(shape), sensor, exposure.start_s, exposure.exposure_s)


@dataclass(frozen=True)
class _Sensor:
    """A sensor, identified by the key of its blinking pixels' renewals."""

    key: int
    unit: NoiseStream = field(compare=False)


@functools.lru_cache(maxsize=1)
def _blinking(
    kind: BlinkingPixels, size: int, sensor: _Sensor, start_s: float, exposure_s: float
) -> tuple[NDArray[np.intp], Floats]:
    """Return indices and excess of blinking pixels; cached because both the image and the truth need them."""
    random = sensor.unit("blinking")
    places = rare_pixels(random, size, kind.fraction)
    amplitude = kind.amplitude_e_s * random.standard_exponential(len(places))
    constant_s = kind.shortest_s * (kind.longest_s / kind.shortest_s) ** random.random(len(places))
    offset = random.random(len(places))
    time_s = start_s + (np.arange(MOMENTS) + 0.5) / MOMENTS * exposure_s
    high = telegraph_level(sensor.key, time_s[:, None] / constant_s + offset).sum(axis=0)
    return places, (amplitude * high / MOMENTS).astype(np.float32)


def telegraph_level(key: int, time: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Levels of n independent random telegraph processes at times (..., n) in units of their time constants, (..., n) array.

    Process i of a key is the same function of time in every call. Probabilities of both levels are 1/2.
    """
    shape, count = time.shape, time.shape[-1]
    time = time.reshape(-1)
    cell = np.floor(time)
    level = np.zeros(len(time), bool)
    decided = np.zeros(len(time), bool)
    everyone = np.arange(len(time))
    # Cumulative Poisson probabilities of mean 1.
    counts = np.exp(-1.0) * np.cumsum(1 / np.cumprod([1.0, *range(1, MOST_RENEWALS + 1)]))
    for back in range(MOST_CELLS):
        left = everyone[~decided]
        if not len(left):
            break
        draws = uniform_at(key, left % count, (cell[left] - back).astype(np.int64), 1 + 2 * MOST_RENEWALS)
        when, what = draws[1 : 1 + MOST_RENEWALS], draws[1 + MOST_RENEWALS :]
        happened = np.arange(MOST_RENEWALS)[:, None] < np.searchsorted(counts, draws[0], side="right")
        if not back:
            happened &= when <= time[left] - cell[left]
        latest = np.argmax(np.where(happened, when, -1.0), axis=0)
        found = happened.any(axis=0)
        level[left[found]] = what[latest[found], np.flatnonzero(found)] < 0.5
        decided[left[found]] = True
    return level.reshape(shape)


@dataclass(frozen=True)
class DarkCurrent:
    """Thermal electrons: Poisson, with a mean that doubles every few degrees (EMVA 1288, release 4.0).

    Attributes
    ----------
    mean_e_s : float
        Mean dark current of a normal pixel.
    defects : tuple of HotPixels and BlinkingPixels
    noise : bool
    """

    mean_e_s: float
    defects: tuple[HotPixels | BlinkingPixels, ...]
    noise: bool

    def apply(self, signal: Floats, exposure: Exposure) -> Floats:
        """Add dark electrons."""
        mean = self.mean_e_s * exposure.exposure_s
        if not self.defects:
            if not self.noise:
                return signal + np.float32(mean)
            return signal + poisson(mean, signal.shape, exposure.frame("dark"))
        expected = np.full(signal.shape, mean, np.float32)
        flat = expected.reshape(-1)
        for defect in self.defects:
            places, excess_e_s = defect.excess_e_s(signal.shape, exposure)
            flat[places] += excess_e_s * np.float32(exposure.exposure_s)
        return signal + (poisson(expected, signal.shape, exposure.frame("dark")) if self.noise else expected)
