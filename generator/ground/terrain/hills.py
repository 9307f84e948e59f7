"""Hills of an elevation raster as a panorama, with skylines in front of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from generator.ground.panorama import Panorama
from generator.ground.skylines.canvas import Canvas, covered, smooth_noise
from generator.ground.skylines.draw import draw_skylines
from generator.ground.skylines.hills import SLOPE_COLOUR
from generator.ground.terrain.geotiff import Elevation
from generator.ground.terrain.outlook import outlook


def terrain_panorama(
    elevation: Elevation,
    place: tuple[float, float],
    eye_height_m: float,
    skylines: Sequence[str],
    rng: np.random.Generator,
    glow_cd_m2: float,
) -> Panorama:
    """Panorama of the terrain around a place, and of skylines in front of it.

    Parameters
    ----------
    elevation : Elevation
    place : (latitude, longitude)
        Geodetic position, deg.
    eye_height_m : float
        Height above the raster's ground at the place.
    skylines : sequence of str
        Skylines drawn in front, in this order.
    rng : Generator
        Random generator for the texture and the skylines.
    glow_cd_m2 : float

    Raises
    ------
    ElevationError
        The raster has no height at the place.
    """
    canvas = Canvas(rng, grass=False)
    _draw(canvas, elevation, place, eye_height_m)
    draw_skylines(canvas, skylines)
    return canvas.panorama(glow_cd_m2)


def _draw(canvas: Canvas, elevation: Elevation, place: tuple[float, float], eye_height_m: float) -> None:
    """Draw the ground, each texel at the distance of the nearest ground in its direction."""
    seen = outlook(elevation, place, eye_height_m, canvas.azimuth_deg, canvas.altitude_deg)
    patch = canvas.whole(-90.0, float(seen.edge_deg.max()))
    alpha = covered(seen.edge_deg[None, :], patch.altitude_deg[:, None], canvas.step_deg)
    # The uppermost texels are partly hidden by ground that does not reach their centres.
    distance = seen.distance_m[patch.rows]
    nearest = np.where(np.isfinite(distance), distance, np.roll(distance, -1, axis=0))
    nearest = np.where(np.isfinite(nearest), nearest, 0.0)
    # Closer than the raster's step, the ground is a plane.
    down = np.sin(np.radians(np.maximum(-patch.altitude_deg, 1e-3)))[:, None]
    flat = np.where(patch.altitude_deg[:, None] < 0, eye_height_m / down, np.inf)
    speckle = 1 + 0.2 * smooth_noise(canvas.rng, patch.shape, 2.0)
    canvas.draw(patch, alpha, SLOPE_COLOUR * speckle[..., None], np.minimum(nearest, flat))
