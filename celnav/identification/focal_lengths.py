"""The order of searches: near a last known position, the whole sky, and the whole sky at other focal lengths."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from celnav.identification.effort import Effort
from celnav.identification.frame_grid import frame_grid
from celnav.identification.identify import Identified, identify
from celnav.identification.question import Question
from celnav.identification.search_config import SearchConfig
from celnav.identification.sky_index import SkyIndex
from celnav.identification.verification import WHOLE_SKY


def identify_at_focal_lengths(
    question: Question,
    index: SkyIndex,
    config: SearchConfig,
    factors: Iterable[float],
    effort: Effort,
    share: float,
) -> Identified:
    """Find the orientation with the camera as supplied and, if that fails, with other focal lengths in turn.

    The neighbourhood of a last known position is searched first, with `SearchConfig.near_share` of the effort. The whole
    sky, searched after that, may contradict it; the caller must judge that.

    Parameters
    ----------
    question, index, config
        As for `identify`, which tolerates a focal length that is off by 6 %.
    factors : iterable of float
        Factors on the focal length. They are used only if detections are ordered by brightness; without an order, the
        search takes several times as long.
    effort : Effort
        Budget of all searches together; their false-alarm bounds count what all of them have tried.
    share : float
        Fraction of the effort that is reserved for each factor.

    Returns
    -------
    Identified
        Detections are rows of the question, and `log_f` is relative to the focal length of its camera.
    """
    others = tuple(factors) if question.ranked else ()
    told = 1 if question.local is None else 2
    question = replace(question, searches=(1 + len(others)) * told + (question.near is not None))
    if question.near is not None:
        effort.allow(config.near_share * effort.max_work)
        found = identify(question, index, config, effort)
        if found.alignment is not None:
            return found
        question = replace(question, near=None)
    work_each = int(share * effort.max_work)
    kept = config.kept_for_rival(effort.max_work)
    as_given = effort.max_work - kept - len(others) * work_each - effort.work
    found = _identify_as_told(question, index, config, effort, as_given)
    for factor in others:
        if found.alignment is not None:
            break
        scaled, rows = _with_focal_length(question, factor)
        if not len(rows):
            continue
        found = _identify_as_told(scaled, index, config, effort, work_each)
        if found.alignment is not None:
            alignment = found.alignment
            found = replace(
                found,
                alignment=replace(
                    alignment, log_f=alignment.log_f + math.log(factor), detection=rows[alignment.detection]
                ),
            )
    return found


def _identify_as_told(
    question: Question, index: SkyIndex, config: SearchConfig, effort: Effort, work: int
) -> Identified:
    """Search with the supplied attitude if hypotheses come from it, and then without it, in case the mount has moved."""
    begun = effort.work
    if question.local is not None:
        effort.allow(config.told_share * work)
        found = identify(question, index, config, effort)
        if found.alignment is not None:
            return found
        question = replace(question, local=None, region=WHOLE_SKY)
    effort.allow(work - (effort.work - begun))
    return identify(question, index, config, effort)


def _with_focal_length(question: Question, factor: float) -> tuple[Question, NDArray[np.intp]]:
    """Scale the camera's focal length; also return the rows of the detections that such a camera can produce."""
    given = question.camera
    camera = replace(given, f_px=given.f_px * factor, fy_px=given.fy_px * factor)
    rays = camera.to_rays(question.uv)
    rows = np.flatnonzero(np.isfinite(rays[:, 0]))
    scaled = replace(
        question,
        camera=camera,
        uv=question.uv[rows],
        rays=rays[rows],
        mag=None if question.mag is None else question.mag[rows],
        solid_angle_sr=frame_grid(camera).solid_angle_sr,
    )
    return scaled, rows
