"""Directions of view of the baked maps."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def view_directions(altitude_deg: Any, azimuth_deg: Any) -> Floats:
    """Unit vectors, y towards azimuth 0, for all altitudes x azimuths: (m, 3) array, azimuth varying fastest."""
    altitude, azimuth = np.radians(np.meshgrid(altitude_deg, azimuth_deg, indexing="ij")).reshape(2, -1)
    return np.stack([np.sin(azimuth) * np.cos(altitude), np.cos(azimuth) * np.cos(altitude), np.sin(altitude)], axis=-1)
