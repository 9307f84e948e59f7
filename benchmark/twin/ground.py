"""Landscape in front of a fixed camera, derived from several of its photographs, for its scenario."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_closing, binary_dilation, find_objects, gaussian_filter, label, median, minimum

from benchmark.errors import PhotographError
from benchmark.photographed.view import View
from celnav.camera import Camera

Mask = NDArray[np.bool_]
Singles = NDArray[np.float32]

RING_DEG = 1.0
"""Width of the rings of equal altitude within which pixels are compared."""
SECTORS = 72
NEIGHBOUR_SECTORS = 5
"""Number of sectors on either side from which the level of the sky is taken: 25 deg."""
SKY_QUANTILE = 0.75
"""Quantile of a ring's pixels around an azimuth: the level of the sky even where two thirds of them are ground."""
GROUND_PART, MOST_FRAMES = 0.8, 0.7
"""Light relative to that level below which a pixel is dark, and the fraction of photographs in which ground is dark."""
HIGHEST_DEG = 35.0
"""Nothing on the ground reaches higher; the sky above is not classified."""
LEAST_PX = 150
"""Least size of a connected area; smaller ones are scratches and dust."""
AREA_PART = 0.7
"""Largest median light of such an area relative to the level of the sky: on photographs trees and walls have 0.38 to 0.66 of
it, the sky next to the glow of a city 0.78 to 0.82."""
STANDING_DEG = 8.0
"""Altitude below which an area that stands on the ground must begin, and below which the ground is closed."""
CLOSED_PX = 3
PICTURE_PX = 1024
SKY_BESIDE_DEG = (10.0, 20.0)
"""Altitudes of the sky that lights what stands on the ground."""
SHADED_PART = 0.25
"""Fraction of the photographs in which the Moon is assumed not to shine on a surface."""
DARKEST, BRIGHTEST = 0.03, 0.95
"""Diffuse reflectances, from dark needles to white paint."""
DARK_SHARE = 0.05
"""Fraction of the ground that has the first of them."""
BESIDE_PX = 15
"""Width of the sky with which an area of a mask is compared."""
MASKED_PX = 2048
"""Side of the picture of a mask, whose pixels are finer: 11 per degree."""
DARK_PART = 0.15
"""Light of dark trees and walls relative to the sky's: 0.08 to 0.25 on an all-sky camera's photographs; with this value a
meteor camera keeps its black level in April 2023."""
MASKED = 2 * DARK_PART
"""Reflectance of what a mask hides, as if it were a wall, which is lit by half of the sky."""
UNSEEN = 0.07
"""Reflectance of ground that no photograph shows."""
MOST_MOVED_DEG = 1.0
"""Largest difference of a pixel's direction between photographs of one ground: the width of a ring of equal altitude."""
CHECKED = 9
"""Pixels along a side of the frame whose directions are compared."""


def check_fixed(name: str, own: tuple[Camera, NDArray[np.float64]], first: tuple[Camera, NDArray[np.float64]]) -> None:
    """Refuse a photograph whose camera looks elsewhere than the first one's; each is a camera with its ENU to camera.

    Raises
    ------
    PhotographError
        The pixels of the two cameras differ by more than `MOST_MOVED_DEG`; the message begins with the photograph's name.
    """
    v, u = np.meshgrid(
        *(np.linspace(0, side - 1, CHECKED) for side in (first[0].height, first[0].width)), indexing="ij"
    )
    uv = np.column_stack((u.ravel(), v.ravel()))
    ours, theirs = (camera.to_rays(uv) @ R_cam for camera, R_cam in (own, first))
    # The chord, which small angles do not round to 0 as their cosine does.
    chord = np.linalg.norm(ours - theirs, axis=1)
    moved_deg = float(np.degrees(2 * np.arcsin(min(1.0, np.nanmax(chord, initial=0.0) / 2))))
    if moved_deg > MOST_MOVED_DEG:
        raise PhotographError(
            f"{name}: its camera looks up to {moved_deg:.3g} deg away from where that of the first photograph looks; "
            "the ground needs photographs of one fixed camera"
        )


def ground_mask(frames: Sequence[NDArray[np.floating]], view: View) -> Mask:
    """Find the ground pixels, (height, width), from photographs minus their dark level, in DN.

    In most of the photographs the ground is darker than the sky next to it at the same altitude. Sky is visible between and
    under branches; only below `STANDING_DEG` is everything below the highest ground at an azimuth ground.
    """
    altitude = view.altitude_deg
    near = (altitude > 0) & (altitude < HIGHEST_DEG)
    parts = np.stack([_part_of_sky(frame, view, near) for frame in frames])
    dark = near & (np.quantile(parts, MOST_FRAMES, axis=0) < GROUND_PART)
    dark = binary_closing(dark, iterations=CLOSED_PX) & near
    areas, count = label(dark)
    lowest = minimum(altitude, areas, np.arange(count + 1))
    large = np.asarray(np.bincount(np.asarray(areas).ravel()) >= LEAST_PX)
    low = np.asarray(lowest) < STANDING_DEG
    typical = median(np.quantile(parts, MOST_FRAMES, axis=0), areas, np.arange(count + 1))
    kept = np.flatnonzero(large & low & (np.asarray(typical) < AREA_PART))
    return _down_to_the_horizon(np.asarray(np.isin(areas, kept[kept > 0])), view)


def widened(mask: Mask, by_px: int) -> Mask:
    """Widen a mask by some pixels."""
    return np.asarray(binary_dilation(mask, iterations=by_px)) if by_px else mask


def ground_reflectance(frames: Sequence[NDArray[np.floating]], view: View, ground: Mask) -> Singles:
    """Diffuse reflectance of the ground, (height, width), from the same photographs; `UNSEEN` elsewhere.

    A wall is lit by half of the sky: under a uniform sky of radiance L it reflects a radiance of reflectance times L / 2
    (Lambert's law). The light that the lens scatters onto the ground is estimated from its darkest pixels.
    """
    beside = ~ground & (view.altitude_deg >= SKY_BESIDE_DEG[0]) & (view.altitude_deg < SKY_BESIDE_DEG[1])
    shown = ground & (view.altitude_deg > 0)
    found = np.full(ground.shape, UNSEEN, dtype=np.float32)
    if not shown.any() or not beside.any():
        return found
    parts = [
        gaussian_filter(frame.astype(np.float32), 1.0) / max(float(np.median(frame[beside])), 1e-3) for frame in frames
    ]
    part = np.quantile(np.stack([each[shown] for each in parts]), SHADED_PART, axis=0)
    scattered = float(np.quantile(part, DARK_SHARE)) - DARKEST / 2
    found[shown] = np.clip(2 * (part - scattered), DARKEST, BRIGHTEST)
    return found


def masked_picture(
    pixels: NDArray[np.floating], black: float, not_sky: Mask, camera: Camera, R_cam: NDArray[np.float64]
) -> NDArray[np.uint8]:
    """What a mask (height, width) hides, as a landscape's picture of one reflectance.

    Areas that a photograph shows as bright as the sky beside them are not ground, because masks also hide what shines or
    moves. `black` is the photograph's DN without light.
    """
    areas, _ = label(not_sky)
    ground = np.zeros(not_sky.shape, dtype=bool)
    for number, place in enumerate(find_objects(areas), start=1):
        rows, columns = (slice(max(side.start - BESIDE_PX, 0), side.stop + BESIDE_PX) for side in place)
        area, light = areas[rows, columns] == number, pixels[rows, columns] - black
        beside = binary_dilation(area, iterations=BESIDE_PX) & ~not_sky[rows, columns]
        if not beside.any() or np.median(light[area]) < AREA_PART * np.median(light[beside]):
            ground[rows, columns] |= area
    return landscape_picture(ground, np.full(ground.shape, MASKED, dtype=np.float32), camera, R_cam, MASKED_PX)


def landscape_picture(
    ground: Mask, reflectance: Singles, camera: Camera, R_cam: NDArray[np.float64], side_px: int = PICTURE_PX
) -> NDArray[np.uint8]:
    """The ground as a fisheye picture, (side, side, 4) sRGB and alpha: north at the top, east on the left, 180 deg across.

    White represents a reflectance of 1.
    """
    middle = (side_px - 1) / 2
    v, u = np.mgrid[0:side_px, 0:side_px]
    zenith_distance = np.radians(np.hypot(u - middle, v - middle) / (side_px / 2) * 90)
    azimuth = np.arctan2(-(u - middle), -(v - middle))
    level = np.sin(zenith_distance)
    enu = np.stack((np.sin(azimuth) * level, np.cos(azimuth) * level, np.cos(zenith_distance)), axis=-1).reshape(-1, 3)
    at = camera.project(enu @ R_cam.T)
    known = np.asarray(np.isfinite(at).all(axis=1))
    pixel = np.rint(np.where(known[:, None], at, -1)).astype(np.int64)
    height, width = ground.shape
    known &= ((pixel >= 0) & (pixel < [width, height])).all(axis=1)
    picture = np.zeros((side_px**2, 4), dtype=np.uint8)
    picture[:, :3] = _srgb(np.array(UNSEEN))
    picture[known, :3] = _srgb(reflectance[pixel[known, 1], pixel[known, 0]])[:, None]
    picture[known, 3] = 255 * ground[pixel[known, 1], pixel[known, 0]]
    return picture.reshape(side_px, side_px, 4)


def _srgb(linear: NDArray[np.floating]) -> NDArray[np.uint8]:
    """Encode linear values from 0 to 1 by the transfer curve of IEC 61966-2-1."""
    curve = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 0.0031308) ** (1 / 2.4) - 0.055)
    return np.asarray(np.rint(255 * curve), dtype=np.uint8)


def _part_of_sky(frame: NDArray[np.floating], view: View, near: Mask) -> Singles:
    """Light relative to the level of the sky at the same altitude, (height, width); 1 where it is not requested."""
    smooth = gaussian_filter(frame.astype(np.float32), 1.0)
    part = np.ones(frame.shape, dtype=np.float32)
    ring = (view.altitude_deg[near] / RING_DEG).astype(int)
    sector = (view.azimuth_deg[near] / 360 * SECTORS).astype(int) % SECTORS
    values, found = smooth[near], np.ones(int(near.sum()), dtype=np.float32)
    for number in np.unique(ring):
        on_ring = np.flatnonzero(ring == number)
        light, sectors = values[on_ring], sector[on_ring]
        level = np.ones(SECTORS, dtype=np.float32)
        for each in np.unique(sectors):
            beside = np.abs((sectors - each + SECTORS // 2) % SECTORS - SECTORS // 2) <= NEIGHBOUR_SECTORS
            level[each] = np.quantile(light[beside], SKY_QUANTILE)
        found[on_ring] = light / np.maximum(level[sectors], 1e-3)
    part[near] = found
    return part


def _down_to_the_horizon(ground: Mask, view: View) -> Mask:
    """Fill a mask, in each third of a degree of azimuth, below its highest pixel under `STANDING_DEG`."""
    column = np.nan_to_num(view.azimuth_deg * 3).astype(int) % 1080
    highest = np.full(1080, -np.inf)
    low = ground & (view.altitude_deg < STANDING_DEG)
    np.maximum.at(highest, column[low], view.altitude_deg[low].astype(np.float64))
    return np.asarray((view.altitude_deg <= highest[column]) | ground)
