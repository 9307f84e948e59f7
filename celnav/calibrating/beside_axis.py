"""Pictures cut from one side of a larger one: starts with the axis beside the middle, and the test that asks for them.

Around its axis a lens is r = f theta, and alike in all directions. Beside it a fisheye's scale differs along and across the
radius, by 6 % at 35 deg. A lens about the middle of such a picture names the stars there and misses the others: its residuals
are a pattern over the frame, not the scatter of single stars.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from celnav.calibrating.blind_start import Start
from celnav.calibrating.bundle import Bundle
from celnav.calibrating.frames import CalibrationFrame, Sky
from celnav.calibrating.growth import grow
from celnav.calibrating.joint_fit import JointFit
from celnav.calibrating.star_matching import match_frame
from celnav.identification.verification import rotation_of

F8 = NDArray[np.float64]

FALSE_ALARM = 1e-3
# Of the scatter of single stars: a larger pattern is reason to look for another lens. Few stars hide one twice as large.
SUSPECT = 0.5
# Radians from the middle of the picture to the axis, and directions: a start 0.2 rad off still grows.
_AWAY_RAD, _DIRECTIONS = (0.3, 0.6), 8
STARTS = len(_AWAY_RAD) * _DIRECTIONS
# Of the polynomials in u and v that a pattern is sought with.
_DEGREE = 4
_FEWEST_FREE = 2
_RADIUS_PX = 1.5


def is_patterned(fit: JointFit, times: float = 1.0) -> bool:
    """Tell whether the residuals are a pattern larger than `times` the scatter of single stars; too few stars tell nothing.

    An F test of polynomials of fourth degree over the frame. Where the pattern is at most so large, F has at most the
    noncentral distribution whose noncentrality is the number of residuals times `times` squared, and exceeds the bound with
    a probability of `FALSE_ALARM` at most.
    """
    return patterned(fit.seen.uv, fit.residual_px / fit.seen.sigma_px[:, None], times)


def patterned(uv: F8, residual: F8, times: float = 1.0) -> bool:
    """The test of `is_patterned`, of residuals over their standard deviations up to a common factor, shape (n, 2)."""
    from scipy.special import ncfdtr

    at = (uv - uv.mean(axis=0)) / np.maximum(uv.std(axis=0), 1e-9)
    powers = [(i, j) for i in range(_DEGREE + 1) for j in range(_DEGREE + 1 - i)]
    terms = np.column_stack([at[:, 0] ** i * at[:, 1] ** j for i, j in powers])
    used, free = 2 * len(powers), 2 * (len(uv) - len(powers))
    if free < 2 * _FEWEST_FREE:
        return False
    shared = terms @ np.linalg.lstsq(terms, residual, rcond=None)[0]
    left = float(np.sum((residual - shared) ** 2))
    ratio = float(np.sum(shared**2)) / used / max(left / free, 1e-300)
    return bool(ncfdtr(used, free, 2.0 * len(uv) * times**2, ratio) > 1 - FALSE_ALARM)


def starts_beside(start: Start) -> Iterator[Start]:
    """Starts that see the middle as `start` does, with the lens' axis away from it; the scale there is the mean of both."""
    camera = start.camera
    for away in _AWAY_RAD:
        f_px = math.sqrt(camera.f_px * camera.fy_px * away / math.sin(away))
        for turn in np.arange(_DIRECTIONS) * 2 * math.pi / _DIRECTIONS:
            u, v = math.cos(turn), math.sin(turn)
            beside = replace(
                camera,
                f_px=f_px,
                fy_px=f_px,
                cx_px=camera.cx_px - away * f_px * u,
                cy_px=camera.cy_px - away * f_px * v,
            )
            rotation = rotation_of(away * np.array([-v, u, 0.0])) @ start.rotation
            yield replace(start, camera=beside, rotation=rotation)


def grow_beside(frame: CalibrationFrame, sky: Sky, start: Start) -> Bundle:
    """Fit lens and attitude from the middle outwards from each of `starts_beside`, and return what chance explains least."""
    none = np.zeros(len(sky.dirs), dtype=np.intp)
    grown = [grow(frame, sky, one) for one in starts_beside(start)]
    return min(grown, key=lambda one: match_frame(frame, sky, one.predict(sky.dirs, none), _RADIUS_PX).log10_chance)
