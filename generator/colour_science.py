"""The one door to colour-science and colour-demosaicing: imported when first needed, without effects on this process.

Their import takes over a second, switches NumPy's printing of all numbers to that of version 1.13, adds filters of warnings,
and warns of optional packages that are missing and of names that SciPy has moved. The functions below undo all of this.
"""

from __future__ import annotations

import functools
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@contextmanager
def _without_effects() -> Iterator[None]:
    with np.printoptions(), warnings.catch_warnings():
        warnings.filterwarnings("ignore", message='(?s)".*" related API features are not available')
        warnings.filterwarnings("ignore", message=r"Please import `convolve", category=DeprecationWarning)
        yield


@functools.cache
def colour() -> Any:
    """Return the module ``colour`` (colour-science)."""
    with _without_effects():
        import colour
    return colour


@functools.cache
def colour_demosaicing() -> Any:
    """Return the module ``colour_demosaicing``."""
    with _without_effects():
        import colour_demosaicing
    return colour_demosaicing


def srgb_encoded(linear: Floats) -> Floats:
    """Values from 0 to 1 after the transfer curve of sRGB (IEC 61966-2-1), of linear values from 0 to 1."""
    encoded: Floats = colour().cctf_encoding(linear, function="sRGB")
    return encoded
