"""Hills: ridges of fractal noise, one behind the other.

A ridge's line is a sum of waves whose power is proportional to the frequency to the power of -2.4: profiles of natural
relief have fractal dimensions of 1.2 to 1.3, D = (5 - slope) / 2 (Turcotte 1997, "Fractals and chaos in geology and
geophysics").
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from generator.ground.skylines.canvas import COLUMNS, Canvas, covered, smooth_noise

Floats = NDArray[np.float64]

RIDGES_M = (25_000.0, 12_000.0, 5_000.0, 2_000.0)
HEIGHTS_M = (1400.0, 520.0, 160.0, 45.0)
"""Mean height of each ridge above the camera."""
SPECTRAL_SLOPE = -2.4
SLOPE_COLOUR = np.array([0.050, 0.060, 0.030])


def ridge(rng: np.random.Generator, columns: int = COLUMNS) -> Floats:
    """A line around the horizon with mean 0 and standard deviation 1."""
    frequency = np.arange(columns // 2 + 1, dtype=np.float64)
    amplitude = np.zeros_like(frequency)
    amplitude[3:] = frequency[3:] ** (SPECTRAL_SLOPE / 2)
    phase = np.exp(2j * np.pi * rng.random(len(frequency)))
    line = np.fft.irfft(amplitude * phase, columns)
    return np.asarray((line - line.mean()) / line.std())


def draw_hills(canvas: Canvas) -> None:
    """Draw ridges around the camera, from far to near."""
    for away, height in zip(RIDGES_M, HEIGHTS_M, strict=True):
        line = height * np.maximum(1 + 0.45 * ridge(canvas.rng), 0.05)
        edge = np.degrees(np.arctan2(line, away))
        patch = canvas.whole(0.0, float(edge.max()))
        alpha = covered(edge[patch.columns][None, :], patch.altitude_deg[:, None], canvas.step_deg)
        speckle = 1 + 0.2 * smooth_noise(canvas.rng, patch.shape, 2.0)
        canvas.draw(patch, alpha, SLOPE_COLOUR * speckle[..., None], away)
