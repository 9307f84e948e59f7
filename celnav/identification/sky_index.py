"""Look-up tables of the sky for the identification, built once and cached on disk.

A *level* consists of the N brightest stars of the sky, for N = 100, 200, … 12800. Brightness ranks need no photometric zero
point, so the level follows from the number of detections and the solid angle. Each level has

- its pairs of stars sorted by separation (Mortari's k-vector idea, with a binary search), for hypotheses;
- the nearest star of every cell of an octahedral map of the sphere, for scoring thousands of hypotheses at once.

Sources: Mortari et al. 2004, "The Pyramid Star Identification Technique", Navigation 51(3) 171 (pairs by separation);
Cigolle et al. 2014, "Survey of Efficient Representations for Independent Unit Vectors", JCGT 3(2) (octahedral map).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from celnav.cache import cached, digest
from celnav.sky.catalog import load_catalog, propagate

F4 = NDArray[np.float32]
F8 = NDArray[np.float64]
Rows = NDArray[np.integer]

# Deeper levels, for fields so narrow that the levels above have too few stars in them.
DEEP_LEVELS = (25600, 51200, 102400)
DEEP_PAIR_LIMIT_DEG = (6.0, 3.5, 2.2)
LEVELS = (100, 200, 400, 800, 1600, 3200, 6400, 12800)
# Widest separation of pairs in each level, degrees, which keeps the tables at some 1.5 million pairs.
PAIR_LIMIT_DEG = (180.0, 180.0, 180.0, 180.0, 60.0, 25.0, 15.0, 9.0)
# Epoch of the positions in the tables; identification tolerates the proper motions of a few decades.
EPOCH_JYEAR = 2015.0
_SIDE_BITS = 9
MAP_SIDE = 1 << _SIDE_BITS
# Slightly less than half a side, so that a coordinate of 1 falls into the last cell and not beyond it.
_HALF_SIDE = np.float32(MAP_SIDE / 2 * (1 - 1e-6))
BLEND_ARCSEC = 120.0
# Fields count as narrow if the sky consists of at least this many of them: below about 20 by 13 deg.
NARROW = 150


@dataclass(frozen=True, eq=False)
class Level:
    """The `n` brightest stars of the sky.

    Attributes
    ----------
    n : int
        Number of stars.
    pair_limit_rad : float
        Largest separation of the listed pairs.
    separation_rad : ndarray of float32, shape (p,)
        Separations of the pairs, ascending.
    first, second : ndarray of int16 or int32, shape (p,)
        Stars of the pairs (rows of the index).
    nearest : ndarray of int16 or int32, shape (2 * MAP_SIDE**2,)
        The star nearest to the centre of each cell of the octahedral map.
    """

    n: int
    pair_limit_rad: float
    separation_rad: F4
    first: Rows
    second: Rows
    nearest: Rows


@dataclass(frozen=True, eq=False)
class SkyIndex:
    """All levels for one list of stars.

    Attributes
    ----------
    xyz : ndarray of float32, shape (n, 3)
        ICRS unit vectors at `EPOCH_JYEAR`, brightest first; fainter components within `BLEND_ARCSEC` are left out.
    v_mag : ndarray of float32, shape (n,)
        V magnitudes of the stars.
    axes : tuple of three ndarrays of float32, shape (n,)
        The columns of `xyz`, each contiguous.
    levels : tuple of Level
        The levels, in ascending order of depth.
    """

    xyz: F4
    v_mag: F4
    axes: tuple[F4, F4, F4]
    levels: tuple[Level, ...]

    def at_least(self, n: float, reach_rad: float = 0.0) -> Level:
        """Return the smallest level with at least `n` stars whose pairs reach `reach_rad`.

        If no level satisfies both, the deepest one whose pairs reach that far is returned.
        """
        reaching = [level for level in self.levels if level.pair_limit_rad >= reach_rad] or [self.levels[0]]
        return next((level for level in reaching if level.n >= n), reaching[-1])


def octahedral_cell(x: F4, y: F4, z: F4) -> NDArray[np.int32]:
    """Return the cell of the octahedral map for components of directions, float32 arrays of equal shape.

    The octahedron |x| + |y| + |z| = 1 seen along z is a square standing on its corner; each hemisphere has its own square map
    that contains it. Half of the cells are beyond the octahedron's edges, which costs memory but saves the folding of the
    usual octahedral map; scoring hypotheses spends most of its time here.
    """
    scale = np.abs(x)
    work = np.abs(y)
    scale += work
    np.abs(z, out=work)
    scale += work
    np.divide(_HALF_SIDE, scale, out=scale)
    np.multiply(x, scale, out=work)
    work += _HALF_SIDE
    cell = work.astype(np.int32)
    np.multiply(y, scale, out=work)
    work += _HALF_SIDE
    row = work.astype(np.int32)
    row <<= _SIDE_BITS
    cell |= row
    southern = np.ascontiguousarray(z).view(np.uint32) >> np.uint32(31)  # the sign bit
    southern <<= np.uint32(2 * _SIDE_BITS)
    cell |= southern.view(np.int32)
    return cell


def octahedral_centres() -> F8:
    """Return unit vectors of the centres of all cells, shape (2 * MAP_SIDE**2, 3), northern map first.

    Cells beyond the edges of the octahedron have directions just across the equator.
    """
    axis = (np.arange(MAP_SIDE) + 0.5) / MAP_SIDE * 2 - 1
    q, p = (grid.ravel() for grid in np.meshgrid(axis, axis, indexing="ij"))
    z = 1 - np.abs(p) - np.abs(q)
    centres = np.column_stack((np.tile(p, 2), np.tile(q, 2), np.concatenate((z, -z))))
    return np.asarray(centres / np.linalg.norm(centres, axis=1, keepdims=True))


def _stars(most: int) -> tuple[F8, F8]:
    """Return unit vectors and magnitudes of the `most` brightest stars, without fainter components of close pairs."""
    from scipy.spatial import cKDTree

    catalog = load_catalog()
    brightest = catalog.take(np.arange(min(len(catalog), 2 * most)))
    xyz = propagate(brightest.vectors, brightest.motion, EPOCH_JYEAR - brightest.epoch_jyear)
    close = cKDTree(xyz).query_pairs(np.radians(BLEND_ARCSEC / 3600), output_type="ndarray")
    alone = np.ones(len(xyz), dtype=bool)
    alone[close.max(axis=1)] = False  # sorted by magnitude, so the larger row is the fainter star
    return np.asarray(xyz[alone][:most]), np.asarray(brightest.v_mag[alone][:most])


def _build(levels: tuple[int, ...], limits_deg: tuple[float, ...], rows: type[np.integer]) -> dict[str, Rows | F4]:
    from scipy.spatial import cKDTree

    xyz, v_mag = _stars(levels[-1])
    arrays: dict[str, Rows | F4] = {"xyz": xyz.astype(np.float32), "v_mag": v_mag.astype(np.float32)}
    centres = octahedral_centres()
    for n, limit_deg in zip(levels, limits_deg, strict=True):
        tree = cKDTree(xyz[:n])
        if limit_deg >= 180:
            first, second = np.triu_indices(n, 1)
        else:
            first, second = tree.query_pairs(2 * np.sin(np.radians(limit_deg) / 2), output_type="ndarray").T
        chord = np.linalg.norm(xyz[first] - xyz[second], axis=1)
        order = np.argsort(chord, kind="stable")
        arrays[f"separation_rad_{n}"] = (2 * np.arcsin(np.minimum(chord[order] / 2, 1.0))).astype(np.float32)
        arrays[f"first_{n}"], arrays[f"second_{n}"] = first[order].astype(rows), second[order].astype(rows)
        arrays[f"nearest_{n}"] = np.asarray(tree.query(centres)[1], dtype=rows)
    return arrays


def _load(
    name: str, levels: tuple[int, ...], limits_deg: tuple[float, ...], rows: type[np.integer]
) -> tuple[F4, F4, tuple[Level, ...]]:
    catalog = load_catalog()
    stars = slice(2 * levels[-1])
    key = digest(Path(__file__).read_bytes(), catalog.ra_rad[stars].tobytes(), catalog.dec_rad[stars].tobytes())
    arrays = cached(name, key, partial(_build, levels, limits_deg, rows))
    found = tuple(
        Level(
            n,
            float(np.radians(limit_deg)),
            arrays[f"separation_rad_{n}"].astype(np.float32, copy=False),
            arrays[f"first_{n}"].astype(rows, copy=False),
            arrays[f"second_{n}"].astype(rows, copy=False),
            arrays[f"nearest_{n}"].astype(rows, copy=False),
        )
        for n, limit_deg in zip(levels, limits_deg, strict=True)
    )
    xyz, v_mag = (arrays[of_stars].astype(np.float32, copy=False) for of_stars in ("xyz", "v_mag"))
    return xyz, v_mag, found


def _index(xyz: F4, v_mag: F4, levels: tuple[Level, ...]) -> SkyIndex:
    x, y, z = (np.ascontiguousarray(column) for column in xyz.T)
    return SkyIndex(xyz, v_mag, (x, y, z), levels)


@lru_cache(maxsize=1)
def load_sky_index() -> SkyIndex:
    """Return the tables from the cache; if they are not there, build them in about two seconds."""
    return _index(*_load("sky-index", LEVELS, PAIR_LIMIT_DEG, np.int16))


@lru_cache(maxsize=1)
def load_deep_sky_index() -> SkyIndex:
    """Return the tables with the levels for narrow fields: nearly the whole catalogue, which ends at V 8 to 9.

    The brighter stars are the same in both, so the levels of `load_sky_index` are included.
    """
    xyz, v_mag, deep = _load("deep-sky-index", DEEP_LEVELS, DEEP_PAIR_LIMIT_DEG, np.int32)
    return _index(xyz, v_mag, (*load_sky_index().levels, *deep))


def sky_index_for(solid_angle_sr: float) -> SkyIndex:
    """Return the tables for a field of view: the deep ones if the sky contains more than `NARROW` such fields."""
    return load_deep_sky_index() if 4 * np.pi > NARROW * solid_angle_sr else load_sky_index()
