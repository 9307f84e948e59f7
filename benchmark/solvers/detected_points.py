"""Common form for what the detectors of peers return."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Points:
    """Detections, brightest first.

    Attributes
    ----------
    uv : ndarray, shape (n, 2)
        Positions, px, pixel centres at integers.
    flux : ndarray, shape (n,), or None
        Brightness; None where the detector does not report it.
    """

    uv: NDArray[np.float64]
    flux: NDArray[np.float64] | None
