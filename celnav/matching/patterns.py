"""Pattern database and look-up table of the thesis (section 4.i), in contiguous arrays.

For each magnitude-limited catalogue and each of its stars, the database holds the neighbours within a radius: their distance
theta, the ratio rho = theta / theta_max, and their bearing. The look-up table lists, for every bin of (theta, rho), the
stars that have a neighbour in it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import lru_cache
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from celnav.cache import cached, digest
from celnav.checking import bounded, check_fields
from celnav.errors import ConfigError
from celnav.sky.catalog import StarCatalog, load_catalog

F8 = NDArray[np.float64]
F4 = NDArray[np.float32]
I4 = NDArray[np.int32]


# The number of pairs grows with the square of the number of stars: 8,900 stars to V 6.5 make some ten million.
MAX_LIMIT_DECIMAG = 65


@dataclass(frozen=True)
class PatternConfig:
    """Contents of the database; equal configurations share one database.

    Attributes
    ----------
    limits_decimag : tuple of int
        Magnitude limits of the catalogues, in tenths of a magnitude: 20 .. 45 in the thesis.
    radius_deg : float
        Radius around the reference star within which stars are neighbours.
    theta_bin_deg, rho_bin : float
        Bins of the look-up table; 0.5 deg and 0.02 in the thesis.
    theta_max : str
        Denominator of rho: the farthest neighbour in the ``pattern`` (for the image, its own farthest neighbour), or the
        ``radius``, which does not depend on missing stars.
    """

    limits_decimag: tuple[int, ...] = bounded(tuple(range(20, 46)), -20, MAX_LIMIT_DECIMAG)
    radius_deg: float = bounded(45.0, 0.01, 90)
    theta_bin_deg: float = bounded(0.5, 0.01, 90)
    rho_bin: float = bounded(0.02, 0.001, 1)
    theta_max: Literal["pattern", "radius"] = "pattern"

    def __post_init__(self) -> None:
        check_fields(self)
        if not self.limits_decimag or list(self.limits_decimag) != sorted(set(self.limits_decimag)):
            raise ConfigError("limits_decimag must hold at least one limit, in rising order")

    @property
    def n_theta(self) -> int:
        """Number of bins in theta."""
        return int(np.ceil(self.radius_deg / self.theta_bin_deg - 1e-9))

    @property
    def n_rho(self) -> int:
        """Number of bins in rho; rho = 1, the farthest neighbour, falls into the last one."""
        return int(np.ceil(1 / self.rho_bin - 1e-9))

    def bins(self, theta_rad: NDArray[np.floating], rho: NDArray[np.floating]) -> NDArray[np.int64]:
        """Return the bin of each feature, shape (n,)."""
        theta = np.minimum((np.degrees(theta_rad) / self.theta_bin_deg).astype(np.int64), self.n_theta - 1)
        ratio = np.minimum((rho / self.rho_bin).astype(np.int64), self.n_rho - 1)
        return np.asarray(theta * self.n_rho + ratio)


@dataclass(frozen=True, eq=False)
class Patterns:
    """Patterns and look-up table of one catalogue.

    Attributes
    ----------
    star_id, dec_rad : ndarray, shape (n,)
        The catalogue's stars, brightest first.
    start : ndarray of int32, shape (n + 1,)
        The neighbours of star i are rows ``start[i]:start[i + 1]`` of the next three arrays, in order of distance.
    neighbour : ndarray of int16
        Rows of the neighbours in the catalogue.
    theta_rad, bearing_rad : ndarray of float32
        Distance, and position angle from north through east.
    lut_start : ndarray of int32, shape (bins + 1,)
        The stars of bin b are ``lut_star[lut_start[b]:lut_start[b + 1]]``, each listed once.
    lut_star : ndarray of int16
        Rows in the catalogue.
    """

    star_id: I4
    dec_rad: F8
    start: I4
    neighbour: NDArray[np.int16]
    theta_rad: F4
    bearing_rad: F4
    lut_start: I4
    lut_star: NDArray[np.int16]

    def __len__(self) -> int:
        return len(self.star_id)

    @property
    def mean_neighbours(self) -> float:
        """Density statistic: mean number of neighbours within the radius."""
        return len(self.neighbour) / max(len(self), 1)

    def votes(self, bins: NDArray[np.int64]) -> NDArray[np.int64]:
        """Count, for each star, the given bins in which it has a neighbour; shape (n,)."""
        return np.bincount(self.stars_in(bins)[0], minlength=len(self)).astype(np.int64)

    def stars_in(self, bins: NDArray[np.int64]) -> tuple[NDArray[np.int16], NDArray[np.intp]]:
        """Return the stars listed in the given bins, one list after the other, and the row in `bins` for each."""
        first, last = self.lut_start[bins].astype(np.int64), self.lut_start[bins + 1].astype(np.int64)
        length = last - first
        # Positions of all lists, one list after the other, without a loop.
        positions = np.arange(int(length.sum())) + np.repeat(first - np.cumsum(length) + length, length)
        return self.lut_star[positions], np.repeat(np.arange(len(bins)), length)


def bearings(reference: F8, dirs: F8) -> F8:
    """Return the bearings of unit vectors, shape (n, 3), seen from another, shape (3,), in radians.

    They count from the direction of the frame's third axis. In ICRS this is the position angle, north through east; in any
    other right-handed frame it differs by a constant, so mirror images remain distinguishable.
    """
    pole = np.array([0.0, 0.0, 1.0]) if abs(reference[2]) < 1 - 1e-12 else np.array([1.0, 0.0, 0.0])
    north = pole - (pole @ reference) * reference
    north /= np.linalg.norm(north)
    east = np.cross(north, reference)
    return np.asarray(np.arctan2(dirs @ east, dirs @ north))


def separations(reference: F8, dirs: F8) -> F8:
    """Return the angles between a unit vector, shape (3,), and others, shape (n, 3), radians; exact for small angles too."""
    return np.asarray(2 * np.arcsin(np.minimum(np.linalg.norm(dirs - reference, axis=1) / 2, 1.0)))


def build_patterns(vectors: F8, star_id: I4, config: PatternConfig) -> Patterns:
    """Build the patterns and the look-up table of one catalogue.

    Parameters
    ----------
    vectors : ndarray, shape (n, 3)
        Unit vectors of the stars.
    star_id : ndarray, shape (n,)
        Ids of the stars.
    config : PatternConfig
        Radius and bins.
    """
    n = len(vectors)
    reference, neighbour = _neighbours(vectors, np.cos(np.radians(config.radius_deg)))
    a, b = vectors[reference], vectors[neighbour]
    theta = 2 * np.arcsin(np.minimum(np.linalg.norm(b - a, axis=1) / 2, 1.0))
    order = np.lexsort((theta, reference))
    reference, neighbour, theta, a, b = reference[order], neighbour[order], theta[order], a[order], b[order]
    # Position angles without a loop: east is (-sin(ra), cos(ra)), and north follows from it.
    east = np.column_stack((-a[:, 1], a[:, 0], np.zeros(len(a))))
    east /= np.maximum(np.linalg.norm(east, axis=1, keepdims=True), 1e-300)
    north = np.cross(a, east)
    bearing = np.arctan2(np.sum(b * east, axis=1), np.sum(b * north, axis=1))
    count = np.bincount(reference, minlength=n)
    start = np.concatenate(([0], np.cumsum(count)))
    # Rows are sorted by distance within each reference star, so its last row is the farthest neighbour.
    farthest = np.full(n, np.radians(config.radius_deg))
    if config.theta_max == "pattern":
        farthest[count > 0] = theta[start[1:][count > 0] - 1]
    # Two stars at the same position (a double) give theta_max = 0 only if the star has no other neighbour.
    rho = theta / np.maximum(farthest[reference], 1e-12)
    n_bins = config.n_theta * config.n_rho
    entries = np.unique(config.bins(theta, rho) * n + reference)
    lut_start = np.searchsorted(entries, np.arange(n_bins + 1) * n)
    return Patterns(
        star_id=star_id.astype(np.int32),
        dec_rad=np.arcsin(np.clip(vectors[:, 2], -1, 1)),
        start=start.astype(np.int32),
        neighbour=neighbour.astype(np.int16),
        theta_rad=theta.astype(np.float32),
        bearing_rad=bearing.astype(np.float32),
        lut_start=lut_start.astype(np.int32),
        lut_star=(entries % n).astype(np.int16),
    )


def _neighbours(vectors: F8, cosine: float) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the pairs of different stars whose separation has at least this cosine, as rows of both stars."""
    # Work in blocks of rows, because the whole matrix of a deep catalogue does not fit into memory.
    block = 1024
    first, second = [], []
    for start in range(0, len(vectors), block):
        near = vectors[start : start + block] @ vectors.T >= cosine
        np.fill_diagonal(near[:, start:], False)
        i, j = np.nonzero(near)
        first.append(i + start)
        second.append(j)
    if not first:
        return np.empty(0, np.intp), np.empty(0, np.intp)
    return np.concatenate(first), np.concatenate(second)


def pattern_stars(catalog: StarCatalog, limit_decimag: int) -> StarCatalog:
    """Return the stars of the Bright Star Catalogue down to a magnitude limit, brightest first."""
    # The catalogue gives magnitudes to 0.01; half of that includes the limit itself, whatever the rounding.
    return catalog.take(np.flatnonzero((catalog.hr > 0) & (catalog.v_mag <= limit_decimag / 10 + 0.005)))


# The thesis' 26 catalogues, continued to the end of the Bright Star Catalogue. Patterns grow with the square of the number of
# stars, so the deep ones come in steps of half a magnitude and with a smaller neighbourhood.
EXTENDED_PATTERNS = PatternConfig(limits_decimag=(*range(20, 46), 50, 55, 60, 65), radius_deg=30.0)


@lru_cache(maxsize=8)
def load_patterns(config: PatternConfig) -> tuple[Patterns, ...]:
    """Return the patterns of every catalogue of the configuration, from the cache if they are there."""
    catalog = load_catalog()
    deepest = pattern_stars(catalog, config.limits_decimag[-1])
    if len(deepest) > np.iinfo(np.int16).max:
        raise ConfigError(f"magnitude limit {config.limits_decimag[-1] / 10} gives too many stars for the patterns")

    def build() -> Mapping[str, NDArray[np.generic]]:
        arrays: dict[str, NDArray[np.generic]] = {}
        for limit in config.limits_decimag:
            stars = pattern_stars(catalog, limit)
            patterns = build_patterns(stars.vectors, stars.star_id, config)
            arrays |= {f"{field.name}_{limit}": getattr(patterns, field.name) for field in fields(Patterns)}
        return arrays

    key = digest(Path(__file__).read_bytes(), repr(config), deepest.star_id.tobytes(), deepest.vectors.tobytes())
    arrays = cached("patterns", key, build)
    return tuple(
        Patterns(**{field.name: arrays[f"{field.name}_{limit}"] for field in fields(Patterns)})  # type: ignore[arg-type]
        for limit in config.limits_decimag
    )
