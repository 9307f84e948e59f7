"""Spectral reflectance of a picture's colours: sums of three curves, one each for red, green and blue.

The curves are those of Mallett & Yuksel 2019, "Spectral primary decomposition for rendering with sRGB reflectance" (EGSR
2019): they add up to 1, are between 0 and 1, and reproduce every colour of sRGB under illuminant D65. They end at 380 and
780 nm and are continued as constants; real plants are brighter than that beyond 700 nm.
"""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray

from generator.colour_science import colour
from generator.identity.kept import kept
from generator.light.photometry import GRID_NM

Floats = NDArray[np.float64]


@functools.cache
def primaries() -> Floats:
    """Reflectances of red, green and blue at GRID_NM, (3, n) array; their sum is 1."""
    return np.asarray(kept("primaries", (), lambda: {"curves": _mallett_yuksel()})["curves"], dtype=np.float64)


def _mallett_yuksel() -> Floats:
    table = colour().recovery.MSDS_BASIS_FUNCTIONS_sRGB_MALLETT2019
    curves = np.array([np.interp(GRID_NM, table.wavelengths, curve) for curve in np.transpose(table.values)])
    return np.asarray(curves / curves.sum(axis=0), dtype=np.float64)
