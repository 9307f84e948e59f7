"""Detections that stay in place while the sky turns: hot pixels, lamps, scratches."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from celnav.calibrating.frames import CalibrationFrame
from celnav.identification.pairing import candidate_pairs

_STILL_PX = 0.75
# Least motion of stars on the equator between frames that are compared; stars within 20 deg of the pole move by a third.
_MOVED_PX = 6.0
_TURN_RAD_PER_DAY = 2 * math.pi * 1.00273790935
_MOST_EXPECTED = 0.01


def moving(frames: list[CalibrationFrame], f_px: float) -> list[NDArray[np.bool_]]:
    """Return which detections of each frame, shape (n,), do not recur at the same place under another sky.

    A detection stands still if so many other frames show one within 0.75 px that chance would cause fewer than one such case
    in a hundred sets of frames like these (a binomial tail). Two frames alone show little; five are enough for a clear
    result.

    Parameters
    ----------
    frames : list of CalibrationFrame
        Frames of one camera.
    f_px : float
        Focal length, which determines how far the sky moves between two frames.
    """
    turned = np.array([frame.utc.mjd * _TURN_RAD_PER_DAY for frame in frames])
    apart = 2 * np.abs(np.sin((turned[:, None] - turned) / 2)) * f_px > _MOVED_PX
    result = []
    for i, frame in enumerate(frames):
        others = np.flatnonzero(apart[i])
        found = np.zeros(len(frame.uv), dtype=int)
        chance = []
        for j in others:
            other = frames[j]
            near, _, _ = candidate_pairs(frame.uv, other.uv, _STILL_PX)
            found[np.unique(near)] += 1
            chance.append(len(other.uv) * math.pi * _STILL_PX**2 / math.prod(other.size))
        result.append(found < _fewest(chance, len(frame.uv)))
    return result


def _fewest(chance: list[float], tried: int) -> int:
    """Return the number of coincidences that chance reaches in fewer than `_MOST_EXPECTED` of `tried` detections."""
    if not chance:
        return 1
    from scipy.special import bdtrc

    tail = bdtrc(np.arange(len(chance)), len(chance), max(chance))
    enough = np.flatnonzero(tail * tried < _MOST_EXPECTED)
    return int(enough[0]) + 1 if len(enough) else len(chance) + 1
