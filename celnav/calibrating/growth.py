"""Growth from a start that holds near the axis to the whole frame: the lens is fitted to a disk that expands outwards."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from celnav.calibrating.blind_start import Start, is_narrow
from celnav.calibrating.bundle import Bundle, Observations, adjust, residuals
from celnav.calibrating.frames import CalibrationFrame, Sky
from celnav.calibrating.lens_form import LensForm
from celnav.calibrating.star_matching import Match, match_frame

F8 = NDArray[np.float64]

# Kannala-Brandt's odd polynomial is general: it can follow each of the laws over the field of that law.
GENERAL = LensForm("kannala_brandt", 4)
GROWTH = 1.15
# Stars used during the growth: down to this magnitude, and at least this many in the frame.
_FIRST_MAG, _STARS_IN_FRAME = 6.5, 80
_WIDEST_RADIUS_PX, _NARROWEST_RADIUS_PX = 6.0, 1.5
# Prior standard deviations of the terms, for where few stars constrain them. For comparison, the terms of the tangent, the
# steepest law, are 1/3, 2/15, 17/315, ...
_TERM_SIGMAS = (0.3, 0.2, 0.1, 0.05)
_CORNER_SIGMA = 0.01
CENTRE_SIGMA = 0.05  # of the frame's width
FEWEST = 12


def grow(frame: CalibrationFrame, sky: Sky, start: Start) -> Bundle:
    """Fit lens and attitude of one frame from its centre outwards; with an aspect if the start has one."""
    width, height = frame.size
    middle = np.array([(width - 1) / 2, (height - 1) / 2])
    camera = start.camera
    square = camera.fy_px == camera.f_px
    form = replace(GENERAL, aspect=not square)
    focal = [math.sqrt(camera.f_px * camera.fy_px)] if square else [camera.f_px, camera.fy_px]
    values = np.array([*focal, camera.cx_px, camera.cy_px, 0.0, 0.0, 0.0, 0.0])
    expected = CENTRE_SIGMA * max(frame.size) if is_narrow(camera) else math.inf
    bundle = Bundle(form, frame.size, values, start.rotation[None], centre_sigma_px=expected)
    corner, reach, radius = math.hypot(width, height) / 2, start.reach_px, _WIDEST_RADIUS_PX
    while True:
        for _ in range(2):
            predicted = bundle.predict(sky.dirs, np.zeros(len(sky.dirs), dtype=np.intp))
            faintest = max(_FIRST_MAG, sky.magnitude_of(predicted, frame.size, _STARS_IN_FRAME))
            match = match_frame(frame, sky, predicted, radius, faintest_mag=faintest, region=(middle, reach))
            if len(match.detection) < FEWEST:
                break
            seen = observations([frame], [sky], [match])
            bundle = adjust(bundle, seen, seen.frame, robust=True, prior=held(form, bundle))
            spread = robust_sigma(residuals(bundle, seen, seen.frame))
            radius = min(max(5 * spread, _NARROWEST_RADIUS_PX), _WIDEST_RADIUS_PX)
        if reach >= corner:
            return bundle
        reach = min(reach * GROWTH, corner)
        radius = min(1.6 * radius + 1.0, _WIDEST_RADIUS_PX)


def held(form: LensForm, bundle: Bundle) -> F8:
    """Return weights, shape (m,), that hold the axis to the frame's centre and the lens to r = f theta if stars are few."""
    weights, size = np.zeros(len(form.names)), bundle.size
    corner = math.hypot(*size) / 2 / float(bundle.values[0])
    for column, name in enumerate(form.names):
        if name in ("cx_px", "cy_px"):
            weights[column] = 1 / (CENTRE_SIGMA * max(size)) ** 2
        elif name.startswith("k"):
            # Long lenses also distort by a fraction of the distance to the corner.
            usual = _CORNER_SIGMA / corner**2 if name == "k1" else 0.0
            weights[column] = 1 / max(_TERM_SIGMAS[int(name[1:]) - 1], usual) ** 2
    return weights


def observations(frames: list[CalibrationFrame], skies: list[Sky], matches: list[Match]) -> Observations:
    """Gather the pairs of all frames, with standard deviations of one pixel."""
    parts = list(enumerate(zip(frames, skies, matches, strict=True)))
    return Observations(
        np.concatenate([frame.uv[match.detection] for _, (frame, _, match) in parts]),
        np.concatenate([sky.dirs[match.star] for _, (_, sky, match) in parts]),
        np.ones(sum(len(match.star) for match in matches)),
        np.concatenate([np.full(len(match.star), i, dtype=np.intp) for i, (_, _, match) in parts]),
        np.concatenate([match.detection for match in matches]),
        np.concatenate([match.star for match in matches]),
        np.concatenate([match.pull_px for match in matches]),
    )


def robust_sigma(residual: F8) -> float:
    """Return the standard deviation along an axis, from the median length of the residuals, shape (n, 2)."""
    return 1.4826 * float(np.median(np.abs(residual[np.isfinite(residual[:, 0])])))
