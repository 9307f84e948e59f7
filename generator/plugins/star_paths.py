"""Places of stars on the film during the exposure, and their motion between two keyframes.

Most stars move together, so one star in every cell of the frame (a probe) represents the motion of the others; flying
objects each have a path of their own.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from generator.device_arrays import aligned
from generator.plugins.camera import FLOAT64, NightSkyCamera
from generator.plugins.stars import OwnTimes, StarEmitter

Floats = NDArray[np.float64]
Rows = NDArray[np.int64]

COARSE_CHECKS = 33
"""Number of moments of the exposure at which sources without probes are first examined, to find those near the frame."""
FEW_SHARES: Floats = np.array([0.0, 0.5, 1.0])
"""Fractions of the exposure at which every star is projected if probes represent the rest."""
PROBES = (32, 24)
"""Numbers of cells across and down the frame, with one probe each."""
SAFETY = 1.15
"""Factor on the probes' motion, larger than its variation within a cell."""
SLACK_PX = 1.0
"""Distance added to the probes' excursion, for cells whose stars hardly move."""
FAR_PX = 200.0
"""Distance beyond the reach of the frame up to which probes count, because they represent stars nearer to it."""
LANES_AT_ONCE = 1_000_000
"""Projections in one launch: enough to fill any device, few enough for its memory."""


@dataclass(frozen=True)
class Placed:
    """m sources on the film, each at one moment.

    Attributes
    ----------
    u, v : (m,) arrays
        Position, px; NaN outside the lens' range.
    cosine : (m,) array
        Cosine of the angle from the boresight.
    valid : (m,) bool array
        Whether the source is within the lens' range.
    time : (m,) array
        Time, 0 to 1 over the shutter's time.
    direction : tuple of Float64
        Directions east, north, up, on the device.
    """

    u: Floats
    v: Floats
    cosine: Floats
    valid: NDArray[np.bool_]
    time: Floats
    direction: Any


def project(camera: NightSkyCamera, emitter: StarEmitter, star: Rows, share: Floats) -> Placed:
    """Project stars (indices, (m,)) when fractions (m,) of the exposures of their rows have passed."""
    index = mi.UInt32(aligned(star.astype(np.uint32)))
    u, v, cosine, valid, time = camera.project_source(
        lambda time: emitter.direction(index, time), FLOAT64(aligned(share))
    )
    direction = emitter.direction(index, time)
    dr.eval(u, v, cosine, valid, time, direction)
    good = np.array(valid)
    place = [np.where(good, np.array(value, dtype=np.float64), np.nan) for value in (u, v)]
    return Placed(place[0], place[1], np.array(cosine), good, np.array(time), direction)


def relative_light(camera: NightSkyCamera, placed: Placed) -> Floats:
    """The camera's relative light at positions, (m,) array; 0 outside the lens' range."""
    u, v = (FLOAT64(aligned(np.nan_to_num(position))) for position in (placed.u, placed.v))
    return np.where(placed.valid, np.array(camera.relative_light(u, v, FLOAT64(aligned(placed.cosine)))), 0.0)


@dataclass(frozen=True)
class LitShares:
    """Parts of their rows' exposures in which n stars shine.

    Attributes
    ----------
    times : OwnTimes
    first, length : (n,) arrays
        Start and length as fractions of the exposure.
    """

    times: OwnTimes
    first: Floats
    length: Floats

    def share(self, star: Rows, own: Floats) -> Floats:
        """Fractions (m,) of the exposure at fractions (m,) of the stars' own time span."""
        return self.first[star] + own * self.length[star]

    @classmethod
    def of(cls, camera: NightSkyCamera, emitter: StarEmitter) -> LitShares | None:
        """Return those of an emitter; None if all its stars shine throughout.

        With a rolling shutter, the start and end of an own time span depend on the star's place then, because rows differ
        in the start of their exposure. For a star outside the lens' range the longest possible span is used.
        """
        if emitter.own is None:
            return None
        start, end = emitter.own.start, emitter.own.end
        if camera.read_out_share:
            index = mi.UInt32(dr.arange(mi.UInt32, emitter.count))
            first, last = (
                _share_at(camera, emitter, index, time, beyond)
                for time, beyond in ((start, camera.read_out_share), (end, 0.0))
            )
            first, last = np.where(start <= 0, 0.0, first), np.where(end >= 1, 1.0, last)
            return cls(emitter.own, first, np.maximum(last - first, 0))
        return cls(emitter.own, start, end - start)


def _share_at(camera: NightSkyCamera, emitter: StarEmitter, index: Any, time: Floats, beyond: float) -> Floats:
    """Fraction of its row's exposure, between 0 and 1, at which the time is that of each star.

    `beyond` is the start of the row's exposure to use outside the lens' range.
    """
    moment = FLOAT64(aligned(time))
    _, v, _, valid = camera.project(*emitter.direction(index, moment), moment)
    starts = camera.moment(dr.clip(dr.select(valid, v, 0), -camera.height, 2 * camera.height), 0)
    row_start = np.where(np.array(valid), np.array(starts), beyond)
    return np.clip((time - row_start) / camera.exposure_share, 0, 1)


@dataclass(frozen=True)
class Paths:
    """The stars whose light may touch the frame at some time, and their motion.

    Attributes
    ----------
    near : (n,) bool array
        Mask of these among all stars.
    star : (m,) array
        Their indices.
    start, end : (m, 2) arrays
        Positions (u, v) when the exposure of a star's row, or the star's own time span within it, starts and ends, px;
        NaN outside the lens' range.
    longest_px : (m,) array
        Longest step between two of `checks` evenly spaced fractions of that time.
    checks : int
    """

    near: NDArray[np.bool_]
    star: Rows
    start: Floats
    end: Floats
    longest_px: Floats
    checks: int


def find_paths(
    camera: NightSkyCamera, emitter: StarEmitter, middle: Placed, reach_px: float, lit: LitShares | None = None
) -> Paths:
    """Find the stars whose light may touch the frame.

    Parameters
    ----------
    camera, emitter
    middle : Placed
        All n stars of the emitter, half-way through their rows' exposure.
    reach_px : float
        Largest distance of a star's centre from the frame at which its light still touches the frame.
    lit : LitShares or None
        Times at which they shine; None for throughout.
    """
    everyone = np.arange(emitter.count, dtype=np.int64)
    checks = max(2, camera.keyframes, emitter.keyframes)
    excursion, probed = np.zeros(emitter.count), None
    if lit is None and checks > len(FEW_SHARES):
        u, v = _tracks(camera, emitter, everyone, FEW_SHARES[::2])
        u, v = (np.insert(ends, 1, half, axis=1) for ends, half in ((u, middle.u), (v, middle.v)))
        excursion, probed = _probe(camera, emitter, middle, checks, reach_px)
    else:
        u, v = _tracks(camera, emitter, everyone, np.linspace(0, 1, min(checks, COARSE_CHECKS)), lit)
    steps, touching = _steps_by_the_frame(camera, u, v, reach_px + excursion[:, None])
    near = touching.any(axis=1)
    # Indexing with indices is several times faster than with masks.
    chosen = np.flatnonzero(near)
    if probed is not None:
        longest = probed[chosen]
    elif len(chosen) and checks > u.shape[1]:
        longest = _longest_step(camera, emitter, chosen, checks, reach_px, lit)
    else:
        longest = steps.max(axis=1, initial=0.0)[chosen]
    start, end = (np.stack([u[chosen, share], v[chosen, share]], axis=1) for share in (0, -1))
    return Paths(near, chosen, start, end, longest, checks)


def _tracks(
    camera: NightSkyCamera, emitter: StarEmitter, star: Rows, shares: Floats, lit: LitShares | None = None
) -> tuple[Floats, Floats]:
    """Positions u and v, (stars, shares) arrays, at fractions of the exposure or of the stars' own time span within it."""
    every, share = np.repeat(star, len(shares)), np.tile(shares, len(star))
    placed = project(camera, emitter, every, share if lit is None else lit.share(every, share))
    return placed.u.reshape(len(star), -1), placed.v.reshape(len(star), -1)


def _probe(
    camera: NightSkyCamera, emitter: StarEmitter, middle: Placed, checks: int, reach_px: float
) -> tuple[Floats, Floats]:
    """Bounds on the motion of all n stars, from one star in every cell of the frame.

    Returns
    -------
    excursion : (n,) array
        Distance by which the image leaves the rectangle around its positions at FEW_SHARES, px.
    longest : (n,) array
        Longest step, px, between two of `checks` evenly spaced fractions of the exposure.
    """
    probes, of_star = _probes(camera, middle, reach_px + FAR_PX)
    u, v = _tracks(camera, emitter, probes, FEW_SHARES)
    low, high = (np.stack([f.reduce(u, axis=1), f.reduce(v, axis=1)]) for f in (np.fmin, np.fmax))
    excursion, longest = np.zeros(len(probes)), np.zeros(len(probes))
    for shares in _blocks_of_shares(len(probes), checks):
        u, v = _tracks(camera, emitter, probes, shares)
        steps, _ = _steps_by_the_frame(camera, u, v, reach_px + FAR_PX)
        longest = np.maximum(longest, steps.max(axis=1, initial=0.0))
        for axis, position in enumerate((u, v)):
            beyond = np.fmax(low[axis][:, None] - position, position - high[axis][:, None])
            excursion = np.fmax(excursion, np.nan_to_num(beyond).max(axis=1, initial=0.0))
    return SAFETY * excursion[of_star] + SLACK_PX, SAFETY * longest[of_star]


def _probes(camera: NightSkyCamera, middle: Placed, counted_px: float) -> tuple[Rows, NDArray[np.intp]]:
    """The outermost star of each cell, where images move fastest, and the number of each star's probe among them.

    Cells on the rim include all stars beyond. Stars farther from the frame than `counted_px`, whose steps do not count,
    represent a cell only if it contains no other.
    """
    columns, rows = (
        np.clip(np.nan_to_num(position) * (cells / size), 0, cells - 1).astype(np.intp)
        for position, size, cells in ((middle.u, camera.width, PROBES[0]), (middle.v, camera.height, PROBES[1]))
    )
    distance = np.hypot(middle.u - camera.width / 2, middle.v - camera.height / 2)
    beyond = np.maximum(
        np.abs(middle.u - camera.width / 2) - camera.width / 2, np.abs(middle.v - camera.height / 2) - camera.height / 2
    )
    distance = np.nan_to_num(np.where(beyond < counted_px, distance, -distance), nan=-np.inf)
    cell = rows * PROBES[0] + columns
    farthest = np.full(PROBES[0] * PROBES[1], -np.inf)
    np.maximum.at(farthest, cell, distance)
    outermost = np.flatnonzero(distance == farthest[cell])
    held, first = np.unique(cell[outermost], return_index=True)
    number = np.zeros(len(farthest), np.intp)
    number[held] = np.arange(len(held))
    return outermost[first], number[cell]


def _blocks_of_shares(count: int, checks: int) -> Iterator[Floats]:
    """Evenly spaced fractions of the exposure in overlapping blocks, as many as fill LANES_AT_ONCE for `count` stars."""
    block = max(1, LANES_AT_ONCE // max(count, 1))
    for lower in range(0, checks - 1, block):
        yield np.arange(lower, min(lower + block, checks - 1) + 1) / (checks - 1)


def _steps_by_the_frame(
    camera: NightSkyCamera, u: Floats, v: Floats, reach_px: float | Floats
) -> tuple[Floats, NDArray[np.bool_]]:
    """Lengths, px, of the steps between successive positions (n, k), and whether their light can touch the frame.

    Steps that cannot touch the frame are set to 0, because far outside the frame a rectilinear image moves without bound.
    """
    touching = np.ones((u.shape[0], u.shape[1] - 1), dtype=bool)
    for position, size in ((u, camera.width), (v, camera.height)):
        lowest, highest = np.fmin(position[:, 1:], position[:, :-1]), np.fmax(position[:, 1:], position[:, :-1])
        touching &= (highest > -reach_px - 1) & (lowest < size + reach_px)
    steps = np.nan_to_num(np.hypot(np.diff(u), np.diff(v)))
    return np.where(touching, steps, 0.0), touching


def _longest_step(
    camera: NightSkyCamera, emitter: StarEmitter, chosen: Rows, checks: int, reach_px: float, lit: LitShares | None
) -> Floats:
    """Longest step, px, of each chosen star between two of `checks` evenly spaced fractions of its time."""
    longest = np.zeros(len(chosen))
    for shares in _blocks_of_shares(len(chosen), checks):
        steps, _ = _steps_by_the_frame(camera, *_tracks(camera, emitter, chosen, shares, lit), reach_px)
        longest = np.maximum(longest, steps.max(axis=1, initial=0.0))
    return longest
