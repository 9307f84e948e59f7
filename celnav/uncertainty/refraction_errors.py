"""Uncertainty of the refraction, which differs from that computed from the supplied pressure and temperature.

Above 15 deg of altitude, refraction is the refractivity of the air at the observer times tan z, less a thousandth (Green
1985, Spherical Astronomy, section 4.4). The refractivity is proportional to the pressure over the absolute temperature, so
1 % of it corresponds to 10 hPa or 3 K. A camera that points beside the zenith sees an error of it as a shift of all stars,
which their residuals do not show.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from celnav.camera import Camera
from celnav.sky.refraction import refraction_rad

F8 = NDArray[np.float64]

RELATIVE_SIGMA = 0.01
"""Relative standard deviation of the refraction: the temperature along the path through the lowest air differs from the
observer's by some 3 K."""


def refraction_derivatives(camera: Camera, rays: F8, up: F8, pressure_hpa: float, temperature_c: float) -> F8:
    """Derivatives of positions without refraction by the relative error of the refraction, shape (n, 2, 1).

    Parameters
    ----------
    camera : Camera
        The camera.
    rays : ndarray, shape (n, 3)
        Directions without refraction, camera frame.
    up : ndarray, shape (3,)
        Zenith, camera frame.
    pressure_hpa, temperature_c : float
        Pressure and temperature of the air.
    """
    height = rays @ up
    outward = up - height[:, None] * rays
    length = np.maximum(np.sqrt(np.einsum("ni,ni->n", outward, outward)), 1e-12)
    angle = refraction_rad(np.minimum(np.arctan2(length, height), np.pi / 2), pressure_hpa, temperature_c)
    _, by_direction = camera.project_with_derivatives(rays)
    lifted = outward * (angle / length)[:, None]
    moved = by_direction @ lifted[:, :, None]
    moved[~np.isfinite(moved)] = 0.0
    return np.asarray(moved)
