"""Exposure times in FITS headers: start, middle and duration of the exposure, or the reason why they are not available.

Source: Rots et al. 2015, A&A 574, A36 (FITS time). DATE-OBS is the start unless the header has DATE-BEG, DATE-AVG or
DATE-END; TIMESYS states a time scale other than UTC, such as UT1, which is up to 0.9 s away. Older headers have the time of
day in a separate keyword.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

Header = Mapping[str, object]

LONGEST_S = 86400.0
_EXPOSURES = ("EXPTIME", "EXPOSURE", "XPOSURE", "EXP_TIME")
_YEARS = (1900, 2200)
_TIMES_OF_DAY = ("TIME-OBS", "UT", "UTC", "UTSTART", "UTC-OBS", "UT-OBS", "TIME-BEG")
_MJD_EPOCH = datetime(1858, 11, 17, tzinfo=UTC)
_SCALES = ("", "UTC", "UT", "GMT", "Z")
# File name of the mean of a block of video frames, as used by stations of the Global Meteor Network.
_BLOCK_NAME = re.compile(r"FF_?\w*?_(\d{8})_(\d{6})_(\d{3})_")


@dataclass(frozen=True)
class ExposureInHeader:
    """Time of the exposure according to a header.

    Attributes
    ----------
    begun, middle : datetime or None
        Start and middle, UTC; None if the header does not give them.
    length_s : float or None
        Exposure time, s; None if the header does not give it.
    lacks : str
        Reason why the middle is not known, as a sentence; empty if it is known.
    """

    begun: datetime | None
    middle: datetime | None
    length_s: float | None
    lacks: str = ""


class _UnusableError(Exception):
    """A keyword of the header is present but cannot be used."""


def exposure_in(header: Header, first: Header, name: str) -> ExposureInHeader:
    """Read the exposure from an image's header, else from the first header of the file, else from a meteor block's name.

    Parameters
    ----------
    header, first : mapping
        Keywords and their values, of the image and of the file's first unit.
    name : str
        Name of the file.
    """
    try:
        length_s = _length(header, first)
        for part in (header, first):
            # A time scale that only the first header names is taken to be that of the image too.
            if (found := _of({"TIMESYS": first.get("TIMESYS"), **part}, length_s)) is not None:
                return found
    except _UnusableError as error:
        return ExposureInHeader(None, None, None, str(error))
    block_s = _block_length(first)
    if block_s is not None and (middle := block_middle(name, block_s)) is not None:
        return ExposureInHeader(middle - timedelta(seconds=block_s / 2), middle, length_s or block_s)
    return ExposureInHeader(None, None, length_s, "its header has no DATE-OBS")


def _of(part: Header, length_s: float | None) -> ExposureInHeader | None:
    """Read the exposure from one header; None if it has no date."""
    average = _moment(part, "DATE-AVG", "MJD-AVG")
    if average is not None:
        begun = None if length_s is None else average - timedelta(seconds=length_s / 2)
        return ExposureInHeader(begun, average, length_s)
    begun = _moment(part, "DATE-BEG", "MJD-BEG") or _moment(part, "DATE-OBS", "MJD-OBS")
    if begun is None:
        return None
    if length_s is not None:
        return ExposureInHeader(begun, begun + timedelta(seconds=length_s / 2), length_s)
    ended = _moment(part, "DATE-END", "MJD-END")
    if ended is not None and 0 <= (took_s := (ended - begun).total_seconds()) <= LONGEST_S:
        return ExposureInHeader(begun, begun + timedelta(seconds=took_s / 2), took_s)
    return ExposureInHeader(begun, None, None, "its header has no EXPTIME")


def _length(header: Header, first: Header) -> float | None:
    """Return the first usable exposure time, s; None if no keyword gives one."""
    wrong = ""
    for part in (header, first):
        for key in _EXPOSURES:
            if (value := part.get(key)) is None:
                continue
            length_s = _number(value)
            if 0 <= length_s <= LONGEST_S:
                return length_s
            wrong = wrong or f"its {key} is {_shown(value)}, expected seconds from 0 to {LONGEST_S:g}"
    if wrong:
        raise _UnusableError(wrong)
    return None


def _number(value: object) -> float:
    """Return a number, even if the header has it as text; NaN for anything else."""
    try:
        return float(value) if isinstance(value, (int, float, str)) and not isinstance(value, bool) else math.nan
    except ValueError:
        return math.nan


def _moment(part: Header, date_key: str, mjd_key: str) -> datetime | None:
    """Read a date with its time of day, or a Modified Julian Date; without a time zone it is UTC."""
    value = part.get(date_key)
    text = value.strip() if isinstance(value, str) else ""
    if not text:
        return _of_mjd(part, mjd_key)
    day = text.replace("/", "-")
    if re.fullmatch(r"[\dW-]{7,10}", day):
        of_day = next(
            (clock for key in _TIMES_OF_DAY if isinstance(clock := part.get(key), str) and ":" in clock), None
        )
        if of_day is None:
            if (moment := _of_mjd(part, mjd_key)) is not None and f"{moment:%Y%m%d}" == day.replace("-", ""):
                return moment
            raise _UnusableError(f"its {date_key} is {_shown(text)}, which is without a time of day")
        day = f"{day}T{of_day.strip()}"
    try:
        moment = datetime.fromisoformat(day)
        if not _YEARS[0] <= moment.year <= _YEARS[1]:
            raise ValueError
        moment = moment.replace(tzinfo=UTC) if moment.tzinfo is None else moment.astimezone(UTC)
    except (ValueError, OverflowError):
        raise _UnusableError(f"its {date_key} is {_shown(text)}, expected UTC such as 2018-09-14T11:53:22.8") from None
    return _in_utc(part, moment)


def _of_mjd(part: Header, key: str) -> datetime | None:
    value = part.get(key)
    if value is None:
        return None
    try:
        moment = _MJD_EPOCH + timedelta(days=_number(value))
        if not _YEARS[0] <= moment.year <= _YEARS[1]:
            raise ValueError
    except (ValueError, OverflowError):
        raise _UnusableError(
            f"its {key} is {_shown(value)}, expected a Modified Julian Date such as 58375.4954"
        ) from None
    return _in_utc(part, moment)


def _in_utc(part: Header, moment: datetime) -> datetime:
    scale = part.get("TIMESYS")
    if isinstance(scale, str) and scale.partition("(")[0].strip().upper() not in _SCALES:
        raise _UnusableError(f"its times are in {_shown(scale.strip())} (TIMESYS), expected UTC")
    return moment


def _shown(value: object) -> str:
    return repr(value)[:60]


def _block_length(first: Header) -> float | None:
    """Return the duration of a meteor station's block of video frames, s."""
    count, rate = first.get("NFRAMES"), first.get("FPS")
    if not (isinstance(count, (int, float)) and isinstance(rate, (int, float)) and 0 < count < 1e6 and 0 < rate < 1e6):
        return None
    return count / rate if count / rate < LONGEST_S else None


def block_middle(name: str, length_s: float) -> datetime | None:
    """Return the middle of a block of video frames from its file name, ``FF_<station>_<date>_<time>_<ms>_…``, else None."""
    found = _BLOCK_NAME.match(name)
    if found is None:
        return None
    try:
        begun = datetime.strptime(found[1] + found[2], "%Y%m%d%H%M%S").replace(tzinfo=UTC)
    except ValueError:
        return None
    if not _YEARS[0] <= begun.year <= _YEARS[1]:
        return None
    return begun + timedelta(milliseconds=int(found[3])) + timedelta(seconds=length_s / 2)
