"""The index of patterns for seiza's blind search, built from a star catalogue.

Its Python package opens such a file (`SEIZABI1`, little-endian) but cannot build one; its command-line program can, but is
not on the Package Index. Rules and layout are those of its own builder: theatrus/seiza (Apache-2.0), `seiza/src/blind.rs`.
Each radius has a magnitude limit. A star that is the brightest within a radius, among stars to that limit, forms patterns:
all groups of four from itself and the five next brightest stars there.
"""

import math
import struct
from itertools import combinations
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

TIERS = ((6.0, 6.1), (3.0, 7.6), (1.5, 9.2), (0.75, 10.7), (0.4, 11.8))
"""Radii in degrees and their magnitude limits; the last ones are beyond the depth of any catalogue used here."""
MOST_MEMBERS = 6
LONGEST_DEG = 6.0
"""Longest edge of a pattern."""
BINS, SCHEMA = 128, 1
HEADER = struct.Struct("<8sQQQffIIQQ")


def index_of(ra_deg: Any, dec_deg: Any, magnitudes: Any, magnitude_limit: float) -> bytes:
    """Content of the file for n stars to the magnitude limit; three arrays of shape (n,), with ICRS positions."""
    order = np.argsort(magnitudes, kind="stable")
    ra, dec, mag = np.radians(ra_deg)[order], np.radians(dec_deg)[order], np.asarray(magnitudes)[order]
    stars = np.column_stack((np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)))
    points, centre, longest = planes_of(stars[quads_of(stars, mag)])
    kept = longest <= LONGEST_DEG
    points, centre, longest = points[kept], centre[kept], longest[kept]
    keys = keys_of(points)
    by_key = np.argsort(keys, kind="stable")
    known, first = np.unique(keys[by_key], return_index=True)
    header = HEADER.pack(
        b"SEIZABI1", len(known), len(keys), len(keys), magnitude_limit, LONGEST_DEG, BINS, SCHEMA, len(mag), 0
    )
    records = np.column_stack((points.reshape(-1, 8), centre, longest))
    arrays = ((known, "<u8"), (np.append(first, len(keys)), "<u4"), (by_key, "<u4"), (records, "<f4"))
    return header + b"".join(array.astype(form).tobytes() for array, form in arrays)


def quads_of(stars: Any, mag: Any) -> Any:
    """Indices of the four stars of each pattern, without duplicates, shape (m, 4); the stars are sorted by magnitude."""
    found: dict[tuple[int, ...], None] = {}
    for radius_deg, faintest in TIERS:
        some = stars[: np.searchsorted(mag, faintest, side="right")]
        near = cKDTree(some).query_ball_point(some, 2.0 * math.sin(math.radians(radius_deg) / 2), return_sorted=True)
        for row, members in enumerate(near):
            if members[0] == row:
                found.update(dict.fromkeys(combinations(members[:MOST_MEMBERS], 4)))
    return np.array(list(found), dtype=int).reshape(-1, 4)


def planes_of(stars: Any) -> tuple[Any, Any, Any]:
    """Project patterns, given as unit vectors of shape (m, 4, 3), onto planes tangent to the sky at their centres.

    Returns
    -------
    points : ndarray of float32, shape (m, 4, 2)
        East and north, degrees, sorted by the sum of a star's distances to the others.
    centre : ndarray, shape (m, 2)
        Right ascension and declination of the centre, degrees.
    longest : ndarray, shape (m,)
        Largest distance, degrees.
    """
    middle = stars.sum(axis=1)
    middle /= np.linalg.norm(middle, axis=1, keepdims=True)
    across = np.hypot(middle[:, 0], middle[:, 1])
    east = np.column_stack((-middle[:, 1] / across, middle[:, 0] / across, np.zeros(len(middle))))
    axes = np.stack((east, np.cross(middle, east)), axis=-1)
    points = np.degrees(stars @ axes / (stars @ middle[:, :, None]))
    apart = np.linalg.norm(points[:, :, None] - points[:, None], axis=-1)
    by_sum = np.argsort(apart.sum(axis=2), axis=1, kind="stable")
    ra = np.degrees(np.arctan2(middle[:, 1], middle[:, 0])) % 360.0
    centre = np.column_stack((ra, np.degrees(np.arcsin(middle[:, 2]))))
    return np.take_along_axis(points, by_sum[:, :, None], axis=1).astype(np.float32), centre, apart.max(axis=(1, 2))


def keys_of(points: Any) -> Any:
    """Keys by which the index is sorted: the five shorter distances over the longest, sorted, one byte each."""
    ends = np.array(list(combinations(range(4), 2))).T
    apart = np.sort(np.linalg.norm(points[:, ends[0]].astype(float) - points[:, ends[1]], axis=-1), axis=1)
    bins = np.minimum(apart[:, :5] / apart[:, 5:] * BINS, 255).astype(np.uint64)
    return bins @ np.array([1 << shift for shift in (32, 24, 16, 8, 0)], dtype=np.uint64)
