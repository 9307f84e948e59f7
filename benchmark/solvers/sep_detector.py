"""Detection for peers without their own: sep (Barbary 2016), the core of SExtractor (Bertin and Arnouts 1996)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

THRESHOLD_SIGMA = 3.0
PIXEL_STACK = 1_000_000
SUB_OBJECTS = 10_000
SEP_DETECTOR = f"sep-{THRESHOLD_SIGMA:g}-sigma"


@dataclass(frozen=True)
class Points:
    """Detections, brightest first."""

    uv: NDArray[np.float64]
    flux: NDArray[np.float64]


def detect_with_sep(image: NDArray[np.uint16]) -> Points:
    """Find what stands 3 sigma above sep's background."""
    import sep  # of the extra `peers`

    # Its own limits are for sparse frames.
    sep.set_extract_pixstack(PIXEL_STACK)
    sep.set_sub_object_limit(SUB_OBJECTS)
    pixels = np.ascontiguousarray(image, dtype=np.float32)
    background = sep.Background(pixels)
    found = sep.extract(pixels - background, THRESHOLD_SIGMA, err=background.globalrms)
    found = found[np.argsort(-found["flux"], kind="stable")]
    return Points(np.column_stack((found["x"], found["y"])).astype(np.float64), found["flux"].astype(np.float64))
