"""What a last known position says about the sky: which stars can stand where a detection is.

A place near the one known has its zenith near the one known, so that a star's distance from that zenith is nearly the
detection's distance from the vertical. Where the heading is known as well, so nearly is the star's direction.
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

# Standard deviations of the attitude within which it is believed.
BELIEVED_SIGMAS = 4.0
# Added to every limit: refraction and noise of a raw hypothesis, radians.
SLACK_RAD = math.radians(0.3)
# Beyond it the directions that the heading allows are no restriction worth its cost.
WIDEST_RAD = math.radians(60.0)


@dataclass(frozen=True, eq=False)
class Neighbourhood:
    """The zeniths, and the orientations, that a last known position leaves.

    Attributes
    ----------
    zenith : ndarray, shape (3,)
        ICRS direction of the last known position's zenith.
    up : ndarray, shape (3,)
        The vertical in the camera frame.
    radius_rad : float
        How far the true zenith may be from `zenith`, the uncertainty of the vertical included.
    camera_to_sky : ndarray, shape (3, 3), or None
        Orientation of a camera of the heading given at that position; None where the heading is unknown.
    reach_rad : float
        How far a star may stand from the direction that this orientation gives.
    region : Region
        Orientations left open.
    """

    zenith: F8
    up: F8
    radius_rad: float
    camera_to_sky: F8 | None
    reach_rad: float
    region: Region

    def allowed(self, rays: F4, stars: F4) -> NDArray[np.bool_]:
        """Tell which stars, shape (n, 3), may be which rays, shape (m, 3); shape (m, n)."""
        of_star = np.arccos(np.clip(stars @ self.zenith.astype(np.float32), -1, 1))
        of_ray = np.arccos(np.clip(rays @ self.up.astype(np.float32), -1, 1))
        able = np.abs(of_ray[:, None] - of_star[None, :]) <= self.radius_rad
        if self.camera_to_sky is not None and self.reach_rad < WIDEST_RAD:
            able &= rays @ self.camera_to_sky.T.astype(np.float32) @ stars.T >= math.cos(self.reach_rad)
        return np.asarray(able)

    def holds(self, rotations: F4) -> NDArray[np.bool_]:
        """Tell which orientations, camera to sky, shape (h, 3, 3), have their zenith near; shape (h,)."""
        cosine = (rotations @ self.up.astype(np.float32)) @ self.zenith.astype(np.float32)
        return np.asarray(cosine >= math.cos(self.radius_rad))


def neighbourhood(
    near: LastKnown, attitude: Attitude, to_terrestrial: F8, *, heading_known: bool
) -> Neighbourhood | None:
    """Say what a last known position allows; None where that is no restriction.

    Parameters
    ----------
    near : LastKnown
        The position, and the radius that holds the answer.
    attitude : Attitude
        The vertical, and the heading where it is known.
    to_terrestrial : ndarray, shape (3, 3)
        Celestial to terrestrial frame at the instant.
    heading_known : bool
        Whether the attitude is known so well that hypotheses are places.
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
    # Meridians converge: north turns by the difference in longitude times the sine of the latitude.
    highest = min(abs(math.radians(near.lat_deg)) + moved, math.pi / 2)
    turn = moved * math.tan(highest) if highest < math.radians(89) else math.pi
    reach = min(radius + turn + BELIEVED_SIGMAS * math.radians(attitude.heading_deg), math.pi)
    return Neighbourhood(zenith, frame[:, 2], radius, (frame @ to_enu @ to_terrestrial).T, reach, region)


def open_region(attitude: Attitude | None, zeniths_sr: float = 4 * math.pi, *, heading_known: bool) -> Region:
    """Measure the orientations that the attitude leaves open where zeniths are those of a solid angle.

    A heading counts where it is known so well that hypotheses are places; what it leaves open is then added to them.
    """
    if attitude is None or not heading_known:
        return Region(zeniths_sr * 2 * math.pi, 3)
    headings = 2 * BELIEVED_SIGMAS * math.radians(max(attitude.heading_deg, attitude.tilt_deg))
    return Region(zeniths_sr * headings, 3) if headings > 0 else Region(zeniths_sr, 2)
