"""The flying objects of a frame. Each has its own time span within the shutter's, over which places and light are sampled."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Whole = NDArray[np.intp]

KEYFRAMES = 65
"""Number of directions of each object over its own time span; in between they are interpolated linearly."""
FEWEST_PARTS = 64
"""Fewest parts of a light curve."""


@dataclass(frozen=True)
class FlyingObjects:
    """n objects of a frame.

    Attributes
    ----------
    number : (n,) int array
        Index in the scenario.
    kind : tuple of str
    v_mag, bv_mag : (n,) arrays
    lit : (n, 2) array
        Start and end of the object's own time span, as fractions (0-1) of the shutter's; outside it there is no light.
    directions : (n, k, 3) array
        Apparent unit vectors (ENU), evenly spaced over its own time span.
    parts : (n,) int array
        Number of equal parts into which its light curve divides the time span.
    light_curve : (sum of parts,) array
        Relative brightness in each part, object by object.
    """

    number: NDArray[np.int32]
    kind: tuple[str, ...]
    v_mag: Floats
    bv_mag: Floats
    lit: Floats
    directions: Floats
    parts: Whole
    light_curve: Floats

    def __len__(self) -> int:
        return len(self.kind)

    @property
    def first_part(self) -> Whole:
        """Index of the first part of each object's light curve, (n,) array."""
        return np.asarray(np.cumsum(self.parts) - self.parts, dtype=np.intp)

    @property
    def dark_ends(self) -> NDArray[np.bool_]:
        """Whether each object is dark in the first and in the last part of its time span, (n, 2) array."""
        ends = np.stack([self.first_part, np.cumsum(self.parts) - 1], axis=1)
        return np.asarray(self.light_curve[ends] == 0, dtype=np.bool_)

    @property
    def shining(self) -> NDArray[np.bool_]:
        """Which objects emit any light, (n,) array."""
        return np.bincount(self._owner, self.light_curve, len(self)) > 0

    @property
    def _owner(self) -> Whole:
        """Index of the object to which each part belongs."""
        return np.repeat(np.arange(len(self)), self.parts)

    def chosen(self, wanted: NDArray[np.bool_]) -> FlyingObjects:
        """Return the objects that a mask (n,) selects."""
        return FlyingObjects(
            self.number[wanted],
            tuple(kind for kind, one in zip(self.kind, wanted, strict=True) if one),
            self.v_mag[wanted],
            self.bv_mag[wanted],
            self.lit[wanted],
            self.directions[wanted],
            self.parts[wanted],
            self.light_curve[wanted[self._owner]],
        )

    def within(self, start: float, stop: float) -> FlyingObjects:
        """Return the objects over a part of the exposure, from fraction `start` to `stop`; dark if they do not shine then."""
        begin, end = np.maximum(self.lit[:, 0], start), np.minimum(self.lit[:, 1], stop)
        dark = end <= begin
        length = self.lit[:, 1] - self.lit[:, 0]
        own = np.clip(np.stack([begin, np.maximum(begin, end)], axis=1) - self.lit[:, :1], 0, length[:, None])
        own /= length[:, None]
        lit = (np.stack([begin, end], axis=1) - start) / (stop - start)
        parts, curve = self._curve_within(own, dark)
        return replace(
            self,
            lit=np.where(dark[:, None], [0.0, 1.0], lit),
            directions=_places_within(self.directions, own),
            parts=parts,
            light_curve=curve,
        )

    def _curve_within(self, own: Floats, dark: NDArray[np.bool_]) -> tuple[Whole, Floats]:
        """Return light curves over parts of the time spans, from and to fractions (n, 2), no finer than the whole curves."""
        asked = np.ceil(self.parts * (own[:, 1] - own[:, 0]) - 1e-9)
        parts = np.minimum(self.parts, np.maximum(asked, FEWEST_PARTS)).astype(np.intp)
        place = self.first_part[:, None] + own * self.parts[:, None]
        step = (place[:, 1] - place[:, 0]) / parts
        owner = np.repeat(np.arange(len(parts)), parts)
        number = np.arange(len(owner)) - np.repeat(np.cumsum(parts) - parts, parts)
        low = place[owner, 0] + number * step[owner]
        high = np.minimum(place[owner, 0] + (number + 1) * step[owner], place[owner, 1])
        summed = np.concatenate([[0.0], np.cumsum(self.light_curve)])
        edges = np.arange(len(summed))
        light = np.interp(high, edges, summed) - np.interp(low, edges, summed)
        width = np.where(dark, 1.0, step)[owner]
        return parts, np.asarray(np.where(dark[owner], 0.0, light / width))


def _places_within(values: Floats, own: Floats) -> Floats:
    """Resample places (n, k, 3), linear in between over each object's time span, as k samples over a part (n, 2) of it."""
    last = values.shape[1] - 1
    place = np.linspace(own[:, 0], own[:, 1], last + 1, axis=1) * last
    before = np.minimum(np.floor(place).astype(np.intp), last - 1)
    weight = (place - before)[..., None]
    row = np.arange(len(values))[:, None]
    return np.asarray((1 - weight) * values[row, before] + weight * values[row, before + 1])


def steady(count: int) -> tuple[Floats, Whole, Floats]:
    """Return `lit`, `parts` and `light_curve` for objects that shine steadily over the whole exposure."""
    parts = np.full(count, FEWEST_PARTS, dtype=np.intp)
    return np.tile([0.0, 1.0], (count, 1)), parts, np.ones(count * FEWEST_PARTS)


def none() -> FlyingObjects:
    """Return an empty set of objects."""
    lit, parts, curve = steady(0)
    nothing = np.zeros(0)
    return FlyingObjects(np.zeros(0, np.int32), (), nothing, nothing, lit, np.zeros((0, KEYFRAMES, 3)), parts, curve)


def joined(groups: list[FlyingObjects]) -> FlyingObjects:
    """Concatenate groups of objects."""
    return FlyingObjects(
        np.concatenate([group.number for group in groups]),
        tuple(kind for group in groups for kind in group.kind),
        np.concatenate([group.v_mag for group in groups]),
        np.concatenate([group.bv_mag for group in groups]),
        np.concatenate([group.lit for group in groups]),
        np.concatenate([group.directions for group in groups]),
        np.concatenate([group.parts for group in groups]),
        np.concatenate([group.light_curve for group in groups]),
    )
