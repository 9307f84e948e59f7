"""Coordinated Universal Time: a strict reader, and the time scales that follow from it."""

from __future__ import annotations

import re
from dataclasses import dataclass
from datetime import UTC, date, datetime, timedelta
from functools import cache

import erfa
import numpy as np
from numpy.typing import NDArray

from celnav.errors import TimeError

_PATTERN = re.compile(
    r"(?P<year>\d{4})-(?P<month>\d\d)-(?P<day>\d\d)[T ](?P<hour>\d\d):(?P<minute>\d\d)"
    r"(?::(?P<second>\d\d)(?P<fraction>\.\d+)?)?(?P<zone>Z|[+-]\d\d:?\d\d)?"
)
_MJD_EPOCH = date(1858, 11, 17)
_TT_MINUS_TAI_S = 32.184


@dataclass(frozen=True)
class Utc:
    """An instant of UTC.

    Attributes
    ----------
    mjd_day : int
        Modified Julian Date of the UTC day.
    second_of_day_s : float
        Seconds since 0 h UTC; 86400 to 86401 within a positive leap second.
    """

    mjd_day: int
    second_of_day_s: float

    @property
    def tai_utc_s(self) -> float:
        """TAI - UTC in seconds, from ERFA's table of leap seconds."""
        return tai_minus_utc_s(self.mjd_day)

    @property
    def mjd(self) -> float:
        """Modified Julian Date (UTC), good to about a microsecond."""
        return self.mjd_day + self.second_of_day_s / 86400.0

    @property
    def tt(self) -> tuple[float, float]:
        """Terrestrial Time as a two-part Julian Date."""
        seconds = self.second_of_day_s + self.tai_utc_s + _TT_MINUS_TAI_S
        return 2400000.5 + self.mjd_day, seconds / 86400.0

    def ut1(self, dut1_s: float) -> tuple[float, float]:
        """Return UT1 as a two-part Julian Date, given UT1 - UTC in seconds."""
        return 2400000.5 + self.mjd_day, (self.second_of_day_s + dut1_s) / 86400.0


@cache
def _leap_table() -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    table = erfa.leap_seconds.get()
    table = table[table["year"] >= 1972]
    days = [(date(int(y), int(m), 1) - _MJD_EPOCH).days for y, m in zip(table["year"], table["month"], strict=True)]
    return np.asarray(days, dtype=np.int64), np.asarray(table["tai_utc"], dtype=np.float64)


def tai_minus_utc_s(mjd_day: int) -> float:
    """Return TAI - UTC (s) on a UTC day given by its MJD; raise `TimeError` before 1972."""
    days, offsets = _leap_table()
    row = int(np.searchsorted(days, mjd_day, side="right")) - 1
    if row < 0:
        raise TimeError("UTC before 1972-01-01 has no whole leap seconds; give a later time")
    return float(offsets[row])


def parse_utc(utc: str | datetime | Utc) -> Utc:
    """Read a UTC time.

    Parameters
    ----------
    utc : str, datetime or Utc
        ISO 8601 with a time zone (``2020-01-01T00:00:00Z``, or an offset such as ``+02:00``), or a datetime with a time
        zone. The second 60 is accepted in a leap second.

    Returns
    -------
    Utc
        The instant.

    Raises
    ------
    TimeError
        When the time cannot be read, has no time zone, or does not exist.
    """
    if isinstance(utc, Utc):
        return utc
    if isinstance(utc, datetime):
        if utc.tzinfo is None:
            raise TimeError(f"UTC {utc.isoformat()} has no zone: use datetime(..., tzinfo=datetime.UTC)")
        moment = utc.astimezone(UTC)
        seconds = moment.hour * 3600 + moment.minute * 60 + moment.second + moment.microsecond * 1e-6
        return _checked(Utc((moment.date() - _MJD_EPOCH).days, seconds))
    if not isinstance(utc, str):
        raise TimeError(f"UTC must be a string such as 2020-01-01T00:00:00Z, not {type(utc).__name__}")
    found = _PATTERN.fullmatch(utc.strip())
    if found is None:
        raise TimeError(f"UTC {utc!r} is not ISO 8601: write it as 2020-01-01T00:00:00Z")
    zone = found["zone"]
    if zone is None:
        raise TimeError(f"UTC {utc!r} has no zone: append Z")
    second, hour, minute = int(found["second"] or 0), int(found["hour"]), int(found["minute"])
    leap = second == 60
    try:
        base = datetime(
            int(found["year"]), int(found["month"]), int(found["day"]), hour, minute, 59 if leap else second, tzinfo=UTC
        )
        if zone != "Z":
            sign, digits = (1 if zone[0] == "+" else -1), zone[1:].replace(":", "")
            if int(digits[:2]) > 14 or int(digits[2:]) > 59:
                raise ValueError("offset out of range")
            base -= sign * timedelta(hours=int(digits[:2]), minutes=int(digits[2:]))
    except (ValueError, OverflowError) as error:
        raise TimeError(f"UTC {utc!r} does not exist ({error}): write it as 2020-01-01T00:00:00Z") from None
    seconds = base.hour * 3600 + base.minute * 60 + base.second + (1 if leap else 0) + float(found["fraction"] or 0.0)
    instant = Utc((base.date() - _MJD_EPOCH).days, seconds)
    if leap and (seconds < 86400 or tai_minus_utc_s(instant.mjd_day + 1) == instant.tai_utc_s):
        raise TimeError(f"UTC {utc!r} has second 60, but there is no leap second then")
    return _checked(instant)


def _checked(instant: Utc) -> Utc:
    tai_minus_utc_s(instant.mjd_day)
    return instant
