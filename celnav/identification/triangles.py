"""Orientation and focal length of a narrow field, both unknown, from triangles of detections and triangles of stars.

Over a few degrees every lens is a similarity from the sky to the frame, so a triangle keeps its shape whatever the focal
length: the ratios of its sides and its sense of rotation identify it, and its size gives the focal length. Each star forms
triangles with its nearest neighbours in a level of the sky tables; the triangles of the brightest detections are looked up
among them. A triangle matches some hundred others; the remaining detections decide between the resulting orientations.

Sources: Valdes et al. 1995, "FOCAS Automatic Catalog Matching Algorithms", PASP 107, 1119 (ratios of sides); Lang et al.
2010, "Astrometry.net", AJ 139, 1782 (blind identification by shapes of a few stars, verified by all).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from celnav.camera import Camera
from celnav.identification.effort import BATCH_WORK, HYPOTHESIS_WORK, VERIFICATION_WORK, Effort
from celnav.identification.search import triads, turns
from celnav.identification.search_config import SearchConfig
from celnav.identification.sky_index import F4, F8, Level, SkyIndex, load_deep_sky_index, octahedral_cell
from celnav.identification.verification import Alignment, Region, verify

Rows = NDArray[np.intp]

# Each star forms triangles with two of this many nearest stars.
_NEIGHBOURS = 8
# Tolerance on the sides of matching triangles, as a fraction of the longest: noise, refraction and distortion.
_TOLERANCE = 0.004
# Thinner triangles are left out, because noise can reverse their sense of rotation.
_THINNEST = 0.15
# Triangles use this many of the brightest detections, and their longest side is at least this fraction of the frame's shorter
# side.
_BRIGHT, _SHORTEST_SIDE = 30, 0.12
# The level is the first with at least this many stars in one field; the brightest detections should be among them.
_IN_FIELD = 14
# Focal lengths that are searched together span this factor.
_SPAN = math.sqrt(2)
_SCORED, _TOLERANCE_PX, _CANDIDATES = 60, 5.0, 4
_AT_ONCE = 4_000
# Steps of the focal length that a verification counts: some 0.2 % each, a factor of 20 in all.
_FOCAL_STEPS = 2_000
ANY_FOCAL_LENGTH = Region(8 * math.pi**2 * _FOCAL_STEPS, 3)


@dataclass(frozen=True, eq=False)
class Triangles:
    """Triangles of stars, sorted by the cell of their shape.

    Attributes
    ----------
    stars : ndarray, shape (t, 3)
        Rows of the index: the corners opposite the longest, the middle and the shortest side.
    shape : ndarray of float32, shape (t, 2)
        Middle and shortest side over the longest; the latter is negative for the opposite sense of rotation.
    longest_rad : ndarray of float32, shape (t,)
        Longest side.
    cell : ndarray of int64, shape (t,)
        Cells of the shapes, ascending.
    """

    stars: NDArray[np.int32]
    shape: F4
    longest_rad: F4
    cell: NDArray[np.int64]


def find_narrow_field(
    uv: F8, size: tuple[int, int], focal_px: tuple[float, float], effort: Effort, config: SearchConfig
) -> tuple[Camera, Alignment] | None:
    """Find the orientation and focal length of a field of some 3 to 20 deg.

    Parameters
    ----------
    uv : ndarray, shape (n, 2)
        Detections, brightest first.
    size : tuple of int
        Width and height of the frame, pixels.
    focal_px : tuple of float
        Smallest and largest focal length.
    effort : Effort
        Budget of the search.
    config : SearchConfig
        False-alarm bound, and number of detections that verify.

    Returns
    -------
    tuple of Camera and Alignment, or None
        A pinhole camera and its orientation; None if no hypothesis passes.
    """
    index = load_deep_sky_index()
    first, last = focal_px
    steps = max(1, math.ceil(math.log(last / first) / math.log(_SPAN) - 1e-9))
    factor = (last / first) ** (1 / steps)
    for step in range(steps):
        focal = first * factor**step, first * factor ** (step + 1)
        found = _find(uv, size, focal, index, effort, config)
        if found is not None:
            return found
    return None


def _find(
    uv: F8, size: tuple[int, int], focal: tuple[float, float], index: SkyIndex, effort: Effort, config: SearchConfig
) -> tuple[Camera, Alignment] | None:
    """Search a narrow range of focal lengths."""
    middle_f = math.sqrt(focal[0] * focal[1])
    per_field = 4 * math.pi / Camera("pinhole", *size, middle_f).solid_angle_sr
    middle = (np.array(size) - 1) / 2
    seen = uv[:_SCORED] - middle
    level = index.at_least(_IN_FIELD * per_field)
    scoring = index.at_least(config.scored_depth * len(seen) * per_field)
    verified = uv[: config.verified]
    n_stars = int(min(max(config.verified_depth * len(verified), 30) * per_field, len(index.xyz)))
    stars = index.xyz[:n_stars].astype(np.float64)
    by_chance = len(seen) * min(1.0, scoring.n * (_TOLERANCE_PX / middle_f) ** 2 / 4) / 2
    least = by_chance + config.chance_sigmas * math.sqrt(by_chance) + 2.0
    triples, shape, longest = _triangles_seen(seen[:_BRIGHT], _SHORTEST_SIDE * min(size))
    table = triangles_of(level.n)
    for of_seen, of_sky in _fitting(table, shape):
        f_px = longest[of_seen] / table.longest_rad[of_sky]
        kept = (f_px >= focal[0]) & (f_px <= focal[1])
        of_seen, of_sky, f_px = of_seen[kept], of_sky[kept], f_px[kept]
        work = BATCH_WORK + len(f_px) * (HYPOTHESIS_WORK + len(seen)) + _CANDIDATES * VERIFICATION_WORK
        if not effort.affords(work):
            return None
        effort.work += work
        effort.hypotheses += len(f_px)
        if not len(f_px):
            continue
        to_sky = _orientations(seen, triples[of_seen], index.xyz[table.stars[of_sky]], f_px)
        score = _scores(to_sky, seen, f_px, scoring, index)
        for row in np.argsort(-score, kind="stable")[:_CANDIDATES]:
            if score[row] < least:
                break
            camera = Camera("pinhole", *size, float(f_px[row]))
            found = verify(
                camera, verified, stars, to_sky[row].astype(np.float64).T, _TOLERANCE_PX,
                log10_tried=math.log10(effort.hypotheses), free_stars=3, region=ANY_FOCAL_LENGTH,
                area_px=float(size[0] * size[1]), finest_rad=float(camera.radians_per_px(verified).min()),
            )  # fmt: skip
            if found.log10_false_alarm <= config.max_log10_false_alarm:
                return camera, found
    return None


@lru_cache(maxsize=8)
def triangles_of(n: int) -> Triangles:
    """Return the triangles that the `n` brightest stars of the sky form with their neighbours."""
    from scipy.spatial import cKDTree

    xyz = load_deep_sky_index().xyz[:n].astype(np.float64)
    near = np.asarray(cKDTree(xyz).query(xyz, _NEIGHBOURS + 1)[1])
    i, j = np.triu_indices(_NEIGHBOURS, 1)
    own = np.repeat(np.arange(n), len(i))
    corners = np.sort(np.column_stack((own, near[:, 1 + i].ravel(), near[:, 1 + j].ravel())), axis=1)
    corners = np.unique(corners @ np.array([n * n, n, 1]))
    corners = np.column_stack((corners // (n * n), corners // n % n, corners % n))
    corners, shape, longest = _described(xyz, corners)
    cell = _cell(shape[:, 0], shape[:, 1])
    order = np.argsort(cell, kind="stable")
    return Triangles(
        corners[order].astype(np.int32), shape[order].astype(np.float32), longest[order].astype(np.float32), cell[order]
    )


def _described(points: F8, corners: Rows) -> tuple[Rows, F8, F8]:
    """Order the corners, shape (t, 3), by their opposite sides; also return shapes (t, 2) and longest sides.

    Thin triangles are left out. `points` are unit vectors, or (u, v, 1) in the frame; for both, the determinant gives the
    sense of rotation.
    """
    sides = np.stack(
        [np.linalg.norm(points[corners[:, b]] - points[corners[:, c]], axis=1) for b, c in ((1, 2), (2, 0), (0, 1))],
        axis=1,
    )
    order = np.argsort(-sides, axis=1)
    corners, sides = np.take_along_axis(corners, order, axis=1), np.take_along_axis(sides, order, axis=1)
    sense = np.sign(np.linalg.det(points[corners]))
    ratios = sides[:, 1:] / np.maximum(sides[:, :1], 1e-12)
    shape = np.column_stack((ratios[:, 0], sense * ratios[:, 1]))
    # Twice the area over the square of the longest side, by Heron's formula; small if the corners are almost collinear.
    b, c = ratios.T
    area = np.sqrt(np.maximum((1 + b + c) * (b + c - 1) * (1 + c - b) * (1 + b - c), 0)) / 2
    good = (ratios[:, 1] > _THINNEST) & (area > _THINNEST / 2)
    return corners[good], shape[good], sides[good, 0]


def _triangles_seen(seen: F8, shortest_px: float) -> tuple[Rows, F8, F8]:
    """Return the triangles of detections whose longest side is long enough, those of the brightest first."""
    n = len(seen)
    i, j, k = np.meshgrid(np.arange(n), np.arange(n), np.arange(n), indexing="ij")
    corners = np.column_stack([part[(i < j) & (j < k)] for part in (i, j, k)])
    corners = corners[np.argsort(corners.sum(axis=1), kind="stable")]
    corners, shape, longest = _described(np.column_stack((seen, np.ones(n))), corners)
    long = longest >= shortest_px
    return corners[long], shape[long], longest[long]


_CELLS_ACROSS = 2048


def _cell(first: NDArray[np.floating], second: NDArray[np.floating]) -> NDArray[np.int64]:
    """Return the cell of a shape: rows of the first ratio, columns of the second."""
    row, column = np.floor(first / _TOLERANCE).astype(np.int64), np.floor(second / _TOLERANCE).astype(np.int64)
    return row * _CELLS_ACROSS + column + _CELLS_ACROSS // 2


def _fitting(table: Triangles, shape: F8) -> Iterator[tuple[Rows, Rows]]:
    """Yield rows of the shapes and of the table's triangles that match, some thousands at a time."""
    low, end = (
        np.stack([np.searchsorted(table.cell, _cell(shape[:, 0] + step * _TOLERANCE, shape[:, 1] + side * _TOLERANCE) + past)
                  for step in (-1, 0, 1)], axis=1).ravel()
        for side, past in ((-1, 0), (1, 1))
    )  # fmt: skip
    owner = np.repeat(np.arange(len(shape)), 3)
    total = np.cumsum(end - low)
    start = 0
    while start < len(low):
        before = total[start - 1] if start else 0
        stop = max(start + 1, int(np.searchsorted(total, before + 6 * _AT_ONCE, side="right")))
        count = (end - low)[start:stop]
        rows = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count) + np.repeat(low[start:stop], count)
        of_seen = np.repeat(owner[start:stop], count)
        near = (np.abs(table.shape[rows] - shape[of_seen]) <= _TOLERANCE).all(axis=1)
        yield of_seen[near], rows[near]
        start = stop


def _orientations(seen: F8, corners: Rows, stars: F4, f_px: F8) -> F4:
    """Return rotations from camera to sky, shape (h, 3, 3), that map the longest sides of triangles onto those of stars."""
    # The longest side is between the second and the third corner.
    rays = np.concatenate((seen[corners[:, 1:]], np.broadcast_to(f_px[:, None, None], (len(f_px), 2, 1))), axis=2)
    rays = (rays / np.linalg.norm(rays, axis=2, keepdims=True)).astype(np.float32)
    a, b = (np.ascontiguousarray(stars[:, k].T) for k in (1, 2))
    return turns(a, b, triads(*(np.ascontiguousarray(rays[:, k].T) for k in (0, 1))))


def _scores(to_sky: F4, seen: F8, f_px: F8, level: Level, index: SkyIndex) -> F4:
    """Return the sum over the detections of max(0, 1 - (distance / tolerance)^2) for each orientation and focal length."""
    scores = np.zeros(len(to_sky), dtype=np.float32)
    for start in range(0, len(to_sky), 256):
        part = slice(start, start + 256)
        f = f_px[part, None].astype(np.float32)
        u, v = (seen.T[:, None, :] / f[None]).astype(np.float32)
        norm = np.sqrt(1 + u * u + v * v)
        R = to_sky[part]
        x, y, z = ((R[:, k, 0, None] * u + R[:, k, 1, None] * v + R[:, k, 2, None]) / norm for k in range(3))
        star = level.nearest.take(octahedral_cell(x, y, z), mode="clip")
        square = np.zeros_like(x)
        for mine, of_stars in zip((x, y, z), index.axes, strict=True):
            square += (mine - of_stars.take(star)) ** 2
        scores[part] = np.maximum(0, 1 - square * (f / _TOLERANCE_PX) ** 2).sum(axis=1)
    return scores
