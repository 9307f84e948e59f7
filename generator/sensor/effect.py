"""The input of every sensor effect, and the protocol that effects share."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]
"""Electrons, in single precision: integers up to 1.6e7, above the largest full well, are exact."""

NoiseStream = Callable[[str], np.random.Generator]


@dataclass(frozen=True)
class Exposure:
    """One exposure of one sensor.

    Attributes
    ----------
    exposure_s : float
    frame : callable
        Returns the random generator of a named stream, different in every frame.
    unit : callable
        Returns the random generator of a named stream that belongs to this particular sensor and is the same in all its
        frames.
    start_s : float
        Start of the exposure, seconds from any fixed moment; effects with a memory are functions of it.
    """

    exposure_s: float
    frame: NoiseStream
    unit: NoiseStream
    start_s: float = 0.0


class Effect(Protocol):
    """One step between expected electrons from light and DN.

    Every effect draws from streams named after itself, so that switching one off does not change the others' draws.
    """

    def apply(self, signal: Floats, exposure: Exposure) -> Floats:
        """Return the signal (…, height, width), electrons, after this effect."""
