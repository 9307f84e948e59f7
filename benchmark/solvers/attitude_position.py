"""From an attitude among the stars to a position: the last step for solvers that answer with an attitude alone."""

import math

import erfa
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from celnav.sky.astrometry import AU_PER_DAY_IN_C, aberrate, celestial_to_terrestrial
from celnav.sky.earth_rotation import earth_orientation
from celnav.sky.utc import parse_utc

ROTATION_TOLERANCE = 1e-4


def position_of_attitude(R_icrs_to_camera: ArrayLike, up_camera: ArrayLike, utc: str) -> tuple[float, float]:
    """Find the place whose vertical points where the frame's does.

    An attitude that was fitted to catalogue directions has taken in the annual aberration of its field (at most 20.5 arcsec
    or 0.63 km): to second order in the field's radius it is the turn that carries the boresight to its apparent direction.
    That turn is taken back, and the vertical, turned into the Earth's frame, is the normal of the ellipsoid at the place.
    Parallax, diurnal aberration (0.3 arcsec, 10 m) and refraction's pull on a field off the zenith are left out.

    Parameters
    ----------
    R_icrs_to_camera : array_like, shape (3, 3)
        Takes catalogue directions (ICRS, at the frame's epoch, without aberration) to the camera frame: x right, y down,
        z along the boresight.
    up_camera : array_like, shape (3,)
        The zenith in the camera frame; any length.
    utc : str
        Mid-exposure.

    Returns
    -------
    (latitude_deg, longitude_deg) : float
        Geodetic, WGS84, east positive.

    Raises
    ------
    ValueError
        The matrix is no rotation, or the vertical has no length.

    References
    ----------
    S. E. Urban, P. K. Seidelmann (eds.), Explanatory Supplement to the Astronomical Almanac, 3rd ed., 2013, sections 7.2
    and 7.5 (aberration, CIO-based reduction).
    """
    rotation = np.asarray(R_icrs_to_camera, dtype=np.float64)
    up = np.asarray(up_camera, dtype=np.float64)
    if rotation.shape != (3, 3) or not np.abs(rotation @ rotation.T - np.eye(3)).max() < ROTATION_TOLERANCE:
        raise ValueError("R_icrs_to_camera is not a rotation matrix")
    if np.linalg.det(rotation) < 0.0:
        raise ValueError("R_icrs_to_camera is a reflection: check the handedness of the camera frame")
    if up.shape != (3,) or not np.linalg.norm(up) > 0.0:
        raise ValueError("up_camera is not a direction")
    instant = parse_utc(utc)
    _, earth = erfa.epv00(*instant.tt)
    boresight = rotation[2]
    seen = aberrate(boresight[None], np.asarray(earth["v"]) * AU_PER_DAY_IN_C)[0]
    turn = Rotation.from_rotvec(np.cross(boresight, seen))  # of 0.1 mrad at most, where an angle is its sine
    inertial: NDArray[np.float64] = turn.apply(rotation.T @ up / np.linalg.norm(up))
    zenith = celestial_to_terrestrial(instant, earth_orientation(instant)) @ inertial
    return math.degrees(math.asin(max(-1.0, min(1.0, float(zenith[2]))))), math.degrees(
        math.atan2(zenith[1], zenith[0])
    )
