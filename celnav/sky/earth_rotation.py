"""Earth orientation: UT1-UTC and polar motion from the IERS table finals2000A."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from celnav.checking import finite_number
from celnav.errors import EarthRotationError
from celnav.sky.utc import Utc, tai_minus_utc_s


@dataclass(frozen=True)
class EarthOrientation:
    """Orientation of the Earth at an instant.

    Attributes
    ----------
    dut1_s : float
        UT1 - UTC, seconds.
    xp_arcsec, yp_arcsec : float
        Coordinates of the celestial intermediate pole in the terrestrial frame, arcseconds.
    """

    dut1_s: float
    xp_arcsec: float = 0.0
    yp_arcsec: float = 0.0


@dataclass(frozen=True, eq=False)
class EarthOrientationTable:
    """Daily values at 0 h UTC: MJD, UT1 - TAI (s, continuous over leap seconds), polar motion (arcsec). Shapes (n,)."""

    mjd: NDArray[np.float64]
    ut1_tai_s: NDArray[np.float64]
    xp_arcsec: NDArray[np.float64]
    yp_arcsec: NDArray[np.float64]

    def at(self, utc: Utc) -> EarthOrientation:
        """Interpolate linearly to `utc`; raise `EarthRotationError` outside the table."""
        if not self.mjd[0] <= utc.mjd <= self.mjd[-1]:
            raise EarthRotationError(
                f"no Earth rotation data for MJD {utc.mjd:.1f}: the table covers MJD {self.mjd[0]:.0f} to "
                f"{self.mjd[-1]:.0f}; update the package astropy-iers-data or give dut1_s"
            )
        ut1_tai = float(np.interp(utc.mjd, self.mjd, self.ut1_tai_s))
        return EarthOrientation(
            dut1_s=ut1_tai + utc.tai_utc_s,
            xp_arcsec=float(np.interp(utc.mjd, self.mjd, self.xp_arcsec)),
            yp_arcsec=float(np.interp(utc.mjd, self.mjd, self.yp_arcsec)),
        )


def read_finals2000a(path: Path) -> EarthOrientationTable:
    """Read an IERS finals2000A file (Bulletin A values: observed, then predicted).

    The columns are those of the file's ReadMe: MJD 8-15, x pole 19-27 and y pole 38-46 (arcsec), UT1-UTC 59-68 (s). The
    table ends at the first day without a UT1-UTC.
    """
    try:
        lines = path.read_bytes().splitlines()
    except OSError as error:
        raise EarthRotationError(f"cannot read the Earth rotation table {path}: {error.strerror}") from None
    text = np.array([line.ljust(68)[:68] for line in lines], dtype="S68").view("S1").reshape(len(lines), 68)

    def column(first: int, last: int) -> NDArray[np.bytes_]:
        return np.ascontiguousarray(text[:, first - 1 : last]).view(f"S{last - first + 1}")[:, 0]

    blank = np.char.strip(column(59, 68)) == b""
    n = int(np.argmax(blank)) if blank.any() else len(lines)
    if n < 2:
        raise EarthRotationError(f"the Earth rotation table {path} holds no UT1-UTC: reinstall astropy-iers-data")
    mjd = column(8, 15)[:n].astype(np.float64)
    tai_utc = np.array([tai_minus_utc_s(int(day)) for day in mjd])
    return EarthOrientationTable(
        mjd,
        column(59, 68)[:n].astype(np.float64) - tai_utc,
        column(19, 27)[:n].astype(np.float64),
        column(38, 46)[:n].astype(np.float64),
    )


@lru_cache(maxsize=1)
def default_table() -> EarthOrientationTable:
    """Return the table of the installed data package astropy-iers-data."""
    import astropy_iers_data

    return read_finals2000a(Path(astropy_iers_data.IERS_A_FILE))


def earth_orientation(utc: Utc, dut1_s: float | None = None) -> EarthOrientation:
    """Return the Earth's orientation at `utc`.

    If `dut1_s` is given, it replaces the UT1-UTC of the table; outside the table, polar motion (at most 0.6 arcsec, 18 m)
    is then taken as zero.
    """
    if dut1_s is None:
        return default_table().at(utc)
    dut1_s = finite_number(dut1_s, "dut1_s", EarthRotationError)
    if not abs(dut1_s) < 1.0:
        raise EarthRotationError(f"dut1_s = {dut1_s} is impossible: |UT1-UTC| is kept below 0.9 s")
    table = default_table()
    if not table.mjd[0] <= utc.mjd <= table.mjd[-1]:
        return EarthOrientation(dut1_s)
    known = table.at(utc)
    return EarthOrientation(dut1_s, known.xp_arcsec, known.yp_arcsec)
