"""Lights that cross the sky on great circles at constant angular speed: trails, and trains of satellites."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from generator.errors import ScenarioError
from generator.frame.flying.objects import FEWEST_PARTS, KEYFRAMES, FlyingObjects, steady
from generator.scenario.foreground_spec import NO_WAY_RAD, DirectionSpec, StrobeSpec, TrailSpec, TrainSpec

Floats = NDArray[np.float64]

PARTS_PER_FLASH = 8
MOST_PARTS = 1 << 17
"""Largest number of parts of a light curve: enough for flashes of 0.05 s over 13 minutes. Limits time and memory."""
NO_TURN = 1e-9
"""Fraction of a strobe's period below which a time counts as the start of a flash, to allow for rounded times."""
TURN_RAD = 2 * math.pi


@dataclass(frozen=True)
class GreatCircle:
    """A path on the sky along a great circle: it is at `first` at the angle 0 and proceeds towards `across`.

    Attributes
    ----------
    first, across : (3,) arrays
        Unit vectors (ENU), at right angles.
    rate_rad_s : float
        Angular rate; 0 if the light stands still.
    start_s : float
        Time at which the light is at `first`, from the start of the exposure.
    middle_rad : float
        Half the angle of the path in the scenario.
    """

    first: Floats
    across: Floats
    rate_rad_s: float
    start_s: float
    middle_rad: float

    @classmethod
    def between(cls, start: DirectionSpec, end: DirectionSpec, start_s: float, end_s: float) -> GreatCircle:
        """Return the path from one direction to another within a time span."""
        first, last = _unit(start), _unit(end)
        across = last - (last @ first) * first
        length = float(np.linalg.norm(across))
        if length < NO_WAY_RAD or end_s <= start_s:
            return cls(first, np.zeros(3), 0.0, start_s, 0.0)
        angle = math.atan2(length, float(last @ first))
        return cls(first, across / length, angle / (end_s - start_s), start_s, angle / 2)

    def directions(self, time_s: Floats) -> Floats:
        """Unit vectors (k, 3) at times (k,) from the start of the exposure."""
        angle = (self.rate_rad_s * (time_s - self.start_s))[:, None]
        return np.asarray(np.cos(angle) * self.first + np.sin(angle) * self.across)

    def above_s(self, horizon_sine: float) -> tuple[float, float]:
        """Return the time span in which the light is above a horizon, once around its path's middle; empty if it never is."""
        if self.rate_rad_s == 0:
            return (-math.inf, math.inf) if self.first[2] >= horizon_sine else (0.0, 0.0)
        highest = math.hypot(self.first[2], self.across[2])
        if highest <= horizon_sine:
            return 0.0, 0.0
        half = math.acos(max(horizon_sine / highest, -1.0))
        top = math.atan2(self.across[2], self.first[2])
        top += TURN_RAD * round((self.middle_rad - top) / TURN_RAD)
        return self.start_s + (top - half) / self.rate_rad_s, self.start_s + (top + half) / self.rate_rad_s


def trail_objects(trails: tuple[TrailSpec, ...], shutter_s: float, horizon_sine: float) -> list[FlyingObjects]:
    """Return each trail of a foreground as one object.

    Raises
    ------
    ScenarioError
        Flashes are too short for the time over which they go on.
    """
    return [_trail(trail, number, shutter_s, horizon_sine) for number, trail in enumerate(trails)]


def _trail(trail: TrailSpec, number: int, shutter_s: float, horizon_sine: float) -> FlyingObjects:
    end_s = shutter_s if trail.end_s is None else trail.end_s
    way = GreatCircle.between(trail.start, trail.end, trail.start_s, end_s)
    lit, parts, curve = steady(1)
    begin, end = lit_s(trail, end_s, way.above_s(horizon_sine), shutter_s)
    if end > begin:
        lit = np.array([[begin / shutter_s, end / shutter_s]])
        count = _parts(trail.strobe, number, end - begin)
        parts, curve = np.array([count], dtype=np.intp), light_curve(trail, end_s, np.linspace(begin, end, count + 1))
    else:
        begin, end, curve = 0.0, shutter_s, np.zeros_like(curve)
    return FlyingObjects(
        number=np.array([number], dtype=np.int32),
        kind=(trail.kind,),
        v_mag=np.array([trail.v_mag]),
        bv_mag=np.array([trail.bv_mag]),
        lit=lit,
        directions=way.directions(np.linspace(begin, end, KEYFRAMES))[None],
        parts=parts,
        light_curve=curve,
    )


def lit_s(trail: TrailSpec, end_s: float, above_s: tuple[float, float], shutter_s: float) -> tuple[float, float]:
    """Return the times of first and last light of a trail within the exposure, s from its start; if dark, last <= first."""
    begin, end = max(trail.start_s, above_s[0], 0.0), min(end_s, above_s[1], shutter_s)
    if trail.strobe is not None:
        period_s, flash_s, first_s = trail.strobe.period_s, trail.strobe.flash_s, trail.strobe.first_s
        since = (begin - first_s) % period_s
        if since >= flash_s:
            begin += period_s - since
        since = (end - first_s) % period_s
        end -= max((since if since > NO_TURN * period_s else period_s) - flash_s, 0.0)
    return begin, end


def _parts(strobe: StrobeSpec | None, number: int, lit_s: float) -> int:
    """Return the number of parts of the light curve of a trail that shines or flashes for a given time."""
    if strobe is None:
        return FEWEST_PARTS
    asked = math.ceil(PARTS_PER_FLASH * lit_s / strobe.flash_s)
    if asked > MOST_PARTS:
        raise ScenarioError(
            f"foreground.trails.{number}.strobe.flash_s: flashes of {strobe.flash_s:g} s over {lit_s:g} s of the exposure "
            f"are more than a light curve resolves; make flashes of {PARTS_PER_FLASH * lit_s / MOST_PARTS:.2g} s or more, "
            "a shorter exposure, or several trails, each with a part of the time (start_s, end_s)"
        )
    return max(asked, FEWEST_PARTS)


def light_curve(trail: TrailSpec, end_s: float, edges_s: Floats) -> Floats:
    """Mean brightness of an always lit trail, relative to its magnitude, between successive times (m + 1,).

    A meteor's brightness rises and falls as a parabola over its path, as a first approximation to observed light curves.
    """
    if trail.strobe is not None:
        turns, since = np.divmod(edges_s - trail.strobe.first_s, trail.strobe.period_s)
        flash_s = min(trail.strobe.flash_s, trail.strobe.period_s)
        light = turns * flash_s + np.minimum(since, flash_s)
    elif trail.kind == "meteor":
        share = (edges_s - trail.start_s) / (end_s - trail.start_s)
        light = (2 * share**2 - 4 / 3 * share**3) * (end_s - trail.start_s)
    else:
        return np.ones(len(edges_s) - 1)
    mean = np.diff(light) / np.diff(edges_s)
    # Residuals of rounding in the dark would count as light.
    return np.asarray(np.where(mean > NO_TURN, mean, 0.0))


def train_objects(train: TrainSpec, first: int, shutter_s: float, horizon_sine: float) -> FlyingObjects:
    """Satellites that follow each other on one path, each for as long as it is above the horizon."""
    way = GreatCircle.between(train.start, train.end, train.start_s, train.end_s)
    above, late = np.array(way.above_s(horizon_sine)), train.gap_s * np.arange(train.count)[:, None]
    times = np.clip(above + late, 0, shutter_s)
    dark = times[:, 1] <= times[:, 0]
    times = np.where(dark[:, None], [0.0, shutter_s], times)
    _, parts, curve = steady(train.count)
    keyframes = np.linspace(times[:, 0], times[:, 1], KEYFRAMES, axis=1) - late
    return FlyingObjects(
        number=first + np.arange(train.count, dtype=np.int32),
        kind=("satellite",) * train.count,
        v_mag=np.full(train.count, train.v_mag),
        bv_mag=np.full(train.count, train.bv_mag),
        lit=times / shutter_s,
        directions=way.directions(keyframes.ravel()).reshape(train.count, KEYFRAMES, 3),
        parts=parts,
        light_curve=curve * ~np.repeat(dark, parts),
    )


def _unit(direction: DirectionSpec) -> Floats:
    azimuth, altitude = np.radians([direction.azimuth_deg, direction.altitude_deg])
    return np.array([np.sin(azimuth) * np.cos(altitude), np.cos(azimuth) * np.cos(altitude), np.sin(altitude)])
