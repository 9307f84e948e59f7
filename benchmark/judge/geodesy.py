"""Distance and direction between two positions on the WGS84 ellipsoid."""

import math

from scipy.optimize import minimize_scalar

WGS84_A_M = 6378137.0
WGS84_F = 1.0 / 298.257223563
WGS84_B_M = WGS84_A_M * (1.0 - WGS84_F)

_TOLERANCE_RAD = 1e-12
_MAX_ITERATIONS = 200


def geodesic_km(lat1_deg: float, lon1_deg: float, lat2_deg: float, lon2_deg: float) -> float:
    """Length of the shortest path over the WGS84 ellipsoid.

    Vincenty's inverse iteration serves every pair for which it converges. It does not for nearly antipodal points;
    there the shortest path is found as the shortest detour over a waypoint, see `_antipodal_m`.

    Parameters
    ----------
    lat1_deg, lon1_deg, lat2_deg, lon2_deg : float
        Geodetic latitudes (-90 to 90) and longitudes (any finite value), degrees, east positive.

    Returns
    -------
    float
        Kilometres. Within 1 mm of the exact geodesic (tests compare with GeographicLib's values).

    Raises
    ------
    ValueError
        A coordinate is not finite or a latitude is beyond a pole.

    References
    ----------
    T. Vincenty, "Direct and inverse solutions of geodesics on the ellipsoid with application of nested equations",
    Survey Review 23 (176), 88-93, 1975.
    C. F. F. Karney, "Algorithms for geodesics", Journal of Geodesy 87, 43-55, 2013 (test values).
    """
    length_m, _ = _geodesic(lat1_deg, lon1_deg, lat2_deg, lon2_deg)
    return length_m / 1000.0


def east_north_km(lat1_deg: float, lon1_deg: float, lat2_deg: float, lon2_deg: float) -> tuple[float, float]:
    """Components to the east and to the north, at the first point, of the shortest path to the second.

    Their root sum of squares is `geodesic_km`: the path's length in the direction in which it sets out (the geodesic
    polar coordinates of the second point about the first).

    Parameters
    ----------
    lat1_deg, lon1_deg, lat2_deg, lon2_deg : float
        As of `geodesic_km`.

    Returns
    -------
    (east, north) : float
        Kilometres.
    """
    length_m, azimuth = _geodesic(lat1_deg, lon1_deg, lat2_deg, lon2_deg)
    return length_m / 1000.0 * math.sin(azimuth), length_m / 1000.0 * math.cos(azimuth)


def _geodesic(lat1_deg: float, lon1_deg: float, lat2_deg: float, lon2_deg: float) -> tuple[float, float]:
    """Length (metres) of the shortest path and its azimuth (radians, from north through east) at the first point."""
    if not all(math.isfinite(value) for value in (lat1_deg, lon1_deg, lat2_deg, lon2_deg)):
        raise ValueError(f"coordinates must be finite, found {(lat1_deg, lon1_deg, lat2_deg, lon2_deg)}")
    if abs(lat1_deg) > 90.0 or abs(lat2_deg) > 90.0:
        raise ValueError(f"latitudes must lie within -90 to 90 degrees, found {lat1_deg} and {lat2_deg}")
    phi1, phi2 = math.radians(lat1_deg), math.radians(lat2_deg)
    # remainder() brings the difference of longitude to -180..180 exactly, across the date line too.
    dlon = math.radians(math.remainder(lon2_deg - lon1_deg, 360.0))
    path = _vincenty(phi1, phi2, dlon)
    return _antipodal(phi1, phi2, dlon) if path is None else path


def _reduced_latitude(phi: float) -> float:
    return math.atan2((1.0 - WGS84_F) * math.sin(phi), math.cos(phi))


def _vincenty(phi1: float, phi2: float, dlon: float) -> tuple[float, float] | None:
    """Vincenty's inverse formula: length (m) and azimuth at the first point (rad); None where it does not converge."""
    beta1, beta2 = _reduced_latitude(phi1), _reduced_latitude(phi2)
    sin1, cos1 = math.sin(beta1), math.cos(beta1)
    sin2, cos2 = math.sin(beta2), math.cos(beta2)
    lam = dlon
    for _ in range(_MAX_ITERATIONS):
        sin_sigma = math.hypot(cos2 * math.sin(lam), cos1 * sin2 - sin1 * cos2 * math.cos(lam))
        if sin_sigma == 0.0:
            # Coincident points, or exactly antipodal ones, for which every azimuth fits the formula.
            return (0.0, 0.0) if sin1 * sin2 + cos1 * cos2 * math.cos(lam) > 0.0 else None
        cos_sigma = sin1 * sin2 + cos1 * cos2 * math.cos(lam)
        sigma = math.atan2(sin_sigma, cos_sigma)
        sin_alpha = cos1 * cos2 * math.sin(lam) / sin_sigma
        cos2_alpha = 1.0 - sin_alpha * sin_alpha
        # On the equator cos2_alpha is 0 and the term with it vanishes.
        cos_2sm = cos_sigma - 2.0 * sin1 * sin2 / cos2_alpha if cos2_alpha > 1e-15 else 0.0
        c = WGS84_F / 16.0 * cos2_alpha * (4.0 + WGS84_F * (4.0 - 3.0 * cos2_alpha))
        series = sigma + c * sin_sigma * (cos_2sm + c * cos_sigma * (2.0 * cos_2sm**2 - 1.0))
        new_lam = dlon + (1.0 - c) * WGS84_F * sin_alpha * series
        if abs(new_lam) > math.pi:
            return None
        if abs(new_lam - lam) < _TOLERANCE_RAD:
            # Equation 20.
            azimuth = math.atan2(cos2 * math.sin(new_lam), cos1 * sin2 - sin1 * cos2 * math.cos(new_lam))
            return _vincenty_length_m(sigma, sin_sigma, cos_sigma, cos_2sm, cos2_alpha), azimuth
        lam = new_lam
    return None


def _vincenty_length_m(sigma: float, sin_sigma: float, cos_sigma: float, cos_2sm: float, cos2_alpha: float) -> float:
    """Equations 3, 4, 6 and 19 of Vincenty (1975)."""
    u2 = cos2_alpha * (WGS84_A_M**2 - WGS84_B_M**2) / WGS84_B_M**2
    a = 1.0 + u2 / 16384.0 * (4096.0 + u2 * (-768.0 + u2 * (320.0 - 175.0 * u2)))
    b = u2 / 1024.0 * (256.0 + u2 * (-128.0 + u2 * (74.0 - 47.0 * u2)))
    cubic = b / 6.0 * cos_2sm * (4.0 * sin_sigma**2 - 3.0) * (4.0 * cos_2sm**2 - 3.0)
    delta = b * sin_sigma * (cos_2sm + b / 4.0 * (cos_sigma * (2.0 * cos_2sm**2 - 1.0) - cubic))
    return WGS84_B_M * a * (sigma - delta)


def _antipodal(phi1: float, phi2: float, dlon: float) -> tuple[float, float]:
    """Shortest path between nearly antipodal points: length (m) and azimuth at the first (rad).

    Every path from the first point to the second crosses the circle of points a quarter turn (in reduced latitude)
    from the first. Vincenty's formula converges from each end to any point of that circle, so the shortest path is
    the least sum of the two legs over the circle: a minimum in one variable.
    """
    beta1 = _reduced_latitude(phi1)

    def legs(azimuth: float) -> tuple[tuple[float, float], tuple[float, float]]:
        beta = math.asin(max(-1.0, min(1.0, math.cos(beta1) * math.cos(azimuth))))
        lam = math.atan2(math.sin(azimuth), -math.sin(beta1) * math.cos(azimuth))
        phi = math.atan2(math.sin(beta), (1.0 - WGS84_F) * math.cos(beta))
        first, second = _vincenty(phi1, phi, lam), _vincenty(phi, phi2, math.remainder(dlon - lam, 2.0 * math.pi))
        if first is None or second is None:
            raise ArithmeticError("a quarter-turn leg did not converge")
        return first, second

    def detour(azimuth: float) -> float:
        return sum(length_m for length_m, _ in legs(azimuth))

    step = math.radians(2.0)
    best = min((index * step for index in range(180)), key=detour)
    refined = minimize_scalar(detour, bounds=(best - step, best + step), method="bounded", options={"xatol": 1e-9})
    return float(refined.fun), legs(float(refined.x))[0][1]
