"""Contribution of the errors of supplied quantities to a position, for solvers that cannot take them into account."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from benchmark.protocol import Observation
from celnav.sky.wgs84 import MEAN_RADIUS_KM, ROTATION_RAD_S


def covariance_of_told(latitude_deg: float, told: Observation) -> NDArray[np.float64]:
    """East-north covariance, shape (2, 2), km^2, that errors of the supplied vertical and time add to a position."""
    along_equator = math.cos(math.radians(latitude_deg)) * ROTATION_RAD_S * told.utc_sigma_s
    vertical = math.radians(told.tilt_sigma_deg)
    return np.asarray(MEAN_RADIUS_KM**2 * np.diag([vertical**2 + along_equator**2, vertical**2]))
