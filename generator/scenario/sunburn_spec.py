"""The scenario's ``sensor.sunburn``: pixels that the Sun's image burnt."""

from __future__ import annotations

import itertools
from typing import Annotated

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from generator.places.times import Instant
from generator.scenario.strict import Fraction, Strict, listed

MOST_DAYS = 400


def _check_day(text: str) -> str:
    _midnight(text)
    return text


def _midnight(day: str) -> Instant:
    return Instant.parse(f"{day}T00:00:00Z")


def _increasing_hours(curve: tuple[tuple[float, float], ...]) -> tuple[tuple[float, float], ...]:
    if any(after[0] <= before[0] for before, after in itertools.pairwise(curve)):
        raise ValueError("hours must increase")
    if curve[-1][0] - curve[0][0] > 24:
        raise ValueError("hours must lie within one day")
    return curve


Day = Annotated[str, AfterValidator(_check_day)]
Hours = Annotated[
    tuple[tuple[Annotated[float, Field(ge=0, le=48)], Fraction], ...],
    Field(min_length=2, max_length=100),
    AfterValidator(_increasing_hours),
    BeforeValidator(listed),
]


class SunburnSpec(Strict):
    """Days on which a fixed camera was exposed to the Sun, and the damage to its pixels.

    Place and attitude are those of that time: the camera may point elsewhere in the frames.
    """

    first_day: Day
    """First of the days, UTC, such as 2017-05-30."""
    last_day: Day
    """Last of the days; at most 400 in all."""
    hours_utc: Hours
    """Points [hour of UTC, fraction of the days on which the Sun reached the sensor at that hour], linear in between, zero
    outside; hours beyond 24 belong to the next day."""
    latitude_deg: Annotated[float, Field(ge=-90, le=90)]
    """Geodetic latitude of the camera, deg."""
    longitude_deg: Annotated[float, Field(ge=-180, le=360)]
    """Longitude, deg, east positive."""
    azimuth_deg: Annotated[float, Field(ge=-360, le=360)]
    """Azimuth of the boresight, from north through east, deg."""
    altitude_deg: Annotated[float, Field(ge=-90, le=90)]
    """Altitude of the boresight, deg."""
    roll_deg: Annotated[float, Field(ge=-360, le=360)] = 0.0
    """Clockwise turn of the camera about its boresight, deg."""
    traps_per_min: Annotated[float, Field(gt=0, le=1000)]
    """Mean number of traps that a minute in the Sun's image leaves in a pixel."""
    trap_e: Annotated[float, Field(gt=0, le=1e6)]
    """Mean of the exponentially distributed charge that a trap can hold, electrons."""
    half_full_e: Annotated[float, Field(ge=0, le=1e6)] = 0.0
    """Free charge of a pixel that keeps its traps half full, electrons; 0 fills them first."""

    @model_validator(mode="after")
    def _days_in_order(self) -> SunburnSpec:
        if not 0 <= self.days - 1 < MOST_DAYS:
            raise ValueError(
                f"last_day {self.last_day} is not within {MOST_DAYS} days from first_day {self.first_day} on; change one"
            )
        return self

    @property
    def days(self) -> int:
        """Number of days."""
        return round(_midnight(self.last_day).mjd - _midnight(self.first_day).mjd) + 1

    @property
    def first_midnight(self) -> Instant:
        """Start of the first day."""
        return _midnight(self.first_day)
