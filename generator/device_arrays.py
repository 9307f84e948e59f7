"""Arrays where Dr.Jit reads them as its own.

Dr.Jit takes a NumPy array as it lies in memory. Where its address is no multiple of a vector's bytes, kernels that read it
lane by lane have another text and are compiled anew, and look-ups of four numbers become four look-ups. NumPy's addresses are
multiples of 16 bytes alone, and vary from one process to the next. Arrays that are only looked up number by number may lie
anywhere.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

ALIGNMENT = 128
"""Bytes of a vector of 16 numbers in double precision, the longest that Dr.Jit loads at once."""


def aligned_zeros(shape: tuple[int, ...], dtype: Any) -> NDArray[Any]:
    """Zeros at an address that is a multiple of ALIGNMENT."""
    size = math.prod(shape) * np.dtype(dtype).itemsize
    store = np.zeros(size + ALIGNMENT, np.uint8)
    start = -store.__array_interface__["data"][0] % ALIGNMENT
    return store[start : start + size].view(dtype).reshape(shape)


def aligned(values: NDArray[Any]) -> NDArray[Any]:
    """The array row by row at an address that is a multiple of ALIGNMENT; a copy only where it does not lie so."""
    values = np.ascontiguousarray(values)
    if values.__array_interface__["data"][0] % ALIGNMENT == 0:
        return values
    store = np.empty(values.nbytes + ALIGNMENT, np.uint8)
    start = -store.__array_interface__["data"][0] % ALIGNMENT
    copy = store[start : start + values.nbytes].view(values.dtype).reshape(values.shape)
    copy[...] = values
    return copy
