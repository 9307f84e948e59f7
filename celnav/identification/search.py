"""Hypotheses of the camera's orientation, and the scoring of thousands of them at once.

A hypothesis is a rotation from the camera to the sky (ICRS). If nothing is known, hypotheses come from pairs of detections.
If the attitude relative to the horizon is known, single detections suffice, because latitude and longitude are then the only
unknowns, and one star gives two equations.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from celnav.identification.sky_index import F4, F8, Level, SkyIndex, octahedral_cell

Pairs = NDArray[np.intp]

# Look-ups at a time. This many stay in the processor's cache, and their matrix products are too small for OpenBLAS to split
# over threads, which would cost more than it gains.
_BLOCK = 20_000
MOST_SLACK_RAD = 5.5e-4
# With fewer look-ups than this, all detections score all hypotheses.
_FEW_LOOKUPS = 12 * _BLOCK


@dataclass(frozen=True, eq=False)
class View:
    """Detections as used by the search, most promising first.

    Attributes
    ----------
    rays : ndarray of float32, shape (n, 3)
        Unit vectors in the camera frame, with refraction removed if the vertical is known.
    radians_per_px : ndarray of float32, shape (n,)
        Plate scale at each detection.
    """

    rays: F4
    radians_per_px: F4


def choose_pairs(rays: F4, ranks: tuple[int, int], lags: tuple[int, int], separation_rad: tuple[float, float]) -> Pairs:
    """Return pairs (p, 2) of rays whose separation is in a range.

    Ranks in brightness are in the range `ranks` and differ by `lags` (first and last, inclusive). Neighbours in brightness
    come first, so that bright clutter at the head of the list does not delay all pairs of true stars (this has the effect of
    the ordering of Mortari et al. 2004).
    """
    first, second = _all_pairs(ranks[1] - ranks[0])
    lag = second - first
    chosen = (lag >= lags[0]) & (lag <= lags[1])
    first, second, lag = first[chosen] + ranks[0], second[chosen] + ranks[0], lag[chosen]
    apart = rays[first] - rays[second]
    chord = np.sqrt(np.einsum("ni,ni->n", apart, apart))
    low, high = (2 * np.sin(min(angle, np.pi) / 2) for angle in separation_rad)
    good = np.flatnonzero((chord >= low) & (chord <= high))
    order = good[np.lexsort((first[good], lag[good]))]
    return np.column_stack((first[order], second[order]))


@lru_cache(maxsize=4)
def _all_pairs(n: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    return np.triu_indices(n, 1)


def triads(a: F4, b: F4) -> F4:
    """Return orthonormal frames of pairs of unit vectors, shapes (3, n).

    Shape (3, 3, n): the axes (middle, normal and third), and the components of each. With the pairs last, every step passes
    over them in memory order, which takes a third of the time of matrix products.
    """
    frames = np.empty((3, *a.shape), dtype=a.dtype)
    np.add(a, b, out=frames[0])
    _cross(a, b, out=frames[1])
    for axis in frames[:2]:
        axis /= np.sqrt(np.einsum("in,in->n", axis, axis))
    _cross(frames[0], frames[1], out=frames[2])
    return frames


def _cross(a: F4, b: F4, out: F4) -> None:
    """Write the cross products of vectors, shapes (3, n)."""
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        np.multiply(a[i], b[j], out=out[k])
        out[k] -= a[j] * b[i]


def pair_hypotheses(
    view: View,
    pairs: Pairs,
    level: Level,
    axes: tuple[F4, F4, F4],
    sigma_px: float,
    slack: tuple[float, float],
    at_once: int,
    allowed: NDArray[np.bool_] | None = None,
) -> Iterator[tuple[F4, int]]:
    """Yield rotations from camera to sky, shape (h, 3, 3), that map a pair of detections onto a pair of stars.

    Each array comes with the number of rotations that were skipped because `allowed` excludes them.

    Parameters
    ----------
    view : View
        Detections.
    pairs : ndarray, shape (p, 2)
        Pairs of detections.
    level : Level
        Stars.
    axes : tuple of three ndarrays, shape (n,)
        Components of the stars' unit vectors.
    sigma_px : float
        Standard deviation of a centroid along each axis; separations may differ by 3.5 times their own.
    slack : tuple of float
        Additional tolerance: radians, and a fraction of the separation (up to `MOST_SLACK_RAD`).
    at_once : int
        Largest number of rotations in one array.
    allowed : ndarray of bool, shape (m, n), optional
        Which of the level's stars each of the first m detections may be.
    """
    i, j = pairs.T
    a, b = view.rays[i], view.rays[j]
    separation = 2 * np.arcsin(np.minimum(np.linalg.norm(a - b, axis=1) / 2, 1.0))
    tolerance = 3.5 * sigma_px * np.hypot(view.radians_per_px[i], view.radians_per_px[j]) + slack[0]
    tolerance += np.minimum(slack[1] * separation, MOST_SLACK_RAD)
    low = np.searchsorted(level.separation_rad, (separation - tolerance).astype(np.float32))
    end = np.cumsum(np.searchsorted(level.separation_rad, (separation + tolerance).astype(np.float32)) - low)
    start = np.concatenate(([0], end[:-1]))
    seen = triads(np.ascontiguousarray(a.T), np.ascontiguousarray(b.T))
    total = int(end[-1]) if len(end) else 0
    # Each matching pair of stars gives two rotations, since the pair may be either way round.
    parts = math.ceil(2 * total / at_once)
    for part in range(parts):
        fitting = np.arange(part * total // parts, (part + 1) * total // parts)
        of_pair = np.searchsorted(end, fitting, side="right")
        rows = fitting - start[of_pair] + low[of_pair]
        first, second = level.first[rows], level.second[rows]
        if allowed is not None:
            one, other = i[of_pair], j[of_pair]
            forth = np.flatnonzero(allowed[one, first] & allowed[other, second])
            back = np.flatnonzero(allowed[one, second] & allowed[other, first])
            of_pair = np.concatenate((of_pair[forth], of_pair[back]))
            first, second = (
                np.concatenate((first[forth], second[back])),
                np.concatenate((second[forth], first[back])),
            )
            oriented = turns(_stars(axes, first), _stars(axes, second), seen.take(of_pair, axis=2))
            yield oriented, 2 * len(rows) - len(first)
            continue
        middle, beside = _shares(_stars(axes, first), _stars(axes, second), seen.take(of_pair, axis=2))
        yield _matrices(np.concatenate((middle + beside, middle - beside), axis=2)), 0


def turns(a: F4, b: F4, seen: F4) -> F4:
    """Return rotations, shape (n, 3, 3), that map frames `seen`, shape (3, 3, n), onto those of pairs, shapes (3, n)."""
    middle, beside = _shares(a, b, seen)
    return _matrices(middle + beside)


def _shares(a: F4, b: F4, seen: F4) -> tuple[F4, F4]:
    """Return two terms, shapes (3, 3, n), whose sum is what `turns` returns, and whose difference is that for (b, a)."""
    of_sky = triads(a, b)
    beside = of_sky[1, :, None] * seen[1, None]
    beside += of_sky[2, :, None] * seen[2, None]
    return of_sky[0, :, None] * seen[0, None], beside


def _stars(axes: tuple[F4, F4, F4], rows: NDArray[np.integer]) -> F4:
    """Return unit vectors of stars, shape (3, n)."""
    return np.stack([axis.take(rows) for axis in axes])


def _matrices(planes: F4) -> F4:
    """Put the indices of matrices, shape (3, 3, n), last."""
    return np.ascontiguousarray(planes.transpose(2, 0, 1))


def single_star_hypotheses(dirs_enu: F8, stars_itrs: F8) -> tuple[F8, F8, NDArray[np.intp]]:
    """Return latitudes and longitudes, radians, at which a star is seen in a direction, and the row of that direction.

    Every direction, shape (b, 3), is combined with every star, shape (n, 3): the star's height above the equator fixes the
    latitude, for which there may be two solutions, and its hour angle then fixes the longitude.
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
    """Return rotations from the terrestrial frame to east-north-up, shape (h, 3, 3)."""
    sin_lat, cos_lat, sin_lon, cos_lon = np.sin(lat_rad), np.cos(lat_rad), np.sin(lon_rad), np.cos(lon_rad)
    rows = (
        (-sin_lon, cos_lon, np.zeros_like(sin_lon)),
        (-sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat),
        (cos_lat * cos_lon, cos_lat * sin_lon, sin_lat),
    )
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def nearest_stars(rotations: F4, rays: F4, level: Level, index: SkyIndex) -> tuple[NDArray[np.integer], F4]:
    """Return the catalogue star nearest to each ray under each rotation, and the squared chord; shapes (h, m)."""
    sky = (rotations.transpose(1, 0, 2).reshape(-1, 3) @ rays.T).reshape(3, -1)
    star = level.nearest.take(octahedral_cell(*sky), mode="clip")
    square = np.zeros(sky.shape[1], dtype=np.float32)
    for component, of_stars in zip(sky, index.axes, strict=True):
        component -= of_stars.take(star, mode="clip")
        component *= component
        square += component
    shape = len(rotations), len(rays)
    return star.reshape(shape), square.reshape(shape)


def soft_count(rotations: F4, rays: F4, inverse_square_tolerance: F4, level: Level, index: SkyIndex) -> F4:
    """Score hypotheses: the sum over detections of max(0, 1 - (distance / tolerance)^2), shape (h,)."""
    scores = np.empty(len(rotations), dtype=np.float32)
    step = max(1, _BLOCK // max(1, len(rays)))
    for start in range(0, len(rotations), step):
        _, square = nearest_stars(rotations[start : start + step], rays, level, index)
        square *= -inverse_square_tolerance
        square += 1
        scores[start : start + step] = np.maximum(square, 0, out=square).sum(axis=1)
    return scores


def scoring_work(n_rotations: int, n_rays: int, first_look: int) -> int:
    """Return the number of look-ups that `best_hypotheses` takes."""
    if n_rotations * n_rays <= _FEW_LOOKUPS or n_rays <= first_look:
        return n_rotations * n_rays
    return n_rotations * first_look + _kept(n_rotations) * n_rays


def _kept(n_rotations: int) -> int:
    """Return how many hypotheses pass the first look."""
    return min(n_rotations, max(400, n_rotations // 4))


def best_hypotheses(
    rotations: F4, view: View, tolerance_px: float, level: Level, index: SkyIndex, most: int, first_look: int
) -> tuple[F4, F4]:
    """Return the rotations with the highest soft counts (at most `most`), and those counts.

    If there are many hypotheses, they are first scored by `first_look` detections, and only the better quarter by all.
    """
    weight = (1.0 / (tolerance_px * view.radians_per_px) ** 2).astype(np.float32)
    if len(rotations) * len(view.rays) > _FEW_LOOKUPS and len(view.rays) > first_look:
        # Spread over all ranks, because the brightest may be clutter.
        few = np.linspace(0, len(view.rays) - 1, first_look).astype(np.intp)
        first = soft_count(rotations, view.rays[few], weight[few], level, index)
        kept = _kept(len(rotations))
        if kept < len(rotations):
            rotations = rotations[np.argpartition(-first, kept)[:kept]]
    scores = soft_count(rotations, view.rays, weight, level, index)
    top = np.argsort(-scores, kind="stable")[: 8 * most]
    # Hypotheses that differ by a rotation of less than the tolerance are the same one.
    limit = 3 - (2 * tolerance_px * float(view.radians_per_px.max())) ** 2
    turn = np.einsum("aij,bij->ab", rotations[top], rotations[top])
    chosen: list[int] = []
    for k in range(len(top)):
        if not (turn[k, chosen] > limit).any():
            chosen.append(k)
        if len(chosen) == most:
            break
    return rotations[top[chosen]], scores[top[chosen]]


def polish(rotations: F4, view: View, tolerance_px: float, level: Level, index: SkyIndex) -> tuple[F8, F8]:
    """Refine hypotheses, shape (h, 3, 3), to the least-squares rotation of the stars that they explain, twice.

    Returns
    -------
    tuple of two ndarrays
        The rotations, camera to sky, and their soft counts, shape (h,).
    """
    current = rotations.astype(np.float64)
    rays = view.rays.astype(np.float64)
    limit = (tolerance_px * view.radians_per_px) ** 2
    weight = 1.0 / view.radians_per_px.astype(np.float64) ** 2
    score = np.zeros(len(current))
    for last in (False, False, True):
        star, square = nearest_stars(current.astype(np.float32), view.rays, level, index)
        near = square <= limit
        score = np.maximum(0, 1 - square / limit).sum(axis=1).astype(np.float64)
        if last:
            break
        fixed = near.sum(axis=1) >= 2
        turned = wahba(rays, index.xyz[star].astype(np.float64), np.where(near, weight, 0.0))
        current = np.where(fixed[:, None, None], turned, current)
    return current, score


def wahba(rays: F8, stars: F8, weight: F8) -> F8:
    """Return the rotations R, shape (h, 3, 3), that minimise the weighted sums of |stars - R rays|^2.

    Computed by singular value decomposition (Markley 1988, J. Astronaut. Sci. 36, 245).

    Parameters
    ----------
    rays : ndarray, shape (m, 3)
        Unit vectors.
    stars : ndarray, shape (h, m, 3)
        The same in the other frame, for each rotation.
    weight : ndarray, shape (h, m)
        Weights.
    """
    u, _, vt = np.linalg.svd(np.swapaxes(stars * weight[:, :, None], 1, 2) @ rays)
    proper = np.ones((len(u), 1, 3))
    proper[:, 0, 2] = np.sign(np.linalg.det(u @ vt))
    return np.asarray((u * proper) @ vt)
