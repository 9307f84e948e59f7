"""Arrays at addresses that suit Dr.Jit.

Dr.Jit uses a NumPy array in place, without copying it. If its address is not a multiple of the size of a vector,
kernels that read it lane by lane differ in their text and are compiled again, and a look-up of four numbers becomes
four look-ups. NumPy only guarantees addresses that are multiples of 16 bytes, and they vary from one process to the
next. Arrays that are only looked up number by number may be at any address.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

ALIGNMENT = 128
"""Size in bytes of a vector of 16 double-precision numbers, the longest that Dr.Jit loads at once."""


def aligned_zeros(shape: tuple[int, ...], dtype: Any) -> NDArray[Any]:
    """Return an array of zeros whose address is a multiple of ALIGNMENT."""
    size = math.prod(shape) * np.dtype(dtype).itemsize
    store = np.zeros(size + ALIGNMENT, np.uint8)
    start = -store.__array_interface__["data"][0] % ALIGNMENT
    return store[start : start + size].view(dtype).reshape(shape)


def aligned(values: NDArray[Any]) -> NDArray[Any]:
    """Return the array in row-major order at an address that is a multiple of ALIGNMENT; copies it only if necessary."""
    values = np.ascontiguousarray(values)
    if values.__array_interface__["data"][0] % ALIGNMENT == 0:
        return values
    store = np.empty(values.nbytes + ALIGNMENT, np.uint8)
    start = -store.__array_interface__["data"][0] % ALIGNMENT
    copy = store[start : start + values.nbytes].view(values.dtype).reshape(values.shape)
    copy[...] = values
    return copy
