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

from celnav.calibrating.blind_start import Start, is_narrow
from celnav.calibrating.bundle import Bundle
from celnav.calibrating.frames import CalibrationFrame, Sky
from celnav.calibrating.growth import grow
from celnav.calibrating.joint_fit import MOST_LOG10_CHANCE, Field, JointFit, refine
from celnav.calibrating.star_matching import match_frame
from celnav.errors import CalibrationError
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
# Of the frame's longer side: in a narrow field the principal point is one with the orientation, and is left in the middle.
_NARROW_CENTRE = 0.002
# Beyond it the lens does not follow the stars.
_MOST_SCATTER_PX = 1.0
SURE_PX = 0.4
"""Residuals that are a pattern and larger may be those of chance's names, which scatter by 0.75 px within a radius of 1.5."""
# Of the standard deviations that detection gave.
_SUSPECT_SIGMAS = 3.0


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


def lens_outwards(
    frame: CalibrationFrame, sky: Sky, start: Start, grown: Bundle, least_px: float = 0.0
) -> tuple[JointFit | None, bool]:
    """Fit a lens that has grown over one frame; where it leaves a pattern, or scatters, also one with its axis beside it.

    Parameters
    ----------
    frame, sky
        The frame, and the stars that it may show.
    start, grown
        From `growth.grow`.
    least_px : float
        Scatter that is no reason for another lens, whatever detection claims.

    Returns
    -------
    The fit, None where it names no more stars than chance; and whether its axis is one of `starts_beside`.
    """
    narrow = is_narrow(start.camera)
    fit = _fitted(frame, sky, grown, narrow)
    most_log10, is_beside = MOST_LOG10_CHANCE, False
    if fit is not None and _is_suspect(fit, frame, least_px):
        fit = _decentred(frame, sky, fit)
    if not narrow and (fit is None or _is_suspect(fit, frame, least_px)):
        beside = _fitted(frame, sky, grow_beside(frame, sky, start), narrow)
        tries_log10 = math.log10(1 + STARTS)
        if fit is None or (beside is not None and _log10_chance(beside) + tries_log10 < _log10_chance(fit)):
            fit, most_log10, is_beside = beside, most_log10 - tries_log10, True
    return (None if fit is None or _log10_chance(fit) > most_log10 else fit), is_beside


def follows(fit: JointFit, frame: CalibrationFrame) -> bool:
    """Tell whether a lens follows the stars of its frame outwards, not lights that chance puts near their places."""
    scatter, usual = scatter_px(fit), _SUSPECT_SIGMAS * _usual_sigma(frame)
    return not (scatter > max(_MOST_SCATTER_PX, usual) or (scatter > max(SURE_PX, usual) and is_patterned(fit)))


def scatter_px(fit: JointFit) -> float:
    """Root mean square of the residuals along an axis, pixels."""
    return math.sqrt(float((fit.residual_px**2).mean()))


def _fitted(frame: CalibrationFrame, sky: Sky, begun: Bundle, narrow: bool) -> JointFit | None:
    """Match and adjust what has grown; None where that names too few stars, or no more than chance."""
    if narrow:
        begun = replace(begun, centre_sigma_px=_NARROW_CENTRE * max(frame.size))
    field = Field([frame], [sky], [np.ones(len(frame.uv), dtype=bool)])
    try:
        fit = refine(field, begun, np.zeros(1, dtype=np.intp), held_back=True)
    except CalibrationError:
        return None
    return None if _log10_chance(fit) > MOST_LOG10_CHANCE else fit


def _decentred(frame: CalibrationFrame, sky: Sky, fit: JointFit) -> JointFit:
    """Let the lens be decentred, which a plain one of many stars may be seen to need; the better of the two."""
    plain = fit.bundle
    form, values = replace(plain.form, decentring=True), np.append(plain.values, [0.0, 0.0])
    bundle = replace(plain, form=form, values=values, cov=None, turn_cov=None, turn_by_lens=None)
    narrow = math.isfinite(plain.centre_sigma_px)
    other = _fitted(frame, sky, bundle, narrow)
    return fit if other is None or is_patterned(other) else other


def _is_suspect(fit: JointFit, frame: CalibrationFrame, least_px: float) -> bool:
    """Tell whether another lens may fit better: a pattern is left, or stars scatter as wrong names do, not as detected."""
    return is_patterned(fit, SUSPECT) or scatter_px(fit) > max(least_px, _SUSPECT_SIGMAS * _usual_sigma(frame))


def _log10_chance(fit: JointFit) -> float:
    """Logarithm of the probability that chance names as many stars."""
    return fit.matches[0].log10_chance


def _usual_sigma(frame: CalibrationFrame) -> float:
    """Median of the standard deviations that detection gave the positions, pixels."""
    sigma_px = frame.detections.sigma_px
    return 0.0 if sigma_px is None else float(np.median(sigma_px))
