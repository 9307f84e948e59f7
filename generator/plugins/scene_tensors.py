"""Tensors in a scene's description.

Mitsuba tries to read a tensor whose first axis has three entries as a colour, and prints a warning when that fails; such
tensors are passed with an additional leading axis of one entry.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from generator import mitsuba_runtime

LOOKS_LIKE_A_COLOUR = 3


def tensor(values: ArrayLike) -> Any:
    """Convert an array to a Mitsuba tensor in single precision that :func:`array` can read; needs a running Mitsuba."""
    single = np.ascontiguousarray(values, dtype=np.float32)
    return mitsuba_runtime.start().TensorXf(single[None] if len(single) == LOOKS_LIKE_A_COLOUR else single)


def array(value: Any, axes: int, dtype: Any = np.float64) -> NDArray[Any]:
    """Convert a parameter with `axes` axes to an array, without the additional leading axis."""
    result = np.array(value, dtype=dtype)
    return result[0] if result.ndim == axes + 1 and len(result) == 1 else result
