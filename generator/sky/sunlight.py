"""The Sun's colours, and its spectrum for zodiacal light."""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray

from generator.light.photometry import GRID_NM
from generator.light.stellar_spectra import star_spectra

Floats = NDArray[np.float64]

SUN_BV_MAG, SUN_VI_MAG = 0.653, 0.702
"""Colours of the Sun. Source: Ramirez et al. 2012, ApJ 752, 5."""


@functools.cache
def solar_shape() -> Floats:
    """The Sun's photon spectrum at GRID_NM relative to that at 500 nm: a star of its B-V and V-I (see stellar_spectra)."""
    spectrum: Floats = star_spectra([0.0], [SUN_BV_MAG], [SUN_VI_MAG])[0]
    return spectrum / np.interp(500.0, GRID_NM, spectrum)
