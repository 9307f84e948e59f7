"""Make the generator's stars.xz and near_brighter.csv, and celnav's: python tools/build_tycho2.py tycho2_2.orig.tar.xz.

The archive is the source of Debian's package astrometry-data-tycho2: `apt-get source --download-only tycho2`.
"""

from __future__ import annotations

import hashlib
import sys
import tarfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from generator.places.catalogue import (
    ASSUMED_BV_MAG,
    StarCatalogue,
    merge,
    propagate,
    read_hip2,
    read_hipparcos,
    read_ybsc,
    tangent_frame,
)
from generator.places.near_brighter import COLUMNS, NEAR_BRIGHTER_PATH
from generator.places.packed_stars import Stars, packed
from generator.places.tycho2 import FAINTEST_V_MAG, TYCHO2_PATH, johnson_from_tycho

Floats = NDArray[np.float64]

CELNAV_PATH = Path("celnav/data/tycho2/near_brighter.csv")
ARCHIVE_SHA256 = "b0d74bd4280e53f7cfc4b37ccb30a1cfbbc30131907dda81c706bbbab5632dfa"
# Bytes of a line, from 0, of the fields of tyc2.dat and of suppl_1.dat (ReadMe).
MEAN = {"ra": (15, 27), "dec": (28, 40), "pm_ra": (41, 48), "pm_dec": (49, 56), "bt": (110, 116), "vt": (123, 129),
        "hip": (142, 148), "ra_seen": (152, 164), "dec_seen": (165, 177)}  # fmt: skip
SUPPLEMENT = {"ra": (15, 27), "dec": (28, 40), "pm_ra": (41, 48), "pm_dec": (49, 56), "bt": (83, 89), "vt": (96, 102),
              "hip": (115, 121)}  # fmt: skip
MEAN_LINE_BYTES, SUPPLEMENT_LINE_BYTES = 207, 123
YEARS_FROM_HIPPARCOS = 8.75
SAME_STAR_ARCSEC, SAME_STAR_MAG = 5.0, 1.5
YALE_ARCSEC, YALE_MAG = 10.0, 0.5
"""Limits for stars placed by the Yale catalogue, which gives parts of a pair one position (sigma CrB B: 5.6 arcsec off)."""
FIELD_ARCSEC, EXCESS_MAG, BRIGHTER_MAG, MEASURED_MAG = 45.0, 0.4, 0.3, 12.5
"""Limits for a star with a brighter one next to it: their distance, how far Hipparcos' V is below Tycho-2's, by how much the
other star is brighter, and the V to which Tycho-2 measures."""


def numbers(data: bytes, line_bytes: int, fields: dict[str, tuple[int, int]]) -> dict[str, Floats]:
    """Read fields from lines of equal length; NaN where they are blank."""
    lines = np.frombuffer(data, "S1").reshape(-1, line_bytes)
    found = {}
    for name, (start, end) in fields.items():
        text = np.char.strip(np.ascontiguousarray(lines[:, start:end]).view(f"S{end - start}").ravel())
        found[name] = np.where(text == b"", b"nan", text).astype(float)
    return found


def read(archive: Path) -> tuple[Stars, NDArray[np.int64]]:
    """Read all stars of Tycho-2 and of its first supplement, with their Hipparcos numbers (0: none)."""
    if hashlib.sha256(archive.read_bytes()).hexdigest() != ARCHIVE_SHA256:
        raise SystemExit(f"{archive}: another file than tycho2_2.orig.tar.xz of Debian's source package tycho2 2-4")
    parts = []
    with tarfile.open(archive) as tar:
        for member in sorted(tar.getmembers(), key=lambda each: each.name):
            if "tyc2.dat" in member.name or "suppl_1.dat" in member.name:
                stream = tar.extractfile(member)
                assert stream is not None
                whole = "tyc2.dat" in member.name
                form = (MEAN_LINE_BYTES, MEAN) if whole else (SUPPLEMENT_LINE_BYTES, SUPPLEMENT)
                parts.append(numbers(stream.read(), *form))
    for part in parts:
        if "ra_seen" in part:
            # Where there is no mean position, use the one observed around 1991.
            for name in ("ra", "dec"):
                part[name] = np.where(np.isnan(part[name]), part.pop(f"{name}_seen"), part[name])
        else:
            motion = np.nan_to_num(part["pm_ra"]), np.nan_to_num(part["pm_dec"])
            part["ra"], part["dec"] = propagate(part["ra"], part["dec"], *motion, YEARS_FROM_HIPPARCOS)
    columns = {name: np.concatenate([part[name] for part in parts]) for name in SUPPLEMENT}
    bt_vt = columns["bt"] - columns["vt"]
    colour = np.where(np.isnan(bt_vt), ASSUMED_BV_MAG / 0.85, bt_vt)
    vt = np.where(np.isnan(columns["vt"]), columns["bt"] - colour, columns["vt"])
    v_mag, bv_mag = johnson_from_tycho(vt, colour)
    stars = Stars(
        columns["ra"],
        columns["dec"],
        np.nan_to_num(columns["pm_ra"]),
        np.nan_to_num(columns["pm_dec"]),
        v_mag,
        np.where(np.isnan(bt_vt), np.nan, bv_mag),
    )
    return stars, np.nan_to_num(columns["hip"]).astype(int)


def near_brighter(stars: Stars, hip: NDArray[np.int64]) -> Floats:
    """Hipparcos stars that include the light of a brighter one next to them, as rows of COLUMNS with Tycho-2's values."""
    table = read_hip2()
    numbers, v_mag = table["hip"].to_numpy(), table["v_mag"].to_numpy()
    light = np.where(hip > 0, 10 ** (-0.4 * stars.v_mag), 0.0)
    length = max(int(hip.max()), int(numbers.max())) + 1
    total = np.bincount(hip, light, length)[numbers]
    tycho_v = np.where(total > 0, -2.5 * np.log10(np.where(total > 0, total, 1.0)), np.nan)
    place = tangent_frame(table["ra_deg"].to_numpy(), table["dec_deg"].to_numpy())[0].T
    first, second = cKDTree(place).query_pairs(np.radians(FIELD_ARCSEC / 3600), output_type="ndarray").T
    star, other = np.concatenate([first, second]), np.concatenate([second, first])
    other_v = np.where(np.isnan(tycho_v), v_mag, tycho_v)[other]
    chosen = (v_mag[star] < tycho_v[star] - EXCESS_MAG) & (other_v < tycho_v[star] - BRIGHTER_MAG)
    chosen &= tycho_v[star] < MEASURED_MAG
    rows = []
    for row in np.unique(star[chosen]):
        own = hip == numbers[row]
        means = [np.average(getattr(stars, name)[own], weights=light[own]) for name in COLUMNS[1:5]]
        rows.append([numbers[row], *means, tycho_v[row]])
    return np.array(rows)


def known(stars: Stars, hip: NDArray[np.int64], base: StarCatalogue) -> NDArray[np.bool_]:
    """Which of n stars a catalogue contains.

    A star counts as contained within SAME_STAR_ARCSEC, at J2000 or 1991.25, of a star that is within SAME_STAR_MAG or has the
    same Hipparcos number (variable stars, and companions whose light Hipparcos includes in the star's). It also counts as
    contained within YALE_ARCSEC and YALE_MAG of a star without a Hipparcos number.
    """
    place = tangent_frame(stars.ra_deg, stars.dec_deg)[0].T
    reach = float(np.radians(SAME_STAR_ARCSEC / 3600))
    v_mag, number = np.append(base.v_mag, np.inf), np.append(np.where(base.hip > 0, base.hip, -1), -1)
    found = np.zeros(len(hip), bool)
    for years in (0.0, -YEARS_FROM_HIPPARCOS):
        tree = cKDTree(base.icrs + years * base.motion_rad_yr)
        distance, row = tree.query(place, k=2, distance_upper_bound=reach)
        same = (np.abs(v_mag[row] - stars.v_mag[:, None]) < SAME_STAR_MAG) | (number[row] == hip[:, None])
        found |= (np.isfinite(distance) & same).any(axis=1)
    yale = base[base.hip == 0]
    distance, row = cKDTree(yale.icrs).query(place, distance_upper_bound=float(np.radians(YALE_ARCSEC / 3600)))
    return found | (np.abs(np.append(yale.v_mag, np.inf)[row] - stars.v_mag) < YALE_MAG)


def chosen(stars: Stars, rows: NDArray[np.bool_]) -> Stars:
    return Stars(*(getattr(stars, name)[rows] for name in Stars.__dataclass_fields__))


def main(archive: Path) -> None:
    stars, hip = read(archive)
    TYCHO2_PATH.parent.mkdir(exist_ok=True)
    formats = ["%d", "%.6f", "%.6f", "%.1f", "%.1f", "%.2f"]
    for path in (NEAR_BRIGHTER_PATH, CELNAV_PATH):
        path.parent.mkdir(exist_ok=True)
        np.savetxt(path, near_brighter(stars, hip), formats, ",", header=",".join(COLUMNS), comments="")
    bright = stars.v_mag <= FAINTEST_V_MAG
    stars, hip = chosen(stars, bright), hip[bright]
    rest = chosen(stars, ~known(stars, hip, merge(read_ybsc(), read_hipparcos())))
    TYCHO2_PATH.write_bytes(packed(rest))
    print(f"{len(hip)} stars to V {FAINTEST_V_MAG}, {len(rest.v_mag)} of them in {TYCHO2_PATH}")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
