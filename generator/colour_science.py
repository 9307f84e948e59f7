"""Access to colour-science and colour-demosaicing: imported only when needed, without side effects on this process.

Importing them takes over a second, switches NumPy's printing of all numbers to that of version 1.13, adds warning
filters, and warns about missing optional packages and about names that SciPy has moved. The functions below undo these
effects. The generator uses both packages through this module only.
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
    """Apply the transfer curve of sRGB (IEC 61966-2-1) to linear values from 0 to 1; the result is from 0 to 1."""
    encoded: Floats = colour().cctf_encoding(linear, function="sRGB")
    return encoded
