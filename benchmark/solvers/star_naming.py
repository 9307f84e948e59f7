"""Stars named by their place in the catalogue: peers have catalogues of their own, and numbers of their own."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from celnav.sky.catalog import load_catalog, propagate

EPOCH_JYEAR = 2020.0
RADIUS_ARCSEC = 20.0
"""Wider than thirty years of proper motion of all but 30 stars to V 8, and than what 16-bit tables round."""
FAINTEST_V = 9.0
"""No peer's catalogue of wide fields goes deeper."""


def star_ids_at(directions: NDArray[np.float64]) -> NDArray[np.int64]:
    """Name the stars in some catalogue directions: the brightest of skybench's catalogue within `RADIUS_ARCSEC` of each.

    The brighter one of a close pair is meant, as a catalogue that lists one entry for both has it.

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
    # Rows ascend in magnitude, so that the least row is the brightest star.
    near = tree.query_ball_point(np.asarray(directions, dtype=np.float64).reshape(-1, 3), radius)
    return np.array([ids[min(rows)] if rows else 0 for rows in near], dtype=np.int64)


def named_matches(detections: NDArray[np.integer], directions: NDArray[np.float64]) -> NDArray[np.int64]:
    """Matches as the protocol has them, shape (m, 2): detection and star id; those without a name are left out.

    Parameters
    ----------
    detections : ndarray of int, shape (n,)
        Rows of the detections; of one that occurs twice the first counts.
    directions : ndarray, shape (n, 3)
        Where the stars are that they are matched with, as for `star_ids_at`.
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
