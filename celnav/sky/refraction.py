"""Atmospheric refraction: ERFA's series and a ray integral for the default solver, Bennett's formula for the thesis'."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from celnav.sky.ray_integral import Air, air_at, ray_bending_rad

# Below this altitude the formula is out of range (its pole is at -4.4 deg), and the refraction is kept constant.
LOWEST_ALTITUDE_DEG = -1.0


def bennett_arcmin(
    apparent_altitude_deg: ArrayLike, pressure_hpa: float = 1010.0, temperature_c: float = 10.0
) -> NDArray[np.float64]:
    """Return the refraction at an apparent altitude.

    R = cot(h + 7.31 / (h + 4.4)) arcmin with h in degrees, scaled by P/1010 hPa and 283/(273 + T).

    Parameters
    ----------
    apparent_altitude_deg : array_like
        Apparent altitude, degrees.
    pressure_hpa, temperature_c : float
        Air at the observer; at zero pressure there is no refraction.

    Returns
    -------
    ndarray
        Apparent minus true altitude, arcminutes.

    References
    ----------
    Bennett 1982, "The Calculation of Astronomical Refraction in Marine Navigation", Journal of Navigation 35, 255.
    """
    h = np.maximum(np.asarray(apparent_altitude_deg, dtype=np.float64), LOWEST_ALTITUDE_DEG)
    scale = pressure_hpa / 1010.0 * 283.0 / (273.0 + temperature_c)
    return np.asarray(scale / np.tan(np.radians(h + 7.31 / (h + 4.4))))


def unrefract(dirs_enu: NDArray[np.float64], pressure_hpa: float, temperature_c: float) -> NDArray[np.float64]:
    """Convert apparent ENU unit vectors, shape (n, 3), to geometric ones by lowering each by its refraction."""
    return _lift(
        dirs_enu, -bennett_arcmin(np.degrees(np.arcsin(np.clip(dirs_enu[:, 2], -1, 1))), pressure_hpa, temperature_c)
    )


def refract(dirs_enu: NDArray[np.float64], pressure_hpa: float, temperature_c: float) -> NDArray[np.float64]:
    """Convert geometric ENU unit vectors, shape (n, 3), to apparent ones.

    Bennett's formula needs the apparent altitude, which is found by iteration; after three rounds, the error is below
    0.01 arcsec above 5 deg.
    """
    true_deg = np.degrees(np.arcsin(np.clip(dirs_enu[:, 2], -1, 1)))
    refraction_arcmin = np.zeros(len(dirs_enu))
    for _ in range(4):
        refraction_arcmin = bennett_arcmin(true_deg + refraction_arcmin / 60, pressure_hpa, temperature_c)
    return _lift(dirs_enu, refraction_arcmin)


def _lift(dirs_enu: NDArray[np.float64], arcmin: NDArray[np.float64]) -> NDArray[np.float64]:
    """Raise directions by angles along their vertical circles, away from the horizon."""
    horizontal = np.hypot(dirs_enu[:, 0], dirs_enu[:, 1])
    angle = np.radians(arcmin / 60)
    cos_angle, sin_angle = np.cos(angle), np.sin(angle)
    z = dirs_enu[:, 2] * cos_angle + horizontal * sin_angle
    # At the zenith there is no vertical circle, and the refraction, which vanishes there, has no direction.
    factor = cos_angle - dirs_enu[:, 2] * sin_angle / np.maximum(horizontal, 1e-12)
    factor = np.where(horizontal < 1e-9, 1.0, factor)
    return np.column_stack((dirs_enu[:, 0] * factor, dirs_enu[:, 1] * factor, z))


LOWEST_ALTITUDE_OF_SERIES_DEG = 15.0
# Above this altitude, the integral is a smooth function that a series of this many polynomials gives to rounding errors.
_LOWEST_OF_SERIES_RAD, _TERMS = np.radians(1.0), 28
# Air of lower pressure bends no ray by a hundredth of an arcsecond.
LEAST_PRESSURE_HPA = 1e-3


def refraction_rad(
    apparent_zenith_distance_rad: NDArray[np.float64],
    pressure_hpa: float,
    temperature_c: float,
    relative_humidity: float = 0.5,
    wavelength_um: float = 0.55,
) -> NDArray[np.float64]:
    """Return the refraction at apparent zenith distances, shape (n,), radians.

    Above 15 deg of altitude it is A tan z + B tan^3 z with ERFA's ``refco`` (good to 0.05 arcsec). Below, it is the integral
    of `celnav.sky.ray_integral` through standard air, down to the horizon of an observer at the height at which the standard
    atmosphere has this pressure. Their difference at 15 deg, 0.02 arcsec, fades out towards the horizontal.

    References
    ----------
    Hohenkerk & Sinclair 1985, NAO Technical Note 63; Stone 1996, PASP 108, 1051 (as cited by ERFA's ``refco``).
    """
    import erfa

    if pressure_hpa < LEAST_PRESSURE_HPA:
        return np.zeros_like(apparent_zenith_distance_rad)
    a, b = erfa.refco(pressure_hpa, temperature_c, relative_humidity, wavelength_um)
    highest = np.radians(90 - LOWEST_ALTITUDE_OF_SERIES_DEG)
    tangent = np.tan(np.minimum(apparent_zenith_distance_rad, highest))
    bending = np.asarray(tangent * (a + b * tangent**2))
    low = np.flatnonzero(apparent_zenith_distance_rad > highest)
    if len(low):
        air = air_at(pressure_hpa, temperature_c, relative_humidity, wavelength_um)
        altitude = np.pi / 2 - apparent_zenith_distance_rad[low]
        seam = np.radians(LOWEST_ALTITUDE_OF_SERIES_DEG)
        difference = bending[low] - _bending_at_seam(air)
        bending[low] = _low_bending(altitude, air) + difference * np.maximum(altitude, 0) / seam
    return bending


def _low_bending(altitude_rad: NDArray[np.float64], air: Air) -> NDArray[np.float64]:
    """Return `ray_bending_rad` up to the seam; above `_LOWEST_OF_SERIES_RAD`, a Chebyshev series with errors below 1e-12."""
    if not (altitude_rad >= _LOWEST_OF_SERIES_RAD).all():
        bending = np.empty_like(altitude_rad)
        fitted = altitude_rad >= _LOWEST_OF_SERIES_RAD
        bending[fitted] = _low_bending(altitude_rad[fitted], air)
        bending[~fitted] = ray_bending_rad(altitude_rad[~fitted], air)
        return bending
    seam = np.radians(LOWEST_ALTITUDE_OF_SERIES_DEG)
    place = 2 * (altitude_rad - _LOWEST_OF_SERIES_RAD) / (seam - _LOWEST_OF_SERIES_RAD) - 1
    return np.asarray(np.cos(np.arccos(np.clip(place, -1, 1))[:, None] * np.arange(_TERMS)) @ _series_of_bending(air))


@lru_cache(maxsize=8)
def _series_of_bending(air: Air) -> NDArray[np.float64]:
    """Return the coefficients of the Chebyshev series that interpolates the integral at its nodes, shape (_TERMS,)."""
    seam = np.radians(LOWEST_ALTITUDE_OF_SERIES_DEG)
    angle = np.pi * (np.arange(_TERMS) + 0.5) / _TERMS
    altitude = _LOWEST_OF_SERIES_RAD + (np.cos(angle) + 1) / 2 * (seam - _LOWEST_OF_SERIES_RAD)
    series = np.cos(np.outer(np.arange(_TERMS), angle)) @ ray_bending_rad(altitude, air) * (2 / _TERMS)
    series[0] /= 2
    return np.asarray(series)


@lru_cache(maxsize=8)
def _bending_at_seam(air: Air) -> float:
    return float(ray_bending_rad(np.array([np.radians(LOWEST_ALTITUDE_OF_SERIES_DEG)]), air)[0])


def unrefract_rays(
    rays: NDArray[np.float64], up: NDArray[np.float64], pressure_hpa: float, temperature_c: float
) -> NDArray[np.float64]:
    """Convert apparent unit vectors, shape (n, 3), of any frame to geometric ones, given the vertical, shape (3,)."""
    height = rays @ up
    outward = up - height[:, None] * rays
    length = np.sqrt(np.einsum("ni,ni->n", outward, outward))
    angle = refraction_rad(np.arctan2(length, height), pressure_hpa, temperature_c)
    away = outward / np.maximum(length, 1e-12)[:, None]
    return np.asarray(rays * np.cos(angle)[:, None] - away * np.sin(angle)[:, None])
