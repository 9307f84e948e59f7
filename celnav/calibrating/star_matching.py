"""Matching of detections with stars, once lens and attitude are approximately known."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from celnav.calibrating.frames import CalibrationFrame, Sky
from celnav.identification.pairing import candidate_pairs, mutual_nearest
from celnav.identification.verification import log10_chance

F8 = NDArray[np.float64]
Rows = NDArray[np.intp]

# With a neighbour within this distance that is less than this many magnitudes fainter, the match is ambiguous.
BLEND_PX, BLEND_MAG = 3.0, 1.0
# The light of fainter neighbours pulls a centroid within a window of this standard deviation.
_WINDOW_PX = 1.5
# Deviations of fluxes from the magnitudes up to this do not indicate a wrong match: colours, clouds, saturation.
_LEAST_MAG, _MAG_SIGMAS = 0.8, 4.0
_FEWEST_FOR_FLUX = 20


@dataclass(frozen=True, eq=False)
class Match:
    """Pairs of one frame.

    Attributes
    ----------
    detection, star : ndarray, shape (m,)
        Rows of the detections and of the sky.
    limiting_mag : float
        Magnitude down to which stars were matched.
    log10_chance : float
        Bound, as a decimal logarithm, on the probability that chance gives as many pairs at this attitude.
    pull_px : ndarray, shape (m,)
        Distance by which the light of fainter neighbours may pull each centroid, pixels.
    """

    detection: Rows
    star: Rows
    limiting_mag: float
    log10_chance: float
    pull_px: F8


def match_frame(
    frame: CalibrationFrame,
    sky: Sky,
    predicted: F8,
    radius_px: float,
    *,
    faintest_mag: float = math.inf,
    usable: NDArray[np.bool_] | None = None,
    region: tuple[F8, float] | None = None,
) -> Match:
    """Pair each detection with the star predicted nearest to it.

    Parameters
    ----------
    frame, sky
        The frame, and the stars over it.
    predicted : ndarray, shape (k, 2)
        Predicted positions of the stars of the sky; NaN for stars not in view.
    radius_px : float
        Largest distance of a pair, pixels.
    faintest_mag : float
        Stars fainter than this are left out, and so are those fainter than the frame shows.
    usable : ndarray of bool, shape (n,), optional
        Detections that may be stars, unlike hot pixels.
    region : tuple of (ndarray (2,), float), optional
        Centre and radius, pixels, of the part of the frame that is matched.
    """
    width, height = frame.size
    u, v = np.nan_to_num(predicted, nan=-1e6).T
    inside = (u > -0.5) & (u < width - 0.5) & (v > -0.5) & (v < height - 0.5) & (sky.v_mag <= faintest_mag)
    good = np.ones(len(frame.uv), dtype=bool) if usable is None else usable.copy()
    area = float(width * height)
    if region is not None:
        middle, reach = region
        inside &= np.hypot(u - middle[0], v - middle[1]) <= reach
        good &= np.hypot(*(frame.uv - middle).T) <= reach
        area = min(area, math.pi * reach**2)
    stars, detections = np.flatnonzero(inside), np.flatnonzero(good)
    nothing = Match(np.empty(0, np.intp), np.empty(0, np.intp), -math.inf, 0.0, np.empty(0))
    if not len(stars) or not len(detections):
        return nothing
    detection, star = mutual_nearest(frame.uv[detections], predicted[stars], radius_px)
    chance = 1 - math.exp(-len(detections) * math.pi * radius_px**2 / area)
    seen = np.zeros(len(stars), dtype=bool)
    seen[star] = True
    n_deep = _depth(seen, chance)
    deep = star < n_deep
    detection, star = detections[detection[deep]], stars[star[deep]]
    agreeing = log10_chance(int(seen[:n_deep].sum()), n_deep, min(max(chance, 1e-9), 1 - 1e-9))
    alone, pull_px = _neighbours(predicted, sky.v_mag, star)
    clear = alone & _agreeing_in_flux(frame, sky, detection, star)
    limit = float(sky.v_mag[stars[n_deep - 1]]) if n_deep else -math.inf
    return Match(detection[clear], star[clear], limit, agreeing, pull_px[clear])


def _depth(seen: NDArray[np.bool_], chance: float) -> int:
    """Return how many of the stars, brightest first, the frame shows: the number that best separates seen from unseen.

    The threshold is halfway between the fraction of the brighter stars that is seen and the fraction expected by chance for
    stars that are too faint.
    """
    bright = seen[: max(20, len(seen) // 10)]
    share = max((float(bright.mean()) - chance) / max(1 - chance, 1e-3), 0.05)
    gain = np.cumsum(seen - (chance + 0.5 * share * (1 - chance)))
    return int(np.argmax(gain)) + 1 if gain.max() > 0 else 0


def _neighbours(predicted: F8, v_mag: F8, star: Rows) -> tuple[NDArray[np.bool_], F8]:
    """Return which stars cannot be confused with a neighbour, and how far neighbours pull their centroids, px."""
    in_view = np.flatnonzero(np.isfinite(predicted[:, 0]))
    one, other, distance = candidate_pairs(predicted[star], predicted[in_view], 3 * _WINDOW_PX)
    other = in_view[other]
    fainter_by = v_mag[other] - v_mag[star[one]]
    neighbour = star[one] != other
    alone = np.ones(len(star), dtype=bool)
    alone[one[neighbour & (distance < BLEND_PX) & (fainter_by < BLEND_MAG)]] = False
    pull = 10 ** (-0.4 * np.maximum(fainter_by, 0)) * distance * np.exp(-0.5 * (distance / _WINDOW_PX) ** 2)
    square = np.bincount(one[neighbour], weights=pull[neighbour] ** 2, minlength=len(star))
    return alone, np.asarray(np.sqrt(square), dtype=np.float64)


def _agreeing_in_flux(frame: CalibrationFrame, sky: Sky, detection: Rows, star: Rows) -> NDArray[np.bool_]:
    """Return which detections are as bright as their stars, given the frame's zero point, falloff and extinction."""
    agreeing = np.ones(len(star), dtype=bool)
    flux = frame.detections.flux
    if flux is None or len(star) < _FEWEST_FOR_FLUX:
        return agreeing
    off = -2.5 * np.log10(np.maximum(flux[detection], 1e-30)) - sky.v_mag[star]
    middle = np.array(frame.size) / 2
    r2 = np.sum((frame.uv[detection] - middle) ** 2, axis=1) / np.sum(middle**2)
    airmass = 1 / np.maximum(sky.dirs[star, 2], 0.08)
    design = np.column_stack((np.ones(len(off)), r2, r2**2, airmass, sky.v_mag[star]))
    spread = math.inf
    for _ in range(4):
        solution = np.linalg.lstsq(design[agreeing], off[agreeing], rcond=None)[0]
        left = off - design @ solution
        spread = 1.4826 * float(np.median(np.abs(left[agreeing])))
        agreeing = np.abs(left) <= max(_LEAST_MAG, _MAG_SIGMAS * spread)
    return agreeing
