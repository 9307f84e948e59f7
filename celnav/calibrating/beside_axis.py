"""Pictures cut from one side of a larger one: starts with an off-centre axis, and the test that calls for them.

Near its axis a lens follows r = f theta, alike in all directions. Away from the axis, the plate scales of a fisheye along and
across the radius differ, by 6 % at 35 deg. A lens centred on such a picture identifies the stars in the middle and misses the
others: its residuals form a pattern over the frame instead of the scatter of single stars.
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
# A pattern larger than this fraction of the scatter of single stars is a reason to look for another lens. With few stars, one
# twice as large goes unnoticed.
SUSPECT = 0.5
# Distances from the centre of the picture to the axis, rad, and number of directions; a start 0.2 rad off still grows.
_AWAY_RAD, _DIRECTIONS = (0.3, 0.6), 8
STARTS = len(_AWAY_RAD) * _DIRECTIONS
# Degree of the polynomials in u and v that are fitted to find a pattern.
_DEGREE = 4
_FEWEST_FREE = 2
_RADIUS_PX = 1.5
# Standard deviation of the principal point, as a fraction of the frame's longer side. In a narrow field the principal point
# cannot be separated from the orientation, and is kept at the centre.
_NARROW_CENTRE = 0.002
# With more scatter, the lens does not follow the stars.
_MOST_SCATTER_PX = 1.0
SURE_PX = 0.4
"""Larger patterned residuals may come from chance matches, which scatter by 0.75 px within a matching radius of 1.5."""
# Scatter, in multiples of the standard deviations from detection, beyond which another lens is tried.
_SUSPECT_SIGMAS = 3.0


def is_patterned(fit: JointFit, times: float = 1.0) -> bool:
    """Return whether the residuals have a pattern larger than `times` the scatter of single stars; False with too few stars.

    This is an F test of polynomials of fourth degree over the frame. If the pattern is not larger, F has at most the
    noncentral distribution whose noncentrality is the number of residuals times `times` squared, and exceeds the bound with
    a probability of at most `FALSE_ALARM`.
    """
    return patterned(fit.seen.uv, fit.residual_px / fit.seen.sigma_px[:, None], times)


def patterned(uv: F8, residual: F8, times: float = 1.0) -> bool:
    """Apply the test of `is_patterned` to residuals, shape (n, 2), over their standard deviations up to a common factor."""
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
    """Yield starts that agree with `start` at the centre but have the lens axis elsewhere.

    The plate scale at the centre is the geometric mean of the radial and the tangential scale.
    """
    camera = start.camera
    aspect = math.sqrt(camera.fy_px / camera.f_px)
    for away in _AWAY_RAD:
        f_px = math.sqrt(camera.f_px * camera.fy_px * away / math.sin(away)) / aspect
        fy_px = f_px * aspect**2
        for turn in np.arange(_DIRECTIONS) * 2 * math.pi / _DIRECTIONS:
            u, v = math.cos(turn), math.sin(turn)
            beside = replace(
                camera,
                f_px=f_px,
                fy_px=fy_px,
                cx_px=camera.cx_px - away * f_px * u,
                cy_px=camera.cy_px - away * fy_px * v,
            )
            rotation = rotation_of(away * np.array([-v, u, 0.0])) @ start.rotation
            yield replace(start, camera=beside, rotation=rotation)


def grow_beside(frame: CalibrationFrame, sky: Sky, start: Start) -> Bundle:
    """Fit lens and attitude outwards from each of `starts_beside`; return the result that is least likely by chance."""
    none = np.zeros(len(sky.dirs), dtype=np.intp)
    grown = [grow(frame, sky, one) for one in starts_beside(start)]
    return min(grown, key=lambda one: match_frame(frame, sky, one.predict(sky.dirs, none), _RADIUS_PX).log10_chance)


def lens_outwards(
    frame: CalibrationFrame, sky: Sky, start: Start, grown: Bundle, least_px: float = 0.0
) -> tuple[JointFit | None, bool]:
    """Fit a lens that has grown over one frame; if a pattern or scatter remains, also try one with its axis off-centre.

    Parameters
    ----------
    frame, sky
        The frame, and the stars that it may show.
    start, grown
        Input and result of `growth.grow`.
    least_px : float
        Scatter that is never a reason for another lens, whatever the standard deviations from detection.

    Returns
    -------
    JointFit or None, bool
        The fit, or None if it identifies no more stars than chance; and whether its axis is one of `starts_beside`.
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
    """Return whether a lens follows the stars of its frame outwards, rather than lights that are near them by chance."""
    scatter, usual = scatter_px(fit), _SUSPECT_SIGMAS * _usual_sigma(frame)
    return not (scatter > max(_MOST_SCATTER_PX, usual) or (scatter > max(SURE_PX, usual) and is_patterned(fit)))


def scatter_px(fit: JointFit) -> float:
    """Return the root mean square of the residuals along an axis, pixels."""
    return math.sqrt(float((fit.residual_px**2).mean()))


def _fitted(frame: CalibrationFrame, sky: Sky, begun: Bundle, narrow: bool) -> JointFit | None:
    """Match and adjust a grown lens; None if that identifies too few stars, or no more than chance."""
    if narrow:
        begun = replace(begun, centre_sigma_px=_NARROW_CENTRE * max(frame.size))
    field = Field([frame], [sky], [np.ones(len(frame.uv), dtype=bool)])
    try:
        fit = refine(field, begun, np.zeros(1, dtype=np.intp), held_back=True)
    except CalibrationError:
        return None
    return None if _log10_chance(fit) > MOST_LOG10_CHANCE else fit


def _decentred(frame: CalibrationFrame, sky: Sky, fit: JointFit) -> JointFit:
    """Also fit a decentred lens, which many stars may show to be necessary; return the better of the two."""
    plain = fit.bundle
    form, values = replace(plain.form, decentring=True), np.append(plain.values, [0.0, 0.0])
    bundle = replace(plain, form=form, values=values, cov=None, turn_cov=None, turn_by_lens=None)
    narrow = math.isfinite(plain.centre_sigma_px)
    other = _fitted(frame, sky, bundle, narrow)
    return fit if other is None or is_patterned(other) else other


def _is_suspect(fit: JointFit, frame: CalibrationFrame, least_px: float) -> bool:
    """Return whether another lens may fit better: a pattern remains, or stars scatter more than detection explains."""
    return is_patterned(fit, SUSPECT) or scatter_px(fit) > max(least_px, _SUSPECT_SIGMAS * _usual_sigma(frame))


def _log10_chance(fit: JointFit) -> float:
    """Return the decimal logarithm of the probability that chance identifies as many stars."""
    return fit.matches[0].log10_chance


def _usual_sigma(frame: CalibrationFrame) -> float:
    """Return the median of the standard deviations of the positions from detection, pixels."""
    sigma_px = frame.detections.sigma_px
    return 0.0 if sigma_px is None else float(np.median(sigma_px))
