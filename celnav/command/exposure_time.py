"""The middle of the exposure: as supplied, or from a photograph's tags and a time zone."""

from __future__ import annotations

import re
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta, timezone, tzinfo
from typing import Literal

from celnav.command.exif import PhotoTags
from celnav.errors import TimeError
from celnav.reading.fits_file import is_fits
from celnav.sky.utc import parse_utc

Stamp = Literal["start", "middle", "end"]
# Times of position fixes can be minutes old, and clocks slightly wrong.
_MOST_STALE_S = 240.0
# Offsets of the zones in use, whole hours and others, in minutes (IANA's database since 2000). Among all multiples of a
# quarter hour, a fix a quarter of an hour old would give a zone that nobody has.
_ODD_ZONES_MIN = (-570, -270, -210, -150, 210, 270, 330, 345, 390, 510, 525, 570, 585, 630, 690, 765, 825)
_ZONES_MIN = (*range(-720, 841, 60), *_ODD_ZONES_MIN)


@dataclass(frozen=True)
class ExposureTime:
    """The middle of the exposure.

    Attributes
    ----------
    utc : str
        ISO 8601 with Z, or as supplied by the caller.
    assumed : tuple of str
        How the time follows from the photograph, a sentence each.
    """

    utc: str
    assumed: tuple[str, ...] = ()


def exposure_time(tags: PhotoTags, utc: str | None, time_zone: str | None, stamp: Stamp = "start") -> ExposureTime:
    """Determine the middle of the exposure.

    Parameters
    ----------
    tags : PhotoTags
        Tags of the photograph.
    utc : str or None
        The middle, if the caller knows it; the tags are then not used.
    time_zone : str or None
        Time zone of the camera's clock, ``+02:00`` or ``Europe/Berlin``; None takes it from the tags.
    stamp : str
        What the photograph's time refers to: the ``start``, ``middle`` or ``end`` of the exposure. The EXIF standard leaves
        it open; most cameras write the start.

    Raises
    ------
    TimeError
        When the time is missing, malformed, without a time zone, or in an hour that a clock shows twice or never.
    """
    if utc is not None:
        if time_zone is not None:
            raise TimeError("give --utc or --time-zone, not both: --utc needs no zone")
        if stamp != "start":
            raise TimeError("give --utc or --exif-time-is, not both: --utc is the middle of the exposure")
        parse_utc(utc)
        return ExposureTime(utc)
    if tags.taken is None:
        if tags.gps_utc is None:
            why = f" ({tags.lacks})" if tags.lacks else ""
            raise TimeError(f"the image has no time of its own{why}: give --utc, such as --utc 2020-01-01T00:00:00Z")
        begun, assumed = tags.gps_utc, ["time from the tag of its last position fix, which may be older"]
    else:
        begun, assumed = _on_the_clock(tags, tags.taken, time_zone)
        if tags.whole_seconds:
            assumed[-1] += "; to whole seconds"
    exposure = timedelta(seconds=tags.exposure_s or 0.0)
    # In UTC, because the sum of a local time and a duration ignores a change to or from summer time between them.
    middle = begun.astimezone(UTC) + {"start": 0.5, "middle": 0.0, "end": -0.5}[stamp] * exposure
    if stamp != "middle":
        length = f"{tags.exposure_s:g} s" if tags.exposure_s else "an exposure of no stated length, taken as none"
        assumed.append(f"that time marks the {stamp} of {length}")
    written = middle.strftime("%Y-%m-%dT%H:%M:%S.%f").rstrip("0").rstrip(".")
    return ExposureTime(f"{written}Z", tuple(assumed))


def refuse_clock_options(path: str, time_zone: str | None, stamp: Stamp) -> None:
    """Raise `TimeError` for options that would shift the time of a FITS image, whose header states it fully."""
    options = [*(["--time-zone"] if time_zone is not None else []), *(["--exif-time-is"] if stamp != "start" else [])]
    if options and is_fits(path):
        raise TimeError(
            f"{' and '.join(options)}: for clocks of photographs; the times in the header of the FITS file {path} are UTC, "
            f"and its keywords (DATE-OBS) say what they mark: leave {'it' if len(options) == 1 else 'them'} out"
        )


def _on_the_clock(tags: PhotoTags, taken: datetime, time_zone: str | None) -> tuple[datetime, list[str]]:
    """Return the time of the camera's clock, with its time zone, and how that zone is known."""
    shown = f"{taken:%Y-%m-%d %H:%M:%S}"
    if time_zone is not None:
        return _local(taken, _zone(time_zone), time_zone), [
            f"time {shown} of the camera's clock in the zone {time_zone}"
        ]
    if tags.offset is not None:
        return taken.replace(tzinfo=timezone(tags.offset)), [
            f"time {shown} of the camera's clock at UTC{_offset_text(tags.offset)} ({tags.source})"
        ]
    if tags.gps_utc is not None:
        apart_s = (taken.replace(tzinfo=UTC) - tags.gps_utc).total_seconds()
        offset = timedelta(minutes=min(_ZONES_MIN, key=lambda minutes: abs(60 * minutes - apart_s)))
        if abs(apart_s - offset.total_seconds()) <= _MOST_STALE_S:
            return taken.replace(tzinfo=timezone(offset)), [
                f"time {shown} of the camera's clock at UTC{_offset_text(offset)}, by its difference from the tag of GPS time"
            ]
    raise TimeError(
        f"the image was taken at {shown} by its clock, whose zone it does not say: give --time-zone, such as +02:00 or "
        "Europe/Berlin, or --utc"
    )


def _zone(name: str) -> tzinfo:
    if found := re.fullmatch(r"([+-])(\d\d):?(\d\d)", name.strip()):
        offset = timedelta(hours=int(found[2]), minutes=int(found[3]))
        if offset <= timedelta(hours=14) and int(found[3]) < 60:
            return timezone(offset if found[1] == "+" else -offset)
    elif name.strip().upper() in ("Z", "UTC"):
        return UTC
    else:
        from zoneinfo import ZoneInfo

        try:
            return ZoneInfo(name.strip())
        except (KeyError, ValueError, OSError):  # unknown; a path; a folder of zones
            pass
    raise TimeError(f"time zone {name!r} is not known: write it as +02:00 or Europe/Berlin")


def _local(taken: datetime, zone: tzinfo, name: str) -> datetime:
    """Add the time zone to a clock's time; refuse a time that the clock showed twice or never."""
    first, second = taken.replace(tzinfo=zone, fold=0), taken.replace(tzinfo=zone, fold=1)
    offsets = [_offset_text(moment.utcoffset() or timedelta(0)) for moment in (first, second)]
    if offsets[0] != offsets[1]:
        raise TimeError(
            f"clocks of {name} are set back or forth at {taken:%Y-%m-%d %H:%M:%S}: give --time-zone {offsets[0]} or "
            f"{offsets[1]}"
        )
    return first


def _offset_text(offset: timedelta) -> str:
    minutes = round(offset.total_seconds() / 60)
    return f"{'-' if minutes < 0 else '+'}{abs(minutes) // 60:02d}:{abs(minutes) % 60:02d}"
