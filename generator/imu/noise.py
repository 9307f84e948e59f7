"""Errors of an inertial sensor by the parameters of its Allan deviation.

Names, spectra and Allan variances are those of IEEE Std 952-1997, annex C:

==================  =======  ==================================  =========================
process             symbol   two-sided spectrum of the rate      Allan variance
==================  =======  ==================================  =========================
white noise         N        N^2                                 N^2 / tau
bias instability    B        B^2 / (2 pi f)                      2 ln 2 / pi B^2
rate random walk    K        K^2 / (2 pi f)^2                    K^2 tau / 3
==================  =======  ==================================  =========================

Bias instability is flicker noise, made by fractional integration of white noise to the order 1/2 (Kasdin 1995, Proc. IEEE
83, 802, section III); whatever is slower than the sequence is part of the constant bias.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Stream = Callable[[str], np.random.Generator]


@dataclass(frozen=True)
class ErrorModel:
    """Errors of a triad of sensors; `unit` is rad/s of a gyroscope, m/s^2 of an accelerometer.

    Attributes
    ----------
    bias : (3,) array
        Constant, unit.
    bias_sigma : float
        Spread of a further constant bias, unit.
    white : float
        N, unit times square root of a second.
    instability : float
        B, unit.
    random_walk : float
        K, unit over square root of a second.
    """

    bias: Floats
    bias_sigma: float
    white: float
    instability: float
    random_walk: float


def flicker(count: int, random: np.random.Generator) -> Floats:
    """Flicker noise of B = 1 in `count` consecutive samples about three axes, (count, 3); it starts at white noise."""
    # Its import takes half a second.
    from scipy.signal import fftconvolve

    lag = np.arange(1, count)
    weights = np.concatenate([[1.0], np.cumprod((lag - 0.5) / lag)])
    white = random.normal(size=(count, 3))
    return np.asarray(fftconvolve(white, weights[:, None], axes=0)[:count])


def drifting_bias(model: ErrorModel, count: int, interval_s: float, stream: Stream) -> Floats:
    """Bias in `count` consecutive readings, (count, 3): constant, flicker and random walk, each of its own stream."""
    bias = np.tile(model.bias + model.bias_sigma * stream("bias").normal(size=3), (count, 1))
    if model.instability:
        bias += model.instability * flicker(count, stream("instability"))
    if model.random_walk:
        steps = model.random_walk * np.sqrt(interval_s) * stream("walk").normal(size=(count, 3))
        bias += np.cumsum(steps, axis=0)
    return bias


def white_noise(model: ErrorModel, count: int, interval_s: float, stream: Stream) -> Floats:
    """White noise in `count` readings that are means over an interval, (count, 3)."""
    return model.white / np.sqrt(interval_s) * stream("white").normal(size=(count, 3))
