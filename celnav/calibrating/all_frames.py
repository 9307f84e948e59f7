"""Frame-by-frame identification: the first frame whose centre can be identified gives a lens for all the others."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from celnav.calibrating.below_horizon import HIGHEST_DEG, stars_below
from celnav.calibrating.beside_axis import SURE_PX, follows, lens_outwards, scatter_px
from celnav.calibrating.blind_start import PASSES, Start, find_start, identify_with, is_mirrored, is_narrow
from celnav.calibrating.bundle import Bundle, adjust
from celnav.calibrating.frames import CalibrationFrame, Sky, sky_over
from celnav.calibrating.growth import grow, observations
from celnav.calibrating.joint_fit import MOST_LOG10_CHANCE, Field, JointFit, NothingNamedError, refine
from celnav.calibrating.star_matching import match_frame
from celnav.errors import CalibrationError

F8 = NDArray[np.float64]

_MOUNT_RADII_PX = (10.0, 5.0, 3.0)
# For each matching radius: limiting magnitude, and the least number of stars in the frame (if need be, fainter ones).
_MOUNT_DEPTHS = ((3.5, 12), (4.5, 30), (5.5, 80))
# Number of frames on which a guess is tried, at 0.04 s each.
_GUESSED_FRAMES = 50
# If more than this fraction of a frame's stars is below the horizon, place or time are wrong.
_MOST_BELOW = 0.05


def first_frame(field: Field, guess: Start | None = None) -> tuple[int, Bundle]:
    """Find lens and attitude from the first frame whose centre shows stars that can be identified.

    `guess` is a camera whose focal length is known within 6 %. If the lens does not follow the stars outwards, the
    identification was by chance, and the next frame is tried.
    """
    left = ""
    for i, start in _starts(field, guess):
        part = field.take([i]).as_deep_as(start.camera)
        frame, sky = part.frames[0], part.skies[0]
        if float((start.rotation.T @ middle_axis(start))[2]) < math.sin(math.radians(-20)):
            raise CalibrationError(
                f"frame {frame.name}: {start.stars} stars are identified, but they lie below the horizon of the place at "
                "that time: check latitude, longitude (east is positive) and time"
            )
        bundle = grow(frame, sky, start)
        if not is_narrow(start.camera):
            fit, is_beside = lens_outwards(frame, sky, start, bundle, SURE_PX)
            if fit is not None and not follows(fit, frame):
                left = left or (
                    f"frame {frame.name}: {len(fit.seen)} stars are identified near the middle, but no lens follows them "
                    f"outwards ({scatter_px(fit):.1f} px): is the picture cut from one side of a larger one, or are lamps "
                    "and hot pixels its brightest lights? Give other frames, a mask of what is not sky, or a camera"
                )
                continue
            if fit is not None and is_beside:
                bundle = replace(fit.bundle, cov=None, turn_cov=None, turn_by_lens=None)
        if _bound(part, 0, bundle, math.inf) < MOST_LOG10_CHANCE:
            _refuse_below_horizon(frame, sky, start)
            return i, bundle
    if left:
        raise NothingNamedError(left)
    fullest = max(range(len(field.frames)), key=lambda i: len(field.frames[i].uv))
    if is_mirrored(field.frames[fullest], field.skies[fullest]):
        raise CalibrationError("the frames show the sky mirrored: turn the rows of the images over")
    raise NothingNamedError(
        "no frame shows stars that could be named in its middle: give a clearer frame, longer exposures or a camera; pixels "
        "that are not square need one with f_px and fy_px (--camera)"
    )


def _refuse_below_horizon(frame: CalibrationFrame, sky: Sky, start: Start) -> None:
    """Raise if a frame, with its lens fitted to the stars of the whole sky, shows stars below the horizon of the place."""
    if is_narrow(start.camera):  # the check of the frame's centre has decided already
        return
    whole = sky_over(sky.site, sky.utc, lowest_deg=-90.0)
    bundle = grow(frame, whole, start)
    predicted = bundle.predict(whole.dirs, np.zeros(len(whole.dirs), dtype=np.intp))
    match = match_frame(frame, whole, predicted, 3.0)
    seen, chance = stars_below(frame, whole, bundle, match.limiting_mag)
    if seen > _MOST_BELOW * len(match.star) and chance < MOST_LOG10_CHANCE:
        raise CalibrationError(
            f"frame {frame.name}: {seen} stars are seen that stand more than {-HIGHEST_DEG:g} deg below the horizon of the "
            "place at that time: check latitude, longitude (east is positive) and time"
        )


def _starts(field: Field, guess: Start | None) -> Iterator[tuple[int, Start]]:
    """Yield frames whose centre can be identified, with their starts: with the guess first, then by a blind search."""
    if guess is not None:
        for i, (frame, sky) in enumerate(zip(field.frames, field.skies, strict=True)):
            if i < _GUESSED_FRAMES and (start := identify_with(frame, sky, guess.camera, guess.reach_px)) is not None:
                yield i, start
    for each in PASSES:
        count = len(field.frames)
        for i in np.unique(np.linspace(0, count - 1, min(count, each.frames)).round().astype(int)).tolist():
            if (start := find_start(field.frames[i], field.skies[i], (each,))) is not None:
                yield i, start


def middle_axis(start: Start) -> F8:
    """Direction of the centre of the frame, camera frame."""
    camera = start.camera
    return np.asarray(camera.to_rays([[(camera.width - 1) / 2, (camera.height - 1) / 2]])[0])


def _bound(field: Field, number: int, bundle: Bundle, faintest_mag: float) -> float:
    sky = field.skies[number]
    predicted = bundle.predict(sky.dirs, np.zeros(len(sky.dirs), dtype=np.intp))
    return match_frame(field.frames[number], sky, predicted, 3.0, faintest_mag=faintest_mag).log10_chance


def attitude_of(field: Field, number: int, lens: Bundle, near: list[F8]) -> F8 | None:
    """Find the attitude of a frame with a known lens, near those of other frames or else blindly; None if both fail."""
    frame, sky, usable = field.frames[number], field.skies[number], field.usable[number]
    none = np.zeros(len(sky.dirs), dtype=np.intp)
    infinite = np.full(len(lens.values), 1e18)
    best: tuple[float, F8] | None = None
    for rotation in near:
        bundle = replace(lens, rotations=rotation[None], cov=None)
        match = None
        for radius, (v_mag, stars) in zip(_MOUNT_RADII_PX, _MOUNT_DEPTHS, strict=True):
            predicted = bundle.predict(sky.dirs, none)
            faintest = max(v_mag, sky.magnitude_of(predicted, frame.size, stars))
            match = match_frame(frame, sky, predicted, radius, faintest_mag=faintest, usable=usable)
            if len(match.detection) < 6:
                break
            seen = observations([frame], [sky], [match])
            bundle = adjust(bundle, seen, seen.frame, robust=True, prior=infinite)
        if match is not None and (best is None or match.log10_chance < best[0]):
            best = match.log10_chance, bundle.rotations[0]
        if best is not None and best[0] < 3 * MOST_LOG10_CHANCE:
            return best[1]
    if best is not None and best[0] < MOST_LOG10_CHANCE:
        return best[1]
    camera = lens.form.camera(lens.values, lens.size)
    start = identify_with(frame, sky, camera, math.hypot(*frame.size))
    if start is None or abs(math.log(start.camera.f_px / camera.f_px)) > 0.02:
        return None
    return start.rotation


def fit_all(field: Field, guess: Start | None = None) -> tuple[list[int], Field, JointFit]:
    """Fit one general lens to all frames, and an attitude to each frame.

    Returns
    -------
    list of int, Field, JointFit
        Numbers of the frames that could be used, the field of these frames, and the fit.
    """
    number, lens = first_frame(field, guess)
    field = field.as_deep_as(lens.form.camera(lens.values, lens.size))
    attitudes: dict[int, F8] = {number: lens.rotations[0]}
    # Frames closest in time come first, because their attitudes are the most similar.
    order = sorted(range(len(field.frames)), key=lambda i: abs(field.frames[i].utc.mjd - field.frames[number].utc.mjd))
    for i in order:
        if i in attitudes:
            continue
        near = [
            attitudes[j]
            for j in sorted(attitudes, key=lambda j: abs(field.frames[j].utc.mjd - field.frames[i].utc.mjd))
        ]
        found = attitude_of(field, i, lens, near[:2])
        if found is not None:
            attitudes[i] = found
    used = sorted(attitudes)
    part = field.take(used)
    bundle = replace(lens, rotations=np.stack([attitudes[i] for i in used]), cov=None)
    group = np.arange(len(used))
    form = replace(lens.form, decentring=True)
    bundle = replace(bundle, form=form, values=np.append(bundle.values, [0.0, 0.0]))
    return used, part, refine(part, bundle, group, held_back=True)
