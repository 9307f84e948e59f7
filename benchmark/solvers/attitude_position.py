"""Conversion of an attitude among the stars to a position: the last step for solvers that only return an attitude."""

import dataclasses
import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

import celnav
from benchmark.protocol import CameraRecord, Observation
from benchmark.solvers.told_errors import covariance_of_told
from celnav.sky.astrometry import aberrate, celestial_to_terrestrial, earth_at, enu_rotation
from celnav.sky.earth_rotation import earth_orientation
from celnav.sky.refraction import unrefract_rays
from celnav.sky.utc import parse_utc
from celnav.sky.wgs84 import MEAN_RADIUS_KM

ROTATION_TOLERANCE = 1e-4
_LEAST_RAYS = 3
"""With fewer directions, a rotation remains undetermined."""
_GRID = 7
_LOWEST_SINE = 0.05
"""Sine of the altitude below which a direction of the grid over the frame contains no stars worth counting."""


def position_of_attitude(
    R_icrs_to_camera: ArrayLike,
    up_camera: ArrayLike,
    utc: str,
    seen: NDArray[np.float64],
    pressure_hpa: float,
    temperature_c: float,
) -> tuple[float, float]:
    """Find the place whose vertical points to where the frame's vertical does.

    An attitude that was fitted to catalogue directions has absorbed the effects of the Earth's motion and of the air on the
    stars used in the fit: annual aberration (at most 20.5 arcsec or 0.63 km) and refraction (60 arcsec or 1.8 km at an
    altitude of 45 deg). Both are removed for those stars. Refraction about the frame's vertical is removed from the observed
    directions, aberration is applied to the catalogue directions that the attitude assigns to them, and the least-squares
    rotation between the two takes the vertical to the sky. In the Earth's frame, this direction is the normal of the
    ellipsoid at the place. Parallax and diurnal aberration (0.3 arcsec, 10 m) are neglected.

    Parameters
    ----------
    R_icrs_to_camera : array_like, shape (3, 3)
        Rotation from catalogue directions (ICRS, at the frame's epoch, without aberration) to the camera frame: x right, y
        down, z along the boresight.
    up_camera : array_like, shape (3,)
        The zenith in the camera frame; any length.
    utc : str
        Mid-exposure.
    seen : ndarray, shape (n, 3)
        Directions of the stars used to fit the attitude, unit vectors in the camera frame, at least 3 (`rays_of_fit`).
    pressure_hpa, temperature_c : float
        Air at the observer; with pressure 0 there is no refraction.

    Returns
    -------
    (latitude_deg, longitude_deg) : float
        Geodetic, WGS84, east positive.

    Raises
    ------
    ValueError
        The matrix is no rotation, the vertical has length zero, or there are too few directions.

    References
    ----------
    S. E. Urban, P. K. Seidelmann (eds.), Explanatory Supplement to the Astronomical Almanac, 3rd ed., 2013, sections 7.2
    and 7.5 (aberration, CIO-based reduction); F. L. Markley, J. Astronaut. Sci. 36, 245, 1988 (the rotation by singular
    values).
    """
    rotation = np.asarray(R_icrs_to_camera, dtype=np.float64)
    up = np.asarray(up_camera, dtype=np.float64)
    if rotation.shape != (3, 3) or not np.abs(rotation @ rotation.T - np.eye(3)).max() < ROTATION_TOLERANCE:
        raise ValueError("R_icrs_to_camera is not a rotation matrix")
    if np.linalg.det(rotation) < 0.0:
        raise ValueError("R_icrs_to_camera is a reflection: check the handedness of the camera frame")
    if up.shape != (3,) or not np.linalg.norm(up) > 0.0:
        raise ValueError("up_camera is not a direction")
    if seen.ndim != 2 or seen.shape[1] != 3 or len(seen) < _LEAST_RAYS:
        raise ValueError(f"seen has shape {seen.shape}: 3 directions or more are needed")
    up = up / np.linalg.norm(up)
    instant = parse_utc(utc)
    above = unrefract_rays(seen, up, pressure_hpa, temperature_c)
    apparent = aberrate(seen @ rotation, earth_at(instant).beta)
    zenith = celestial_to_terrestrial(instant, earth_orientation(instant)) @ (best_rotation(apparent, above).T @ up)
    return math.degrees(math.asin(max(-1.0, min(1.0, float(zenith[2]))))), math.degrees(
        math.atan2(zenith[1], zenith[0])
    )


def covariance_of_attitude(
    cov_rad2: NDArray[np.float64], R_icrs_to_camera: NDArray[np.float64], place: tuple[float, float], told: Observation
) -> NDArray[np.float64]:
    """East-north covariance of a position, shape (2, 2), km^2, from that of an attitude and from the supplied uncertainties.

    Parameters
    ----------
    cov_rad2 : ndarray, shape (3, 3)
        Covariance of small rotations of the camera about its own axes.
    R_icrs_to_camera : ndarray, shape (3, 3)
    place : (float, float)
        Result of `position_of_attitude`.
    told : Observation
        Supplies the standard deviations of vertical and time.
    """
    instant = parse_utc(told.utc)
    to_enu = enu_rotation(*place) @ celestial_to_terrestrial(instant, earth_orientation(instant)) @ R_icrs_to_camera.T
    about = to_enu @ cov_rad2 @ to_enu.T
    # A rotation about north moves the zenith to the east, one about east moves it to the south.
    turned = np.array([[about[1, 1], -about[0, 1]], [-about[0, 1], about[0, 0]]])
    return MEAN_RADIUS_KM**2 * turned + covariance_of_told(place[0], told)


def best_rotation(before: NDArray[np.float64], after: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rotation, shape (3, 3), that best maps unit vectors `before` to `after`, both (n, 3): Wahba's problem."""
    u, _, vt = np.linalg.svd(after.T @ before)
    return np.asarray(u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt)


def rays_of_fit(camera: CameraRecord, uv: NDArray[np.float64], up_camera: NDArray[np.float64]) -> NDArray[np.float64]:
    """Directions of the stars used to fit an attitude: those that the solver names, otherwise a grid over the frame.

    Parameters
    ----------
    camera : CameraRecord
    uv : ndarray, shape (n, 2)
        Pixels of the detections that the solver has matched; may be empty.
    up_camera : ndarray, shape (3,)
        The zenith in the camera frame; the grid is restricted to the sky.

    Returns
    -------
    ndarray, shape (m, 3)
        Unit vectors in the camera frame.
    """
    lens = celnav.Camera.from_dict(dataclasses.asdict(camera))
    named = _finite(lens.to_rays(uv)) if len(uv) else np.empty((0, 3))
    if len(named) >= _LEAST_RAYS:
        return named
    grid = np.stack(np.meshgrid(np.linspace(0, camera.width - 1, _GRID), np.linspace(0, camera.height - 1, _GRID)), -1)
    rays = _finite(lens.to_rays(grid.reshape(-1, 2)))
    sky = rays[rays @ up_camera > _LOWEST_SINE]
    return sky if len(sky) >= _LEAST_RAYS else rays


def _finite(rays: NDArray[np.float64]) -> NDArray[np.float64]:
    """Drop pixels outside a fisheye's image circle, which have no direction."""
    return rays[np.isfinite(rays).all(axis=1)]
