"""What every sensor effect gets to know, and the protocol that they share."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]
"""Electrons, in single precision: whole numbers up to 1.6e7, the largest full well, are exact."""

NoiseStream = Callable[[str], np.random.Generator]


@dataclass(frozen=True)
class Exposure:
    """One exposure of one sensor.

    Attributes
    ----------
    exposure_s : float
    frame : callable
        Random generator of a named stream, new in every frame.
    unit : callable
        Random generator of a named stream that belongs to this very sensor and is the same in all its frames.
    start_s : float
        When the exposure starts, seconds from any fixed moment: what has a memory is a function of it.
    """

    exposure_s: float
    frame: NoiseStream
    unit: NoiseStream
    start_s: float = 0.0


class Effect(Protocol):
    """One step between expected electrons from light and DN.

    Every effect draws from streams named after itself, so that switching one off leaves the others' draws as they were.
    """

    def apply(self, signal: Floats, exposure: Exposure) -> Floats:
        """Return the signal (…, height, width), electrons, after this effect."""
