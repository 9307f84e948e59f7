"""UTC instants as ERFA's two-part quasi Julian dates, and Earth orientation from IERS tables."""

from __future__ import annotations

import functools
import re
import warnings
from dataclasses import dataclass
from pathlib import Path

import astropy_iers_data
import erfa
import numpy as np
from numpy.typing import NDArray

from generator.errors import DataFileError, TimeRangeError

_UTC = re.compile(r"(\d{4})-(\d\d)-(\d\d)T(\d\d):(\d\d):(\d\d(?:\.\d{1,9})?)Z")
SECONDS_PER_DAY = 86400.0
UT1_UTC = slice(58, 68)
BULLETIN_A = (slice(7, 15), slice(18, 27), slice(37, 46), UT1_UTC)
"""Columns of a line of finals2000A: MJD, coordinates of the pole (arcsec) and UT1-UTC (s) of Bulletin A."""


@dataclass(frozen=True)
class Instant:
    """A UTC instant as ERFA's quasi Julian date in two parts (days); leap seconds are handled by ERFA."""

    utc1: float
    utc2: float

    @classmethod
    def parse(cls, text: str) -> Instant:
        """Parse ISO 8601 with a trailing Z, for example ``2020-01-01T00:00:00.5Z``.

        Raises
        ------
        ValueError
            The text is not in this form, or the calendar has no such date.
        """
        match = _UTC.fullmatch(text)
        if match is None:
            raise ValueError(f"{text!r} is not a UTC time like 2020-01-01T00:00:00Z (ISO 8601, ending in Z)")
        year, month, day, hour, minute = (int(part) for part in match.groups()[:5])
        second = float(match.group(6))
        leap_second_possible = hour == 23 and minute == 59
        if hour > 23 or minute > 59 or second >= (61 if leap_second_possible else 60):
            raise ValueError(f"{text!r} has no such time of day")
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error", erfa.ErfaWarning)
                utc1, utc2 = erfa.dtf2d("UTC", year, month, day, hour, minute, second)
        except erfa.ErfaError as error:
            raise ValueError(f"{text!r} is not a date: {error}") from error
        except erfa.ErfaWarning as error:
            raise ValueError(f"{text!r}: leap seconds are not known for that year") from error
        return cls(float(utc1), float(utc2))

    def plus(self, seconds: float) -> Instant:
        """Return the instant `seconds` of TAI later."""
        tai1, tai2 = erfa.utctai(self.utc1, self.utc2)
        utc1, utc2 = erfa.taiutc(tai1, tai2 + seconds / SECONDS_PER_DAY)
        return Instant(float(utc1), float(utc2))

    def since(self, other: Instant) -> float:
        """Seconds of TAI since another instant."""
        (tai1, tai2), (other1, other2) = (erfa.utctai(each.utc1, each.utc2) for each in (self, other))
        return float((tai1 - other1) + (tai2 - other2)) * SECONDS_PER_DAY

    def isoformat(self) -> str:
        """Return ISO 8601 with microseconds and Z."""
        year, month, day, clock = erfa.d2dtf("UTC", 6, self.utc1, self.utc2)
        hour, minute, second, micro = (int(clock[key]) for key in ("h", "m", "s", "f"))
        return f"{int(year):04d}-{int(month):02d}-{int(day):02d}T{hour:02d}:{minute:02d}:{second:02d}.{micro:06d}Z"

    def plain_jd(self) -> tuple[float, float]:
        """Julian date, UTC, in two parts of days of 86,400 s, which a day with a leap second exceeds."""
        tai1, tai2 = erfa.utctai(self.utc1, self.utc2)
        tai_utc_s = erfa.dat(*erfa.jd2cal(self.utc1, self.utc2))
        return float(tai1), float(tai2 - tai_utc_s / SECONDS_PER_DAY)

    @property
    def mjd(self) -> float:
        """Modified Julian date, UTC, to about 1e-9 day."""
        return self.utc1 - 2400000.5 + self.utc2


@dataclass(frozen=True)
class EarthOrientation:
    """Rotation of the Earth that the precession-nutation model does not include.

    Attributes
    ----------
    ut1_utc_s : float
        UT1-UTC, seconds.
    polar_motion_x_arcsec, polar_motion_y_arcsec : float
        Coordinates of the pole, arcsec.
    """

    ut1_utc_s: float
    polar_motion_x_arcsec: float
    polar_motion_y_arcsec: float


@functools.cache
def finals2000a() -> NDArray[np.float64]:
    """Rows (MJD, x_p, y_p, UT1-UTC) of IERS finals2000A, from 1973 with a year of predictions; arcsec and s.

    All values are those of Bulletin A, because a mixture with the final ones of Bulletin B would have a step where those
    end. The file that astropy-iers-data installs is read by the columns of the IERS' description (readme.finals2000A):
    astropy's own reader gives the same numbers, but takes a second in each process that plans a frame.

    Raises
    ------
    DataFileError
        The installed table cannot be read.
    """
    path = Path(astropy_iers_data.IERS_A_FILE)
    try:
        lines = path.read_text(encoding="ascii").splitlines()
        rows = [[float(line[column]) for column in BULLETIN_A] for line in lines if line[UT1_UTC].strip()]
    except (OSError, ValueError) as error:
        raise DataFileError(f"{path}: not an Earth orientation table ({error}); reinstall astropy-iers-data") from error
    if not rows:
        raise DataFileError(f"{path}: holds no UT1-UTC; reinstall astropy-iers-data")
    return np.array(rows)


def earth_orientation(instant: Instant) -> EarthOrientation:
    """Earth orientation at an instant, linear between the daily values of the IERS table.

    UT1-UTC jumps by a second at a leap second; therefore UT1-TAI, which does not jump, is interpolated.

    Raises
    ------
    TimeRangeError
        The instant is outside the table, which starts in 1973 and ends with the predictions of the installed
        astropy-iers-data.
    """
    table = finals2000a()
    mjd = instant.mjd
    row = int(np.searchsorted(table[:, 0], mjd, side="right")) - 1
    if row < 0 or row + 1 >= len(table):
        raise TimeRangeError(
            f"{instant.isoformat()} lies outside the Earth orientation table "
            f"(MJD {table[0, 0]:.0f} to {table[-1, 0]:.0f}); choose a time inside it or update astropy-iers-data"
        )
    before, after = table[row], table[row + 1]
    jump = round(after[3] - before[3])
    weight = (mjd - before[0]) / (after[0] - before[0])
    x, y, ut1_utc = before[1:] + weight * (after[1:] - before[1:] - np.array([0.0, 0.0, jump]))
    return EarthOrientation(float(ut1_utc), float(x), float(y))
