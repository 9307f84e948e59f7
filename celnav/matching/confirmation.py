"""Confirmation of a candidate by the relative bearings of its neighbours.

The thesis (section 4.i) encodes "relative bearing angles between neighbors" along with distances, without stating how they
are compared. There are two readings: `align` finds the rotation about the reference star that brings most neighbours of the
image onto neighbours of the pattern; `compare_differences` compares the angle from each neighbour to the next. Both respect
the sense of rotation, so a mirror image does not pass.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

F8 = NDArray[np.float64]
_TURN = 2 * np.pi


@dataclass(frozen=True, eq=False)
class Alignment:
    """The best rotation of a pattern onto the image's.

    Attributes
    ----------
    rotation_rad : float
        Image bearing minus pattern bearing.
    image, pattern : ndarray of int, shape (m,)
        Rows of the image's and of the pattern's neighbours that coincide, one to one.
    log10_false_alarm : float
        Bound on the decimal logarithm of the probability that chance alone does as well at *some* rotation.
    """

    rotation_rad: float
    image: NDArray[np.intp]
    pattern: NDArray[np.intp]
    log10_false_alarm: float


def align(
    image_theta: F8,
    image_bearing: F8,
    pattern_theta: F8,
    pattern_bearing: F8,
    tolerance_rad: float,
    radius_rad: float,
) -> Alignment:
    """Find the rotation about the reference star that matches most neighbours.

    Parameters
    ----------
    image_theta, image_bearing : ndarray, shape (n,)
        Distances and bearings of the detections around the reference, radians.
    pattern_theta, pattern_bearing : ndarray, shape (m,)
        The same for the catalogue pattern, sorted by distance.
    tolerance_rad : float
        Distance, along and across, within which two neighbours coincide.
    radius_rad : float
        Radius of the pattern, for the false-alarm probability.
    """
    nothing = Alignment(0.0, np.empty(0, np.intp), np.empty(0, np.intp), 0.0)
    # Consider only pairs of similar distance: a window of the sorted pattern for each neighbour in the image.
    low = np.searchsorted(pattern_theta, image_theta - tolerance_rad)
    count = np.searchsorted(pattern_theta, image_theta + tolerance_rad, side="right") - low
    total = int(count.sum())
    if total == 0:
        return nothing
    i = np.repeat(np.arange(len(image_theta)), count)
    j = np.arange(total) + np.repeat(low - np.cumsum(count) + count, count)
    turn = (image_bearing[i] - pattern_bearing[j]) % _TURN
    sine = np.maximum(np.sin(image_theta[i]), 1e-9)
    # Bins have the width of the tolerance at half the radius of the pattern. A peak may straddle an edge, hence sums of two.
    n_bins = max(8, int(_TURN * math.sin(radius_rad / 2) / tolerance_rad))
    histogram = np.bincount((turn / _TURN * n_bins).astype(np.intp) % n_bins, minlength=n_bins)
    peak = int(np.argmax(histogram + np.roll(histogram, -1)))
    centre = (peak + 1) / n_bins * _TURN
    rotation = centre
    width = _TURN / n_bins
    off = np.abs(_wrap(turn - centre)) <= width
    for _ in range(3):
        rotation += float(np.median(_wrap(turn[off] - rotation)))
        near = np.abs(_wrap(turn - rotation)) * sine <= tolerance_rad
        if not near.any():
            return nothing
        off = near
    distance = np.hypot(_wrap(turn[off] - rotation) * sine[off], image_theta[i[off]] - pattern_theta[j[off]])
    rows, columns = keep_mutually_nearest(i[off], j[off], distance)
    trials = n_bins
    expected = len(image_theta) * len(pattern_theta) * 2 * tolerance_rad**2 / (math.pi * (1 - math.cos(radius_rad)))
    return Alignment(rotation, rows, columns, log10_chance(len(rows), expected) + math.log10(trials))


def compare_differences(
    image_theta: F8,
    image_bearing: F8,
    pattern_theta: F8,
    pattern_bearing: F8,
    tolerance_rad: float,
) -> Alignment:
    """Compare sorted bearing differences.

    Each neighbour in the image is paired with the neighbour of the pattern that is nearest in distance (and to which it is
    the nearest). The pairs are sorted by their bearing in the image, and the angle from each to the next is compared with the
    same angle in the pattern. A neighbour agrees if the step to it or the step from it agrees.

    Parameters
    ----------
    image_theta, image_bearing, pattern_theta, pattern_bearing, tolerance_rad
        As for `align`.
    """
    nothing = Alignment(0.0, np.empty(0, np.intp), np.empty(0, np.intp), 0.0)
    if len(image_theta) == 0 or len(pattern_theta) == 0:
        return nothing
    right = np.clip(np.searchsorted(pattern_theta, image_theta), 1, max(len(pattern_theta) - 1, 1))
    right = np.minimum(right, len(pattern_theta) - 1)
    left = np.maximum(right - 1, 0)
    nearer_left = np.abs(pattern_theta[left] - image_theta) <= np.abs(pattern_theta[right] - image_theta)
    nearest = np.where(nearer_left, left, right)
    apart = np.abs(pattern_theta[nearest] - image_theta)
    close = np.flatnonzero(apart <= tolerance_rad)
    rows, columns = keep_mutually_nearest(close, nearest[close], apart[close])
    if len(rows) < 2:
        return nothing
    order = np.argsort(image_bearing[rows] % _TURN, kind="stable")
    rows, columns = rows[order], columns[order]
    step_image = np.roll(image_bearing[rows], -1) - image_bearing[rows]
    step_pattern = np.roll(pattern_bearing[columns], -1) - pattern_bearing[columns]
    # The uncertainty of a bearing is the tolerance divided by the sine of the distance; a step has two ends.
    wide = tolerance_rad / np.maximum(np.sin(image_theta[rows]), tolerance_rad)
    allowed = np.minimum(np.hypot(wide, np.roll(wide, -1)), np.pi)
    agrees = np.abs(_wrap(step_image - step_pattern)) <= allowed
    member = agrees | np.roll(agrees, 1)
    if not agrees.any():
        return nothing
    rows, columns = rows[member], columns[member]
    offset = image_bearing[rows] - pattern_bearing[columns]
    rotation = float(np.angle(np.mean(np.exp(1j * offset))))
    chance = log10_chance(int(agrees.sum()), float(np.sum(allowed) / np.pi))
    return Alignment(rotation % _TURN, rows, columns, chance)


def log10_chance(n: int, expected: float) -> float:
    """Return Chernoff's bound on log10 of the probability of n or more events if `expected` are expected (Poisson)."""
    if n <= expected or n == 0:
        return 0.0
    return (n - expected - n * math.log(n / expected)) / math.log(10)


def _wrap(angle: F8) -> F8:
    return (angle + np.pi) % _TURN - np.pi


def keep_mutually_nearest(
    rows: NDArray[np.intp], columns: NDArray[np.intp], distance: F8
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Keep the pairs that are each other's nearest."""
    order = np.argsort(distance, kind="stable")
    rows, columns = rows[order], columns[order]
    first_row = np.zeros(len(rows), dtype=bool)
    first_column = np.zeros(len(rows), dtype=bool)
    first_row[np.unique(rows, return_index=True)[1]] = True
    first_column[np.unique(columns, return_index=True)[1]] = True
    mutual = first_row & first_column
    return rows[mutual], columns[mutual]
