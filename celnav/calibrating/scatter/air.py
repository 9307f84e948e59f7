"""What a calibration does not know about the air: its refraction lifts the stars by more or less than was computed.

The refractivity of air is proportional to its pressure over its absolute temperature (Green 1985, Spherical Astronomy,
section 4.4). Around the zenith refraction shrinks the sky by 0.03 %, so that 3 % of it are 1e-5 of the focal length,
whatever the number of stars.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from celnav.calibrating.bundle import Bundle, Observations, response
from celnav.position import Weather
from celnav.uncertainty.refraction_errors import RELATIVE_SIGMA, refraction_derivatives

F8 = NDArray[np.float64]
Rows = NDArray[np.intp]

USUAL_PRESSURE_SIGMA_HPA = 10.0
"""Standard deviation of the pressure about that of the standard atmosphere at the same height, as on middle latitudes."""
USUAL_TEMPERATURE_SIGMA_C = 10.0
"""Standard deviation of a night's temperature about that of the standard atmosphere, over seasons and latitudes."""
_KELVIN = 273.15


def relative_sigma(weather: Weather, *, pressure_given: bool, temperature_given: bool) -> float:
    """Relative standard deviation of the refraction computed from the air, parts of which may only be the usual ones."""
    if weather.pressure_hpa == 0:
        return 0.0
    by_pressure = 0.0 if pressure_given else USUAL_PRESSURE_SIGMA_HPA / weather.pressure_hpa
    by_temperature = 0.0 if temperature_given else USUAL_TEMPERATURE_SIGMA_C / (weather.temperature_c + _KELVIN)
    return math.hypot(RELATIVE_SIGMA, by_pressure, by_temperature)


@dataclass(frozen=True, eq=False)
class AirErrors:
    """Covariances by the air of each night, which is independent of that of others.

    Attributes
    ----------
    lens_cov : ndarray, shape (m, m)
        Of the lens parameters.
    turn_cov : ndarray, shape (g, 3, 3)
        Of a rotation of each group in the camera frame, radians squared, with the lens held fixed.
    """

    lens_cov: F8
    turn_cov: F8


def air_errors(
    bundle: Bundle, seen: Observations, group: Rows, night: Rows, weather: Weather, sigma: float
) -> AirErrors:
    """Return what an error of the refraction adds to the covariances of a fit.

    Parameters
    ----------
    bundle : Bundle
        The fit.
    seen : Observations
        The n stars that it was fitted to.
    group, night : ndarray, shape (n,)
        Attitude and night of each star.
    weather : Weather
    sigma : float
        Relative standard deviation of the refraction.
    """
    lifted = np.zeros((len(seen), 2))
    camera = bundle.form.camera(bundle.values, bundle.size)
    for g, rotation in enumerate(bundle.rotations):
        rows = np.flatnonzero(group == g)
        rays = seen.dirs[rows] @ rotation.T
        air = weather.pressure_hpa, weather.temperature_c
        lifted[rows] = sigma * refraction_derivatives(camera, rays, rotation[:, 2], *air)[:, :, 0]
    by_night = np.where((night == np.unique(night)[:, None])[:, :, None], lifted, 0.0)
    lens, turn = response(bundle, seen, group, by_night)
    return AirErrors(lens.T @ lens, np.einsum("cgi,cgj->gij", turn, turn))
