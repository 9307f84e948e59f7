"""Hypotheses of the camera's orientation, and the scoring of thousands of them at once.

A hypothesis is a rotation from the camera to the sky (ICRS). Pairs of detections give them where nothing is known;
single detections do where the attitude to the horizon is known, because latitude and longitude are then the only
unknowns and one star gives two equations.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from celnav.identification.sky_index import F4, F8, Level, octahedral_cell

Pairs = NDArray[np.intp]

# Lookups at a time: they stay in the processor's cache, and the matrix products below what OpenBLAS splits over threads,
# which costs more than it gains.
_BLOCK = 20_000


@dataclass(frozen=True, eq=False)
class View:
    """Detections as the search sees them, most promising first.

    Attributes
    ----------
    rays : ndarray of float32, shape (n, 3)
        Unit vectors in the camera frame, refraction taken off where the vertical is known.
    radians_per_px : ndarray of float32, shape (n,)
        Scale at each detection.
    """

    rays: F4
    radians_per_px: F4


def choose_pairs(rays: F4, ranks: tuple[int, int], lags: tuple[int, int], separation_rad: tuple[float, float]) -> Pairs:
    """Return pairs (p, 2) of rays whose separation lies in a range.

    Ranks in brightness lie in the range `ranks`, and differ by `lags` (first and last, inclusive): neighbours in
    brightness come first, so that a crowd of bright clutter at the head of the list does not keep all pairs of true
    stars waiting (the ordering of Mortari et al. 2004 in its effect).
    """
    first, second = np.triu_indices(ranks[1] - ranks[0], 1)
    lag = second - first
    chosen = (lag >= lags[0]) & (lag <= lags[1])
    first, second, lag = first[chosen] + ranks[0], second[chosen] + ranks[0], lag[chosen]
    chord = np.linalg.norm(rays[first] - rays[second], axis=1)
    low, high = (2 * np.sin(min(angle, np.pi) / 2) for angle in separation_rad)
    good = np.flatnonzero((chord >= low) & (chord <= high))
    order = good[np.lexsort((first[good], lag[good]))]
    return np.column_stack((first[order], second[order]))


def triads(a: F4, b: F4) -> F4:
    """Return orthonormal frames (n, 3, 3), in columns, of pairs of unit vectors: middle, normal, third."""
    middle = a + b
    middle /= np.linalg.norm(middle, axis=1, keepdims=True)
    normal = _cross(a, b)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return np.stack((middle, normal, _cross(middle, normal)), axis=2)


def _cross(a: F4, b: F4) -> F4:
    """Cross products of rows; `np.cross` takes ten times as long for a few hundred."""
    x, y, z = a.T
    p, q, r = b.T
    return np.stack((y * r - z * q, z * p - x * r, x * q - y * p), axis=1)


def pair_hypotheses(view: View, pairs: Pairs, level: Level, xyz: F4, sigma_px: float, slack_rad: float) -> F4:
    """Return rotations camera to sky, shape (h, 3, 3), that lay a pair of detections on a pair of stars.

    Parameters
    ----------
    view : View
        Detections.
    pairs : ndarray, shape (p, 2)
        Pairs of detections.
    level : Level
        Stars.
    xyz : ndarray, shape (n, 3)
        Their unit vectors.
    sigma_px : float
        Standard deviation of a centroid along each axis; separations may differ by 3.5 of their own.
    slack_rad : float
        Added to that.
    """
    i, j = pairs.T
    a, b = view.rays[i], view.rays[j]
    separation = 2 * np.arcsin(np.minimum(np.linalg.norm(a - b, axis=1) / 2, 1.0))
    tolerance = 3.5 * sigma_px * np.hypot(view.radians_per_px[i], view.radians_per_px[j]) + slack_rad
    low = np.searchsorted(level.separation_rad, (separation - tolerance).astype(np.float32))
    high = np.searchsorted(level.separation_rad, (separation + tolerance).astype(np.float32))
    count = high - low
    of_pair = np.repeat(np.arange(len(pairs)), count)
    rows = np.arange(len(of_pair)) - np.repeat(np.cumsum(count) - count, count) + low[of_pair]
    first, second = xyz[level.first[rows]], xyz[level.second[rows]]
    frames = triads(first, second)
    seen = np.swapaxes(triads(a, b), 1, 2)[of_pair]
    forward = frames @ seen
    frames[:, :, 1:] *= -1  # the pair the other way round
    return np.concatenate((forward, frames @ seen))


def single_star_hypotheses(dirs_enu: F8, stars_itrs: F8) -> tuple[F8, F8, NDArray[np.intp]]:
    """Return latitudes and longitudes, radians, at which a star stands in a direction, and whose direction it is.

    Every direction, shape (b, 3), is laid on every star, shape (n, 3): the star's height above the equator fixes the
    latitude, of which two may fit, and then its hour angle the longitude.
    """
    east, north, up = (axis[:, None] for axis in dirs_enu.T)
    x, y, z = (axis[None, :] for axis in stars_itrs.T)
    reach = np.hypot(north, up)
    ratio = z / np.maximum(reach, 1e-12)
    possible = np.abs(ratio) <= 1.0
    inclination = np.arcsin(np.clip(ratio, -1, 1))
    offset = np.arctan2(north, up)
    latitudes, longitudes, owners = [], [], []
    owner = np.broadcast_to(np.arange(len(dirs_enu))[:, None], ratio.shape)
    for root in (inclination, np.pi - inclination):
        latitude = np.remainder(root - offset + np.pi, 2 * np.pi) - np.pi
        toward = np.cos(latitude) * up - np.sin(latitude) * north
        longitude = np.arctan2(y, x) - np.arctan2(np.broadcast_to(east, latitude.shape), toward)
        good = possible & (np.abs(latitude) <= np.pi / 2)
        latitudes.append(latitude[good])
        longitudes.append(longitude[good])
        owners.append(owner[good])
    return np.concatenate(latitudes), np.concatenate(longitudes), np.concatenate(owners)


def enu_rotations(lat_rad: F8, lon_rad: F8) -> F8:
    """Return rotations from the terrestrial frame to east, north, up, shape (h, 3, 3)."""
    sin_lat, cos_lat, sin_lon, cos_lon = np.sin(lat_rad), np.cos(lat_rad), np.sin(lon_rad), np.cos(lon_rad)
    rows = (
        (-sin_lon, cos_lon, np.zeros_like(sin_lon)),
        (-sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat),
        (cos_lat * cos_lon, cos_lat * sin_lon, sin_lat),
    )
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def nearest_stars(rotations: F4, rays: F4, level: Level, xyz: F4) -> tuple[NDArray[np.int16], F4]:
    """Return the catalogue star nearest to each ray under each rotation, and the squared chord; shapes (h, m)."""
    sky = (rotations.reshape(-1, 3) @ rays.T).reshape(len(rotations), 3, len(rays))
    x, y, z = sky[:, 0], sky[:, 1], sky[:, 2]
    star = level.nearest.take(octahedral_cell(x, y, z), mode="clip")
    near = xyz.take(star, axis=0, mode="clip")
    square = near[..., 0] - x
    square *= square
    for k, component in ((1, y), (2, z)):
        difference = near[..., k] - component
        difference *= difference
        square += difference
    return star, square


def soft_count(rotations: F4, rays: F4, inverse_square_tolerance: F4, level: Level, xyz: F4) -> F4:
    """Score hypotheses: the sum over detections of max(0, 1 - (distance / tolerance)^2), shape (h,)."""
    scores = np.empty(len(rotations), dtype=np.float32)
    step = max(1, _BLOCK // max(1, len(rays)))
    for start in range(0, len(rotations), step):
        _, square = nearest_stars(rotations[start : start + step], rays, level, xyz)
        scores[start : start + step] = np.maximum(0, 1 - square * inverse_square_tolerance).sum(axis=1)
    return scores


def best_hypotheses(
    rotations: F4, view: View, tolerance_px: float, level: Level, xyz: F4, most: int, first_look: int = 36
) -> tuple[F4, F4, int]:
    """Return the rotations of the highest soft counts (at most `most`), those counts, and how many lookups it took.

    Many hypotheses are first scored by a few detections, and only the better quarter of them by all.
    """
    weight = (1.0 / (tolerance_px * view.radians_per_px) ** 2).astype(np.float32)
    lookups = 0
    if len(rotations) * len(view.rays) > 12 * _BLOCK and len(view.rays) > first_look:
        # Spread over all ranks: the brightest may be clutter.
        few = np.linspace(0, len(view.rays) - 1, first_look).astype(np.intp)
        first = soft_count(rotations, view.rays[few], weight[few], level, xyz)
        lookups += len(rotations) * first_look
        kept = max(400, len(rotations) // 4)
        if kept < len(rotations):
            rotations = rotations[np.argpartition(-first, kept)[:kept]]
    scores = soft_count(rotations, view.rays, weight, level, xyz)
    lookups += len(rotations) * len(view.rays)
    top = np.argsort(-scores, kind="stable")[: 8 * most]
    chosen: list[int] = []
    for k in top:
        # Hypotheses that turn the field by less than the tolerance are the same one.
        turn = np.trace(rotations[chosen] @ rotations[k].T, axis1=1, axis2=2) if chosen else np.empty(0)
        if not (turn > 3 - (2 * tolerance_px * float(view.radians_per_px.max())) ** 2).any():
            chosen.append(int(k))
        if len(chosen) == most:
            break
    return rotations[chosen], scores[chosen], lookups


def polish(rotation: F4, view: View, tolerance_px: float, level: Level, xyz: F4) -> tuple[F8, float]:
    """Turn a hypothesis to the least-squares rotation of the stars it explains, twice; also the soft count then.

    Wahba's problem by singular value decomposition (Markley 1988, J. Astronaut. Sci. 36, 245).
    """
    current = rotation.astype(np.float64)
    limit = (tolerance_px * view.radians_per_px) ** 2
    weight = 1.0 / view.radians_per_px.astype(np.float64) ** 2
    score = 0.0
    for last in (False, False, True):
        star, square = nearest_stars(current[None].astype(np.float32), view.rays, level, xyz)
        near = square[0] <= limit
        score = float(np.maximum(0, 1 - square[0] / limit).sum())
        if last or near.sum() < 2:
            break
        current = wahba(view.rays[near].astype(np.float64), xyz[star[0][near]].astype(np.float64), weight[near])
    return current, score


def wahba(rays: F8, stars: F8, weight: F8) -> F8:
    """Return the rotation R, shape (3, 3), that minimises the weighted sum of |stars - R rays|^2."""
    u, _, vt = np.linalg.svd((stars * weight[:, None]).T @ rays)
    return np.asarray(u @ np.diag([1.0, 1.0, float(np.sign(np.linalg.det(u) * np.linalg.det(vt)))]) @ vt)
