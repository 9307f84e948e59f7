"""True attitude of a camera, found from the stars of a photograph whose place and time are known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from benchmark.photographed.star_light import star_light
from benchmark.photographed.view import on_mask
from celnav.camera import Camera

Floats = NDArray[np.float64]

ROUNDS = ((6.0, 8.0), (3.0, 5.0), (1.5, 2.5))
"""For each round, the distance within which a star is searched, px, and the least SNR of stars that count."""
LEAST_STARS = 8
FIRST_STEP_PX, FIRST_STEPS = 4.0, 3
"""Step between the positions tried around the supplied attitude, and their number on either side, along both axes."""
FIRST_ROLLS_DEG = (0.0, -0.4, 0.4)
FIRST_SNR, ENOUGH = 8.0, 0.5
"""SNR of a star that counts in these tries, and the share of all stars from which the supplied attitude is accepted."""
SCALE_PX = 0.15
"""Residual from which a star has less weight."""


@dataclass(frozen=True, eq=False)
class Alignment:
    """An attitude derived from the stars.

    Attributes
    ----------
    R_cam : (3, 3) array
        ENU to camera.
    stars : int
        Number of stars that agree; with fewer than `LEAST_STARS` the attitude is the supplied one.
    rms_px : float
        Root mean square of their residuals along each axis.
    turned_deg : float
        Angle between the supplied and the found attitude.
    """

    R_cam: Floats
    stars: int
    rms_px: float
    turned_deg: float


def directions(azimuth_deg: Floats, altitude_deg: Floats) -> Floats:
    """Unit vectors east, north, up, (n, 3)."""
    azimuth, altitude = np.radians(azimuth_deg), np.radians(altitude_deg)
    level = np.cos(altitude)
    return np.column_stack((np.sin(azimuth) * level, np.cos(azimuth) * level, np.sin(altitude)))


def align(
    pixels: NDArray[np.floating], sky: NDArray[np.bool_], camera: Camera, R_cam: Floats, stars_enu: Floats
) -> Alignment:
    """Find the attitude near a supplied one at which stars (n, 3), apparent directions, match lights of the photograph.

    `sky` is the mask of sky pixels. Stars are searched around their expected positions within ever smaller distances;
    residuals beyond `SCALE_PX` have less weight (soft L1).
    """
    turned, kept, residuals = _first_turn(pixels, sky, camera, np.asarray(R_cam), stars_enu), 0, np.zeros((0, 2))
    for search_px, least_snr in ROUNDS:
        uv = camera.project(stars_enu @ (turned @ R_cam).T)
        usable = on_mask(uv, sky)
        light = star_light(pixels, np.where(usable[:, None], uv, np.nan), search_px)
        seen = np.isfinite(light.flux) & (light.snr > least_snr) & (np.hypot(*(light.uv - uv).T) < search_px)
        if seen.sum() < LEAST_STARS:
            return Alignment(np.asarray(R_cam), int(seen.sum()), float("nan"), 0.0)
        enu, measured = stars_enu[seen], light.uv[seen]

        def misses(vector: Floats, enu: Floats = enu, measured: Floats = measured) -> Floats:
            rotation = Rotation.from_rotvec(vector).as_matrix()
            return np.asarray((camera.project(enu @ (rotation @ R_cam).T) - measured).ravel())

        start = Rotation.from_matrix(turned).as_rotvec()
        found = least_squares(misses, start, loss="soft_l1", f_scale=SCALE_PX, x_scale=1e-3)
        turned = Rotation.from_rotvec(found.x).as_matrix()
        residuals = misses(found.x).reshape(-1, 2)
        residuals = residuals[np.hypot(*residuals.T) < 4 * SCALE_PX]
        kept = len(residuals)
    if kept < LEAST_STARS:
        return Alignment(np.asarray(R_cam), kept, float("nan"), 0.0)
    angle_deg = float(np.degrees(Rotation.from_matrix(turned).magnitude()))
    return Alignment(turned @ R_cam, kept, float(np.sqrt((residuals**2).mean())), angle_deg)


def _first_turn(
    pixels: NDArray[np.floating], sky: NDArray[np.bool_], camera: Camera, R_cam: Floats, stars_enu: Floats
) -> Floats:
    """Rotation from the supplied attitude at which most stars match lights, for a mount that moved by many pixels."""

    def part_on_lights(turn: Floats) -> float:
        uv = camera.project(stars_enu @ (turn @ R_cam).T)
        usable = on_mask(uv, sky)
        light = star_light(pixels, np.where(usable[:, None], uv, np.nan), FIRST_STEP_PX / 2)
        near = np.hypot(*(light.uv - uv).T) < FIRST_STEP_PX
        return float(((light.snr > FIRST_SNR) & near).sum()) / max(int(usable.sum()), 1)

    best, turned = part_on_lights(np.eye(3)), np.eye(3)
    if best >= ENOUGH:
        return turned
    steps = np.arange(-FIRST_STEPS, FIRST_STEPS + 1) * FIRST_STEP_PX / camera.f_px
    for roll_deg in FIRST_ROLLS_DEG:
        for about_right in steps:
            for about_down in steps:
                turn = Rotation.from_rotvec([about_right, about_down, np.radians(roll_deg)]).as_matrix()
                found = part_on_lights(turn)
                if found > best:
                    best, turned = found, turn
    return np.asarray(turned)
