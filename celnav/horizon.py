"""Position from the camera's orientation relative to the stars and its orientation, as far as known, relative to the horizon.

The stars give the rotation from the terrestrial frame to the camera, with a covariance. The attitude gives the rotation from
east-north-up to the camera, or a part of it. Their quotient is the local frame of the observer: three numbers for two
unknowns, weighted by both covariances (Gauss-Markov), so that one formula covers an unknown heading, an uncertain tilt and
an exact attitude.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from celnav.attitude import Attitude
from celnav.sky.astrometry import enu_rotation
from celnav.sky.wgs84 import ECCENTRICITY_SQUARED, MEAN_RADIUS_KM, SEMI_MAJOR_AXIS_KM

F8 = NDArray[np.float64]

LEAST_CONTRADICTION = 6.63
"""Chi-squared with one degree of freedom that chance exceeds in one frame of a hundred."""
CLEAR_SIGMAS = 5.0
"""Standard deviations beyond which a heading error is a contradiction rather than an error of the stated size."""
STEEP_LAT_DEG = 60.0
"""Latitude beyond which a small tilt changes the heading by much, so heading errors count less (`heading_contradicts`)."""


@dataclass(frozen=True, eq=False)
class Place:
    """A position derived from an orientation.

    Attributes
    ----------
    lat_deg, lon_deg : float
        Geodetic position.
    cov_km2 : ndarray, shape (2, 2)
        Covariance in the axes east and north.
    heading_off_deg : float
        Difference between the heading that the stars imply and the supplied one; NaN if none was supplied.
    chi2 : float
        Square of the rotation that no position explains, in standard deviations of the supplied attitude and the stars, with
        one degree of freedom; 0 if no heading was supplied.
    """

    lat_deg: float
    lon_deg: float
    cov_km2: F8
    heading_off_deg: float
    chi2: float


@lru_cache(maxsize=64)
def horizontal_frame(attitude: Attitude) -> F8:
    """Return R_cam, shape (3, 3); if the heading is unknown, an arbitrary one with the zenith in the right direction.

    That one is the frame of Duff et al. 2017, J. Comput. Graph. Tech. 6(1) 1. The array is shared and cannot be written to.
    """
    if attitude.kind == "rotation":
        frame = attitude.R_cam
        frame.setflags(write=False)
        return frame
    x, y, z = attitude.rows[0]
    sign = math.copysign(1.0, z)
    a = -1.0 / (sign + z)
    b = x * y * a
    frame = np.array([[1.0 + sign * x * x * a, b, x], [sign * b, sign + y * y * a, y], [-sign * x, -y, z]])
    frame.setflags(write=False)
    return frame


def rotation_vector(rotation: F8) -> F8:
    """Return the rotation vector, shape (3,), of a matrix that rotates by less than half a turn."""
    antisymmetric = 0.5 * np.array(
        [rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]]
    )
    sine = float(np.linalg.norm(antisymmetric))
    angle = math.atan2(sine, (float(np.trace(rotation)) - 1) / 2)
    return antisymmetric if sine < 1e-12 else np.asarray(antisymmetric * (angle / sine))


def radii_km(lat_rad: float) -> tuple[float, float]:
    """Radii of curvature of WGS84 to the east (prime vertical) and to the north (meridian), km."""
    curvature = 1 - ECCENTRICITY_SQUARED * math.sin(lat_rad) ** 2
    return SEMI_MAJOR_AXIS_KM / math.sqrt(curvature), SEMI_MAJOR_AXIS_KM * (1 - ECCENTRICITY_SQUARED) / curvature**1.5


def distance_km(lat_deg: float, lon_deg: float, other_lat_deg: float, other_lon_deg: float) -> float:
    """Return the distance between two places on a sphere of the Earth's mean radius, within 0.6 % of the true one."""
    one, other = enu_rotation(lat_deg, lon_deg)[2], enu_rotation(other_lat_deg, other_lon_deg)[2]
    return MEAN_RADIUS_KM * math.atan2(float(np.linalg.norm(np.cross(one, other))), float(one @ other))


def honest_place(
    terrestrial_to_camera: F8,
    cov_rad2: F8,
    attitude: Attitude,
    scatter_cov_rad2: F8 | None = None,
    doubt_deg: float = 0.0,
) -> Place:
    """Determine the position; raise the uncertainty of an attitude that the stars contradict.

    The heading is the only angle of the attitude that stars can check. If it is off by more than its standard deviation and
    that of the stars explain (`LEAST_CONTRADICTION`), the tilt, which comes from the same source and cannot be checked, is
    assumed to be as uncertain as the heading has proved to be: all three variances of the attitude are raised alike, up to
    the square of the rotation that no position explains. That rotation is the heading error times the cosine of the
    latitude, since a tilt to the east moves the position along its parallel, and its meridian turns by the tangent of the
    latitude.

    Parameters are those of `place_from_rotation`; `scatter_cov_rad2` is the covariance from the scatter of the stars alone.
    Stars and heading are weighted by it and by the attitude as supplied, so that widening the covariance does not move the
    position. `doubt_deg` is a further uncertainty of the attitude, from another cause, that is added to its standard
    deviations.
    """
    weights = attitude, cov_rad2 if scatter_cov_rad2 is None else scatter_cov_rad2
    place = place_from_rotation(terrestrial_to_camera, cov_rad2, attitude, weights)
    raised = _with_doubt(_raised(attitude, place), doubt_deg)
    if raised is attitude:
        return place
    return replace(place_from_rotation(terrestrial_to_camera, cov_rad2, raised, weights), chi2=place.chi2)


def heading_contradicts(place: Place, limit_deg: float) -> bool:
    """Return whether the stars contradict the supplied heading by more than a limit and more than the stated errors explain.

    The meridian turns by the tangent of the latitude times the error of the zenith, so near a pole a tilt within its stated
    error can change the heading by any angle. What stays small is the rotation that no position explains, which is the
    heading error times the cosine of the latitude. Beyond `STEEP_LAT_DEG` that rotation, scaled to join the full heading
    error at `STEEP_LAT_DEG`, is compared with the limit; up to there, the heading error counts in full.

    Parameters
    ----------
    place : Place
        Result of `honest_place`.
    limit_deg : float
        Heading error that is accepted whatever the stated standard deviation.
    """
    if math.isnan(place.heading_off_deg) or place.chi2 <= CLEAR_SIGMAS**2:
        return False
    steep = min(1.0, math.cos(math.radians(place.lat_deg)) / math.cos(math.radians(STEEP_LAT_DEG)))
    return abs(place.heading_off_deg) * steep > limit_deg


def doubted(terrestrial_to_camera: F8, cov_rad2: F8, attitude: Attitude, doubt_deg: float = 0.0) -> Attitude:
    """Return the attitude with variances raised as `honest_place` raises them, and by a doubt of the lens.

    It is unchanged if nothing contradicts it and the lens is not in doubt.
    """
    return _with_doubt(_raised(attitude, place_from_rotation(terrestrial_to_camera, cov_rad2, attitude)), doubt_deg)


def _raised(attitude: Attitude, place: Place) -> Attitude:
    if attitude.kind != "rotation" or place.chi2 <= LEAST_CONTRADICTION:
        return attitude
    unexplained_deg = place.heading_off_deg * math.cos(math.radians(place.lat_deg))
    return _with_doubt(attitude, abs(unexplained_deg) * (1 - LEAST_CONTRADICTION / place.chi2) ** 0.5)


def _with_doubt(attitude: Attitude, doubt_deg: float) -> Attitude:
    if not doubt_deg:
        return attitude
    return replace(
        attitude,
        tilt_deg=math.hypot(attitude.tilt_deg, doubt_deg),
        heading_deg=math.hypot(attitude.heading_deg, doubt_deg),
    )


def place_from_rotation(
    terrestrial_to_camera: F8, cov_rad2: F8, attitude: Attitude, weights: tuple[Attitude, F8] | None = None
) -> Place:
    """Determine the position.

    Parameters
    ----------
    terrestrial_to_camera : ndarray, shape (3, 3)
        Rotation from ITRS to the camera, from the stars.
    cov_rad2 : ndarray, shape (3, 3)
        Covariance of its error as a small rotation in the camera frame.
    attitude : Attitude
        What is known of the camera's orientation relative to the horizon.
    weights : tuple of Attitude and ndarray, shape (3, 3), or None
        Attitude and covariance from which the weights of stars and heading follow; None uses `attitude` and `cov_rad2`,
        which is best if these hold. The returned covariance is always that of the resulting position under `attitude` and
        `cov_rad2`.
    """
    R_cam = horizontal_frame(attitude)
    local = R_cam.T @ terrestrial_to_camera
    covariance = _local_covariance(R_cam, cov_rad2, attitude)
    with_heading = attitude.kind == "rotation"
    zenith = local[2]
    lat, lon = math.asin(max(-1.0, min(1.0, float(zenith[2])))), math.atan2(float(zenith[1]), float(zenith[0]))
    if not with_heading:
        # The heading of the frame is arbitrary; a rotation about the vertical leads to true east and north.
        heading = local @ enu_rotation(math.degrees(lat), math.degrees(lon)).T
        (ee, en), (_, nn) = (heading.T @ covariance @ heading)[:2, :2]
        # A rotation about east moves the position north; one about north moves it west.
        return Place(
            math.degrees(lat), math.degrees(lon), kilometres(np.array([[nn, -en], [-en, ee]]), lat), math.nan, 0.0
        )
    information = np.linalg.inv(covariance if weights is None else _local_covariance(R_cam, weights[1], weights[0]))
    free_of_heading = rotation_vector(local @ enu_rotation(math.degrees(lat), math.degrees(lon)).T)
    heading_off = float(free_of_heading[2])
    gain, turn = np.zeros((2, 3)), free_of_heading
    for _ in range(20):
        turn = rotation_vector(local @ enu_rotation(math.degrees(lat), math.degrees(lon)).T)
        cos_lat = max(math.cos(lat), 1e-9)
        design = np.array([[0.0, 1.0], [-1.0, 0.0], [-math.sin(lat) / cos_lat, 0.0]])
        gain = np.linalg.solve(design.T @ information @ design, design.T @ information)
        east, north = gain @ turn
        lat += float(np.clip(north, -0.1, 0.1))
        lon += float(east) / cos_lat
        if abs(lat) > math.pi / 2:
            lat, lon = math.copysign(math.pi, lat) - lat, lon + math.pi
        if math.hypot(float(east), float(north)) < 1e-12:
            break
    # The only axis about which no change of position rotates the horizon: it is orthogonal to the design, even at a pole.
    unmoved = np.array([0.0, -math.sin(lat), math.cos(lat)])
    return Place(
        math.degrees(lat),
        math.degrees(math.remainder(lon, 2 * math.pi)),
        kilometres(gain @ covariance @ gain.T, lat),
        math.degrees(heading_off),
        float((unmoved @ turn) ** 2 / (unmoved @ covariance @ unmoved)),
    )


def _local_covariance(R_cam: F8, cov_rad2: F8, attitude: Attitude) -> F8:
    """Covariance, in the local frame, of the rotation between the horizons given by stars and attitude, rad^2."""
    covariance = np.asarray(R_cam.T @ cov_rad2 @ R_cam)
    tilt, heading = math.radians(attitude.tilt_deg), math.radians(attitude.heading_deg)
    return covariance + np.diag([tilt**2, tilt**2, heading**2 if attitude.kind == "rotation" else 0.0])


def kilometres(cov_rad2: F8, lat_rad: float) -> F8:
    """Convert a covariance of angles to east and north, rad^2, to km^2 on the ellipsoid."""
    scale = np.array(radii_km(lat_rad))
    return np.asarray(cov_rad2 * scale[:, None] * scale)
