"""Constraints from a last known position: which stars each detection can be.

A place near the known one has its zenith near the known zenith, so a star's distance from that zenith is nearly the
detection's distance from the vertical. If the heading is known as well, the star's direction is also nearly known.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from celnav.attitude import Attitude
from celnav.horizon import horizontal_frame
from celnav.identification.sky_index import F4, F8
from celnav.identification.verification import Region
from celnav.problem import LastKnown
from celnav.sky.astrometry import enu_rotation
from celnav.sky.wgs84 import MEAN_RADIUS_KM

# Number of its standard deviations within which the attitude is trusted.
BELIEVED_SIGMAS = 4.0
# Margin of every limit for refraction and for the noise of a raw hypothesis, radians.
SLACK_RAD = math.radians(0.3)
# If the heading allows directions beyond this, the restriction is not worth its cost.
WIDEST_RAD = math.radians(60.0)


@dataclass(frozen=True, eq=False)
class Neighbourhood:
    """The zeniths and orientations that a last known position allows.

    Attributes
    ----------
    zenith : ndarray, shape (3,)
        ICRS direction of the last known position's zenith.
    up : ndarray, shape (3,)
        The vertical in the camera frame.
    radius_rad : float
        Largest distance of the true zenith from `zenith`, including the uncertainty of the vertical.
    camera_to_sky : ndarray, shape (3, 3), or None
        Orientation of a camera with the supplied heading at that position; None if the heading is unknown.
    reach_rad : float
        Largest distance of a star from the direction that this orientation gives.
    region : Region
        Orientations that remain possible.
    """

    zenith: F8
    up: F8
    radius_rad: float
    camera_to_sky: F8 | None
    reach_rad: float
    region: Region

    def allowed(self, rays: F4, stars: F4) -> NDArray[np.bool_]:
        """Return which stars, shape (n, 3), may be which rays, shape (m, 3); shape (m, n)."""
        of_star = np.arccos(np.clip(stars @ self.zenith.astype(np.float32), -1, 1))
        of_ray = np.arccos(np.clip(rays @ self.up.astype(np.float32), -1, 1))
        able = np.abs(of_ray[:, None] - of_star[None, :]) <= self.radius_rad
        if self.camera_to_sky is not None and self.reach_rad < WIDEST_RAD:
            able &= rays @ self.camera_to_sky.T.astype(np.float32) @ stars.T >= math.cos(self.reach_rad)
        return np.asarray(able)

    def holds(self, rotations: F4) -> NDArray[np.bool_]:
        """Return which orientations, camera to sky, shape (h, 3, 3), have an allowed zenith; shape (h,)."""
        cosine = (rotations @ self.up.astype(np.float32)) @ self.zenith.astype(np.float32)
        return np.asarray(cosine >= math.cos(self.radius_rad))


def neighbourhood(
    near: LastKnown, attitude: Attitude, to_terrestrial: F8, *, heading_known: bool
) -> Neighbourhood | None:
    """Derive the constraints from a last known position; None if it restricts nothing.

    Parameters
    ----------
    near : LastKnown
        The position, and the radius that contains the answer.
    attitude : Attitude
        The vertical, and the heading if known.
    to_terrestrial : ndarray, shape (3, 3)
        Rotation from the celestial to the terrestrial frame at the instant.
    heading_known : bool
        Whether the attitude is known so well that each hypothesis is a position.
    """
    moved = near.radius_km / MEAN_RADIUS_KM
    radius = moved + BELIEVED_SIGMAS * math.radians(attitude.tilt_deg) + SLACK_RAD
    if radius >= math.pi:
        return None
    to_enu = enu_rotation(near.lat_deg, near.lon_deg)
    zenith = to_terrestrial.T @ to_enu[2]
    frame = horizontal_frame(attitude)
    region = open_region(attitude, 2 * math.pi * (1 - math.cos(radius)), heading_known=heading_known)
    if attitude.kind != "rotation":
        return Neighbourhood(zenith, frame[:, 2], radius, None, math.pi, region)
    # Meridians converge: north rotates by the difference in longitude times the sine of the latitude.
    highest = min(abs(math.radians(near.lat_deg)) + moved, math.pi / 2)
    turn = moved * math.tan(highest) if highest < math.radians(89) else math.pi
    reach = min(radius + turn + BELIEVED_SIGMAS * math.radians(attitude.heading_deg), math.pi)
    return Neighbourhood(zenith, frame[:, 2], radius, (frame @ to_enu @ to_terrestrial).T, reach, region)


def open_region(attitude: Attitude | None, zeniths_sr: float = 4 * math.pi, *, heading_known: bool) -> Region:
    """Measure the set of orientations that the attitude allows if the zenith is within a given solid angle.

    A heading counts only if it is known so well that hypotheses are positions; its uncertainty is then added to them.
    """
    if attitude is None or not heading_known:
        return Region(zeniths_sr * 2 * math.pi, 3)
    headings = 2 * BELIEVED_SIGMAS * math.radians(max(attitude.heading_deg, attitude.tilt_deg))
    return Region(zeniths_sr * headings, 3) if headings > 0 else Region(zeniths_sr, 2)
