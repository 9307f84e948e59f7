"""The ellipsoid WGS84 and its normal gravity.

Source of the constants and formulas: NIMA TR8350.2, 3rd edition, amendment 2 (2004), tables 3.1 and 3.4, section 4.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

SEMI_MAJOR_M = 6378137.0
FLATTENING = 1 / 298.257223563
SEMI_MINOR_M = SEMI_MAJOR_M * (1 - FLATTENING)
SQUARED_ECCENTRICITY = FLATTENING * (2 - FLATTENING)
ROTATION_RAD_S = 7.292115e-5
"""Rotation rate of the Earth."""
EQUATORIAL_GRAVITY_M_S2 = 9.7803253359
SOMIGLIANA_K = 0.00193185265241
ROTATION_SHARE = 0.00344978650684
"""Ratio m = omega^2 a^2 b / GM."""


def normal_vector(latitude_deg: Floats, longitude_deg: Floats) -> Floats:
    """Unit normal of the ellipsoid in Earth-fixed axes at geodetic positions (n): (n, 3) array."""
    latitude, longitude = np.radians(latitude_deg), np.radians(longitude_deg)
    return np.stack(
        [np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude), np.sin(latitude)], axis=-1
    )


def position_of_normal(normal: Floats) -> tuple[Floats, Floats]:
    """Geodetic latitude and longitude, deg, of normals (n, 3)."""
    x, y, z = np.moveaxis(normal, -1, 0)
    return np.degrees(np.arctan2(z, np.hypot(x, y))), np.degrees(np.arctan2(y, x))


def enu_axes(normal: Floats) -> Floats:
    """Rotations from Earth-fixed axes to east, north, up at places with normals (n, 3): (n, 3, 3) array.

    At a pole, where the longitude that the normal gives is 0, east is along the Earth-fixed y axis.
    """
    latitude_deg, longitude_deg = position_of_normal(normal)
    sin_lat, cos_lat = np.sin(np.radians(latitude_deg)), np.cos(np.radians(latitude_deg))
    sin_lon, cos_lon = np.sin(np.radians(longitude_deg)), np.cos(np.radians(longitude_deg))
    east = np.stack([-sin_lon, cos_lon, np.zeros_like(sin_lon)], axis=-1)
    north = np.stack([-sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat], axis=-1)
    return np.stack([east, north, normal], axis=-2)


def curvature_radii_m(latitude_deg: Floats) -> tuple[Floats, Floats]:
    """Radii of curvature along the meridian and across it, m."""
    share = 1 - SQUARED_ECCENTRICITY * np.sin(np.radians(latitude_deg)) ** 2
    return SEMI_MAJOR_M * (1 - SQUARED_ECCENTRICITY) / share**1.5, SEMI_MAJOR_M / np.sqrt(share)


def normal_gravity_m_s2(latitude_deg: Floats, height_m: Floats) -> Floats:
    """Magnitude of normal gravity (gravitation and centrifugal acceleration), m/s^2.

    It is Somigliana's formula on the ellipsoid, to the second order in height above it (equation 4-3), accurate to 1e-6
    m/s^2 up to 20 km. Gravity anomalies, up to 1e-3 m/s^2 over most of the Earth, are not included.
    """
    square = np.sin(np.radians(latitude_deg)) ** 2
    on_ellipsoid = EQUATORIAL_GRAVITY_M_S2 * (1 + SOMIGLIANA_K * square) / np.sqrt(1 - SQUARED_ECCENTRICITY * square)
    share = height_m / SEMI_MAJOR_M
    falls = 2 * (1 + FLATTENING + ROTATION_SHARE - 2 * FLATTENING * square) * share
    return np.asarray(on_ellipsoid * (1 - falls + 3 * share**2))
