"""Identification of stars by their catalogue positions, because peers have their own catalogues and numbers."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from celnav.sky.catalog import load_catalog, propagate

EPOCH_JYEAR = 2020.0
RADIUS_ARCSEC = 20.0
"""More than thirty years of proper motion of all but 30 stars to V 8, and than the rounding of 16-bit tables."""
FAINTEST_V = 9.0
"""No peer's catalogue for wide fields is deeper."""


def star_ids_at(directions: NDArray[np.float64]) -> NDArray[np.int64]:
    """Identify the stars in some catalogue directions: the brightest of skybench's catalogue within `RADIUS_ARCSEC` of each.

    For a close pair the brighter star is meant, because catalogues list one entry for both.

    Parameters
    ----------
    directions : ndarray, shape (n, 3)
        ICRS unit vectors at an epoch near `EPOCH_JYEAR`.

    Returns
    -------
    ndarray of int64, shape (n,)
        Star ids as in docs/solver_protocol.md; 0 where the catalogue has no star there.
    """
    tree, ids = _stars()
    radius = 2.0 * np.sin(np.radians(RADIUS_ARCSEC / 3600.0) / 2.0)
    # Rows are sorted by magnitude, so the lowest row is the brightest star.
    near = tree.query_ball_point(np.asarray(directions, dtype=np.float64).reshape(-1, 3), radius)
    return np.array([ids[min(rows)] if rows else 0 for rows in near], dtype=np.int64)


def named_matches(detections: NDArray[np.integer], directions: NDArray[np.float64]) -> NDArray[np.int64]:
    """Matches as in the protocol, shape (m, 2): detection and star id; those without an id are omitted.

    Parameters
    ----------
    detections : ndarray of int, shape (n,)
        Indices of the detections; if one occurs twice, its first match counts.
    directions : ndarray, shape (n, 3)
        Directions of the stars with which they are matched, as for `star_ids_at`.
    """
    ids = star_ids_at(directions)
    found = np.column_stack((np.asarray(detections, dtype=np.int64).reshape(-1), ids))[ids != 0]
    _, first = np.unique(found[:, 0], return_index=True)
    return np.asarray(found[np.sort(first)])


@lru_cache(maxsize=1)
def _stars() -> tuple[cKDTree, NDArray[np.int64]]:
    stars = load_catalog()
    stars = stars.take(stars.v_mag < FAINTEST_V)
    places = propagate(stars.vectors, stars.motion, EPOCH_JYEAR - stars.epoch_jyear)
    places /= np.linalg.norm(places, axis=1, keepdims=True)
    return cKDTree(places), stars.star_id.astype(np.int64)
